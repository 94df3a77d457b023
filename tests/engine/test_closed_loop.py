"""Compiled closed loops give the bits of plain Python, and notice when their sources change."""

import os
import re
import subprocess
import sys
import textwrap

import numba
import numpy as np
import pytest

from qcar_env.control import CNVC, LAWS, LNVC, NDF
from qcar_env.engine import closed_loop, loop_kernels
from qcar_env.engine.closed_loop import Case, drive
from qcar_env.engine.compile import LANES
from qcar_env.engine.course import course, road_functions
from qcar_env.engine.loop_kernels import NEVER, RESEED, Composition, Limits, kink_step
from qcar_env.engine.starts import Force
from qcar_env.parts.part import Nothing
from qcar_env.physics import tree
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.closed_loop import ControlledState, LoopNumbers, loop_functions
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Phasor, Phasors, given_step, turning, turning_step
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.state import State
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation
from qcar_env.roads.functions import FunctionRoad
from qcar_env.scenarios import PAPER_CAR, PAPER_FORCE

STEP = 1e-3
ROADS = {
    "harmonic": roads.harmonic(h=0.1, omega=55.0),
    "hump": roads.hump(h=0.1, omega=55.0, start=0.01234),
    "train": roads.train(h=0.1, omega=200.0, count=3, gap=0.7, start=0.02),
    "kinks on the grid": roads.hump(h=0.1, omega=np.pi / 0.032, start=0.016),
    "step": roads.step(h=0.05, start=0.0333),
    "step on the grid": roads.step(h=0.05, start=0.032),
}


def uneven(s):
    return 0.02 * s * s - 0.01 * s * s * s if s < 0.4 else 0.03 - 0.02 * s


ROADS["read"] = Excitation(road=FunctionRoad(profile=uneven, kinks_at=(0.4,)), speed=7.3)
CARS = {"paper": PAPER_CAR, "parts": QuarterCar.from_physical(45.0, 320.0, 190e3, 18e3, 80.0, 1e3)}


def case(road, force, law, start, limits=None, car=PAPER_CAR, step=STEP):
    """Return a case, and what it is made of."""
    numbers = car.numbers, road.road.numbers, road.speed, Force(force.f, force.Omega)
    functions = road_functions(type(road.road))
    made = drive(car.functions, functions, numbers, road.road.table, step)
    limits = limits or Nothing()
    state = ControlledState(State(*start), law.at_rest)
    what = Composition(
        car.functions,
        loop_kernels.loop_road(functions),
        law.functions,
        made.under(law.numbers, limits),
    )
    return Case(made, state, law.numbers, limits), what


def in_plain_python(one, what, steps):
    """Return the states of a case that the same functions make without being compiled."""
    on, fixed = course(what.road, what.car), one.drive.under(one.law, one.limits)
    loop = loop_functions(what.car, what.law, limited=isinstance(one.limits, Limits))
    x, w, kink, next = one.state, one.drive.phasors, one.drive.kink, one.drive.next
    table, step, states = one.drive.table, step_fractions(STEP), []

    def advance(x, w, prepared, size, t):
        return on.steps(
            loop.rate, x, w, prepared, step_fractions(size), 1, t, kink, (0.0, 0.0), fixed, table
        )

    for k in range(steps):
        states.append(tree.flat(x))
        t, end, usual = k * step.full, (k + 1) * step.full, fixed.turning
        if next >= end and what.road.pieces is None:
            on_road = (
                on.reading(each * step.full, kink, w, fixed, table)[2].road
                for each in (k, k + 0.5, k + 1)
            )
            x, w = given_step(loop.rate, x, w, usual, step, *on_road, (0.0, 0.0), fixed)
            continue
        if next >= end:
            x, w = advance(x, w, usual, STEP, t)
            continue
        while t < end:
            stop = min(next, end)
            if stop > t:
                prepared = turning(
                    usual.road_s, usual.road_c, usual.F, fixed.omega, fixed.force.Omega, stop - t
                )
                x, w = advance(x, w, prepared, stop - t, t)
            if next < end:
                jump = on.jump(kink, fixed, table)
                x = ControlledState(what.car.kick(x.plant, jump, fixed.car), x.filter)
                w = on.after(w, kink, fixed)
                kink += 1
                next = on.next_kink(kink, fixed.road, fixed.speed, table)
            t = stop
    states.append(tree.flat(x))
    return np.array(states)


def run(cases, steps, **options):
    """Return what the compiled engine makes of cases of one composition."""
    return closed_loop.run(
        cases[0][1], [one for one, _ in cases], step=STEP, steps=steps, every=1, **options
    )


