"""The compiled engine gives the bits of plain Python, and notices when its sources change."""

import os
import re
import subprocess
import sys
import textwrap

import numba
import numpy as np
import pytest

from qcar_env.control import CNVC, LAWS, LNVC, NDF
from qcar_env.envs import task
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.physics import engine, engine_continuous, engine_random, engine_sampled, roads
from qcar_env.physics.closed_loop import (
    REST,
    ControlledState,
    Limits,
    add_controlled,
    advance_controlled,
    controlled_rate,
    no_filter,
    saturate,
    saturated_rate,
)
from qcar_env.physics.dynamics import Coefficients
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.forcing import Amplitudes, MiddleAmplitudes, Passage, World
from qcar_env.physics.motion import plant, world_at
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.roads import Phasor
from qcar_env.physics.state import Filter, State
from qcar_env.scenarios import PAPER_CAR, PAPER_FORCE

STEP = 1e-3
ROADS = {
    "harmonic": roads.harmonic(h=0.1, omega=55.0),
    "hump": roads.hump(h=0.1, omega=55.0, start=0.01234),
    "train": roads.train(h=0.1, omega=200.0, count=3, gap=0.7, start=0.02),
    "kinks on the grid": roads.hump(h=0.1, omega=np.pi / 0.032, start=0.016),
    "step": roads.step(h=0.05, start=0.0333),
}


def columns(road, force, law, start, limits=(1e300, 1e300), step=STEP):
    """Return the slab rows of one car, shape (rows, 1)."""
    one, world = plant(PAPER_CAR, road, force, step), world_at(0.0, road, force)
    rows = np.zeros((engine_continuous.ROWS, 1))
    column = [*start, *REST, *world.road, *world.force, *one.passage.by.road]
    column += [*one.passage.by.force, *one.passage.middle]
    column += [*one.car, *one.amplitudes, *limits, *one.road, road.next_kink(0.0), one.Omega]
    rows[: engine_continuous.WINDOW, 0] = column
    rows[engine_continuous.WINDOW] = engine.NEVER
    rows[engine_continuous.GAINS : engine_continuous.GAINS + len(law.gains), 0] = law.gains
    return rows


def in_plain_python(road, force, law, start, steps, limits=None):
    """Return the states that the engine's functions make without being compiled, (steps + 1, 8)."""
    one, world = plant(PAPER_CAR, road, force, STEP), world_at(0.0, road, force)
    rate = controlled_rate if limits is None else saturated_rate
    filter_rate = law.filter_rate or no_filter
    args = (law.command, filter_rate, law.gains, *([] if limits is None else [limits]), one.car)
    x, kink, states = ControlledState(State(*start), REST), road.next_kink(0.0), []
    for k in range(steps):
        states.append((*x.plant, *x.filter))
        if roads.kink_time(kink, one.road) < (k + 1) * STEP:
            x, world, kink = engine_continuous.forced_step_over_kinks(
                rate,
                advance_controlled,
                add_controlled,
                x,
                world,
                kink,
                k * STEP,
                (k + 1) * STEP,
                one.road,
                one.Omega,
                one.amplitudes,
                *args,
            )
        else:
            x, world = engine_continuous.forced_step(
                rate,
                advance_controlled,
                add_controlled,
                x,
                world,
                one.passage,
                one.amplitudes,
                one.step,
                *args,
            )
    states.append((*x.plant, *x.filter))
    return np.array(states)


def compiled_run(rows, law, steps, saturated=False, fused=False):
    """Return the records (steps + 1, 6, n) of the compiled engine."""
    n = rows.shape[1]
    record = np.empty((steps + 1, 6, n))
    slabs = engine.slabs(rows)
    kernel = engine_continuous.closed_loop_kernel(
        law.command, law.filter_rate, type(law.gains), saturated, fused=fused
    )
    kernel(slabs, 0, slabs.shape[0], n, step_fractions(STEP), steps, 1, 1, record)
    return record


@pytest.mark.parametrize("road", ROADS.values(), ids=ROADS)
@pytest.mark.parametrize("law", [CNVC(), NDF()], ids=lambda law: law.name)
def test_compiled_equals_plain_python_bit_for_bit(law, road):
    start = (0.01, -0.02, 0.3, 0.4)
    expected = in_plain_python(road, PAPER_FORCE, law, start, steps=100)
    record = compiled_run(columns(road, PAPER_FORCE, law, start), law, steps=100)
    np.testing.assert_array_equal(record[:, :4, 0], expected[:, :4])


