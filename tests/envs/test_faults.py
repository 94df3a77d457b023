"""Faults of version 0.1.0, each of which a user met; a test's name says which."""

import dataclasses
import itertools
import math
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from scipy import signal
from scipy.integrate import solve_ivp

from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.parts.actuator import SuspensionActuator
from qcar_env.parts.part import number
from qcar_env.physics.car import QuarterCar
from qcar_env.roads import excitation
from qcar_env.roads.profile import Road
from qcar_env.roads.shapes import Step
from qcar_env.scenarios import Scenario, scenario
from qcar_env.validation import finite, positive

ID = "QuarterCarHump-v0"
REST = {"state": (0.0, 0.0, 0.0, 0.0)}
BUS = {"m1": 320.0, "m2": 2500.0, "k1": 500e3, "k2": 80e3, "c1": 15020.0, "c2": 350.0}  # CTMS


def own(car, road, **kwargs):
    """A scenario of a car and an excitation, as a user makes one."""
    return Scenario(
        car=car,
        road=road.road,
        speed=road.speed,
        actuator=SuspensionActuator(limit=(1500.0,)),
        **kwargs,
    )


def idle(env):
    return np.zeros(env.action_space.shape, np.float32)


# Roads -------------------------------------------------------------------------------------------


def test_a_step_under_a_damped_tyre_kicks_the_wheel():
    """Version 0.1.0 left out c1 h / m1 of the wheel's velocity: 20 % of the suspension's travel.

    The transfer function from road to body over wheel has the numerator -(m2 c1) s^3 - (m2 k1) s^2
    (Control Tutorials for MATLAB and Simulink, bus suspension).
    """
    h, (m1, m2, k1, k2, c1, c2) = 0.1, BUS.values()
    poles = np.polysub(
        np.polymul([m2, c2, k2], [m1, c1 + c2, k1 + k2]), np.polymul([c2, k2], [c2, k2])
    )
    t = 0.005 * np.arange(600)
    expected = h * signal.step(([-m2 * c1, -m2 * k1, 0, 0], poles), T=t)[1]
    bus = own(
        QuarterCar.from_physical(**BUS), excitation.step(h=h), duration=5.0, travel_limit=10.0
    )
    env = QuarterCarHumpEnv(bus)
    env.reset(seed=0, options=REST)
    travel = [0.0]
    for _ in t[1:]:
        env.step(idle(env))
        travel.append(env.state.x2 - env.state.x1)
    # the error of RK4 with steps of 1.25 ms, 5e-9 m
    assert travel == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("mph", [5, 15, 45])
