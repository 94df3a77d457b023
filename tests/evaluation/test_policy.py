"""What a policy must be and return, wherever it is rolled out."""

import numpy as np
import pytest

from qcar_env.evaluation.entry import may_enter
from qcar_env.evaluation.rollouts import rollout, rollouts
from qcar_env.evaluation.tracks import episodes, track
from qcar_env.scenarios import scenario

CASES = episodes(track("budget"), force_scale=1.0, count=1)


class Returns:
    """A policy that returns what it was given."""

    def __init__(self, found):
        self.found = found

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.found


def alone(policy):
    return rollout(policy, scenario("paper"), duration=0.1)


def together(policy):
    return rollouts(policy, CASES, duration=0.1)


@pytest.mark.parametrize("run", [alone, together])
@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (None, "policy must have the predict of Stable-Baselines3, got None; give an object"),
        (Returns, "policy must have the predict .* got <class .*Returns'>; give an object"),
        (Returns(np.zeros((2, 2))), "predict must return actions and memory, got ndarray; return"),
        (Returns(None), "predict must return actions and memory, got NoneType; return"),
        (Returns((np.zeros(2), None)), r"action must have shape \(1, 2\), got \(2,\); return one"),
        (Returns((np.zeros((1, 1)), None)), r"action must have shape \(1, 2\), got \(1, 1\);"),
        (Returns((np.full((1, 2), np.nan), None)), "action must be finite"),
        (Returns((np.full((1, 2), 0.5 + 0.5j), None)), "action must be numbers, got .*0.5j"),
        (Returns((np.full((1, 2), "0.5"), None)), "action must be numbers, got .*'0.5'"),
        (Returns(([["0.5", 0.5]], None)), "action must be numbers, got .*'0.5'"),
        (Returns(([[None, 0.5]], None)), "action must be finite"),
    ],
)
def test_what_is_no_policy_is_refused(run, policy, message):
    with pytest.raises(ValueError, match=message):
        run(policy)


@pytest.mark.parametrize("given", [CASES[0], None, "paper", [None]])
def test_what_are_no_episodes_is_refused(given):
    with pytest.raises(ValueError, match=r"episodes must be a sequence of Episode, got .*; take"):
        rollouts(Returns(None), given)


def test_numbers_and_names_out_of_range_are_refused():
    with pytest.raises(ValueError, match="last must be at least 1, got 0; give 1 or more"):
        rollouts(Returns(None), CASES, last=0)
    with pytest.raises(ValueError, match="seed must be at least 0, got -1; give 0 or more"):
        rollout(Returns(None), scenario("paper"), seed=-1)
    with pytest.raises(ValueError, match="unknown observe 'ful'; did you mean 'full'"):
        may_enter("ful", track("paper"))
