"""The vector environment: the same episodes as single ones, bit for bit, in every mode."""

import contextlib
import dataclasses
import multiprocessing
import os
import pickle
import subprocess
import sys
import threading
import time

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from qcar_env import SCENARIOS
from qcar_env.engine import storage
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.physics.state import State
from qcar_env.roads.iso8608 import ISO8608

SHORT = 0.6  # [s] episodes of the tests: 120 intervals, several of them in a test


def actions_for(env, rng):
    return rng.uniform(-1.1, 1.1, env.action_space.shape).astype(np.float32)  # some saturate


def assert_same(a, b, where=""):
    """Assert that two results are equal to the last bit, with types, masks and keys."""
    assert type(a) is type(b), where
    if isinstance(a, dict):
        assert sorted(a) == sorted(b), where
        for key in a:
            assert_same(a[key], b[key], f"{where}.{key}")
    elif a.dtype == object:
        for x, y in zip(a, b, strict=True):
            assert (x is None) == (y is None), where
            assert x is None or np.array_equal(x, y), where
    else:
        assert a.dtype == b.dtype, where
        assert np.array_equal(a, b), where
        assert a.shape == b.shape, where


def test_equals_single_environments_bit_for_bit(find, every_name):
    n = 130  # more than a block
    mode = "NextStep" if every_name in ("paper-hump", "mathworks-train") else "SameStep"
    arguments = {"scenario": find(every_name), "duration": SHORT}
    native = QuarterCarHumpVectorEnv(n, **arguments, autoreset_mode=mode)
    single = SyncVectorEnv(
        [lambda: QuarterCarHumpEnv(**arguments)] * n, autoreset_mode=AutoresetMode(mode)
    )
    for a, b in zip(native.reset(seed=7), single.reset(seed=7), strict=True):
        assert_same(a, b)
    rng = np.random.default_rng(0)
    for k in range(280):
        action = actions_for(native, rng)
        for i, (a, b) in enumerate(zip(native.step(action), single.step(action), strict=True)):
            assert_same(a, b, f"step {k}, result {i}")


def test_disabled_mode_waits_for_a_reset_of_the_cars_that_are_over():
    env = QuarterCarHumpVectorEnv(3, duration=0.05, autoreset_mode="Disabled")
    env.reset(seed=0)
    action = np.zeros((3, 2), np.float32)
    for _ in range(10):
        observation, _, _, truncated, info = env.step(action)
    assert truncated.all()
    assert "final_obs" not in info
    before = env.states
    with pytest.raises(ValueError, match=r"3 car\(s\) are over .* No car has moved"):
        env.step(action)
    assert np.array_equal(env.states, before)
    again, info = env.reset(options={"reset_mask": np.array([True, False, True])})
    assert np.array_equal(again[1], observation[1])
    assert not np.array_equal(again[0], observation[0])
    assert info["_phase"].tolist() == [True, False, True]
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(action)


def test_gymnasium_makes_it():
    env = gym.make_vec("qcar_env:QuarterCarHump-v0", num_envs=5, scenario="paper-hump")
    assert isinstance(env.unwrapped, QuarterCarHumpVectorEnv)
    assert env.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert env.spec.id == "QuarterCarHump-v0"


def test_works_with_gymnasiums_vector_wrappers():
    env = RecordEpisodeStatistics(QuarterCarHumpVectorEnv(4, duration=0.1))
    env.reset(seed=0)
    total = np.zeros(4)
    for _ in range(20):
        _, reward, _, _, info = env.step(np.zeros((4, 2), np.float32))
        total += reward
    assert info["episode"]["l"].tolist() == [20] * 4
    np.testing.assert_allclose(info["episode"]["r"], total)


def test_seeds():
    env = QuarterCarHumpVectorEnv(4)
    first, _ = env.reset(seed=3)
    later, _ = env.reset()
    again, _ = env.reset(seed=3)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, later)
    moved, _ = env.reset(seed=4)
    assert np.array_equal(moved[:3], first[1:])  # car i gets seed + i
    listed, _ = env.reset(seed=[6, 5, 4, 3])
    assert np.array_equal(listed[::-1], first)
    fresh = [QuarterCarHumpVectorEnv(1).reset()[0] for _ in range(2)]
    assert not np.array_equal(*fresh)