def test_a_car_at_rest_on_a_washboard_does_not_leave_its_travel_limit(mph):
    """The limit was three steady amplitudes, which the transient from rest exceeds."""
    lbf, inch = 4.44822, 0.0254
    car = QuarterCar.from_physical(
        m1=100 * lbf / 9.81,
        m2=1000 * lbf / 9.81,
        k1=1000 * lbf / inch,
        k2=125 * lbf / inch,
        c1=0.0,
        c2=20 * lbf / inch,
    )
    half_wave = 0.5 * 8 * 2**0.5 * inch
    road = excitation.harmonic(h=0.01, V=mph * 1.609344, L=half_wave)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # 45 mph: a coarse step
        env = QuarterCarHumpEnv(own(car, road, duration=4.0))
    for seed, options in itertools.chain(
        [(0, {**REST, "phase": 0.0})], ((i, {}) for i in range(9))
    ):
        env.reset(seed=seed, options=options)
        ends = [env.step(idle(env))[2:4] for _ in range(800)]
        assert ends[-1] == (False, True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ramp(Road):
    """A road of a user's own: it rises from `start` on, for ever."""

    rise: float = number("rise", "-", finite)
    start: float = number("start", "m", positive)

    @staticmethod
    def height(s, piece, p, table):
        return p.rise * (s - p.start) if piece == 1 else 0.0

    @staticmethod
    def slope(s, piece, p, table):
        return p.rise if piece == 1 else 0.0

    @staticmethod
    def kink(piece, p, table):
        return p.start if piece == 0 else np.inf


def test_a_road_of_ones_own_is_driven_over():
    """A subclass was accepted, and the paper's sine driven over instead."""
    base = scenario("mathworks-hump")
    env = QuarterCarHumpEnv(
        dataclasses.replace(base, road=Ramp(rise=0.02, start=1.0), speed=5.0, duration=2.0)
    )
    env.reset(seed=0, options=REST)
    seen = []
    for _ in range(400):
        observation, _, terminated, _, _ = env.step(idle(env))
        assert not terminated
        seen.append(observation[4:6])
    y, y_dot = (np.array(seen) * [env.scenario.reference.scales[n] for n in ("y", "y_dot")]).T
    t = 0.005 * np.arange(1, 401)
    assert y == pytest.approx(np.maximum(0.1 * (t - 0.2), 0.0), abs=1e-6)
    assert np.all(y_dot[t > 0.2] == pytest.approx(0.1))
    assert env.state.x2 == pytest.approx(y[-1], abs=0.05)  # the car has climbed it


def test_the_rate_of_a_road_whose_kink_falls_on_a_control_instant_is_not_late():
    """0.5 s is the end of interval 100; version 0.1.0 showed y' = 0 there."""
    env = QuarterCarHumpEnv("paper-hump")
    env.reset(seed=0, options=REST)
    seen = [env.step(idle(env))[0] for _ in range(100)]
    assert [each[5] for each in seen[-2:]] == [0.0, 1.0]


# Scales ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("L", "V"), [(0.1, 25.0), (0.3, 30.0), (3.0, 30.0)])
def test_the_wheels_velocity_is_not_clipped_in_an_uncontrolled_crossing(L, V):
    """It was divided by the body's frequency: 16 units, shown as 10 without a word."""
    road = excitation.hump(h=0.02, V=V, L=L, start=0.1)
    bus = own(QuarterCar.from_physical(**BUS), road, duration=2.0)
    env = QuarterCarHumpEnv(bus, observe="feedback")
    env.reset(seed=0, options=REST)
    scales = np.array([bus.reference.scales[each] for each in ("x1", "x2", "v1", "v2")])
    largest = 0.0
    for _ in range(399):
        observation = env.step(idle(env))[0]
        assert observation == pytest.approx(np.array(env.state) / scales, rel=1e-6, abs=1e-9)
        largest = np.maximum(largest, np.abs(observation))
    assert np.all(largest <= 1.0 + 1e-6)  # each signal over its own largest value
    assert np.all(largest > 0.1)


# Numbers beyond float64 --------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["road.wavenumber", "speed"])
def test_a_road_without_a_period_is_refused_where_reset_never_returned(number):
    base = scenario("paper")
    with pytest.raises(ValueError, match="period of the road must be finite, got inf s"):
        base.replaced({number: 5e-324})


@pytest.mark.parametrize("number", ["force.f", "road.h", "actuator.limit.0", "car.mu1"])
def test_numbers_whose_motion_overflows_are_refused(number):
    """An observation was not in its space, and a reward was minus infinity."""
    base = scenario("paper")
    with pytest.raises(ValueError, match=f"{number} must be at most 1e.50 in size, got 1e.300"):
        base.replaced({number: 1e300})


@pytest.mark.parametrize("number", ["force.f", "road.h", "actuator.limit.0"])
@pytest.mark.parametrize("observe", ["full", "feedback"])
def test_the_largest_numbers_stay_in_the_observations_space(number, observe):
    env = QuarterCarHumpEnv(scenario("paper").replaced({number: 1e50}), observe=observe)
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        assert env.observation_space.contains(observation)
        observation, reward, terminated, *_ = env.step(np.ones(2, np.float32))
        assert math.isfinite(reward)
        if terminated:
            break
    assert env.observation_space.contains(observation)


# Actions -----------------------------------------------------------------------------------------

PUSH = np.array([[0.25, -0.5], [0.125, 0.75], [-1.0, 1.0]], np.float32)
TAKEN = {
    "as they are": PUSH,
    "by columns": np.array([PUSH[:, 0], PUSH[:, 1]]).T,
    "every other": np.repeat(PUSH, 2, axis=1)[:, ::2],
    "backwards": PUSH[::-1, ::-1].copy()[::-1, ::-1],
    "broadcast": np.broadcast_to(PUSH[:1], (3, 2)),
    "a list": PUSH.tolist(),
    "float64": PUSH.astype(np.float64),
    "float16": PUSH.astype(np.float16),
    "whole numbers": PUSH.astype(np.int64),
    "bytes swapped": PUSH.astype(">f4"),
    "objects": PUSH.astype(object),
    "nothing masked": np.ma.array(PUSH),
}
REFUSED = {
    "complex": PUSH.astype(np.complex64),
    "text": PUSH.astype(str),
    "text among objects": np.array([["0.5", 0.5]] * 3, dtype=object),
    "bytes among objects": np.array([[b"0.5", 0.5]] * 3, dtype=object),
    "nothing among objects": np.array([[None, 0.5]] * 3, dtype=object),
    "masked": np.ma.array(PUSH, mask=[[False, True]] * 3),
    "not a number": np.full((3, 2), np.nan),
    "not a number of float32": np.full((3, 2), np.nan, np.float32),
}


def pushed(kind, actions):
    """Return the forces over their limits, and all cars' states, after a step in a kind of cars."""
    if kind == "single":
        env = QuarterCarHumpEnv()
        env.reset(seed=0)
        try:
            force = env.step(actions[0])[4]["force"]
        finally:
            state = np.array(env.state)
    elif kind == "many":
        env = QuarterCarHumpVectorEnv(3)
        env.reset(seed=0)
        try:
            force = env.step(actions)[4]["force"]
        finally:
            state = env.states
    else:
        env = pytest.importorskip("qcar_env.agents.vec_env").QuarterCarHumpVecEnv(3)
        env.seed(0)
        env.reset()
        force, state = [each["force"] for each in env.step(actions)[3]], env.vector.states
    return np.atleast_2d(force) / [280.0, 33.0], state


@pytest.mark.parametrize("kind", ["single", "many", "training"])
@pytest.mark.parametrize("name", TAKEN)
def test_actions_may_lie_in_memory_in_any_way_and_be_of_any_kind(kind, name):
    """`np.array([u1, u2]).T` was an IndexError."""
    given = TAKEN[name]
    expected = np.asarray(given, np.float32)[: 1 if kind == "single" else 3]
    force, state = pushed(kind, given)
    assert np.array_equal(force, expected)
    assert np.array_equal(state, pushed(kind, np.asarray(given, np.float32))[1])


@pytest.mark.parametrize("kind", ["single", "many", "training"])
@pytest.mark.parametrize("name", REFUSED)
def test_actions_that_are_no_numbers_are_refused(kind, name):
    """The training environment gave observations that were no numbers, and no end."""
    with pytest.raises(ValueError, match=r"actions? must be (numbers|finite), got .*"):
        pushed(kind, REFUSED[name])


# Attributes --------------------------------------------------------------------------------------


def half(env):
    env.reset(seed=0)
    return env.step(np.ones(env.action_space.shape, np.float32))[4]["force"]


def test_a_force_scale_that_is_set_and_read_back_is_in_effect():
    """In version 0.1.0 the attribute was set, read back, and changed nothing."""
    single, wrapped = gym.make(ID).unwrapped, gym.make(ID)
    single.force_scale = 0.5
    wrapped.set_wrapper_attr("force_scale", 0.5)
    sync = gym.make_vec(ID, 2, vectorization_mode="sync")
    sync.set_attr("force_scale", 0.5)
    assert (single.force_scale, wrapped.get_wrapper_attr("force_scale")) == (0.5, 0.5)
    assert sync.get_attr("force_scale") == (0.5, 0.5)
    assert half(single).tolist() == half(wrapped).tolist() == [140.0, 16.5]
    assert half(sync).tolist() == [[140.0, 16.5]] * 2


def test_attributes_can_be_set_through_stable_baselines3():
    """Its own `set_attr` sets the attribute of Monitor, its wrapper, which nobody reads."""
    util = pytest.importorskip("stable_baselines3.common.env_util")
    many = util.make_vec_env(ID, 2)
    many.env_method("set_wrapper_attr", "force_scale", 0.5)
    many.env_method("set_wrapper_attr", "scenario", "paper-hump")
    many.reset()
    infos = many.step(np.ones((2, 2), np.float32))[3]
    assert many.get_attr("force_scale") == [0.5, 0.5]
    assert infos[0]["force"].tolist() == [140.0, 16.5]
    assert [each.name for each in many.get_attr("scenario")] == ["paper-hump"] * 2
    assert many.envs[0].unwrapped.episode.name == "paper-hump"
    many.set_options({"force_scale": 0.25})
    many.reset()
    infos = many.step(np.ones((2, 2), np.float32))[3]
    assert infos[0]["force"].tolist() == [70.0, 8.25]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("force_scale", -1.0, "force_scale must be positive, got -1"),
        ("scenario", "mathworks-hump", "make a new environment"),
        ("scenario", "papre", "did you mean 'paper'"),
    ],
)
def test_an_attribute_that_cannot_be_is_refused_when_it_is_set(name, value, message):
    env = QuarterCarHumpEnv()
    with pytest.raises(ValueError, match=message):
        setattr(env, name, value)
    assert (env.force_scale, env.scenario.name) == (1.0, "paper")


