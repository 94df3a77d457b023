"""Roll a policy out through the environment and keep the time histories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.policy import Policy, actions_of, check_policy
from qcar_env.scenarios import Scenario
from qcar_env.validation import whole

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """Time histories of one episode, one row for each control interval."""

    t: Array  # (k,) time since the start, at the end of each interval [s]
    x1: Array  # (k,) wheel displacement [m]
    x2: Array  # (k,) body displacement [m]
    v1: Array  # (k,) wheel velocity [m/s]
    v2: Array  # (k,) body velocity [m/s]
    force: Array  # (k, m) force held over the interval [m/s^2] or [N]
    reward: Array  # (k,) [-]
    terminated: bool  # whether a displacement left its limit
    scenario: Scenario


def rollout(
    policy: Policy,
    scenario: Scenario,
    *,
    duration: float | None = None,
    observe: Literal["full", "feedback"] = "full",
    state: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    phase: float = 0.0,
    seed: int = 0,
) -> Rollout:
    """Run one episode.

    Parameters
    ----------
    policy : Policy
        What acts.
    scenario : Scenario
        What it acts in.
    duration : float, optional
        Length of the episode [s]; the scenario's if left out.
    observe : {"full", "feedback"}
        What the policy is shown.
    state : array_like (4,)
        Start ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    phase : float
        Phase of the road at the start [rad].
    seed : int
        Seed of the environment, for scenarios that vary.

    Returns
    -------
    Rollout

    Raises
    ------
    ValueError
        If the policy has no `predict`, or returns an action of the wrong shape or one that is not
        a number, or an argument is out of range.
    """
    check_policy(policy)
    whole("seed", seed, least=0)
    env = QuarterCarHumpEnv(scenario, observe=observe, duration=duration)
    observation, _ = env.reset(seed=seed, options={"state": state, "phase": phase})
    steps, size = env.scenario.steps, env.scenario.actuator.size
    states = np.empty((steps, 4))
    force = np.empty((steps, size))
    rewards = np.empty(steps)
    memory: Any = None
    start = np.ones(1, dtype=bool)
    terminated = truncated = False
    k = 0
    while not (terminated or truncated):
        action, memory = actions_of(policy, observation[np.newaxis], memory, start, size)
        start = np.zeros(1, dtype=bool)
        observation, rewards[k], terminated, truncated, info = env.step(action[0])
        states[k] = env.state
        force[k] = info["force"]
        k += 1
    return Rollout(
        t=env.dt * np.arange(1, k + 1, dtype=np.float64),
        x1=states[:k, 0],
        x2=states[:k, 1],
        v1=states[:k, 2],
        v2=states[:k, 3],
        force=force[:k],
        reward=rewards[:k],
        terminated=terminated,
        scenario=env.episode,
    )