def test_options_for_each_car():
    env = QuarterCarHumpVectorEnv(3, autoreset_mode="SameStep")
    states = np.array([[0.1, 0.2, 3.0, 4.0], [0.0, 0.0, 0.0, 0.0], [0.3, 0.1, -1.0, 0.0]])
    env.reset(seed=0, options={"state": states, "phase": [0.1, 0.2, 0.3]})
    assert np.array_equal(env.states, states)
    _, info = env.reset(options={"phase": 0.5, "state": states[0]})
    assert info["phase"].tolist() == [0.5] * 3
    env.reset(options={"force_scale": [1.0, 0.5, 0.25]})
    np.testing.assert_allclose(env.force_limits[:, 0], [280.0, 140.0, 70.0])
    names = ["paper", "paper", "paper-randomised"]
    env.reset(options={"scenario": names})
    assert [env.scenario_of(i).name for i in range(3)] == names
    mixed, _ = env.reset(seed=9)
    alone = QuarterCarHumpEnv("paper-randomised", force_scale=0.25)
    assert np.array_equal(mixed[2], alone.reset(seed=11)[0])


def test_each_car_can_have_its_own_scenario():
    names = ["paper", "paper-randomised"]  # both of an endless sine
    env = QuarterCarHumpVectorEnv(len(names), observe_limit=True)
    single = [QuarterCarHumpEnv(name, observe_limit=True) for name in names]
    observation, _ = env.reset(seed=3, options={"scenario": names})
    expected = [each.reset(seed=3 + i)[0] for i, each in enumerate(single)]
    rng = np.random.default_rng(0)
    for _ in range(150):
        assert np.array_equal(observation, expected)
        action = (0.3 * actions_for(env, rng)).astype(np.float32)
        observation = env.step(action)[0]
        expected = [each.step(action[i])[0] for i, each in enumerate(single)]