def test_saturated_compiled_equals_plain_python_bit_for_bit():
    road, law, start = ROADS["train"], NDF(G1=200.0, G2=200.0), (0.01, -0.02, 3.0, -2.0)
    limits = Limits(3.0, 2.0)
    expected = in_plain_python(road, PAPER_FORCE, law, start, 100, limits)
    rows = columns(road, PAPER_FORCE, law, start, limits)
    record = compiled_run(rows, law, 100, saturated=True)
    np.testing.assert_array_equal(record[:, :4, 0], expected[:, :4])
    assert np.abs(record[:, 4]).max() == 3.0
    assert np.abs(record[:, 5]).max() == 2.0


def test_numpy_arrays_equal_floats_bit_for_bit():
    rng = np.random.default_rng(5)
    n, law = 7, NDF()
    x = rng.normal(size=(8, n))
    car = np.abs(rng.normal(size=(9, n)))
    world, passage, amplitudes = (
        rng.normal(size=(4, n)),
        rng.normal(size=(8, n)),
        rng.normal(size=(3, n)),
    )

    def advance(columns):
        state, c, w, p, a = columns
        return engine_continuous.forced_step(
            saturated_rate,
            advance_controlled,
            add_controlled,
            ControlledState(State(*state[:4]), Filter(*state[4:])),
            World(Phasor(*w[:2]), Phasor(*w[2:])),
            Passage(World(Phasor(*p[:2]), Phasor(*p[2:4])), MiddleAmplitudes(*p[4:])),
            Amplitudes(*a),
            step_fractions(STEP),
            law.command,
            law.filter_rate,
            law.gains,
            Limits(0.5, 0.5),
            Coefficients(*c),
        )

    together, _ = advance((x, car, world, passage, amplitudes))
    for i in range(n):
        alone, _ = advance(
            [[float(v) for v in part[:, i]] for part in (x, car, world, passage, amplitudes)]
        )
        assert tuple(v[i] for v in (*together.plant, *together.filter)) == (
            *alone.plant,
            *alone.filter,
        )


