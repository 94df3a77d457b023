"""The closed loop in continuous time, against what nobody here wrote and against exact results."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from qcar_env.analysis.simulate import simulate, steady_amplitudes
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.control.law import ControlledState
from qcar_env.control.skyhook import Groundhook, Hybrid, Skyhook
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.parts.actuator import LaggedSuspensionActuator, SuspensionActuator
from qcar_env.parts.damper import BilinearDamper
from qcar_env.parts.part import Nothing
from qcar_env.parts.spring import CubicSpring, Stops
from qcar_env.parts.tyre import LiftOffTyre
from qcar_env.physics import linear
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.state import Filter, State
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation
from qcar_env.roads.functions import FunctionRoad
from qcar_env.scenarios import PAPER_CAR, PAPER_FORCE, scenario

PAPER_ROAD = roads.harmonic(h=0.1, omega=55.0)
PAPER = (PAPER_CAR, PAPER_ROAD, PAPER_FORCE)
QUIET = ExternalForce()
MATHWORKS_CAR = scenario("mathworks-hump").car


def histories(found):
    return np.array([found.x1, found.x2, found.v1, found.v2])


def random_case(rng):
    """Draw a car, road, force, law and start; every frequency stays below 80 rad/s."""
    car = PaperCar.from_physical(
        m1=rng.uniform(30, 80),
        m2=rng.uniform(200, 500),
        k1=rng.uniform(8e4, 2e5),
        k2=rng.uniform(1e4, 4e4),
        c1=rng.uniform(0, 100),
        c2=rng.uniform(300, 3000),
        reciprocal=bool(rng.integers(2)),
    )
    h, omega, start = rng.uniform(0.05, 0.12), rng.uniform(20, 80), rng.uniform(0, 0.1)
    road = (
        roads.harmonic(h=h, omega=omega),
        roads.hump(h=h, omega=omega, start=start),
        roads.train(h=h, omega=omega, count=3, gap=rng.uniform(0, 1), start=start),
        roads.step(h=h, start=start),
    )[rng.integers(4)]
    force = ExternalForce(f=rng.uniform(0, 10), Omega=rng.uniform(0, 60))
    law = CNVC(G1=rng.uniform(0, 3), G2=rng.uniform(0, 3))
    return car, road, force, law, State(*(float(each) for each in rng.normal(0, 0.05, 4)))


def dop853(car, road, force, law, start, times):
    """Integrate with scipy, (3)-(4) written here anew, cut at the kinks."""

    def rate(t, x, begin, moving, raised):
        x1, x2, v1, v2 = x
        angle = road.omega * (t - begin)
        y = raised + moving * road.h * math.sin(angle)
        y_dot = moving * road.h * road.omega * math.cos(angle)
        dv1 = (
            car.mu1 * y
            + car.mu2 * y_dot
            - law.G1 * v1**3
            - (car.omega1**2 * x1 + car.b1 * v1 - car.E2 * v2 - car.E1 * x2)
        )
        F = force.f * math.cos(force.Omega * t)
        dv2 = F - law.G2 * v2**3 - (car.omega2**2 * x2 - car.b2 * (v1 - v2) - car.E3 * x1)
        return v1, v2, dv1, dv2

    edges = [0.0, *road.kinks(0.0, times[-1]), times[-1]]
    x, out = np.array(start), np.empty((4, times.size))
    for begin, end in itertools.pairwise(edges):
        middle = 0.5 * (begin + end)
        rises = road.omega == 0.0
        moving = not rises and abs(road.rate(middle)) + abs(road.height(middle)) > 0.0
        raised = float(road.height(middle)) if rises else 0.0
        if rises and begin > 0.0:
            x[2] += car.mu2 * road.h  # the jump throws the wheel: an infinite rate for no time
        inside = (times >= begin) & (times <= end)
        solution = solve_ivp(
            rate,
            (begin, end),
            x,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            t_eval=np.union1d(times[inside], [begin, end]),
            args=(begin, moving, raised),
        )
        out[:, inside] = solution.y[:, np.isin(solution.t, times[inside])]
        x = solution.y[:, -1]
    return out


def test_agrees_with_dop853_and_its_error_falls_with_the_fourth_power_of_the_step():
    rng = np.random.default_rng(2024)
    cases = [random_case(rng) for _ in range(200)]
    times = np.linspace(0.0, 0.2, 11)
    exact = np.stack([dop853(*case, times) for case in cases], axis=-1)
    cars, all_roads, forces, laws, starts = zip(*cases, strict=True)
    errors = []
    for per_record in (20, 40, 80):  # steps of 1, 0.5 and 0.25 ms
        found = simulate(
            cars,
            all_roads,
            forces,
            laws,
            start=starts,
            duration=0.2,
            step=0.02 / per_record,
            record_every=per_record,
        )
        np.testing.assert_allclose(found.t, times, rtol=1e-12)
        scale = np.abs(exact).max(axis=1, keepdims=True)
        errors.append((np.abs(histories(found) - exact) / scale).max(axis=(0, 1)))
    coarse, middle, fine = np.array(errors)
    assert coarse.max() < 2e-4  # of the state's scale; loops up to 300 1/s: (0.3)^5 / 120 a step
    assert fine.max() < 1e-6
    # order 4 over the ensemble and for each case; the next order's term is still 20 % of it here
    assert np.median(np.log2(coarse / middle)) == pytest.approx(4.0, abs=0.3)
    assert np.median(np.log2(middle / fine)) == pytest.approx(4.0, abs=0.2)
    assert (np.log2(middle / fine) > 3.0).all()


def test_equals_the_exact_transition_of_the_uncontrolled_car():
    start = State(0.02, -0.01, 0.4, 0.3)
    found = simulate(*PAPER, Passive(), duration=1.0, step=2.5e-5, record_every=400, start=start)
    exact = linear.exact_transition(*PAPER, 0.01)
    x = np.array(start)
    for k, t in enumerate(found.t):
        # (55 * 25e-6)^4 / 120 a rad over 55 rad, beside rounding: 2e-12
        np.testing.assert_allclose(histories(found)[:, k], x, rtol=0, atol=1e-10)
        force, angle = PAPER_FORCE.phasor(t), 55.0 * t
        x = exact.A @ x + exact.road @ [math.sin(angle), math.cos(angle)]
        x += exact.force @ [force.s, force.c]


def test_stays_on_the_steady_motion():
    steady = linear.steady_state(*PAPER)
    start = State(*(float(each) for each in steady.state(0.0)))
    found = simulate(*PAPER, Passive(), duration=5.0, start=start, step=2e-4)
    exact = np.array([steady.state(t) for t in found.t]).T
    # RK4 detunes the car by (0.011)^4 / 120 = 1e-10, which the resonance (Q = 130) enlarges
    np.testing.assert_allclose(histories(found), exact, atol=1e-6 * np.abs(exact).max(), rtol=0)


@pytest.mark.parametrize(
    ("law", "x1", "x2"),
    [  # equations.md, "What it gives": RK4, 60 s from rest, last five periods; four digits
        (Passive(), 1.116, 1.589),
        (NDF(), 0.4734, 0.1992),
        (PPF(), 0.7309, 1.0565),
        (PPF(G1=70.0, G2=70.0), 0.5022, 0.7406),
        (LNVC(), 0.5974, 0.3905),
        (CNVC(G1=0.5, G2=0.5), 0.1497, 0.0732),
        (CNVC(), 0.1152, 0.0547),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_amplitudes_of_the_paper_preset(law, x1, x2):
    found = steady_amplitudes(*PAPER, law)
    assert found.x1 == pytest.approx(x1, rel=1e-3)
    assert found.x2 == pytest.approx(x2, rel=1e-3)


def test_forces_of_cnvc_in_the_paper_preset():
    found = steady_amplitudes(*PAPER, CNVC())
    assert found.peak_u1 == pytest.approx(277.5, abs=0.1)  # equations.md
    assert found.peak_u2 == pytest.approx(32.3, abs=0.1)
    history = simulate(*PAPER, CNVC(), duration=60.0)
    last = slice(-round(5 * 2 * math.pi / 55.0 / 1e-3), None)
    assert found.rms_u1 == pytest.approx(np.sqrt(np.mean(history.u1[last] ** 2)), rel=1e-12)
    assert found.x2 == np.abs(history.x2[last]).max()


def test_linear_laws_reach_the_steady_state_of_their_linear_closed_loop():
    stiffer = PaperCar(
        omega1=math.sqrt(55.0**2 + 30.0),
        omega2=math.sqrt(55.0**2 + 30.0),
        b1=8.7 + 1.2,
        b2=0.71 + 1.2,
        E1=0.5,
        E2=3.4,
        E3=0.5,
        mu1=2510.0,
        mu2=16.0,
    )
    # b2 also couples the body to v1 in (4), so the equivalent plant is solved here directly
    A = linear.matrices(stiffer).A
    A[3, 2] = 0.71
    drive = linear.matrices(PAPER_CAR).R @ np.array([-0.1j, 0.1 * 55.0, 24.8])
    exact = np.abs(np.linalg.solve(55j * np.eye(4) - A, drive))
    found = steady_amplitudes(*PAPER, PD(), step=5e-4)
    assert found.x1 == pytest.approx(exact[0], rel=1e-4)  # read at the steps: (omega step / 2)^2/2
    assert found.x2 == pytest.approx(exact[1], rel=1e-4)


def test_cases_of_a_sequence_equal_single_calls_bit_for_bit():
    laws = [NDF(G1=G, G2=2 * G) for G in (0.5, 1.0, 5.0)]
    together = simulate(*PAPER, laws, duration=0.5)
    assert together.x1.shape == (501, 3)
    for i, law in enumerate(laws):
        alone = simulate(*PAPER, law, duration=0.5)
        assert alone.x1.shape == (501,)
        np.testing.assert_array_equal(histories(together)[:, :, i], histories(alone))
        np.testing.assert_array_equal(together.u2[:, i], alone.u2)


def test_the_recorded_force_is_the_laws():
    found = simulate(*PAPER, CNVC(G1=0.5, G2=2.0), duration=0.3, record_every=7)
    np.testing.assert_allclose(found.u1, -0.5 * found.v1**3, rtol=1e-15, atol=1e-300)
    np.testing.assert_allclose(found.u2, -2.0 * found.v2**3, rtol=1e-15, atol=1e-300)
    np.testing.assert_allclose(np.diff(found.t), 7e-3, rtol=1e-9)


def test_force_limits_hold():
    found = simulate(*PAPER, LNVC(G1=100.0, G2=100.0), duration=3.0, force_limit=(200.0, 20.0))
    assert np.abs(found.u1).max() == 200.0
    assert np.abs(found.u2).max() == 20.0
    free = simulate(*PAPER, LNVC(G1=100.0, G2=100.0), duration=3.0, force_limit=(1e9, 1e9))
    plain = simulate(*PAPER, LNVC(G1=100.0, G2=100.0), duration=3.0)
    np.testing.assert_array_equal(free.x2, plain.x2)


def test_saturated_loops_have_the_steady_amplitudes_of_the_design():
    # equations.md, last table: rho = max a_i / A_i at the limits (280, 33) times 1, 0.5, 0.25
    limits = [(280.0 * s, 33.0 * s) for s in (1.0, 0.5, 0.25)]
    reference = linear.steady_state(*PAPER).amplitudes
    for law, expected in (
        (CNVC(), (0.103, 0.233, 0.586)),
        (LNVC(G1=100.0, G2=100.0), (0.040, 0.215, 0.585)),
    ):
        found = steady_amplitudes(*PAPER, law, force_limit=limits)
        rho = np.maximum(found.x1 / reference[0], found.x2 / reference[1])
        np.testing.assert_allclose(rho, expected, atol=1.5e-3)


def test_a_held_law_is_the_sampled_closed_loop_of_the_environment():
    env = QuarterCarHumpEnv()
    env.reset(options={"state": [0.0, 0.0, 0.0, 0.0], "phase": 0.0})
    law, limits = CNVC(), np.array([280.0, 33.0])
    states = [env.state]
    for _ in range(400):
        u = law.command(env.state, Nothing(), law.numbers)
        env.step(np.array(u / limits, np.float32))
        states.append(env.state)
    found = simulate(
        *PAPER,
        law,
        duration=2.0,
        step=0.005 / 4,
        hold=0.005,
        record_every=4,
        force_limit=(280.0, 33.0),
    )
    # the environment's actions are single precision: 6e-8 of 280 m/s^2 over 2 s at resonance
    np.testing.assert_allclose(histories(found).T, states, atol=1e-4 * 0.1, rtol=0)


def test_a_held_law_needs_whole_steps_and_approaches_the_continuous_one():
    with pytest.raises(ValueError, match="hold must be a whole number of steps"):
        simulate(*PAPER, CNVC(), duration=1.0, hold=1.5e-3)
    held = steady_amplitudes(*PAPER, CNVC(), hold=0.001, force_limit=(280.0, 33.0))
    continuous = steady_amplitudes(*PAPER, CNVC(), force_limit=(280.0, 33.0))
    # held over 1 ms the force lags by half of it: 55 rad/s * 0.5 ms = 0.03 rad
    assert held.x1 == pytest.approx(continuous.x1, rel=0.03)
    assert held.x2 == pytest.approx(continuous.x2, rel=0.1)


def test_energy_of_an_undriven_reciprocal_car_never_grows():
    car = MATHWORKS_CAR
    flat = roads.hump(h=0.0, omega=1.0)
    found = simulate(car, flat, QUIET, Passive(), duration=3.0, start=State(0.05, -0.1, 1.0, -0.5))
    m1, m2, k1, k2 = car.m1, car.m2, car.tyre.k, car.spring.k
    energy = 0.5 * (
        m1 * found.v1**2 + m2 * found.v2**2 + k1 * found.x1**2 + k2 * (found.x2 - found.x1) ** 2
    )
    assert (np.diff(energy) <= 1e-12 * energy[0]).all()
    assert energy[-1] < 0.1 * energy[0]


def test_a_half_sine_hump_gives_the_published_motion():
    # shared facts: MathWorks car, h = 0.1 m, L = 3 m at 10 km/h: body max, min [m]
    road = roads.hump(h=0.1, V=10.0, L=3.0, start=0.1)
    found = simulate(MATHWORKS_CAR, road, QUIET, Passive(), duration=4.0)
    assert found.x2.max() == pytest.approx(0.1365, abs=1e-4)
    assert found.x2.min() == pytest.approx(-0.0424, abs=1e-4)


def test_a_kink_inside_a_step_is_met_as_exactly_as_one_on_the_grid():
    road = roads.train(h=0.1, omega=30.0, count=2, gap=0.3, start=0.10017)
    coarse = simulate(MATHWORKS_CAR, road, QUIET, Passive(), duration=0.5, step=5e-4)
    fine = simulate(MATHWORKS_CAR, road, QUIET, Passive(), duration=0.5, step=1e-5, record_every=50)
    # RK4's own error: (60 * 5e-4)^4 / 120 a rad of 60 rad/s over 0.5 s, times 0.1 m
    np.testing.assert_allclose(coarse.x2, fine.x2, atol=2e-8, rtol=0)
    np.testing.assert_allclose(coarse.x1, fine.x1, atol=2e-8, rtol=0)


def test_a_filter_can_start_anywhere():
    start = ControlledState(State(0.1, 0.1, 0.0, 0.0), Filter(0.1, 0.1, 0.0, 0.0))
    warm = simulate(*PAPER, PPF(), duration=0.1, start=start)
    cold = simulate(*PAPER, PPF(), duration=0.1, start=start.plant)
    assert warm.u1[0] == 30.0 * 0.1
    assert cold.u1[0] == 0.0
    with pytest.raises(ValueError, match="filter of start must be a Filter of 4 numbers, got "):
        simulate(*PAPER, PPF(), duration=0.1, start=ControlledState(start.plant, Nothing()))


def test_switching_cnvc_on_at_full_motion_needs_a_short_step_and_says_so():
    start = State(*(float(each) for each in linear.steady_state(*PAPER).state(0.0)))
    with pytest.raises(ValueError, match=r"step must be below 0\.00014 s for CNVC at its start"):
        simulate(*PAPER, CNVC(), duration=1.0, start=start)
    found = simulate(*PAPER, CNVC(), duration=10.0, step=5e-5, start=start)
    assert np.abs(found.x2[-2300:]).max() == pytest.approx(0.0547, rel=0.01)


def test_a_saturated_start_is_not_stiff():
    start = State(*(float(each) for each in linear.steady_state(*PAPER).state(0.0)))
    found = steady_amplitudes(*PAPER, CNVC(), start=start, force_limit=(280.0, 33.0))
    assert found.x1 == pytest.approx(0.1152, rel=1e-3)


def test_a_diverging_case_is_reported_and_leaves_the_others_alone():
    # E3 = k1/m2, as the paper prints it, makes a car without damping gain energy
    runaway = PaperCar(
        omega1=20.0, omega2=20.0, b1=0.0, b2=0.0, E1=390.0, E2=0.0, E3=900.0, mu1=400.0, mu2=0.0
    )
    cars = [PAPER_CAR, runaway]
    with pytest.raises(FloatingPointError, match=r"1 of 2 cases diverged .* case 1"):
        steady_amplitudes(cars, PAPER_ROAD, PAPER_FORCE, Passive())
    kept = steady_amplitudes(cars, PAPER_ROAD, PAPER_FORCE, Passive(), on_divergence="keep")
    assert kept.diverged.tolist() == [False, True]
    assert kept.x1[1] == math.inf
    assert kept.x1[0] == steady_amplitudes(*PAPER, Passive()).x1
    with pytest.raises(FloatingPointError, match="diverged"):
        simulate(runaway, PAPER_ROAD, PAPER_FORCE, Passive(), duration=60.0)


@pytest.mark.parametrize("every", [1, 7, 999, 1000, 10**6, 10**30])
def test_a_case_that_diverges_after_the_last_recorded_instant_is_reported(every):
    stiff = {**PAPER_CAR.numbers._asdict(), "E1": 5000.0, "E3": 5000.0, "b1": 0.0, "b2": 0.0}
    given = (PaperCar(**stiff), PAPER_ROAD, PAPER_FORCE, Passive())
    with pytest.raises(FloatingPointError, match="1 of 1 cases diverged within 1 s"):
        simulate(*given, duration=1.0, record_every=every)
    found = simulate(*given, duration=1.0, record_every=every, on_divergence="keep")
    assert found.diverged
    assert found.t.tolist() == [k * 1e-3 for k in range(0, 1001, every)]


def test_a_pair_of_limits_and_a_start_are_sequences_of_any_kind():
    law, pairs = LNVC(G1=100.0, G2=100.0), [(200.0, 20.0), (100.0, 10.0)]
    state = (0.1, 0.2, 0.0, 0.0)

    def motion(limit, start):
        return histories(simulate(*PAPER, law, duration=0.1, force_limit=limit, start=start))

    one, two = motion(pairs[0], State(*state)), motion(pairs, [State(*state)] * 2)
    for kind in (list, np.array, np.float32):
        np.testing.assert_array_equal(motion(kind(pairs[0]), State(*state)), one)
    for kind in (tuple, list, np.array):
        np.testing.assert_array_equal(motion(pairs[0], kind(state)), one)
        np.testing.assert_array_equal(motion(kind(pairs), [kind(state)] * 2), two)
    np.testing.assert_array_equal(motion(np.array(pairs), np.array([state] * 2)), two)


def test_a_coarse_step_warns_and_an_unstable_one_is_refused():
    with pytest.warns(UserWarning, match="coarse"):
        simulate(*PAPER, Passive(), duration=1.0, step=0.02)
    with pytest.raises(ValueError, match=r"step must be below 0\.04\d s .* give a smaller step"):
        simulate(*PAPER, Passive(), duration=1.0, step=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": -1.0}, "duration must be positive, got -1 s"),
        ({"duration": math.nan}, "duration must be finite"),
        ({"step": 0.0}, "step must be positive"),
        ({"record_every": 0}, "record_every must be at least 1"),
        ({"force_limit": (1.0, -1.0)}, "force_limit u2 must be positive"),
        ({"force_limit": (1.0, 1.0, 1.0)}, "force_limit must be a pair"),
        ({"start": State(0.0, math.nan, 0.0, 0.0)}, "start x2 must be finite"),
        ({"law": [CNVC(), LNVC()]}, "laws of one call must be of one class, got CNVC, LNVC"),
        ({"law": [CNVC()] * 3, "road": [PAPER_ROAD] * 2}, "sequences of equal length"),
        ({"law": []}, "sequences of equal length"),
        ({"law": PPF(G1=4000.0)}, "gain G1 must be below omega1"),
        ({"duration": 1e6, "law": [CNVC()] * 100}, "give record_every="),
        ({"on_divergence": "ignore"}, "unknown on_divergence 'ignore'"),
        (
            {"duration": 1e300},
            r"duration must be at most 1e\+10 steps, got 1e\+300 s with step = 0.001",
        ),
        ({"step": 1e-300}, r"duration must be at most 1e\+10 steps, got 1 s with step = 1e-300 s"),
        ({"hold": 1e300}, r"hold must be at most 1e\+10 steps, got 1e\+300 s with step = 0.001 s"),
        ({"hold": "1"}, "hold must be a number in s, got '1'"),
        ({"record_every": 1.5}, "record_every must be a whole number, got 1.5"),
        ({"force_limit": 5}, r"force_limit must be a pair .* got 5; give one pair"),
        ({"force_limit": np.array(5)}, r"force_limit must be a pair .* got array\(5\)"),
        ({"force_limit": {1.0, 2.0}}, r"force_limit must be a pair .* got \{1.0, 2.0\}"),
        ({"force_limit": "ab"}, r"force_limit must be a pair .* got 'a'"),
        ({"start": 5}, "start must be a State of four numbers or a ControlledState, got 5; give"),
        ({"start": np.zeros(3)}, r"start must be a State of four .* got array\(\[0., 0., 0.\]\)"),
        ({"start": ControlledState(None, Nothing())}, "start must be a State of four numbers"),
        ({"car": None}, "car must be a PaperCar or a QuarterCar, got None; give such an object"),
        ({"road": [PAPER_FORCE]}, "road must be of class Excitation, got ExternalForce"),
        ({"force": 24.8}, "force must be of class ExternalForce, got 24.8"),
        ({"law": "cnvc"}, "law must be a control law, got 'c'; give one of qcar_env.control"),
    ],
)
def test_bad_input_is_refused(change, message):
    given = {"car": PAPER_CAR, "road": PAPER_ROAD, "force": PAPER_FORCE, "law": CNVC()}
    with pytest.raises(ValueError, match=message):
        simulate(**{**given, "duration": 1.0, **change})


# Cars of parts, roads that are read, jumps -----------------------------------------------------

FULL = QuarterCar(
    m1=45.0,
    m2=320.0,
    spring=CubicSpring(k=18_000.0, k3=4e5),
    damper=BilinearDamper(c_compression=900.0, c_rebound=2_200.0, knee=0.2, fast=0.3),
    tyre=LiftOffTyre(k=190_000.0, c=120.0),
    stops=Stops(bump=0.04, rebound=0.05, k=60_000.0, k3=2e7),
)


def bumpy(s):
    if s < 0.3:
        return 0.01 * math.sin(7.0 * s)
    if s < 0.9:
        return 0.09 * math.sin((s - 0.3) * math.pi / 0.6) + 0.01 * math.sin(7.0 * s)
    if s < 1.4:
        return 0.01 * math.sin(7.0 * s)
    return 0.03 + 0.01 * math.sin(7.0 * s)


BUMPY = Excitation(road=FunctionRoad(profile=bumpy, kinks_at=(0.3, 0.9, 1.4)), speed=4.0)


def full_dop853(law, start, times, force_on_masses):
    """Integrate `FULL` over `BUMPY` with scipy, from equations written here.

    `force_on_masses(v1, v2)` gives the actuators' forces [N].
    """
    weight = (45.0 + 320.0) * 9.81
    pieces = [
        (0.0, 0.3 / 4.0, 0.0, 0.0),
        (0.3 / 4.0, 0.9 / 4.0, 0.09, 0.0),
        (0.9 / 4.0, 1.4 / 4.0, 0.0, 0.0),
        (1.4 / 4.0, times[-1], 0.0, 0.03),
    ]

    def rate(t, x, hump, raised):
        x1, x2, v1, v2 = x
        s = 4.0 * t
        y = 0.01 * math.sin(7.0 * s) + hump * math.sin((s - 0.3) * math.pi / 0.6) + raised
        slope = 0.07 * math.cos(7.0 * s)
        slope += hump * math.pi / 0.6 * math.cos((s - 0.3) * math.pi / 0.6)
        travel, speed = x2 - x1, v2 - v1
        F = 18_000.0 * travel + 4e5 * travel**3
        eased = math.copysign(min(abs(speed), 0.2) + 0.3 * max(abs(speed) - 0.2, 0.0), speed)
        F += (2_200.0 if speed > 0 else 900.0) * eased
        out, into = max(travel - 0.05, 0.0), max(-travel - 0.04, 0.0)
        F += 60_000.0 * out + 2e7 * out**3 - 60_000.0 * into - 2e7 * into**3
        road = max(190_000.0 * (y - x1) + 120.0 * (4.0 * slope - v1), -weight)
        u1, u2 = force_on_masses(v1, v2)
        return v1, v2, (road + F + u1) / 45.0, (u2 - F) / 320.0

    x, out = np.array(start), np.empty((4, times.size))
    for begin, end, hump, raised in pieces:
        if raised:
            x[2] += 120.0 * 0.03 / 45.0  # c1 h / m1: the jump under the damped tyre
        inside = (times >= begin) & (times <= end)
        at = np.union1d(times[inside], [begin, end])
        solution = solve_ivp(
            rate, (begin, end), x, "DOP853", rtol=1e-10, atol=1e-12, max_step=2e-4, t_eval=at,
            args=(hump, raised),
        )  # fmt: skip
        out[:, inside] = solution.y[:, np.isin(solution.t, times[inside])]
        x = solution.y[:, -1]
    return out


@pytest.mark.parametrize("limit", [None, 600.0])
def test_a_car_of_nonlinear_parts_on_a_road_that_is_read_agrees_with_dop853(limit):
    law, start = CNVC(G1=3.0, G2=1.0), State(0.0, 0.01, 0.0, 0.2)
    times = np.linspace(0.0, 0.6, 61)

    def forces(v1, v2):
        u1, u2 = -45.0 * 3.0 * v1**3, -320.0 * v2**3
        if limit is None:
            return u1, u2
        F = max(-limit, min(limit, u2 - u1))
        return -F, F

    exact = full_dop853(law, start, times, forces)
    actuator = None if limit is None else SuspensionActuator(limit=limit)
    scale = np.abs(exact).max(axis=1, keepdims=True)
    errors = []
    for per_record in (10, 40):
        found = simulate(
            FULL, BUMPY, QUIET, law, duration=0.6, step=0.01 / per_record, start=start,
            record_every=per_record, actuator=actuator,
        )  # fmt: skip
        errors.append(np.abs((histories(found) - exact) / scale).max())
    travel = exact[1] - exact[0]
    assert travel.min() < -0.05  # the stops are met
    # where a stop, a valve or the tyre's lift-off switches inside a step, the order falls to two
    assert errors[0] < 2e-3
    assert errors[1] < errors[0] / 8.0
    if limit is not None:
        assert np.abs(found.u2).max() == pytest.approx(limit / 320.0, rel=1e-12)
        np.testing.assert_allclose(45.0 * found.u1, -320.0 * found.u2, rtol=1e-12)


def test_a_road_that_is_read_gives_what_the_turning_one_gives():
    """The same hump as a half sine and as a function of the distance, kinks within steps."""
    turning = roads.hump(h=0.1, V=14.4, L=0.5, start=0.01234)

    def height(s):
        return 0.1 * math.sin((s - 0.04936) * math.pi / 0.5) if 0.04936 <= s < 0.54936 else 0.0

    def slope(s):
        return (
            0.1 * math.pi / 0.5 * math.cos((s - 0.04936) * math.pi / 0.5)
            if 0.04936 <= s < 0.54936
            else 0.0
        )

    road = FunctionRoad(profile=height, gradient=slope, kinks_at=(0.04936, 0.54936))
    read = Excitation(road=road, speed=4.0)
    force = ExternalForce(f=5.0, Omega=20.0)
    for car in (PAPER_CAR, MATHWORKS_CAR):
        for hold in (None, 0.005):
            one, other = (
                simulate(car, each, force, NDF(), duration=0.5, hold=hold)
                for each in (turning, read)
            )
            scale = np.abs(histories(one)).max(axis=1, keepdims=True)
            # roundings of 500 steps
            assert np.all(np.abs(histories(one) - histories(other)) <= 1e-12 * scale)


@pytest.mark.parametrize("start", [0.0, 0.1, 0.10003])
@pytest.mark.parametrize("law", [PD(), NDF()], ids=lambda law: law.name)
def test_a_jump_of_the_road_under_a_damped_tyre_throws_the_wheel(start, law):
    """A step of the road equals a start with the velocity c1 h / m1 on the road raised."""
    car = QuarterCar.from_physical(45.0, 320.0, 190e3, 18e3, 800.0, 1500.0)
    road, late = roads.step(h=0.04, start=start), 0.3
    found = simulate(car, road, QUIET, law, duration=start + late, step=1e-4)
    raised = roads.step(h=0.04, start=-1.0)  # long ago
    kicked = State(0.0, 0.0, 800.0 * 0.04 / 45.0, 0.0)
    after = simulate(car, raised, QUIET, law, duration=late, step=1e-5, start=kicked)
    since = np.round((found.t - start) / 1e-5).astype(int)
    assert not np.any(histories(found)[:, since <= 0])  # at the jump itself: the state before it
    expected, got = histories(after)[:, since[since > 0]], histories(found)[:, since > 0]
    # RK4 with 1e-4 s of a loop up to 70 rad/s: 1e-9; and rounding
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert np.all(np.abs(got - expected) <= 1e-7 * scale)


def test_cars_and_roads_of_several_kinds_in_one_call_equal_single_calls():
    linear_car = QuarterCar.from_physical(60.0, 300.0, 190e3, 16e3, 0.0, 1e3)
    cars = [PAPER_CAR, FULL, linear_car, FULL, PAPER_CAR, linear_car]
    each_road = [PAPER_ROAD, BUMPY, roads.hump(h=0.05, omega=20.0), PAPER_ROAD, BUMPY, BUMPY]
    laws = [LNVC(G1=0.1 * i, G2=1.0) for i in range(6)]
    together = simulate(cars, each_road, PAPER_FORCE, laws, duration=0.3, step=5e-4)
    for i, given in enumerate(zip(cars, each_road, [PAPER_FORCE] * 6, laws, strict=True)):
        alone = simulate(*given, duration=0.3, step=5e-4)
        np.testing.assert_array_equal(histories(together)[:, :, i], histories(alone))
        np.testing.assert_array_equal(together.u1[:, i], alone.u1)


@pytest.mark.parametrize("law", [Skyhook(), Groundhook(), Hybrid()], ids=lambda law: law.name)
def test_one_actuator_between_the_masses_gives_the_difference_of_what_both_ask_for(law):
    actuator = SuspensionActuator(limit=400.0)
    road = roads.hump(h=0.05, V=10.0, L=3.0)
    found = simulate(MATHWORKS_CAR, road, QUIET, law, duration=2.0, actuator=actuator)
    p = law.numbers
    u1, u2 = law.command(State(found.x1, found.x2, found.v1, found.v2), Nothing(), p)
    F = np.clip(300.0 * u2 - 60.0 * u1, -400.0, 400.0)
    np.testing.assert_allclose(found.u2, F / 300.0, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.u1, -F / 60.0, rtol=1e-12, atol=1e-12)
    held = simulate(MATHWORKS_CAR, road, QUIET, law, duration=2.0, actuator=actuator, hold=0.01)
    assert np.all(held.u2[:2000].reshape(-1, 10) == held.u2[:2000:10, np.newaxis])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"car": PAPER_CAR}, "newtons needs a car with masses, got a PaperCar"),
        ({"force_limit": (1.0, 1.0)}, "give force_limit or an actuator"),
        ({"actuator": 400.0}, "actuator must be of class SuspensionActuator, got 400.0"),
        (
            {"actuator": LaggedSuspensionActuator(limit=1.0, lag=0.1)},
            "actuator must be of class SuspensionActuator, got Lagged",
        ),
    ],
)
def test_an_actuator_that_does_not_fit_is_refused(change, message):
    given = {"car": MATHWORKS_CAR, "road": PAPER_ROAD, "force": QUIET, "law": Skyhook()}
    given["actuator"] = SuspensionActuator(limit=400.0)
    with pytest.raises(ValueError, match=message):
        simulate(**{**given, "duration": 1.0, **change})


def test_a_step_is_judged_by_the_stiffer_side_of_a_bilinear_damper():
    stiff = QuarterCar(
        m1=45.0,
        m2=320.0,
        spring=CubicSpring(k=18_000.0),
        damper=BilinearDamper(c_compression=100.0, c_rebound=1e5, knee=1.0, fast=1.0),
        tyre=LiftOffTyre(k=190_000.0),
    )
    with pytest.raises(ValueError, match=r"step must be below 0\.0012 s for none at rest"):
        simulate(stiff, PAPER_ROAD, QUIET, Passive(), duration=1.0, step=1.3e-3)


def test_a_steady_motion_needs_harmonic_forcing():
    road = roads.hump(h=0.1, omega=55.0)
    with pytest.raises(ValueError, match="needs a harmonic road or force"):
        steady_amplitudes(PAPER_CAR, road, QUIET, Passive())
    assert steady_amplitudes(PAPER_CAR, road, PAPER_FORCE, CNVC()).x2 > 0.0
    with pytest.raises(ValueError, match="periods last"):
        steady_amplitudes(*PAPER, Passive(), duration=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": 1e-300}, r"duration must be at most 1e\+10 steps, got 60 s with step = 1e-300 s"),
        ({"duration": 1e300}, r"duration must be at most 1e\+10 steps, got 1e\+300 s"),
        ({"periods": 10**30}, "periods must be at most 10000000000, got 1000"),
        ({"hold": 1e300}, r"hold must be at most 1e\+10 steps, got 1e\+300 s"),
    ],
)
def test_bad_input_of_a_steady_motion_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        steady_amplitudes(*PAPER, CNVC(), **change)