def test_a_wrong_action_moves_no_car():
    env = QuarterCarHumpVectorEnv(130)
    env.reset(seed=0)
    before = env.states
    action = np.zeros((130, 2), np.float32)
    action[77, 1] = np.nan
    with pytest.raises(ValueError, match=r"actions must be finite, got \[ 0. nan\] for car 77"):
        env.step(action)
    with pytest.raises(ValueError, match=r"actions must have shape \(130, 2\), got \(2, 130\)"):
        env.step(np.zeros((2, 130), np.float32))
    assert np.array_equal(env.states, before)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ({"num_envs": 0}, {}, "num_envs must be at least 1, got 0"),
        ({"autoreset_mode": "Never"}, {}, "unknown autoreset_mode 'Never'"),
        ({"precision": "half"}, {}, "unknown precision 'half'"),
        ({"method": "euler"}, {}, "unknown method 'euler'"),
        ({"threads": 0}, {}, "threads must be at least 1"),
        ({"scenario": "papper"}, {}, "unknown scenario 'papper'"),
        ({}, {"state": np.zeros((2, 4))}, r"state must have shape \(4,\) or \(3, 4\)"),
        ({}, {"phase": [0.0, 1.0]}, "phase must be one value or 3 of them, got 2"),
        ({}, {"force_scale": [1.0, 1.0, -1.0]}, "force_scale must be positive"),
        ({}, {"scenario": "mathworks-hump"}, "make a new environment"),
        ({}, {"speed": 3}, "unknown reset option 'speed'"),
        ({}, {"reset_mask": np.zeros(3, bool)}, "reset_mask must be an array"),
    ],
)
def test_bad_input_is_refused(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        QuarterCarHumpVectorEnv(**{"num_envs": 3, **arguments}).reset(options=options)


REFUSED = [
    {"force_scale": 0.5, "state": [9.0] * 4},
    {"force_scale": 0.5, "phase": np.nan},
    {"force_scale": [0.5, 0.25, 1e300]},
    {"scenario": ["paper-randomised", "paper", "mathworks-hump"]},
    {"scenario": "paper-randomised", "state": "rest"},
    {"scenario": "paper-randomised", "seed": -1},
    {"scenario": "paper-randomised", "seed": [1, 2]},
    {"scenario": "paper-randomised", "seed": 1.5},
    {"scenario": "paper-randomised", "seed": "one"},
    {"scenario": "paper-randomised", "seed": [1, 2, [3]]},
]


@pytest.mark.parametrize("given", REFUSED)
def test_a_refused_reset_changes_nothing(given):
    env = QuarterCarHumpVectorEnv(3)
    env.reset(seed=0, options={"force_scale": [1.0, 0.75, 0.5]})
    copy = pickle.loads(pickle.dumps(env))
    options = {name: value for name, value in given.items() if name != "seed"}
    with pytest.raises(ValueError, match=r"state|phase|force_scale|mathworks-hump|seed"):
        env.reset(seed=given.get("seed"), options=options)
    assert [env.scenario_of(i) for i in range(3)] == [copy.scenario_of(i) for i in range(3)]
    assert [env.force_scale_of(i) for i in range(3)] == [1.0, 0.75, 0.5]
    assert np.array_equal(env.reset()[0], copy.reset()[0])


def test_the_first_reset_begins_all_cars():
    env = QuarterCarHumpVectorEnv(3)
    with pytest.raises(ValueError, match=r"all cars in the first reset, got 1 of 3"):
        env.reset(options={"reset_mask": np.array([True, False, False])})


def test_scenarios_that_no_car_draws_from_are_forgotten():
    env = QuarterCarHumpVectorEnv(4)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(50):
        scales = rng.uniform(0.1, 1.0, 4)
        env.reset(options={"force_scale": scales})
        assert len(env._cars._sources) <= 8
    np.testing.assert_allclose(env.force_limits[:, 0], 280.0 * scales)


def test_a_scenario_with_the_numbers_of_another_keeps_its_own_name():
    env = QuarterCarHumpVectorEnv(2)
    env.reset(seed=0)
    named = dataclasses.replace(SCENARIOS["paper"], name="other")
    env.reset(options={"scenario": [named, "paper"], "reset_mask": np.array([True, False])})
    assert [env.scenario_of(i).name for i in range(2)] == ["other", "paper"]


def test_none_leaves_a_car_without_an_option():
    start = np.array([0.1, 0.2, 3.0, 4.0])
    options = [
        {},
        {"phase": 0.5, "force_scale": 0.5},
        {"state": start, "scenario": "paper-randomised"},
    ]
    env = QuarterCarHumpVectorEnv(3, force_scale=np.array(0.75))
    names = ("state", "phase", "force_scale", "scenario")
    found, _ = env.reset(seed=4, options={n: [each.get(n) for each in options] for n in names})
    for i, each in enumerate(options):
        alone = QuarterCarHumpEnv(force_scale=0.75)
        assert np.array_equal(found[i], alone.reset(seed=4 + i, options=each)[0])
    assert [env.force_scale_of(i) for i in range(3)] == [0.75, 0.5, 0.75]


@pytest.mark.parametrize("threads", [1, 2])
def test_finite_actions_however_large_are_clipped(two_threads, threads):
    envs = [QuarterCarHumpVectorEnv(130, **{**two_threads, "threads": threads}) for _ in range(3)]
    for env in envs:
        env.reset(seed=0)
    single, double = np.zeros((130, 2), np.float32), np.zeros((130, 2))
    single[-1], double[-1] = np.finfo(np.float32).max, -np.finfo(np.float64).max
    results = [env.step(each) for env, each in zip(envs, (single, double, single * 0), strict=True)]
    assert results[0][4]["force"][-1].tolist() == [280.0, 33.0]
    assert results[1][4]["force"][-1].tolist() == [-280.0, -33.0]
    assert np.array_equal(results[0][0][:-1], results[2][0][:-1])
    single[3] = np.inf
    before = envs[0].states
    with pytest.raises(ValueError, match=r"actions must be finite, got .* for car 3"):
        envs[0].step(single)
    assert np.array_equal(envs[0].states, before)


@pytest.mark.parametrize(
    "actions", [{}, [[1j, 0.0]], "push", [["1", "0"]], None, [[1.0], [1.0, 2.0]]]
)
def test_actions_that_are_no_numbers_are_refused(actions):
    env = QuarterCarHumpVectorEnv(1)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions must"):
        env.step(actions)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda env: env.assign([5], force_scale=1.0), "one of 0 to 2, got 5"),
        (lambda env: env.assign([0.5], force_scale=1.0), "one of 0 to 2, got 0.5"),
        (lambda env: env.assign(np.array([True, False, True]), force_scale=1.0), "got .*True"),
        (lambda env: env.assign([0], speed=1.0), "unknown option 'speed'"),
        (
            lambda env: env.assign([0, 1], force_scale=[0.5, 0.0, 1.0]),
            "force_scale must be positive",
        ),
        (lambda env: env.stagger(np.zeros(2, int)), r"elapsed must have shape \(3,\), got \(2,\)"),
        (lambda env: QuarterCarHumpVectorEnv(3, render_cars=0), "render_cars must be indices"),
        (lambda env: QuarterCarHumpVectorEnv(3, force_scale=1e7), r"at most 1e\+06, got 1e\+07"),
    ],
)
def test_what_is_asked_of_cars_is_checked_before_one_changes(call, message):
    env = QuarterCarHumpVectorEnv(3)
    with pytest.raises(ValueError, match=message):
        call(env)
    assert [env.force_scale_of(i) for i in range(3)] == [1.0] * 3


