import dataclasses
import itertools
import math
import os
import signal
import threading
import time

import numpy as np
import pytest

from qcar_env.analysis.optimum import episode_optimum, period_optimum
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.parts.actuator import LaggedSuspensionActuator, SuspensionActuator
from qcar_env.parts.spring import CubicSpring
from qcar_env.physics import linear
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads import excitation as roads
from qcar_env.roads.functions import FunctionRoad
from qcar_env.scenarios import SCENARIOS, scenario

PAPER = scenario("paper")
CAR = dataclasses.replace(  # one actuator in newtons, on an endless road
    scenario("mathworks-hump"),
    road=roads.harmonic(h=0.05, omega=20.0).road,
    speed=1.0,
    actuator=SuspensionActuator(limit=800.0),
)


def limited(scale):
    return PAPER.with_force_scale(scale)


def push_of(case):
    """Specific forces [m/s^2] at action 1, (2, m)."""
    limit = case.actuator.limit
    if len(limit) == 2:
        return np.diag(limit)
    return np.array([[-limit[0] / case.car.m1], [limit[0] / case.car.m2]])


def steady(case, forces, holds, parts):
    """Displacements of the periodic motion under held forces, by plain linear algebra.

    `forces` (count, holds, m) over their limits; returns (count, holds * parts, 2) over A.
    """
    dt = 2.0 * np.pi / case.excitation.omega / (holds * parts)
    a, b = linear.held_transition(case.car, dt)
    b = b @ push_of(case)
    u = np.repeat(forces, parts, axis=1)
    n = holds * parts
    # x_0 = (I - A^n)^-1 sum A^(n - 1 - k) B u_k; the uncontrolled motion is added.
    x = np.zeros((len(forces), 4))
    for k in range(n):
        x = x @ a.T + u[:, k] @ b.T
    x = np.linalg.solve(np.eye(4) - np.linalg.matrix_power(a, n), x.T).T
    free = linear.steady_state(case.car, case.excitation, case.force)
    found = np.empty((len(forces), n, 2))
    for k in range(n):
        found[:, k] = (x + free.state(k * dt))[:, :2]
        x = x @ a.T + u[:, k] @ b.T
    return found / case.reference_amplitudes


@pytest.mark.parametrize(
    ("scale", "rho"), [(1.0, 0.0), (0.75, 0.0031), (0.5, 0.167), (0.25, 0.572), (0.1, 0.829)]
)
def test_the_reference_values_of_the_paper_preset(scale, rho):
    # An independent program gave them, with 64 samples a period; 2 % of each, 1e-4 of zero.
    found = period_optimum(limited(scale))
    assert found.value == pytest.approx(rho, rel=0.02, abs=1e-4)
    assert found.bound <= found.upper
    assert found.gap < 1e-6


@pytest.mark.parametrize("scale", [0.9, 0.75, 0.5, 0.1])
def test_the_bracket_around_continuous_time_closes(scale):
    coarse = period_optimum(limited(scale))
    fine = period_optimum(limited(scale), samples=256)
    assert fine.margin < 0.2 * coarse.margin  # it falls with the square: 1/16
    # The two brackets hold the same number, so they overlap.
    assert coarse.bound <= fine.upper
    assert fine.bound <= coarse.upper
    assert coarse.margin < 1e-3


def test_brute_force_over_every_force_on_a_grid_finds_nothing_better():
    holds, levels = 4, np.linspace(-1.0, 1.0, 25)
    forces = np.array(list(itertools.product(levels, repeat=holds)))[:, :, np.newaxis]
    for objective, measure in (
        ("max", lambda x: np.abs(x).max(axis=(1, 2))),
        ("sum", lambda x: np.abs(x).max(axis=1).sum(axis=1)),
        ("rms", lambda x: np.sqrt((x * x).sum(axis=2).mean(axis=1))),
    ):
        found = period_optimum(CAR, samples=holds, inside=2, objective=objective)
        best = measure(steady(CAR, forces, holds, 2)).min()
        assert found.value <= best + 1e-9
        # Rounding the best force to the grid moves it by half a level, 1/24, in each hold; the
        # motion moves by no more than its answer to that, whatever the signs.
        step = np.abs(
            steady(CAR, np.eye(holds)[:, :, np.newaxis], holds, 2)
            - steady(CAR, np.zeros((1, holds, 1)), holds, 2)
        ).sum(axis=0)
        assert best <= found.value + step.max() * 2.0 / 24.0


