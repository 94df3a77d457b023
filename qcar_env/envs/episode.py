"""What the environments share: what they show, what they are given, and the fleet that they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.starts import OBSERVATION_LIMIT
from qcar_env.envs.reward import Reward, Term, reward_of
from qcar_env.physics.signals import Signal, signal
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.plan import Plan
from qcar_env.validation import known, numbers, positive, shown, whole

FEEDBACK = ("x1", "x2", "v1", "v2")  # the state, which is what the paper's laws use
FULL = (*FEEDBACK, "y", "y_dot", "F", "F_dot")  # also road and external force
OBSERVE = {"full": FULL, "feedback": FEEDBACK}
FEEDBACK_SIZE, FULL_SIZE = len(FEEDBACK), len(FULL)

HIGHEST_SCALE = 1e6  # [-] of a force limit; chosen here: no product of it overflows
RESET_OPTIONS = ("state", "phase", "force_scale", "scenario")

Observe = str | Sequence[str | Signal]
RewardLike = str | Reward | Term | Sequence[Term]

__all__ = ["OBSERVATION_LIMIT"]


def observed(observe: Observe, observe_limit: bool = False) -> tuple[Signal, ...]:
    """Return the signals that an observation is made of.

    Parameters
    ----------
    observe : str or sequence
        ``"full"``, ``"feedback"``, or names of `qcar_env.physics.signals.SIGNALS` and signals of
        one's own.
    observe_limit : bool
        Whether the force limit follows.

    Raises
    ------
    ValueError
        If there is no such set or signal, or nothing to observe.
    """
    if isinstance(observe, str):
        chosen: Sequence[str | Signal] = OBSERVE[known("observe", observe, OBSERVE)]
    else:
        chosen = tuple(observe) if isinstance(observe, Sequence) else ()
        if not chosen:
            raise ValueError(
                f"observe must be 'full', 'feedback' or names of signals, got {shown(observe)}; "
                "give at least one"
            )
    names = (*chosen, "limit") if observe_limit else chosen
    return tuple(signal(each) for each in names)


@dataclasses.dataclass(frozen=True)
class Settings:
    """How an environment is made from a scenario."""

    observe: Observe
    observe_limit: bool
    reward: RewardLike
    duration: float | None  # [s]
    most_steps: int | None  # control intervals in an episode; the scenario's duration otherwise

    def scenario(self, named: Scenario, scale: float) -> Scenario:
        """Return a scenario with the environment's force limit and length of an episode."""
        found = named if scale == 1.0 else named.with_force_scale(scale)
        if self.most_steps is not None:
            return dataclasses.replace(found, duration=self.most_steps * found.dt)
        if self.duration is not None:
            return dataclasses.replace(found, duration=self.duration)
        return found

    def plan(self, named: Scenario, scale: float) -> Plan:
        """Return what a fleet of it is made for."""
        found = reward_of(self.reward, named)
        return Plan(
            scenario=self.scenario(named, scale),
            observed=observed(self.observe, self.observe_limit),
            terms=found.terms,
            penalty=found.penalty,
            own=named,
        )


def most_steps(given: Any) -> int | None:
    """Return a number of control intervals, checked; None stands for the scenario's duration."""
    return None if given is None else whole("max_episode_steps", given)


def given_state(values: Any, scenario: Scenario) -> NDArray[np.float64]:
    """Check a start state that a user gives.

    Parameters
    ----------
    values : array_like (4,)
        ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    scenario : Scenario
        For its travel limits.

    Returns
    -------
    ndarray (4,)

    Raises
    ------
    ValueError
        If the shape is wrong, a value is not finite, or an amplitude is beyond its limit.
    """
    state = numbers("state", values)
    if state.shape != (4,) or not np.all(np.isfinite(state)):
        raise ValueError(
            f"state must be four finite numbers (x1, x2, v1, v2), got {values!r}; "
            "give metres and metres a second"
        )
    scales = scenario.reference.scales
    for name, value in zip(State._fields, state, strict=True):
        limit = scales[name] * scenario.travel_limit
        unit = "m" if name in ("x1", "x2") else "m/s"
        if abs(value) > limit:
            raise ValueError(
                f"state {name} must be within its travel limit of {limit:.4g} {unit}, got "
                f"{value:g} {unit}; start closer to rest"
            )
    return state


def force_scale(value: Any) -> float:
    """Return a factor on the force limit, checked.

    Raises
    ------
    ValueError
        If it is not a positive number up to `HIGHEST_SCALE`.
    """
    scale = positive("force_scale", value)
    if scale > HIGHEST_SCALE:
        raise ValueError(
            f"force_scale must be at most {HIGHEST_SCALE:g}, got {scale:g}; no car needs more"
        )
    return scale


def checked_actions(
    name: str, given: Any, shape: tuple[int, ...], each: str
) -> NDArray[np.float32]:
    """Return a copy of actions as an array of the kind that the engine takes.

    Parameters
    ----------
    name : str
        What they are called.
    given : array_like
        Numbers of any kind. What is beyond float32 becomes 2 or -2, which are clipped like it.
    shape : tuple of int
        What their shape must be.
    each : str
        What each number is for.

    Raises
    ------
    ValueError
        If they are no numbers, or their shape is another.
    """
    wide = numbers(name, given)
    if wide.shape != shape:
        raise ValueError(
            f"{name} must have shape {shape}, got {wide.shape}; give one number for each {each}"
        )
    clipped = np.where(np.isfinite(wide), np.clip(wide, -2.0, 2.0), wide)
    return np.ascontiguousarray(clipped, np.float32)


def no_pygame() -> Exception:
    """Return what says that a picture cannot be drawn."""
    return gym.error.DependencyNotInstalled(
        "rendering needs pygame; pip install 'qcar_env[render]'"
    )