def test_a_seed_is_that_of_the_environments_own_generator_too():
    env = QuarterCarHumpVectorEnv(2)
    env.reset(seed=5)
    assert env.np_random_seed == 5


def test_a_step_before_reset_is_refused():
    with pytest.raises(gym.error.ResetNeeded, match="call reset before step"):
        QuarterCarHumpVectorEnv(1).step(np.zeros((1, 2), np.float32))


def test_returned_arrays_are_the_callers_own():
    env = QuarterCarHumpVectorEnv(3)
    env.reset(seed=0)
    action = np.full((3, 2), 0.2, np.float32)
    *kept, info = env.step(action)
    kept += [info["force"], info["reward_x1"]]
    copies = [each.copy() for each in kept]
    for _ in range(5):
        env.step(action)
    for each, copy in zip(kept, copies, strict=True):
        assert np.array_equal(each, copy)


def trajectory(env, seed, steps=150):
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    return np.array([env.step(actions_for(env, rng))[0] for _ in range(steps)])


@pytest.fixture
def two_threads(monkeypatch):
    """Return the options of an environment that shares few cars out."""
    monkeypatch.setattr(storage, "CARS_A_THREAD", 64)
    return {"threads": 2, "duration": SHORT}


def test_few_cars_stay_in_one_thread(two_threads):
    assert QuarterCarHumpVectorEnv(127, **two_threads)._cars._workers == 1
    assert QuarterCarHumpVectorEnv(128, **two_threads)._cars._workers == 2


def test_threads_share_the_cars_and_change_no_bit(two_threads):
    one = trajectory(QuarterCarHumpVectorEnv(300, duration=SHORT), 1)
    two = trajectory(QuarterCarHumpVectorEnv(300, **two_threads), 1)
    assert np.array_equal(one, two)


def test_environments_in_two_threads_do_not_share_state():
    expected = [trajectory(QuarterCarHumpVectorEnv(70), seed) for seed in (1, 2)]
    found = [None, None]

    def run(i):
        found[i] = trajectory(QuarterCarHumpVectorEnv(70), i + 1)

    threads = [threading.Thread(target=run, args=(i,)) for i in range(2)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert all(np.array_equal(a, b) for a, b in zip(expected, found, strict=True))


def test_a_pickled_environment_goes_on_where_it_was():
    env = QuarterCarHumpVectorEnv(5, duration=SHORT)
    trajectory(env, 1)
    copy = pickle.loads(pickle.dumps(env))
    action = np.full((5, 2), 0.3, np.float32)
    for _ in range(200):
        assert np.array_equal(env.step(action)[0], copy.step(action)[0])
    single = QuarterCarHumpEnv()
    single.reset(seed=0)
    twin = pickle.loads(pickle.dumps(single))
    assert np.array_equal(single.step(action[0])[0], twin.step(action[0])[0])


def in_a_process(queue):
    queue.put(trajectory(QuarterCarHumpVectorEnv(5, threads=2), 3, steps=20))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_another_process_has_the_same_episodes(method):
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=in_a_process, args=(queue,))
    process.start()
    found = queue.get(timeout=120)
    process.join()
    assert np.array_equal(found, trajectory(QuarterCarHumpVectorEnv(5), 3, steps=20))