@pytest.mark.parametrize("car", CARS.values(), ids=CARS)
@pytest.mark.parametrize("road", ROADS.values(), ids=ROADS)
@pytest.mark.parametrize("law", [CNVC(), NDF()], ids=lambda law: law.name)
def test_compiled_equals_plain_python_bit_for_bit(law, road, car):
    made = case(road, PAPER_FORCE, law, (0.01, -0.02, 0.3, 0.4), car=car)
    expected = in_plain_python(*made, steps=100)
    record = run([made], 100).record
    np.testing.assert_array_equal(record[:, :4, 0], expected[:, :4])


def test_saturated_compiled_equals_plain_python_bit_for_bit():
    law, start = NDF(G1=200.0, G2=200.0), (0.01, -0.02, 3.0, -2.0)
    made = case(ROADS["train"], PAPER_FORCE, law, start, Limits(3.0, 2.0))
    expected = in_plain_python(*made, 100)
    record = run([made], 100).record
    np.testing.assert_array_equal(record[:, :4, 0], expected[:, :4])
    assert np.abs(record[:, 4]).max() == 3.0
    assert np.abs(record[:, 5]).max() == 2.0


@pytest.mark.parametrize("held", [False, True])
def test_numpy_arrays_equal_floats_bit_for_bit(held):
    rng = np.random.default_rng(5)
    n, law, functions = 7, NDF(), PAPER_CAR.functions
    like = ControlledState(State(*(0.0,) * 4), law.at_rest)
    step = step_fractions(STEP)
    loop = loop_functions(functions, law.functions, limited=True, held=held)

    def advance(x, w, on_road, coefficients):
        c = type(PAPER_CAR.numbers)(*coefficients)
        prepared = turning(
            functions.road_input(on_road[0], 0.0, c),
            functions.road_input(0.0, on_road[0], c),
            on_road[1], 55.0, 31.0, STEP,
        )  # fmt: skip
        phasors = Phasors(Phasor(*w[:2]), Phasor(*w[2:]))
        p = LoopNumbers(c, law.numbers, Limits(0.5, 0.5))
        x, _ = turning_step(loop.rate, tree.unflat(like, x), phasors, prepared, step, (0.1, 0.2), p)
        return tree.flat(x)

    given = [rng.normal(size=(8, n)), rng.normal(size=(4, n)), rng.normal(size=(2, n))]
    given.append(np.abs(rng.normal(size=(9, n))))
    together = advance(*given)
    for i in range(n):
        alone = advance(*([float(v) for v in part[:, i]] for part in given))
        assert tuple(v[i] for v in together) == alone


