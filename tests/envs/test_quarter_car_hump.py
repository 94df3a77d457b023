"""The environment of one car: what it shows, pays, accepts and refuses."""

import dataclasses
import inspect
import math
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, strategies as st

from qcar_env import SCENARIOS, scenario
from qcar_env.envs import episode as task
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.reward import absolute, squared
from qcar_env.physics import linear
from qcar_env.physics.signals import Signal, signal

ID = "QuarterCarHump-v0"
PAPER = scenario("paper")
HUMP = scenario("mathworks-hump")
STILL = np.zeros(2, dtype=np.float32)
fractions = st.lists(st.floats(-1.0, 1.0, width=32), min_size=2, max_size=2)


def make(name="paper", **kwargs) -> QuarterCarHumpEnv:
    return gym.make(ID, scenario=name, **kwargs).unwrapped


def started(name="paper", options=None, **kwargs) -> QuarterCarHumpEnv:
    env = make(name, **kwargs)
    env.reset(seed=0, options=options)
    return env


def drawn_start(find, every_name, seed=0, **kwargs):
    env = make(find(every_name), **kwargs)
    env.reset(seed=seed)
    return env


# Checkers and seeds -----------------------------------------------------------------------------


def test_gymnasiums_and_sb3s_checkers_pass_without_a_warning(find, every_name):
    sb3 = pytest.importorskip("stable_baselines3.common.env_checker")
    few = {"observe": "feedback", "observe_limit": True} if every_name == "paper" else {}
    env = make(find(every_name), **few)
    check_env(env, skip_render_check=True)  # frames: tests/envs/test_rendering.py
    sb3.check_env(env)


TRAJECTORY = """
import hashlib, sys
import gymnasium as gym, numpy as np
env = gym.make("qcar_env:QuarterCarHump-v0", scenario=sys.argv[1])
env.action_space.seed(1)
seen = hashlib.sha256()
for episode in range(3):
    observation, _ = env.reset(seed=int(sys.argv[2]) if episode == 0 else None)
    seen.update(observation.tobytes())
    for _ in range(50):
        observation, reward, terminated, *_ = env.step(env.action_space.sample())
        seen.update(observation.tobytes() + np.float64(reward).tobytes())
        if terminated:
            break
print(seen.hexdigest())
"""


