"""Linear cars: the map of an interval is exact, and everything else is that of any fleet."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.linalg import expm

from qcar_env.engine.cars import DISABLED, SAME_STEP, Cars
from qcar_env.engine.linear_cars import LinearCars
from qcar_env.engine.random import streams
from qcar_env.envs.episode import Settings
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.parts.actuator import LaggedSuspensionActuator
from qcar_env.parts.damper import BilinearDamper
from qcar_env.parts.spring import LinearSpring
from qcar_env.parts.tyre import LinearTyre
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.linear import exact_transition, matrices
from qcar_env.roads.shapes import OneMinusCosine, Sine
from qcar_env.scenarios import SCENARIOS, Choice, Uniform, Vary

PAPER = SCENARIOS["paper"]
LAGGED = dataclasses.replace(
    SCENARIOS["mathworks-hump"],
    name="lagged",
    road=Sine(h=0.02, wavenumber=4.0),
    actuator=LaggedSuspensionActuator(limit=1_500.0, lag=0.01),
    force=ExternalForce(f=1.0, Omega=9.0),
)
SOON = dataclasses.replace(  # a hump from 0.18 to 1.26 s
    SCENARIOS["mathworks-hump"],
    road=dataclasses.replace(SCENARIOS["mathworks-hump"].road, start=0.5),
)


def fleet(n, scenario, kind=LinearCars, seed=0, given=None, **options):
    """Return a fleet that has just begun, in given starts (n, 5) or drawn ones."""
    settings = Settings("full", False, "amplitudes", None, None)
    cars = kind(n, settings.plan(scenario, 1.0), **options)
    cars.seed(np.arange(n), streams(range(seed, seed + n)))
    starts = np.full((n, 5), np.nan) if given is None else np.asarray(given, dtype=float)
    return cars, cars.reset(np.ones(n, dtype=np.bool_), starts)


def map_of(cars, car=0):
    """Return the map of a car: a row for each number of its state."""
    layout = cars.kernels.fixed
    size, row = len(layout.trees["map"]), layout.row("map")
    states = len(layout.trees["map"]) // columns_of(cars)
    slab = cars._arrays["fixed"][cars._arrays["blocks"][car // 64, 0]].reshape(-1, 64)
    return slab[row : row + size, car % 64].reshape(states, -1)


def columns_of(cars):
    memory = len(cars.plan.scenario.actuator.State._fields)
    return 4 + memory + cars.actions + 4


def truth(scenario, dt):
    """Return the same from scipy; a lag is a state whose rate is (command - force) / lag."""
    plant, road, force = matrices(scenario.car), scenario.excitation, scenario.force
    lag = getattr(scenario.actuator, "lag", None)
    if scenario.actuator.size == 2:
        push = plant.B
    else:
        c = scenario.car
        push = plant.B @ [[-1.0 / c.m1], [1.0 / c.m2]]
    memory = 0 if lag is None else 1
    S, m = 4 + memory, push.shape[1]
    M = np.zeros((S + m + 4,) * 2)
    M[:4, :4] = plant.A
    M[:4, 4 : 4 + m] = push  # of the force where there is a lag, else of the command
    if memory:
        M[4, 4], M[4, 5] = -1.0 / lag, 1.0 / lag
    M[:4, S + m] = plant.R[:, 0] * road.h
    M[:4, S + m + 1] = plant.R[:, 1] * road.h * road.omega
    M[:4, S + m + 3] = plant.R[:, 2] * force.f
    for i, omega in ((S + m, road.omega), (S + m + 2, force.Omega)):
        M[i, i + 1], M[i + 1, i] = omega, -omega
    return expm(M * dt)[:S]


def scales(scenario):
    """Return what the numbers of the state, the commands and the phasors come to."""
    found = scenario.reference.scales
    state = [found[name] for name in ("x1", "x2", "v1", "v2")]
    memory = [scenario.actuator.limit[0]] * len(scenario.actuator.State._fields)
    return np.array([*state, *memory]), np.array(
        [*state, *memory, *scenario.actuator.limit, 1.0, 1.0, 1.0, 1.0]
    )


@pytest.mark.parametrize("dt", [0.0005, 0.005, 0.02])
@pytest.mark.parametrize("scenario", [PAPER, LAGGED], ids=lambda each: each.name)
def test_the_map_is_the_matrix_exponential(scenario, dt):
    """To 1e-13 of what the largest term of a sum comes to, some hundred roundings."""
    scenario = dataclasses.replace(scenario, dt=dt, substeps=20, scales=scenario.scales)
    cars, _ = fleet(2, scenario)
    rows, columns = scales(scenario)
    made, expected = (
        m * columns / rows[:, np.newaxis] for m in (map_of(cars), truth(scenario, dt))
    )
    np.testing.assert_allclose(made, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_two_intervals_under_a_held_command_are_one_of_twice_the_length():
    states = []
    for intervals, dt in ((20, 0.01), (40, 0.005)):
        scenario = dataclasses.replace(PAPER, dt=dt, duration=10.0)
        cars, _ = fleet(3, scenario, given=np.full((3, 5), [0.1, -0.2, 1.0, 2.0, 0.3]))
        push = np.array([[0.2, -0.3], [0.0, 0.0], [-0.1, 0.1]], np.float32)
        for _ in range(intervals):
            cars.step(push, DISABLED)
        states.append(cars.states)
    scale = np.abs(states[0]).max(axis=0)
    np.testing.assert_allclose(states[0] / scale, states[1] / scale, rtol=0, atol=1e-13 * 40)


@pytest.mark.parametrize("name", ["paper", "paper-hump", "paper-step"])
def test_rk4_comes_near_with_the_fourth_power_of_the_step(name):
    """On humps as well, whose kinks cut intervals."""
    start = np.full((3, 5), [0.1, 0.1, 2.0, 1.0, 0.3])
    if name != "paper":
        start[:, 4] = 0.0
    base = dataclasses.replace(SCENARIOS[name], duration=10.0, scales=PAPER.scales)
    if name == "paper-hump":  # early, and not at the end of an interval
        base = dataclasses.replace(base, road=dataclasses.replace(base.road, start=1.003 * 8.0))

    def run(kind, substeps):
        scenario = dataclasses.replace(base, substeps=substeps)
        cars, _ = fleet(3, scenario, kind, given=start)
        rng = np.random.default_rng(0)
        found = []
        for _ in range(400):
            cars.step(rng.uniform(-0.2, 0.2, (3, 2)).astype(np.float32), DISABLED)
            found.append(cars.states)
        return np.array(found)

    exact = run(LinearCars, 4)
    scale = np.abs(exact).max(axis=(0, 1))
    errors = [np.abs((run(Cars, n) - exact) / scale).max() for n in (4, 8, 16, 32)]
    assert errors[0] < 3e-5  # (55 * 1.25 ms)^5 / 120 a step, which the damping sums up
    for coarse, fine in itertools.pairwise(errors):
        assert 14.0 < coarse / fine < 18.0  # 16, but for the next order


@pytest.mark.parametrize("single", [False, True])
def test_randomised_cars_have_each_their_own_map(single):
    precision = "single" if single else "double"
    env = QuarterCarHumpVectorEnv(
        70, "paper-randomised", method="exact", precision=precision, duration=0.1
    )
    env.reset(seed=3)
    for _ in range(25):  # some are in their second episode
        env.step(np.zeros((70, 2), np.float32))
    rows, columns = scales(PAPER)
    tolerance = 1e-6 if single else 1e-13  # the map is made in double precision
    seen = set()
    for car in (0, 1, 63, 64, 69):
        episode = env.episode_of(car)
        made = map_of(env._cars, car)
        expected = exact_transition(episode.car, episode.excitation, episode.force, episode.dt)
        whole = np.hstack([expected.A, expected.B, expected.road, expected.force])
        off = (made - whole) * columns / rows[:, np.newaxis]
        assert np.abs(off).max() < tolerance * np.abs(whole * columns / rows[:, np.newaxis]).max()
        seen.add(float(made[0, 0]))
    assert len(seen) == 5


def test_cars_that_are_alike_share_one_slab_until_they_differ():
    env = QuarterCarHumpVectorEnv(130, "paper", method="exact")
    env.reset(seed=0)
    assert len(env._cars._arrays["fixed"]) == 1
    before = map_of(env._cars, 100)
    env.reset(options={"force_scale": [1.0] * 129 + [0.5]})
    assert len(env._cars._arrays["fixed"]) == 3
    np.testing.assert_array_equal(map_of(env._cars, 100), before)
    np.testing.assert_array_equal(map_of(env._cars, 129), before)  # commands are in m/s^2
    assert env.force_limits[129, 0] == 0.5 * env.force_limits[0, 0]


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
@pytest.mark.parametrize("scenario", ["paper", "paper-randomised", SOON])
def test_episodes_are_those_of_other_cars(scenario, mode):
    """Starts, forces, ends and keys are those of RK4; the rest to its error."""
    results = []
    for method in ("rk4", "exact"):
        env = QuarterCarHumpVectorEnv(
            70, scenario, method=method, duration=0.4, autoreset_mode=mode
        )
        rng = np.random.default_rng(0)
        found = [(env.reset(seed=7)[0], *[None] * 3, {})]
        shape = (70, env.single_action_space.shape[0])
        for _ in range(200):
            found.append(env.step(rng.uniform(-1.0, 1.0, shape).astype(np.float32)))
        results.append(found)
    assert np.array_equal(results[0][0][0], results[1][0][0])  # identical starts
    for a, b in zip(*results, strict=True):
        assert sorted(a[4]) == sorted(b[4])
        np.testing.assert_allclose(a[0], b[0], atol=1e-4)
        for i in (2, 3):
            assert np.array_equal(a[i], b[i])
        if a[1] is not None:
            np.testing.assert_allclose(a[1], b[1], atol=1e-3)
            np.testing.assert_array_equal(a[4]["force"], b[4]["force"])


def test_single_precision_stays_close():
    given = np.full((3, 5), [0.1, 0.1, 2.0, 1.0, 0.3])
    scenario = dataclasses.replace(PAPER, duration=1e3)
    found = []
    for single in (False, True):
        cars, _ = fleet(3, scenario, given=given, single=single)
        rng = np.random.default_rng(0)
        shown = [
            cars.step(rng.uniform(-0.2, 0.2, (3, 2)).astype(np.float32), DISABLED)[0]
            for _ in range(999)
        ]
        found.append(np.array(shown))
    assert 0.0 < np.abs(found[0] - found[1]).max() < 5e-4  # of the amplitudes, as for RK4


def test_a_step_of_humps_does_not_depend_on_the_neighbours():
    """A crossing car is driven by itself; it gets the bits that it has alone."""
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1.0, 1.0, (900, 70, 2)).astype(np.float32)
    many, _ = fleet(70, SCENARIOS["paper-hump"])
    alone, _ = fleet(1, SCENARIOS["paper-hump"], seed=69)
    for each in actions:
        many.step(each, SAME_STEP)
        alone.step(each[69:].copy(), SAME_STEP)
        np.testing.assert_array_equal(many.states[69], alone.states[0])


def with_damper():
    car = SCENARIOS["mathworks-hump"].car
    return QuarterCar(
        m1=car.m1,
        m2=car.m2,
        spring=LinearSpring(k=16_000.0),
        damper=BilinearDamper(c_compression=500.0, c_rebound=1_500.0, knee=0.2, fast=0.5),
        tyre=LinearTyre(k=190_000.0),
    )


def test_what_is_not_linear_is_refused_by_name():
    for name, change in (
        ("car", {"car": with_damper()}),
        ("actuator", {"actuator": LaggedSuspensionActuator(limit=1e3, lag=0.01, power=500.0)}),
        ("road", {"road": OneMinusCosine(h=0.1, L=3.0)}),
    ):
        scenario = dataclasses.replace(LAGGED, **change)
        with pytest.raises(ValueError, match=f"the {name} must be .* for the exact method.*'rk4'"):
            QuarterCarHumpVectorEnv(2, scenario, method="exact")


def test_what_may_become_nonlinear_is_refused():
    dead = {"actuator.dead_zone": 0.0}
    for by in (Uniform(low=0.0, high=10.0), Choice(values=(0.0, 5.0))):
        scenario = dataclasses.replace(LAGGED, randomisation=(Vary(by=by, numbers=dead),))
        with pytest.raises(ValueError, match="the actuator must be linear"):
            QuarterCarHumpVectorEnv(2, scenario, method="exact")
    env = QuarterCarHumpVectorEnv(2, LAGGED, method="exact")
    env.reset(seed=0)
    power = dataclasses.replace(LAGGED.actuator, power=500.0)
    with pytest.raises(ValueError, match="the actuator must be linear"):
        env.reset(options={"scenario": dataclasses.replace(LAGGED, actuator=power)})