@pytest.mark.parametrize("n", [1, 2, 63, 64, 65, 200])
@pytest.mark.parametrize("kinds", [list(ROADS)[:-1], ["read"]], ids=["turning", "read"])
def test_a_car_gets_the_same_bits_whatever_its_neighbours(n, kinds):
    law, force = CNVC(), PAPER_FORCE
    cars = [
        case(ROADS[kinds[i % len(kinds)]], force, law, (1e-3 * i, 0.0, 0.1, 0.0)) for i in range(n)
    ]
    together = run(cars, 80).record
    for i in {0, n // 2, n - 1}:
        np.testing.assert_array_equal(together[:, :, i], run([cars[i]], 80).record[:, :, 0])


def test_cars_read_their_own_tables():
    roads_ = [
        Excitation(road=FunctionRoad(profile=uneven, kinks_at=kinks), speed=7.3)
        for kinks in ((0.4,), (0.1, 0.4), (0.4, 0.5, 0.6))
    ]
    cars = [case(road, PAPER_FORCE, LNVC(), (0.0, 0.0, 0.0, 0.0)) for road in roads_]
    together = run(cars, 100).record
    for i, one in enumerate(cars):
        np.testing.assert_array_equal(together[:, :4, i], in_plain_python(*one, 100)[:, :4])


def test_cars_of_other_numbers_share_a_composition_and_others_do_not():
    law, road = CNVC(), ROADS["harmonic"]
    of = [
        case(each, PAPER_FORCE, law, (0.0,) * 4, car=car)[1]
        for car in (PAPER_CAR, PaperCar(**{**PAPER_CAR.numbers._asdict(), "b1": 1.0}))
        for each in (road, ROADS["hump"], ROADS["step"])
    ]
    assert len(set(of)) == 1
    assert case(ROADS["read"], PAPER_FORCE, law, (0.0,) * 4)[1] != of[0]
    assert case(road, PAPER_FORCE, LNVC(), (0.0,) * 4)[1] != of[0]
    assert case(road, PAPER_FORCE, law, (0.0,) * 4, Limits(1.0, 1.0))[1] != of[0]
    assert case(road, PAPER_FORCE, law, (0.0,) * 4, car=CARS["parts"])[1] != of[0]


def test_phasors_do_not_drift():
    law, steps = LAWS["none"](), 20 * RESEED + 500
    one, what = case(ROADS["harmonic"], ExternalForce(f=1.0, Omega=31.0), law, (0, 0, 0, 0))
    end = closed_loop.run(what, [one], step=STEP, steps=steps).phasors[:, 0]
    t = steps * STEP
    exact = [np.sin(55.0 * t), np.cos(55.0 * t), np.sin(31.0 * t), np.cos(31.0 * t)]
    # an angle of 1e3 rad is itself rounded by 1e-13; half a thousand turns add about as much
    np.testing.assert_allclose(end, exact, atol=1e-12, rtol=0)


def test_slabs_round_trip():
    rows = np.arange(3 * 130.0).reshape(3, 130)
    slabs = closed_loop.slabs(rows)
    assert slabs.shape == (3, 3 * LANES)
    assert slabs[1, 2 * LANES + 5] == rows[2, LANES + 5]
    np.testing.assert_array_equal(closed_loop.from_slabs(slabs, 130), rows)


@pytest.mark.parametrize("work", [1, 10**9])
def test_every_block_runs_once(work):
    seen = []
    closed_loop.over_blocks(lambda begin, end: seen.extend(range(begin, end)), blocks=7, work=work)
    assert sorted(seen) == list(range(7))


@pytest.mark.parametrize("time", [0.0, 1e-9, 0.001, 0.0029999999999999996, 0.003, 5.4321, 1e6])
def test_a_kink_belongs_to_the_step_that_begins_with_it_or_before_it(time):
    k = kink_step(time, STEP)
    assert k * STEP <= time < (k + 1) * STEP
    assert kink_step(np.inf, STEP) == NEVER


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


def compiled_loop(law, fused):
    made = case(ROADS["harmonic"], PAPER_FORCE, law, (0, 0, 0, 0))
    run([made], 1, fused=fused)
    return loop_kernels.compose(made[1], False, fused)[1]


@pytest.mark.slow
def test_the_loops_over_cars_are_compiled_to_vector_instructions():
    """A scalar loop has no packed products; an RK4 step alone multiplies 72 times."""
    loop = compiled_loop(LNVC(), fused=False)
    assert count(PACKED_PRODUCT, loop) > 80  # and the law, and what is measured
    assert count(PACKED_MULTIPLY_ADD, loop) == 0


@pytest.mark.slow
def test_fused_loops_are_compiled_to_packed_multiply_adds():
    # a sum of an RK4 step takes part in one, where it is not the sum of two rates
    loop = compiled_loop(LNVC(), fused=True)
    assert count(PACKED_MULTIPLY_ADD, loop, fastmath={"contract"}) > 40


@pytest.mark.parametrize("road", ROADS.values(), ids=ROADS)
@pytest.mark.parametrize("law", [CNVC(), NDF()], ids=lambda law: law.name)
def test_fused_loops_equal_the_others_to_rounding(law, road):
    """Both are compiled in one process and read one cache: neither must get the other's code."""
    made = case(road, PAPER_FORCE, law, (0.01, -0.02, 0.3, 0.4))
    exact, fused = (run([made], 1000, fused=each).record for each in (False, True))
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
            from dataclasses import dataclass
            from house.gain import scaled
            from qcar_env.control.law import Law
            from qcar_env.parts.part import number
            from qcar_env.validation import positive

            @dataclass(frozen=True, kw_only=True)
            class House(Law):
                G: float = number("gain", "1/s", positive, 1.0)

                @staticmethod
                def command(x, eta, p):
                    return scaled(p.G, x.v1), scaled(p.G, x.v2)
            """
        )
    )
    script = textwrap.dedent(
        """
        from house.law import House
        from qcar_env.analysis.simulate import simulate
        from qcar_env.engine import closed_loop
        from qcar_env.physics.external_force import ExternalForce
        from qcar_env.roads.excitation import harmonic
        from qcar_env.scenarios import PAPER_CAR

        kernels, compose = [], closed_loop.compose
        closed_loop.compose = lambda *given: kernels.append(compose(*given)) or kernels[-1]
        found = simulate(
            PAPER_CAR, harmonic(h=0.1, omega=55.0), ExternalForce(), House(), duration=1e-3,
            start=(0.0, 0.0, 1.0, 0.0),
        )
        run = kernels[0][1]
        (signature,) = run.signatures
        print(found.u1[0], run.stats.cache_hits[signature] if run.stats.cache_hits else 0)
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