def test_a_process_gives_the_trajectory_of_its_seed():
    """By the name with a module, as a spawned worker needs it: it has imported nothing."""

    def process(seed):
        command = [sys.executable, "-c", TRAJECTORY, "paper-randomised", str(seed)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    running = [process(seed) for seed in (7, 7, 8)]
    found = [each.communicate(timeout=120)[0] for each in running]
    assert [each.returncode for each in running] == [0, 0, 0]
    assert len(found[0]) == 65
    assert found[0] == found[1]
    assert found[0] != found[2]


def test_spawned_workers_do_as_this_process_does():
    def trajectory(mode, **kwargs):
        env = gym.make_vec(f"qcar_env:{ID}", num_envs=2, vectorization_mode=mode, **kwargs)
        observation, _ = env.reset(seed=3)
        seen = [observation]
        for _ in range(5):
            seen.append(env.step(np.full((2, 2), 0.5, dtype=np.float32))[0])
        env.close()
        return np.array(seen)

    spawned = trajectory("async", vector_kwargs={"context": "spawn"})
    assert np.array_equal(spawned, trajectory("sync"))


def test_episodes_of_one_seed_differ_from_each_other_and_repeat():
    def starts(seed):
        env = make()
        first, _ = env.reset(seed=seed)
        return [first.tolist(), *(env.reset()[0].tolist() for _ in range(4))]

    assert starts(5) == starts(5)
    assert starts(5) != starts(6)
    assert len(set(map(tuple, starts(5)))) > 1


# Observation ------------------------------------------------------------------------------------


def test_the_observation_is_state_road_and_force_in_the_scenarios_scales(find, every_name):
    env = drawn_start(find, every_name)
    scale = env.scenario.reference.scale
    scales = np.array([scale(signal(name), env.scenario) for name in task.FULL])
    rng = np.random.default_rng(1)
    for _ in range(150):
        action = rng.uniform(-0.3, 0.3, env.action_space.shape).astype(np.float32)
        observation, _, terminated, _, _ = env.step(action)
        if terminated:
            break
        road, force, t = env.episode.excitation, env.episode.force, env.time
        if road.kinks(t - 1e-9, t + 1e-9):  # on a kink rounding decides which piece is met
            continue
        outside = (road.height(t), road.rate(t), force.value(t), force.rate(t))
        true = np.array([*env.state, *map(float, outside)])
        expected = np.clip(np.divide(true, scales, out=np.zeros(8), where=scales > 0), -10, 10)
        # float32, and the phasors' own rounding
        assert observation == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("observe", [("body_acceleration", "travel"), ("tyre_load", "y")])
def test_signals_are_observed_by_their_names(observe):
    env = started("mathworks-hump", observe=observe)
    assert env.observation_space.shape == (2,)
    observation = env.step(np.ones(1, np.float32))[0]
    if observe[0] == "tyre_load":
        assert observation[1] == 0.0  # the hump is yet to come
        return
    scales, x = env.scenario.reference.scales, env.state
    assert observation[1] * scales["travel"] == pytest.approx(x.x2 - x.x1, rel=1e-6)


def test_a_signal_of_ones_own_is_observed_in_its_own_scale():
    mine = Signal("sum", "m", "sum of the displacements", sum_of_displacements, scale=2.0)
    env = started(observe=(mine, "x1"), options={"state": (0.5, 0.25, 0.0, 0.0)})
    assert env.reset(options={"state": (0.5, 0.25, 0.0, 0.0)})[0][0] == 0.375


def sum_of_displacements(m, p):
    return m.x.x1 + m.x.x2


def test_a_signal_that_needs_masses_is_refused_on_a_car_without():
    with pytest.raises(ValueError, match="signal 'tyre_load' needs a car with masses"):
        make(observe=("tyre_load",))


def test_an_observed_actuator_force_is_shown_over_its_limit():
    """Without control there is none, so that its largest value then is no scale."""
    env = started(observe=("u1", "u2"))
    assert env.step(np.array([1.0, -0.5], np.float32))[0].tolist() == [1.0, -0.5]
    env = started("mathworks-hump", observe=("u1", "u2"))
    assert env.step(np.array([0.5], np.float32))[0].tolist() == [-0.5, 0.5]


def test_a_reward_can_be_made_of_terms():
    terms = (squared("body_acceleration", 2.0), absolute("travel"))
    env = started("mathworks-hump", reward=terms, observe=("body_acceleration", "travel"))
    for _ in range(10):
        observation, reward, _, _, info = env.step(np.array([0.4], np.float32))
        a, z = observation.astype(float)
        assert info["reward_body_acceleration"] == pytest.approx(-2.0 * a * a, rel=1e-5)
        assert info["reward_suspension_travel"] == pytest.approx(-abs(z), rel=1e-5)
        assert info["reward_travel"] == 0.0
        assert reward == pytest.approx(-2.0 * a * a - abs(z), rel=1e-5)


def test_feedback_is_the_state_alone():
    full, feedback = started(observe="full"), started(observe="feedback")
    for _ in range(5):
        a, b = full.step(STILL)[0], feedback.step(STILL)[0]
        assert b.shape == (task.FEEDBACK_SIZE,)
        assert np.array_equal(a[: task.FEEDBACK_SIZE], b)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_the_limit_can_be_observed_as_a_share_of_the_scenarios(scale):
    env = make(observe_limit=True)
    observation, _ = env.reset(seed=0, options={"force_scale": scale})
    assert observation[-1] == pytest.approx(scale, rel=1e-6)
    assert observation.shape == env.observation_space.shape == (task.FULL_SIZE + 1,)


def test_an_observation_belongs_to_its_receiver():
    env = started()
    kept, _, _, _, info = env.step(np.ones(2, dtype=np.float32))
    copy, force = kept.copy(), info["force"].copy()
    env.step(-np.ones(2, dtype=np.float32))
    assert np.array_equal(kept, copy)
    assert np.array_equal(info["force"], force)
    before = env.state
    kept[:] = 9.0
    info["force"][:] = 9.0
    assert env.state == before


# Motion and force -------------------------------------------------------------------------------


@given(action=fractions, phase=st.floats(0.0, 6.0), x=st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_a_step_is_the_plants_motion_under_the_held_force(action, phase, x):
    env = started(options={"state": (*x[:2], 30 * x[2], 30 * x[3]), "phase": phase})
    start = np.array(env.state)
    env.step(np.array(action, dtype=np.float32))
    u = np.array(action) * env.force_limit
    road = PAPER.excitation
    m = linear.rk4_transition(PAPER.car, road, PAPER.force, PAPER.dt, PAPER.substeps)
    phasor = np.array([np.sin(phase), np.cos(phase)])  # omega = Omega
    expected = m.A @ start + m.B @ u + m.road @ phasor + m.force @ phasor
    # two ways to do the same sums of terms up to 30 (velocities) and 280 * 0.005
    assert np.array(env.state) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", list(SCENARIOS))
@pytest.mark.parametrize("value", [-3.0, -1.0, -0.25, 0.0, 1.0, 2.0])
def test_the_force_is_the_clipped_action_times_the_limit_in_SI(name, value):
    env = started(name)
    size = env.action_space.shape[0]
    _, _, _, _, info = env.step(np.full(size, value, dtype=np.float32))
    expected = np.clip(value, -1.0, 1.0) * env.force_limit
    assert info["force"] == pytest.approx(expected, rel=1e-15)
    assert env.force_limit == pytest.approx(env.episode.actuator.limit, rel=1e-15)


def test_a_suspension_actuator_lifts_the_body_and_presses_the_wheel():
    env = started("mathworks-hump", options={"state": (0.0, 0.0, 0.0, 0.0)})
    env.step(np.ones(1, dtype=np.float32))  # the hump is yet to come
    x = env.state
    assert x.x2 > 0.0 > x.x1
    # momenta of opposite forces, up to the tyre's push in 5 ms: k1 x1 dt with x1 < 0.3 mm
    assert 60.0 * x.v1 + 300.0 * x.v2 == pytest.approx(0.0, abs=190e3 * 3e-4 * 0.005)


# Reward and end ---------------------------------------------------------------------------------


def test_the_terms_of_the_reward_add_up_and_none_is_positive(find, every_name):
    env = drawn_start(find, every_name)
    env.action_space.seed(2)
    terminated = truncated = False
    while not (terminated or truncated):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        terms = [value for key, value in info.items() if key.startswith("reward_")]
        assert {"reward_x1", "reward_x2", "reward_travel"} <= set(info)
        assert sum(terms) == pytest.approx(reward, rel=1e-14)  # the order of the sum
        assert max(terms) <= 0.0
        assert info["reward_travel"] == 0.0 or terminated


def test_the_uncontrolled_steady_motion_is_paid_alike_at_every_instant():
    steady = linear.steady_state(PAPER.car, PAPER.excitation, PAPER.force)
    env = started(options={"state": steady.state(0.0), "phase": 0.0})
    terms = []
    for _ in range(200):
        _, _, _, _, info = env.step(STILL)
        terms.append((info["reward_x1"], info["reward_x2"]))
    # RK4's steady state differs from the exact one by (55 * 1.25 ms)^4 / 120 = 2e-7 an interval
    assert np.ptp(terms, axis=0) == pytest.approx([0.0, 0.0], abs=1e-4)


def test_a_larger_amplitude_of_a_mass_is_paid_less_and_stillness_costs_nothing(find, every_name):
    env = drawn_start(find, every_name)
    scales = env.scenario.reference.scales
    A = np.array([scales[each] for each in task.FEEDBACK])
    pairs = []
    for _ in range(5):
        env.reset()
        for _ in range(40):
            _, _, terminated, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
            if terminated:
                break
            z = np.array(env.state) / A
            amplitudes = np.hypot(z[:2], z[2:])
            pairs.append((*amplitudes, info["reward_x1"], info["reward_x2"]))
    for amplitude, term in zip(np.transpose(pairs)[:2], np.transpose(pairs)[2:], strict=True):
        order = np.argsort(amplitude)
        assert np.all(np.diff(term[order]) <= 1e-12)
        assert np.all(term[amplitude == 0.0] == 0.0)
        assert np.all(term[amplitude > 1e-6] < 0.0)


@pytest.mark.parametrize("duration", [0.005, 0.3, 0.5])
def test_the_time_limit_truncates_and_does_not_terminate(duration):
    env = started(duration=duration, options={"state": (0.0,) * 4})
    flags = []
    for _ in range(round(duration / 0.005)):
        _, _, terminated, truncated, info = env.step(STILL)
        flags.append((terminated, truncated))
        assert info["reward_travel"] == 0.0
    assert flags == [(False, False)] * (len(flags) - 1) + [(False, True)]


@pytest.mark.parametrize("duration", [0.005, 5.0])
@pytest.mark.parametrize("mass", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_leaving_the_travel_limits_terminates_and_does_not_truncate(mass, sign, duration):
    """Even at the last step of the time limit: the state has no future to be bootstrapped."""
    limit = PAPER.travel_limit * PAPER.reference_amplitudes[mass]
    state = np.zeros(4)
    state[mass], state[2 + mass] = sign * 0.99 * limit, sign * 100.0
    env = started(duration=duration, options={"state": state})
    observation, reward, terminated, truncated, info = env.step(STILL)
    assert (terminated, truncated) == (True, False)
    assert info["reward_travel"] < 0.0
    assert reward < info["reward_travel"]
    assert observation in env.observation_space
    assert abs(env.state[mass]) > limit


def test_leaving_is_worse_than_never_acting():
    """At the usual discount of 0.99 no policy gains by ending an episode that goes badly."""
    steady = linear.steady_state(PAPER.car, PAPER.excitation, PAPER.force)
    idle = started(options={"state": steady.state(0.0), "phase": 0.0}).step(STILL)[1]
    limit = PAPER.travel_limit * PAPER.reference_amplitudes[0]
    leaving = started(options={"state": (0.99 * limit, 0.0, 100.0, 0.0)}).step(STILL)[1]
    assert leaving < idle / (1.0 - 0.99)


# Starts and options -----------------------------------------------------------------------------


def test_starts_lie_within_the_travel_limits_and_the_observation_space(find, every_name):
    env = make(find(every_name))
    scales = env.scenario.reference.scales
    for seed in range(20):
        observation, info = env.reset(seed=seed)
        assert observation in env.observation_space
        x1, x2 = env.state[:2]
        assert abs(x1) <= env.scenario.travel_limit * scales["x1"]
        assert abs(x2) <= env.scenario.travel_limit * scales["x2"]
        assert 0.0 <= info["phase"] < 2.0 * math.pi
        assert np.array_equal(info["force"], np.zeros(env.action_space.shape))


def test_starts_vary_and_some_are_at_rest(find, every_name):
    env = make(find(every_name))
    env.reset(seed=0)
    starts = []
    for _ in range(200):
        env.reset()
        starts.append(env.state)
    at_rest = [not any(x) for x in starts]
    assert any(at_rest)
    assert not all(at_rest)
    assert len(set(starts)) > 50


@given(x=st.tuples(*[st.floats(-1.0, 1.0)] * 4), phase=st.floats(-10.0, 10.0))
def test_options_fix_the_start(x, phase):
    env = make()
    _, info = env.reset(seed=0, options={"state": x, "phase": phase})
    assert env.state == x
    assert info["phase"] == phase
    assert env.time * 55.0 == pytest.approx(phase, rel=1e-14, abs=1e-14)


def test_options_leave_the_draws_as_they_would_have_been():
    """An episode with a given start changes no later one."""

    def second(options):
        env = make()
        env.reset(seed=3, options=options)
        return env.reset()[0].tolist()

    assert second(None) == second({"state": (0.0,) * 4}) == second({"phase": 1.0})


def test_a_force_scale_and_a_scenario_hold_for_the_following_episodes():
    env = make()
    env.reset(seed=0, options={"force_scale": 0.5})
    assert env.force_limit.tolist() == [140.0, 16.5]
    env.reset(options={"scenario": "paper-hump"})
    assert env.episode.name == "paper-hump"
    assert env.force_limit.tolist() == [140.0, 16.5]
    env.reset(options={"force_scale": 2.0})
    assert env.episode.name == "paper-hump"
    assert env.force_limit.tolist() == [560.0, 66.0]
    env.reset(options={"scenario": PAPER})
    assert env.episode == PAPER.with_force_scale(2.0)


def test_a_duration_replaces_the_scenarios_for_every_scenario():
    env = started(duration=0.01)
    env.reset(options={"scenario": "paper-step", "state": (0.0,) * 4})
    flags = [env.step(STILL)[3] for _ in range(2)]
    assert flags == [False, True]


def test_a_randomised_scenario_varies_from_episode_to_episode():
    env = started("paper-randomised")
    heights = set()
    for _ in range(5):
        env.reset()
        heights.add(env.episode.road.h)
    assert len(heights) == 5
    assert env.scenario.road.h == SCENARIOS["paper-randomised"].road.h


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stat": (0.0,) * 4}, "unknown reset option 'stat'; did you mean 'state'"),
        (
            {"state": (0.0,) * 3},
            r"state must be four finite numbers \(x1, x2, v1, v2\), got .*give",
        ),
        ({"state": (0.0, math.nan, 0.0, 0.0)}, "state must be four finite numbers"),
        ({"state": (9.0, 0.0, 0.0, 0.0)}, r"state x1 must be within .* limit of 3\.\d* m, got 9 m"),
        ({"state": (0.0, -9.0, 0.0, 0.0)}, "state x2 must be within .* got -9 m; start closer"),
        ({"state": (0.0, 0.0, 0.0, 1e300)}, r"state v2 must be within .* m/s, got 1e\+300 m/s"),
        ({"state": "rest"}, "state must be numbers, got 'rest'; give a list or an array"),
        ({"state": (0.0, 0.0, 10**400, 0.0)}, "state must be"),
        ({"phase": math.nan}, "phase must be finite, got nan rad"),
        ({"phase": "left"}, "phase must be a number in rad, got 'left'"),
        ({"force_scale": 0.0}, "force_scale must be positive, got 0"),
        ({"force_scale": 1e300}, r"force_scale must be at most 1e\+06, got 1e\+300"),
        ({"scenario": "papre"}, "unknown scenario 'papre'; did you mean 'paper'"),
        (
            {"scenario": "mathworks-hump"},
            r"has 1 actuator\(s\), this environment 2; make a new",
        ),
    ],
)
def test_an_option_out_of_range_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        make().reset(options=options)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"scenario": "papre"}, "unknown scenario 'papre'; did you mean 'paper'"),
        ({"observe": "ful"}, "unknown observe 'ful'; did you mean 'full'"),
        ({"force_scale": -1.0}, "force_scale must be positive, got -1; give a value above 0"),
        ({"force_scale": math.nan}, "force_scale must be finite, got nan"),
        ({"duration": 0.0}, "duration must be positive, got 0 s"),
        ({"duration": 0.001}, "duration must hold a control interval, got 0.001 s"),
        ({"render_mode": "rgb_arry"}, "unknown render mode 'rgb_arry'; did you mean 'rgb_array'"),
    ],
)
def test_an_argument_out_of_range_is_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        QuarterCarHumpEnv(**kwargs)