# Length of an episode ----------------------------------------------------------------------------


def length(env, batch=()):
    """Control intervals until an episode from rest is truncated."""
    env.reset(seed=0, options=REST)
    for k in itertools.count(1):
        truncated = env.step(np.zeros((*batch, 2), np.float32))[3]
        if np.any(truncated):
            return k


@pytest.mark.parametrize("mode", ["sync", "async", "vector_entry_point"])
def test_max_episode_steps_is_kept_in_every_vectorization_mode(mode):
    env = gym.make_vec(f"qcar_env:{ID}", num_envs=2, vectorization_mode=mode, max_episode_steps=5)
    assert length(env, (2,)) == 5
    env.close()


def test_max_episode_steps_is_kept_by_make_and_by_specs():
    env = gym.make(ID, max_episode_steps=5)
    assert env.spec.max_episode_steps == length(env) == 5
    again = gym.make(env.spec)
    assert again.spec.max_episode_steps == length(again) == 5
    other = gym.spec(ID)
    other = dataclasses.replace(other, max_episode_steps=7)
    assert length(gym.make(other)) == 7
    assert length(gym.make_vec(other, num_envs=2), (2,)) == 7


def test_an_episode_longer_than_the_scenarios_is_had_by_duration():
    """`gym.make` tells an environment nothing of its `max_episode_steps`: it only cuts episodes."""
    env = gym.make(ID, duration=6.0)
    assert env.spec.max_episode_steps == length(env) == 1200
    many = QuarterCarHumpVectorEnv(2, max_episode_steps=1200)
    assert length(many, (2,)) == 1200