def test_with_unlimited_force_nothing_is_left():
    assert period_optimum(PAPER.with_force_scale(100.0)).upper < 1e-5


def test_with_hardly_any_force_everything_is_left():
    assert period_optimum(limited(1e-9)).value == pytest.approx(1.0, abs=1e-3)  # peaks at nodes


def test_more_force_never_leaves_more():
    values = [period_optimum(limited(scale)).value for scale in np.linspace(0.05, 1.2, 12)]
    assert np.all(np.diff(values) <= 1e-9)


@pytest.mark.parametrize("objective", ["max", "sum", "rms"])
@pytest.mark.parametrize("case", [limited(0.6), CAR], ids=["independent", "suspension"])
def test_value_and_dual_meet_and_the_force_is_within_its_limit(case, objective):
    found = period_optimum(case, objective=objective)
    assert found.gap < 1e-6
    assert found.bound <= found.value + 1e-9
    assert np.all(np.abs(found.u) <= np.array(case.actuator.limit) * (1.0 + 1e-12))
    motion = steady(case, (found.u / case.actuator.limit)[np.newaxis, ::2], 64, 2)[0]
    # The same motion by other means; matrix powers against a sparse factorisation.
    np.testing.assert_allclose(
        found.x[:-1, :2] / case.reference_amplitudes, motion, rtol=0.0, atol=1e-9
    )


def test_weights_ask_for_one_mass_and_for_the_other():
    both = period_optimum(limited(0.5))
    for mass in (0, 1):
        weights = (1.0, 0.0) if mass == 0 else (0.0, 1.0)
        alone = period_optimum(limited(0.5), weights=weights)
        assert alone.value <= both.value + 1e-9
        assert alone.upper == pytest.approx(
            alone.amplitudes[mass] / PAPER.reference_amplitudes[mass]
        )
    total = period_optimum(limited(0.5), objective="sum")
    assert both.value <= total.value <= 2.0 * both.value


def test_an_odd_number_of_samples_does_without_the_symmetry_and_agrees():
    # 63 and 65 holds are solved over whole periods, 64 over half of one.
    low, high = sorted(period_optimum(limited(0.5), samples=n).bound for n in (63, 65))
    half = period_optimum(limited(0.5), samples=64)
    assert low - half.margin <= half.bound <= high + half.margin


def test_forces_held_as_the_environment_holds_them_cost_something():
    held = period_optimum(limited(0.5), dt=PAPER.dt, inside=4)
    assert held.hold == pytest.approx(PAPER.dt, rel=1e-4)
    free = period_optimum(limited(0.5), samples=256)
    assert free.bound < held.value  # 0.1669 against 0.1699
    assert held.value < 1.03 * free.bound


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.1])
def test_no_random_force_is_below_the_bound(scale):
    case = limited(scale)
    bound = period_optimum(case).bound
    rng = np.random.default_rng(0)
    forces = np.clip(rng.normal(0.0, 1.0, (500, 32, 2)), -1.0, 1.0)
    phase = 2.0 * np.pi * (np.arange(32) + 0.5) / 32
    cancel = np.stack(
        [
            -(PAPER.car.mu1 * 0.1 * np.sin(phase) + PAPER.car.mu2 * 5.5 * np.cos(phase)),
            -24.8 * np.cos(phase),
        ],
        axis=1,
    ) / np.array(case.actuator.limit)
    gains = rng.uniform(0.5, 20.0, (500, 1, 1))
    forces = np.concatenate([forces, np.clip(gains * cancel + 0.05 * forces, -1.0, 1.0)])
    rho = np.abs(steady(case, forces, 32, 4)).max(axis=(1, 2))
    assert rho.min() >= bound


def test_two_frequencies_with_a_common_period():
    double = dataclasses.replace(limited(0.5), force=ExternalForce(f=24.8, Omega=110.0))
    found = period_optimum(double, samples=64)
    assert found.gap < 1e-6
    assert found.t[-1] == pytest.approx(2.0 * np.pi / 55.0)
    triple = dataclasses.replace(limited(0.5), force=ExternalForce(f=24.8, Omega=55.0 * 5 / 3))
    assert period_optimum(triple).t[-1] == pytest.approx(3.0 * 2.0 * np.pi / 55.0)


def test_no_common_period_and_no_period_are_refused():
    other = dataclasses.replace(PAPER, force=ExternalForce(f=1.0, Omega=55.0 * np.pi))
    with pytest.raises(ValueError, match="must share a period"):
        period_optimum(other)
    with pytest.raises(
        ValueError, match="needs a harmonic road, got a HalfSine; use episode_optimum"
    ):
        period_optimum("paper-hump")