@pytest.mark.parametrize("n", [1, 2, 63, 64, 65, 200])
def test_a_car_gets_the_same_bits_whatever_its_neighbours(n):
    law, force = CNVC(), PAPER_FORCE
    kinds = list(ROADS.values())
    cars = [columns(kinds[i % 5], force, law, (1e-3 * i, 0.0, 0.1, 0.0)) for i in range(n)]
    together = compiled_run(np.concatenate(cars, axis=1), law, steps=80)
    for i in {0, n // 2, n - 1}:
        np.testing.assert_array_equal(together[:, :, i], compiled_run(cars[i], law, 80)[:, :, 0])


def test_phasors_do_not_drift():
    law, steps = LAWS["none"](), 20 * engine_continuous.RESEED + 500
    rows = columns(ROADS["harmonic"], ExternalForce(f=1.0, Omega=31.0), law, (0, 0, 0, 0))
    slabs = engine.slabs(rows)
    kernel = engine_continuous.closed_loop_kernel(law.command, None, type(law.gains), False)
    kernel(slabs, 0, 1, 1, step_fractions(STEP), steps, 1, 0, np.empty((0, 6, 1)))
    end = engine.from_slabs(slabs, 1)[engine_continuous.ROAD : engine_continuous.ROAD + 4, 0]
    t = steps * STEP
    exact = [np.sin(55.0 * t), np.cos(55.0 * t), np.sin(31.0 * t), np.cos(31.0 * t)]
    # an angle of 1e3 rad is itself rounded by 1e-13; half a thousand turns add about as much
    np.testing.assert_allclose(end, exact, atol=1e-12, rtol=0)


def test_streams_are_numpys():
    seeds = [0, 1, 2**70, 123456789]
    states, drawn = engine_random.streams(seeds), np.empty((4, 50))
    uniform = engine_random.uniform

    @numba.njit
    def draw(states, drawn):
        for i in range(drawn.shape[0]):
            for k in range(drawn.shape[1]):
                drawn[i, k] = uniform(states, i)

    draw(states, drawn)
    expected = [np.random.Generator(np.random.PCG64(seed)).random(50) for seed in seeds]
    np.testing.assert_array_equal(drawn, expected)


def test_slabs_round_trip():
    rows = np.arange(3 * 130.0).reshape(3, 130)
    slabs = engine.slabs(rows)
    assert slabs.shape == (3, 3 * engine.LANES)
    assert slabs[1, 2 * engine.LANES + 5] == rows[2, engine.LANES + 5]
    np.testing.assert_array_equal(engine.from_slabs(slabs, 130), rows)


@pytest.mark.parametrize("work", [1, 10**9])
def test_every_block_runs_once(work):
    seen = []
    engine.over_blocks(lambda begin, end: seen.extend(range(begin, end)), blocks=7, work=work)
    assert sorted(seen) == list(range(7))


@pytest.mark.parametrize("u", [-3.0, -2.0, -0.1, 0.0, 0.1, 2.0, 3.0])
def test_saturation_keeps_the_bits_inside_and_the_limit_outside(u):
    assert saturate(u, 2.0) == min(max(u, -2.0), 2.0)
    assert saturate(np.array([u]), 2.0)[0] == saturate(u, 2.0)
    assert np.isnan(saturate(np.nan, 2.0))


PACKED_PRODUCT = r"\bv?mulpd\b|\bfmul\s+v\d+\.2d"
PACKED_MULTIPLY_ADD = r"\bvfn?m(add|sub)\d+pd\b|\bfml[as]\s+v\d+\.2d"


def count(pattern, kernel, **options):
    """Count instructions in the machine code of a kernel, compiled afresh."""
    fresh = numba.njit(nogil=True, boundscheck=False, error_model="numpy", **options)(
        kernel.py_func
    )
    (signature,) = kernel.signatures
    fresh.compile(signature)
    return len(re.findall(pattern, fresh.inspect_asm(signature)))


@pytest.mark.slow
def test_the_loops_over_cars_are_compiled_to_vector_instructions():
    """A scalar loop has no packed products; an RK4 step alone multiplies 72 times."""
    law = LNVC()
    continuous = engine_continuous.closed_loop_kernel(
        law.command, None, type(law.gains), False, fused=False
    )
    compiled_run(columns(ROADS["harmonic"], PAPER_FORCE, law, (0, 0, 0, 0)), law, 1)
    assert count(PACKED_PRODUCT, continuous) > 80  # and the law, and what is measured
    assert count(PACKED_MULTIPLY_ADD, continuous) == 0
    sampled = engine_sampled.kernels(task, task.FULL_SIZE, False, 2, False).step
    QuarterCarHumpVectorEnv(1)
    assert count(PACKED_PRODUCT, sampled) > 100  # and forces, observations, costs
    assert count(PACKED_MULTIPLY_ADD, sampled) == 0


@pytest.mark.slow
def test_fused_loops_are_compiled_to_packed_multiply_adds():
    law = LNVC()
    fused = engine_continuous.closed_loop_kernel(
        law.command, None, type(law.gains), False, fused=True
    )
    compiled_run(columns(ROADS["harmonic"], PAPER_FORCE, law, (0, 0, 0, 0)), law, 1, fused=True)
    # a sum of an RK4 step takes part in one, where it is not the sum of two rates
    assert count(PACKED_MULTIPLY_ADD, fused, fastmath={"contract"}) > 40


@pytest.mark.parametrize("road", ROADS.values(), ids=ROADS)
@pytest.mark.parametrize("law", [CNVC(), NDF()], ids=lambda law: law.name)
def test_fused_loops_equal_the_others_to_rounding(law, road):
    """Both are compiled in one process and read one cache: neither must get the other's code."""
    rows = columns(road, PAPER_FORCE, law, (0.01, -0.02, 0.3, 0.4))
    exact, fused = (compiled_run(rows, law, 1000, fused=each) for each in (False, True))
    assert not np.array_equal(exact, fused)
    # roundings of 1000 steps, none of which grows: the loops are stable
    scale = np.abs(exact).max(axis=0)
    assert np.all(np.abs(fused - exact).max(axis=0) <= 1e-13 * scale)


@pytest.mark.slow
def test_an_edited_law_is_compiled_anew(tmp_path):
    """numba's cache alone would go on using the machine code of the law before the edit."""
    package = tmp_path / "house"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "gain.py").write_text("def scaled(g, v):\n    return -g * v\n")
    (package / "law.py").write_text(
        textwrap.dedent(
            """
            from typing import NamedTuple
            from house.gain import scaled

            class Gains(NamedTuple):
                G: float

            def command(x, eta, gains):
                return scaled(gains.G, x.v1), scaled(gains.G, x.v2)
            """
        )
    )
    script = textwrap.dedent(
        """
        import numpy as np
        from house.gain import scaled
        from house.law import Gains, command
        from qcar_env.physics import engine, engine_continuous
        from qcar_env.physics.rk4 import step_fractions

        engine.compiled(scaled)
        run = engine_continuous.closed_loop_kernel(command, None, Gains, False)
        rows = np.zeros((engine_continuous.ROWS, 1))
        rows[2], rows[engine_continuous.GAINS] = 1.0, 1.0
        record = np.empty((2, 6, 1))
        run(engine.slabs(rows), 0, 1, 1, step_fractions(1e-3), 1, 1, 1, record)
        (signature,) = run.signatures
        print(record[0, 4, 0], run.stats.cache_hits[signature] if run.stats.cache_hits else 0)
        """
    )
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)]),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }

    def run():
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        u1, hits = done.stdout.split()
        return float(u1), int(hits)

    assert run() == (-1.0, 0)
    assert run() == (-1.0, 1)
    (package / "gain.py").write_text("def scaled(g, v):\n    return -2.0 * g * v\n")
    assert run() == (-2.0, 0)