@pytest.mark.parametrize(
    ("action", "shape"),
    [(0.5, r"\(\)"), ([0.5], r"\(1,\)"), ([0.1, 0.2, 0.3], r"\(3,\)"), ([[0.1, 0.2]], r"\(1, 2\)")],
)
def test_an_action_of_the_wrong_shape_is_refused(action, shape):
    env = started()
    before = env.state
    with pytest.raises(ValueError, match=rf"action must have shape \(2,\), got {shape}; give one"):
        env.step(np.array(action, dtype=np.float32))
    assert env.state == before


class Marked(np.ndarray):
    """An array of another class."""


PUSH = np.array([0.1, -0.3], np.float32)


@pytest.mark.parametrize(
    "action",
    [
        pickle.loads(pickle.dumps(PUSH)),
        np.stack([PUSH, PUSH], axis=1)[:, 0],
        PUSH.astype(">f4"),
        PUSH.astype(np.float64),
        PUSH.astype(np.dtype(np.float32, metadata={"unit": "-"})),
        PUSH.view(Marked),
        PUSH.tolist(),
        tuple(PUSH),
    ],
    ids=["pickled", "strided", "swapped", "float64", "metadata", "subclass", "list", "tuple"],
)
def test_an_action_is_what_its_numbers_say_whatever_holds_them(action):
    """The engine reads a plain float32 array by itself; all else is turned into one before."""
    env, other = started(), started()
    expected = env.step(PUSH)[0]
    np.testing.assert_array_equal(other.step(action)[0], expected)