def test_single_precision_stays_close():
    start = {"state": np.array([0.1, 0.1, 2.0, 1.0]), "phase": 0.3}
    results = []
    for precision in ("double", "single"):
        env = QuarterCarHumpVectorEnv(3, precision=precision)
        env.reset(seed=0, options=start)
        rng = np.random.default_rng(0)
        results.append([env.step(0.5 * actions_for(env, rng))[0] for _ in range(999)])
    double, single = np.array(results)
    assert np.abs(double - single).max() < 5e-4  # of the amplitudes: 4000 steps of 6e-8 each
    assert not np.array_equal(double, single)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_an_environment_goes_on_after_fork(two_threads):
    """The parent's threads are not there in the child, which needs its own."""
    env = QuarterCarHumpVectorEnv(300, **two_threads)
    trajectory(env, 1, steps=10)
    action = np.full((300, 2), 0.2, np.float32)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    process = context.Process(target=lambda: queue.put([env.step(action)[0] for _ in range(130)]))
    process.start()
    found = queue.get(timeout=60)
    process.join()
    assert np.array_equal(found, [env.step(action)[0] for _ in range(130)])


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux's account")
def test_memory_does_not_grow_over_a_hundred_million_steps():
    def resident():
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    n, half = 4096, 50_000_000
    env = QuarterCarHumpVectorEnv(n, duration=SHORT)
    env.reset(seed=0)
    action = np.zeros((n, 2), np.float32)
    sizes = []
    for _ in range(2):
        for _ in range(half // n + 1):
            env.step(action)
        sizes.append(resident())
    # a byte that a car's step, or 400 that an interval, kept would be tens of megabytes
    assert sizes[1] - sizes[0] < 4_000_000


def test_a_car_takes_less_than_a_kilobyte():
    env = QuarterCarHumpVectorEnv(4096)
    assert env.nbytes / 4096 < 1000


def test_states_are_those_of_the_plant():
    env = QuarterCarHumpVectorEnv(2)
    env.reset(seed=0, options={"state": [0.1, 0.2, 0.3, 0.4]})
    single = QuarterCarHumpEnv()
    single.reset(seed=0, options={"state": [0.1, 0.2, 0.3, 0.4]})
    assert State(*env.states[0]) == single.state


# What goes on while others are reset -------------------------------------------------------------


@pytest.mark.parametrize("observe", ["full", ("u1", "u2", "body_acceleration")])
def test_cars_that_are_not_reset_are_shown_as_they_were(observe):
    """Under the forces that their actuators hold, which the fleet once forgot."""
    env = QuarterCarHumpVectorEnv(3, observe=observe, autoreset_mode="Disabled")
    env.reset(seed=0)
    seen = env.step(np.full((3, 2), 0.5, np.float32))[0]
    again, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    assert np.array_equal(again[[0, 2]], seen[[0, 2]])
    assert not np.array_equal(again[1], seen[1])


def rough(seed):
    base = SCENARIOS["mathworks-hump"]
    road = ISO8608.of_class("C", L=100.0, seed=seed, start=0.5)
    return dataclasses.replace(base, name=f"rough-{seed}", road=road, speed=20.0, duration=SHORT)


def test_a_car_stays_on_its_road_until_its_episode_is_over():
    """A scenario that is assigned holds from the next episode on, also for the road's table."""
    env, alone = (QuarterCarHumpVectorEnv(2, rough(1), autoreset_mode="SameStep") for _ in "ab")
    env.reset(seed=0)
    alone.reset(seed=0)
    still = np.zeros((2, 1), np.float32)
    env.step(still)
    alone.step(still)
    env.assign([0, 1], scenario=rough(2))
    assert env.episode_of(0).name == "rough-1"
    for k in range(119):
        found, expected = env.step(still)[0], alone.step(still)[0]
        assert np.array_equal(found, expected) or k == 118
    assert env.episode_of(0).name == "rough-2"
    other = QuarterCarHumpEnv(rough(2))
    other.reset(seed=0)
    other.reset()  # the second episode of its seed
    assert np.array_equal(env.step(still)[0][0], other.step(still[0])[0])


def test_a_scenario_set_on_one_car_holds_from_the_next_reset_on():
    env, alone = QuarterCarHumpEnv(rough(1)), QuarterCarHumpEnv(rough(1))
    still = np.zeros(1, np.float32)
    env.reset(seed=0)
    alone.reset(seed=0)
    env.scenario = rough(2)
    assert env.scenario.name == "rough-2"
    assert env.episode.name == "rough-1"
    for _ in range(100):
        assert np.array_equal(env.step(still)[0], alone.step(still)[0])
    env.reset()
    assert env.episode.name == "rough-2"


def test_numbers_that_are_alike_are_kept_once():
    env = QuarterCarHumpVectorEnv(1000)
    env.reset(seed=0)
    once = env.nbytes
    env.assign([0], force_scale=0.5)
    assert env.nbytes > once
    env.reset(options={"force_scale": 0.5})
    assert env.nbytes == once
    assert np.all(env.force_limits == [140.0, 16.5])


# Actions in memory -------------------------------------------------------------------------------


def test_actions_may_lie_in_memory_in_any_way():
    action = np.random.default_rng(0).uniform(-1, 1, (130, 2)).astype(np.float32)
    row = np.array([[0.25, -0.5]], np.float32)
    kinds = {
        "plain": action,
        "fortran": np.asfortranarray(action),
        "strided": np.repeat(action, 2, axis=0)[::2],
        "float64": action.astype(np.float64),
        "read-only": np.frombuffer(action.tobytes(), np.float32).reshape(130, 2),
    }
    found = {}
    for name, given in kinds.items():
        env = QuarterCarHumpVectorEnv(130)
        env.reset(seed=0)
        found[name] = env.step(given)[0]
    assert all(np.array_equal(each, found["plain"]) for each in found.values())
    env, other = QuarterCarHumpVectorEnv(130), QuarterCarHumpVectorEnv(130)
    env.reset(seed=0)
    other.reset(seed=0)
    broadcast = np.broadcast_to(row, (130, 2))
    assert np.array_equal(env.step(broadcast)[0], other.step(np.array(broadcast))[0])


# Threads and interrupts --------------------------------------------------------------------------


def test_two_threads_in_one_environment_are_told_apart(monkeypatch):
    env, twin = QuarterCarHumpVectorEnv(64), QuarterCarHumpVectorEnv(64)
    for each in (env, twin):
        each.reset(seed=0)
    action = np.full((64, 2), 0.2, np.float32)
    inside, go_on, stepped = threading.Event(), threading.Event(), []
    outputs = env._cars._outputs

    def held():
        inside.set()
        assert go_on.wait(60.0)
        return outputs()

    with monkeypatch.context() as patch:
        patch.setattr(env._cars, "_outputs", held)
        first = threading.Thread(target=lambda: stepped.append(env.step(action)[0]))
        first.start()
        try:
            assert inside.wait(60.0)
            with pytest.raises(RuntimeError, match="another thread is stepping these cars"):
                env.step(action)
        finally:
            go_on.set()
            first.join()
    assert np.array_equal(stepped, [twin.step(action)[0]])
    assert np.array_equal(env.step(action)[0], twin.step(action)[0])  # and it goes on


@pytest.mark.parametrize("n", [1, 64, 3000])
def test_two_threads_in_one_environment_lose_no_step(n):
    """Each step is taken by all cars, or refused."""
    env, twin = QuarterCarHumpVectorEnv(n), QuarterCarHumpVectorEnv(n)
    env.reset(seed=0)
    twin.reset(seed=0)
    action, taken = np.full((n, 2), 0.2, np.float32), []

    def run():
        for _ in range(300):
            with contextlib.suppress(RuntimeError):
                env.step(action)
                taken.append(1)

    threads = [threading.Thread(target=run) for _ in range(2)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    for _ in taken:
        twin.step(action)
    assert np.array_equal(env.states, twin.states)


@pytest.mark.parametrize("call", ["step", "reset", "assign"])
def test_nothing_is_done_to_cars_that_another_thread_is_stepping(call, monkeypatch):
    env = QuarterCarHumpVectorEnv(3)
    env.reset(seed=0)
    step, refused = env._cars._step, []
    action = np.zeros((3, 2), np.float32)
    calls = {
        "step": lambda: env.step(action),
        "reset": env.reset,
        "assign": lambda: env.assign([0], force_scale=0.5),
    }

    def other():
        with pytest.raises(RuntimeError, match="another thread is stepping these cars"):
            calls[call]()
        refused.append(call)

    def slow(*args):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        return step(*args)

    monkeypatch.setattr(env._cars, "_step", slow)
    env.step(action)
    assert refused == [call]


def test_a_keyboard_interrupt_in_a_threaded_step_waits_for_the_workers(two_threads, monkeypatch):
    """They write into arrays that would be freed otherwise."""
    env = QuarterCarHumpVectorEnv(300, **two_threads)
    env.reset(seed=0)
    action = np.zeros((300, 2), np.float32)
    env.step(action)  # makes the pool
    step, started, finished = env._cars._step, threading.Event(), threading.Event()

    def interrupted(*args):
        if threading.current_thread() is threading.main_thread():
            started.wait()
            raise KeyboardInterrupt
        started.set()
        time.sleep(0.2)
        finished.set()
        return step(*args)

    monkeypatch.setattr(env._cars, "_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        env.step(action)
    assert finished.is_set()
    monkeypatch.setattr(env._cars, "_step", step)
    env.step(action)


SAME = """
def same(env, twin, action, steps):
    '''Say whether twins are alike, at once or after some of so many more steps of the second.'''
    def alike():
        return all(
            np.array_equal(getattr(env._cars, name), getattr(twin._cars, name))
            for name in ("states", "phases", "uniforms")
        )
    return alike() or any(twin.step(action) and alike() for _ in range(steps))
"""


def printed_by(script, argument):
    """Return what a script prints in a process of its own, in which `SAME` is defined."""
    found = subprocess.run(
        [sys.executable, "-c", SAME + script, argument], capture_output=True, text=True, timeout=240
    )
    assert found.returncode == 0, found.stderr
    return found.stdout.strip()


INTERRUPTED = """
import os, signal, sys, threading, time
import numpy as np
from qcar_env.engine import storage
storage.CARS_A_THREAD = 64
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
n, rng = 20_000, np.random.default_rng(0)
env, twin = (
    QuarterCarHumpVectorEnv(n, threads=int(sys.argv[1]), autoreset_mode="SameStep", duration=0.1)
    for _ in range(2)
)
elapsed, action = rng.integers(0, 20, n), np.full((n, 2), 0.2, np.float32)
for each in (env, twin):
    each.reset(seed=0)
    each.stagger(elapsed)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
taken, caught, wanted = 0, 0, threading.Semaphore(0)
def interrupt():
    while wanted.acquire():
        time.sleep(rng.uniform(0.0, 0.01))
        os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=interrupt, daemon=True).start()
while caught < 20:
    try:
        wanted.release()
        while True:
            env.step(action)
            taken += 1
    except KeyboardInterrupt:
        caught += 1
env.step(action)
for _ in range(taken + 1):
    twin.step(action)
print("caught", caught, same(env, twin, action, caught))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs signals of Unix")
@pytest.mark.parametrize("threads", ["1", "2"])
def test_ctrl_c_leaves_all_cars_at_the_same_step(threads):
    """Some had moved and others not, and episodes that had ended went on."""
    assert printed_by(INTERRUPTED, threads) == "caught 20 True"


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_an_interrupt_once_the_cars_have_moved_does_not_lose_an_end(mode, error, monkeypatch):
    env, twin = (QuarterCarHumpVectorEnv(3, duration=0.02, autoreset_mode=mode) for _ in range(2))
    for each in (env, twin):
        each.reset(seed=0)
        each.stagger(np.array([0, 1, 2]))  # the last ends at k = 1
    action = np.full((3, 2), 0.3, np.float32)
    for k in range(12):
        with monkeypatch.context() as patch, contextlib.suppress(error):
            if k % 2:
                patch.setattr(env._cars, "_turn", raising(error))
            env.step(action)
        twin.step(action)
        if k == 1:
            for each in (env, twin):
                each.reset(seed=1, options={"reset_mask": np.array([True, False, False])})
    for _ in range(5):
        assert np.array_equal(env.step(action)[0], twin.step(action)[0])
        assert np.array_equal(env._cars.done, twin._cars.done)


def raising(error):
    def function(*args):
        raise error

    return function


@pytest.mark.parametrize(
    "change",
    [
        lambda env: env.assign([0, 129], scenario="paper-randomised"),
        lambda env: env.reset(options={"scenario": ["paper"] * 129 + ["paper-randomised"]}),
    ],
    ids=["assign", "reset"],
)
def test_an_interrupt_while_cars_are_assigned_changes_nothing(change, monkeypatch):
    """It left numbers of old and new cars side by side, which compiled code read past the end."""
    env, twin = (QuarterCarHumpVectorEnv(130, duration=0.05) for _ in range(2))
    for each in (env, twin):
        each.reset(seed=0)
    with monkeypatch.context() as patch:
        patch.setattr(env._cars, "_bind", raising(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            change(env)
    action = np.full((130, 2), 0.3, np.float32)
    for _ in range(25):
        assert np.array_equal(env.step(action)[0], twin.step(action)[0])
    assert np.array_equal(env.force_limits, twin.force_limits)
    assert env.scenario_of(129).name == "paper"
    assert np.array_equal(env.reset(seed=1)[0], twin.reset(seed=1)[0])


# Memory ------------------------------------------------------------------------------------------


def test_where_no_thread_can_be_started_one_does_it_all(two_threads, monkeypatch):
    expected = trajectory(QuarterCarHumpVectorEnv(300, duration=SHORT), 1)
    monkeypatch.setattr(threading.Thread, "start", raising(RuntimeError))
    assert np.array_equal(trajectory(QuarterCarHumpVectorEnv(300, **two_threads), 1), expected)


SHORT_OF_MEMORY = """
import resource, sys
import numpy as np
from qcar_env.engine import storage
storage.CARS_A_THREAD = 64
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
n = 40_000
env, twin = (
    QuarterCarHumpVectorEnv(n, threads=2, method=sys.argv[1], autoreset_mode="SameStep")
    for _ in range(2)
)
action = np.full((n, 2), 0.2, np.float32)
for each in (env, twin):
    each.reset(seed=0)
    each.stagger(np.arange(n) % 1000)
    each.step(action)
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**24, -1))
kept, taken, failed = [], 0, 0
while failed < 100:
    try:
        kept.append(env.step(action))
        taken += 1
    except MemoryError:
        failed += 1
        del kept[failed % 3 :]
resource.setrlimit(resource.RLIMIT_AS, (-1, -1))
env.step(action)
for _ in range(taken + 1):
    twin.step(action)
print(taken > 100, same(env, twin, action, failed))
"""


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux's account")
@pytest.mark.parametrize("method", ["rk4", "exact"])
def test_no_memory_left_is_a_memory_error_and_loses_no_car(method):
    assert printed_by(SHORT_OF_MEMORY, method) == "True True"


# Time --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["double", "single"])
def test_episodes_end_in_time_beyond_what_single_precision_counts(precision):
    """2^24 + 1 is no number of single precision; the clock is in double."""
    last = 2**24 + 3
    env = QuarterCarHumpVectorEnv(
        2, max_episode_steps=last, precision=precision, autoreset_mode="Disabled"
    )
    env.reset(seed=0, options={"state": np.zeros(4)})
    env.stagger(np.array([last - 3, last - 2]))
    still = np.zeros((2, 2), np.float32)
    ends = np.array([env.step(still)[3] for _ in range(2)])
    assert ends.tolist() == [[False, False], [False, True]]
    env.reset(options={"reset_mask": np.array([False, True])})
    assert env.step(still)[3].tolist() == [True, False]


def test_the_road_goes_on_beyond_what_single_precision_counts():
    """Phasors in single precision are made anew from the clock every 64 intervals."""
    before = 2**24 - 64
    env = QuarterCarHumpVectorEnv(1, max_episode_steps=2**25, precision="single")
    env.reset(seed=0, options={"state": np.zeros(4), "phase": 0.0})
    env.stagger(np.array([before]))
    still = np.zeros((1, 2), np.float32)
    seen = np.array([env.step(still)[0][0, 4:6] for _ in range(256)])
    angle = SCENARIOS["paper"].excitation.omega * env.dt * (before + 1 + np.arange(256))
    # 64 intervals of 4 turns, each rounded to 6e-8
    np.testing.assert_allclose(seen[:, 0], np.sin(angle), rtol=0.0, atol=64 * 4 * 6e-8)
    np.testing.assert_allclose(seen[:, 1], np.cos(angle), rtol=0.0, atol=64 * 4 * 6e-8)


@pytest.mark.parametrize("k", [7, 10, 12])
def test_a_kink_that_rounding_moves_past_an_instant_is_read_as_by_a_single_environment(k):
    preset = SCENARIOS["paper-hump"]
    at = dataclasses.replace(preset.road, start=preset.speed * (k * preset.dt))
    scenario = dataclasses.replace(preset, road=at)
    many, one = QuarterCarHumpVectorEnv(1, scenario), QuarterCarHumpEnv(scenario)
    many.reset(seed=3)
    one.reset(seed=3)
    idle = np.zeros((1, many.single_action_space.shape[0]), np.float32)
    for _ in range(k + 2):
        np.testing.assert_array_equal(many.step(idle)[0][0], one.step(idle[0])[0])