@pytest.mark.parametrize("name", ["paper-hump", "mathworks-hump", "mathworks-train"])
def test_the_environment_confirms_the_force_of_an_episode(name):
    case = scenario(name)
    found = episode_optimum(case, duration=1.5)
    env = QuarterCarHumpEnv(case, duration=1.5)
    env.reset(seed=0, options={"state": np.zeros(4)})
    times = found.t[0] + case.dt * np.arange(300)
    held = found.u[np.searchsorted(found.t, times + 0.5 * case.dt) - 1]
    states = []
    for force in held:
        env.step((force / case.actuator.limit).astype(np.float32))
        states.append(env.state)
    expected = found.x[np.searchsorted(found.t, times + case.dt - 1e-9)]
    # float32 actions: 6e-8 of the limits, and RK4: 1e-6 of the motion
    atol = 1e-5 * np.abs(found.x).max(axis=0) + 1e-5 * np.array([1.0, 1.0, 55.0, 55.0])
    assert np.all(np.abs(np.array(states) - expected) <= atol)


def test_an_episode_is_bounded_and_knowing_more_time_helps():
    case = scenario("mathworks-hump")
    found = episode_optimum(case, duration=2.0)
    assert found.gap < 1e-6
    assert found.bound <= found.upper
    assert found.upper < 1.0  # the uncontrolled episode
    body = episode_optimum(case, duration=2.0, weights=(0.0, 1.0))
    assert body.upper < 0.05  # a suspension actuator can all but still the body
    late = episode_optimum(case, duration=2.0, after=1.5)
    assert late.value < found.value


def test_brute_force_over_a_short_episode_finds_nothing_better():
    case = CAR
    levels = np.linspace(-1.0, 1.0, 21)
    forces = np.array(list(itertools.product(levels, repeat=4)))
    start = np.array([0.02, 0.03, 0.0, -0.5])
    found = episode_optimum(case, state=start, duration=0.2, dt=0.05, inside=2)
    step = linear.exact_transition(case.car, case.excitation, case.force, 0.025)
    push = push_of(case)[:, 0]
    x = np.tile(start, (len(forces), 1))
    worst = np.zeros(len(forces))
    for k in range(8):
        angle = case.excitation.omega * 0.025 * k
        x = x @ step.A.T + forces[:, k // 2, np.newaxis] * (step.B @ push)
        x = x + step.road @ np.array([math.sin(angle), math.cos(angle)])
        worst = np.maximum(worst, np.abs(x[:, :2] / case.reference_amplitudes).max(axis=1))
    assert found.value <= worst.min() + 1e-9
    assert worst.min() <= found.value + 0.02  # levels 0.1 apart
    assert found.bound <= found.value


def test_a_road_that_is_read_has_the_optimum_of_the_same_road_that_turns():
    turning = scenario("mathworks-hump")
    k = math.pi / 3.0

    def height(s):
        return 0.1 * math.sin(k * (s - 1.5)) if 1.5 <= s < 4.5 else 0.0

    def slope(s):
        return 0.1 * k * math.cos(k * (s - 1.5)) if 1.5 <= s < 4.5 else 0.0

    road = FunctionRoad(profile=height, gradient=slope, kinks_at=(1.5, 4.5))
    read = dataclasses.replace(turning, road=road)
    scales = turning.reference_amplitudes
    one, other = (episode_optimum(each, duration=2.0) for each in (turning, read))
    assert read.reference_amplitudes == pytest.approx(scales, rel=1e-9)
    assert other.value == pytest.approx(one.value, rel=1e-6)
    assert other.bound == pytest.approx(one.bound, rel=1e-6, abs=1e-9)


def test_a_jump_of_the_road_throws_the_wheel_of_a_damped_tyre():
    """With hardly any force the motion is that of a simulation from the jump on."""
    car = PAPER.car
    rises = dataclasses.replace(
        PAPER, road=roads.step(h=0.1, start=0.0123).road, speed=1.0
    ).with_force_scale(1e-9)
    found = episode_optimum(rises, duration=0.5)
    exact = linear.exact_transition(car, roads.step(h=0.1), PAPER.force, 0.0123)
    x = exact.force @ [0.0, 1.0]
    x[2] += car.mu2 * 0.1
    rest = linear.exact_transition(car, roads.step(h=0.1), PAPER.force, 0.5 - 0.0123)
    angle = 55.0 * 0.0123
    x = rest.A @ x + rest.road @ [1.0, 0.0] + rest.force @ [math.sin(angle), math.cos(angle)]
    np.testing.assert_allclose(found.x[-1], x, atol=1e-6 * np.abs(x).max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actuator": LaggedSuspensionActuator(limit=1.0, lag=0.1)}, "actuator must be linear"),
        ({"actuator": SuspensionActuator(limit=1.0, delay=0.01)}, "actuator must be linear"),
        (
            {"car": dataclasses.replace(CAR.car, spring=CubicSpring(k=16e3, k3=1e6))},
            "the car must be linear, got",
        ),
    ],
)
def test_a_plant_that_is_not_linear_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        period_optimum(dataclasses.replace(CAR, **change))