@pytest.mark.parametrize("name", ["paper", "mathworks-train"])
def test_an_environment_says_how_long_its_episodes_are(name):
    env = gym.make(ID, scenario=name)
    assert env.spec.max_episode_steps == scenario(name).steps
    aware = gym.wrappers.TimeAwareObservation(env)
    observation, _ = aware.reset(seed=0)
    assert observation in aware.observation_space
    for _ in range(3):
        observation = aware.step(idle(env))[0]
    assert observation[-1] == 3  # of spec.max_episode_steps


def test_the_time_left_is_zero_at_the_end_for_sb3_contribs_wrapper():
    wrappers = pytest.importorskip("sb3_contrib.common.wrappers")
    env = wrappers.TimeFeatureWrapper(gym.make(ID, duration=0.1))
    env.reset(seed=0, options=REST)
    for _ in range(20):
        observation, _, _, truncated, _ = env.step(idle(env))
    assert truncated
    assert observation[-1] == pytest.approx(0.0, abs=1e-6)
    assert observation in env.observation_space


# Specs -------------------------------------------------------------------------------------------

MINE = dataclasses.replace(
    scenario("mathworks-hump"), name="mine", road=Step(h=0.06, start=1.0), speed=3.0
)


@pytest.mark.parametrize("given", ["mathworks-hump", scenario("mathworks-hump"), MINE])
def test_a_scenario_in_a_spec_survives_json(given):
    env = gym.make(ID, scenario=given)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert gym.make(env.spec).unwrapped.scenario == env.unwrapped.scenario


def test_the_wheel_of_a_damped_tyre_is_kicked_in_a_vector_environment_too():
    bus = own(QuarterCar.from_physical(**BUS), excitation.step(h=0.1, start=0.0125))
    env = QuarterCarHumpVectorEnv(2, bus)
    env.reset(seed=0, options=REST)
    for _ in range(3):
        env.step(np.zeros((2, 1), np.float32))

    def f(t, x):
        m1, m2, k1, k2, c1, c2 = BUS.values()
        spring, damper = k2 * (x[1] - x[0]), c2 * (x[3] - x[2])
        wheel = (k1 * (0.1 - x[0]) - c1 * x[2] + spring + damper) / m1
        return [x[2], x[3], wheel, -(spring + damper) / m2]

    kicked = [0.0, 0.0, BUS["c1"] * 0.1 / BUS["m1"], 0.0]
    exact = solve_ivp(f, (0.0, 0.0025), kicked, rtol=1e-10, atol=1e-12).y[:, -1]
    assert env.states == pytest.approx(np.tile(exact, (2, 1)), rel=1e-7, abs=1e-9)


def test_importing_the_environment_loads_no_picture():
    code = "import sys, qcar_env.envs.vector; assert 'pygame' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
