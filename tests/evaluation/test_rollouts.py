"""Rollouts: the environment's own numbers, in order, for any policy."""

import dataclasses

import numpy as np
import pytest

from qcar_env import SCENARIOS, scenario
from qcar_env.envs import task
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.rollouts import rollout

PAPER = scenario("paper")


class Constant:
    """A policy that always does the same, and counts."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)
        self.seen = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append((observation.copy(), state, episode_start.copy(), deterministic))
        count = 0 if state is None else state[0]
        return np.tile(self.action, (len(observation), 1)), (count + 1,)


def test_a_rollout_is_what_the_environment_did():
    policy = Constant(0.3, -0.2)
    start = {"state": (0.1, -0.2, 3.0, 4.0), "phase": 1.0}
    found = rollout(policy, PAPER, duration=0.5, **start)
    env = QuarterCarHumpEnv("paper", duration=0.5)
    env.reset(seed=0, options=start)
    for k in range(100):
        _, reward, terminated, truncated, info = env.step(policy.action)
        assert found.reward[k] == reward
        assert np.array_equal(found.force[k], info["force"])
        state = (found.x1[k], found.x2[k], found.v1[k], found.v2[k])
        assert state == env.state
    assert truncated
    assert not terminated
    assert found.terminated is False
    assert found.scenario == env.episode


def test_the_shapes_and_times_are_those_of_the_intervals():
    found = rollout(Constant(0.0, 0.0), PAPER, duration=0.3)
    assert found.t == pytest.approx(0.005 * np.arange(1, 61), rel=1e-12)
    assert found.force.shape == (60, 2)
    for name in ("x1", "x2", "v1", "v2", "reward"):
        assert getattr(found, name).shape == (60,)


def test_the_policy_is_asked_as_sb3s_evaluator_asks():
    policy = Constant(0.0, 0.0)
    rollout(policy, PAPER, duration=0.05, observe="feedback")
    assert [seen[0].shape for seen in policy.seen] == [(1, task.FEEDBACK_SIZE)] * 10
    assert [seen[2].tolist() for seen in policy.seen] == [[True]] + [[False]] * 9
    assert policy.seen[0][1] is None
    assert [seen[1] for seen in policy.seen[1:]] == [(k,) for k in range(1, 10)]
    assert all(seen[3] for seen in policy.seen)


def test_a_rollout_that_leaves_its_limits_ends_there():
    limit = PAPER.travel_limit * PAPER.reference_amplitudes[0]
    found = rollout(Constant(0.0, 0.0), PAPER, state=(0.99 * limit, 0.0, 60.0, 0.0))
    assert found.terminated is True
    assert len(found.t) < PAPER.steps
    assert abs(found.x1[-1]) > limit
    assert np.all(np.abs(found.x1[:-1]) <= limit)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_can_be_driven_from_rest(name):
    found = rollout(Constant(*[0.0] * SCENARIOS[name].actuator.size), SCENARIOS[name])
    assert not found.terminated
    assert len(found.t) == SCENARIOS[name].steps
    assert np.max(np.abs(found.x2)) > 0.0


def test_a_seed_draws_one_episode_and_another_seed_another():
    nominal = dataclasses.replace(SCENARIOS["paper-randomised"], duration=0.1)
    a, b, c = (rollout(Constant(0.0, 0.0), nominal, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(a.x2, b.x2)
    assert a.scenario == b.scenario != c.scenario
    assert not np.array_equal(a.x2, c.x2)


@pytest.mark.parametrize("action", [(0.0,), (0.0, 0.0, 0.0)])
def test_a_policy_of_the_wrong_size_is_refused(action):
    got = rf"action must have shape \(1, 2\), got \(1, {len(action)}\)"
    message = f"{got}; return one number for each of 2 actuator"
    with pytest.raises(ValueError, match=message):
        rollout(Constant(*action), PAPER, duration=0.05)


def test_a_policy_that_gives_no_number_is_refused():
    with pytest.raises(ValueError, match=r"action must be finite, got .*nan"):
        rollout(Constant(0.0, float("nan")), PAPER, duration=0.05)


def test_an_observation_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="unknown observe 'ful'; did you mean 'full'"):
        rollout(Constant(0.0, 0.0), PAPER, observe="ful")