def test_a_long_episode_comes_near_the_periodic_optimum_from_below():
    periodic = period_optimum(limited(0.5))
    free = linear.steady_state(PAPER.car, PAPER.excitation, PAPER.force)
    episode = episode_optimum(
        limited(0.5), state=periodic.x[0], duration=10 * 2 * np.pi / 55, dt=2 * np.pi / 55 / 64
    )
    # It may follow the periodic force, and it need not come back to where it began.
    assert episode.value <= periodic.upper
    uncontrolled = episode_optimum(limited(1e-6), state=free.state(0.0), duration=1.0)
    assert uncontrolled.value == pytest.approx(1.0, abs=2e-3)  # a node within 0.06 rad of each peak


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.75, 0.5])
def test_the_cost_grows_as_that_of_sparse_programs(scale):
    """Of a dense program it grows with the third power of the steps: eightfold for twice."""
    hump = SCENARIOS["paper-hump"].with_force_scale(scale)
    for work in (
        lambda n: period_optimum(limited(scale), samples=n),
        lambda n: episode_optimum(hump, duration=n * 0.005, dt=0.005),
    ):
        seconds = []
        for steps in (1000, 2000):
            begin = time.process_time()
            work(steps)
            seconds.append(time.process_time() - begin)
        assert seconds[1] < 6.0 * seconds[0]  # 1.2 to 3.6 times on a quiet machine


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 1}, "samples must be at least 2"),
        ({"objective": "least"}, "unknown objective 'least'"),
        ({"weights": (0.0, 0.0)}, "weights must be two numbers"),
        ({"weights": (1.0, -1.0)}, "weight must not be negative"),
        ({"dt": -0.1}, "dt must be positive"),
        ({"inside": 0}, "inside must be at least 1"),
        ({"inside": 10**6}, "inside must be at most 15625, got 1000000"),
        ({"samples": 10**30}, "samples must be at most 1000000, got 1000"),
        ({"weights": 1}, r"weights must be two numbers, .* got 1; give \(1, 1\)"),
        ({"weights": {1.0, 2.0}}, r"weights must be two numbers, .* got \{1.0, 2.0\}"),
        ({"weights": (1.0, "1")}, "weight must be a number, got '1'"),
        ({"dt": 1e-320}, "dt = .* s nearly divides no number of periods"),
        ({"objective": ["max"]}, r"unknown objective \['max'\]"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        period_optimum("paper", **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"state": (0.0, 0.0)}, "state must be four finite numbers"),
        ({"state": "abc"}, "state must be finite, got 'abc'"),
        ({"state": None}, "state must be finite, got None"),
        ({"state": (0.0, 0.0, math.nan, 0.0)}, r"state must be finite, got \(0.0, 0.0, nan, 0.0\)"),
        ({"weights": 1}, "weights must be two numbers, .* got 1"),
        ({"inside": 1.5}, "inside must be a whole number, got 1.5"),
        ({"duration": 1e300}, r"duration must be at most 1000000 nodes, got 1e\+300 s with dt"),
        ({"dt": 1e-300}, "duration must be at most 1000000 nodes, got 5 s with dt = 1e-300 s"),
        ({"start": math.inf}, "start must be finite, got inf s"),
        ({"duration": 0.001}, "duration must hold a control interval"),
        ({"duration": 1.0, "after": 1.0}, "after must be below the duration"),
    ],
)
def test_bad_arguments_of_an_episode(arguments, message):
    with pytest.raises(ValueError, match=message):
        episode_optimum("paper-hump", **arguments)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs signals of Unix")
def test_ctrl_c_ends_a_program():
    def forever():
        while True:
            period_optimum(PAPER, samples=256)

    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            forever()
        timer.join()
    finally:
        signal.signal(signal.SIGINT, before)