def test_what_a_step_returns_is_the_callers_own():
    env = started()
    first = env.step(PUSH)
    kept = first[0].copy(), first[4]["force"].copy()
    second = env.step(-PUSH)
    for array in (first[0], first[4]["force"], second[0], second[4]["force"]):
        assert type(array) is np.ndarray
        assert array.flags.owndata
        assert array.flags.writeable
    np.testing.assert_array_equal(first[0], kept[0])
    np.testing.assert_array_equal(first[4]["force"], kept[1])
    first[0][:] = 7.0
    assert not np.shares_memory(first[0], second[0])
    assert np.all(second[0] != 7.0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_an_action_that_is_not_a_number_is_refused(value):
    env = started()
    before = env.state
    with pytest.raises(
        ValueError, match=r"action must be finite, got .*; allowed range is \[-1, 1\]"
    ):
        env.step(np.array([0.0, value], dtype=np.float32))
    assert env.state == before


@pytest.mark.parametrize("value", [np.float32(3e38), 1e300, 10**100, 2, True])
def test_a_finite_action_however_large_is_clipped(value):
    expected = started().step(np.array([1.0, 0.0], np.float32))
    found = started().step(np.array([value, 0.0], dtype=np.asarray(value).dtype))
    assert np.array_equal(found[0], expected[0])
    assert np.array_equal(found[4]["force"], expected[4]["force"])


@pytest.mark.parametrize(
    "action", [{}, [1j, 0.0], "push", ["1", "0"], [[1.0], [1.0, 2.0]], np.zeros(2, "M8[s]")]
)
def test_an_action_that_is_made_of_something_else_is_refused(action):
    env = started()
    before = env.state
    with pytest.raises(ValueError, match="action must"):
        env.step(action)
    assert env.state == before


@pytest.mark.parametrize("wrapped", [False, True])
def test_a_step_before_the_first_reset_is_refused(wrapped):
    env = gym.make(ID) if wrapped else make()
    with pytest.raises(gym.error.ResetNeeded, match=r"call.*reset"):
        env.step(STILL)
    if not wrapped:
        with pytest.raises(gym.error.ResetNeeded, match="call reset before state"):
            _ = env.state


def test_a_step_after_the_end_is_refused():
    env = started(duration=0.005)
    env.step(STILL)
    with pytest.raises(ValueError, match="the episode is over; call reset before the next step"):
        env.step(STILL)


def test_a_scenario_of_ones_own_serves_as_well():
    mine = dataclasses.replace(HUMP, name="mine", duration=2.0)
    env = gym.make(ID, scenario=mine)
    env.reset(seed=0)
    assert env.unwrapped.scenario == mine


# The documentation page -------------------------------------------------------------------------


def test_the_docstring_names_what_a_user_meets():
    page = QuarterCarHumpEnv.__doc__
    for heading in ("Action space", "Observation space", "Reward", "End of an episode", "Version"):
        assert f"## {heading}" in page
    _, _, _, _, info = started().step(STILL)
    for name in (*task.RESET_OPTIONS, *task.OBSERVE, *info):
        assert f"`{name}`" in page or f'"{name}"' in page or f'info["{name}"]' in page, name
    arguments = list(inspect.signature(QuarterCarHumpEnv.__init__).parameters)[1:]
    assert all(f"`{name}`" in page for name in arguments)


def test_the_numbers_of_the_docstring_are_those_of_the_preset():
    page = QuarterCarHumpEnv.__doc__
    scales = PAPER.reference.scales
    for i, name in enumerate(task.FULL):
        (row,) = [each for each in page.splitlines() if each.strip().startswith(f"| {i} | {name} ")]
        shown = float(row.split("|")[4].split()[0])
        assert shown == pytest.approx(scales[name], rel=5e-4)
    assert (PAPER.actuator.limit, HUMP.actuator.limit) == ((280.0, 33.0), (1500.0,))
    assert (PAPER.travel_limit, PAPER.steps, PAPER.dt) == (3.0, 1000, 0.005)
    limit = PAPER.travel_limit * scales["x1"]
    env = started(options={"state": (0.99 * limit, 0.0, 100.0, 0.0)})
    assert env.step(STILL)[4]["reward_travel"] == pytest.approx(-3000.0)


def test_a_refused_reset_changes_nothing():
    env = QuarterCarHumpEnv()
    env.reset(seed=0)
    before = env.scenario
    with pytest.raises(ValueError, match="phase"):
        env.reset(options={"force_scale": 0.5, "scenario": "paper-step", "phase": float("nan")})
    env.reset()
    assert env.scenario == before
