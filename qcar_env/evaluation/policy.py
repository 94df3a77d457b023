"""What a policy is: anything with the `predict` of Stable-Baselines3."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import Observe
from qcar_env.validation import numbers


class Policy(Protocol):
    """A policy, as Stable-Baselines3's `PolicyPredictor`; its models satisfy it untouched."""

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return the actions and the policy's own state.

        Parameters
        ----------
        observation : ndarray (n, k) or (k,)
            Observations of n cars, or of one.
        state : tuple of ndarray (n, ...), optional
            What the policy remembers; None at the beginning.
        episode_start : ndarray (n,) of bool, optional
            Which cars have just begun an episode, so that their memory is void.
        deterministic : bool
            Whether to return the policy's mode instead of a draw.

        Returns
        -------
        actions : ndarray (n, m) or (m,)
            Force over its limit.
        state : tuple of ndarray or None
        """
        ...


def check_policy(policy: Any) -> None:
    """Raise ValueError where an object is no policy."""
    if isinstance(policy, type) or not callable(getattr(policy, "predict", None)):
        raise ValueError(
            f"policy must have the predict of Stable-Baselines3, got {policy!r}; "
            "give an object, such as qcar_env.baselines.catalogue.make('cnvc')"
        )


def actions_of(
    policy: Policy,
    observation: NDArray[np.float32],
    memory: Any,
    begins: NDArray[np.bool_],
    size: int,
) -> tuple[NDArray[np.float64], Any]:
    """Return a policy's actions (n, size) and memory after a check of what it returned.

    Arguments are those of `Policy.predict`, for n cars with `size` actuators.

    Raises
    ------
    ValueError
        If the policy does not return a pair, or actions that are no numbers or of another shape.
    """
    found: Any = policy.predict(observation, state=memory, episode_start=begins, deterministic=True)
    if not isinstance(found, (tuple, list)) or len(found) != 2:
        raise ValueError(
            f"predict must return actions and memory, got {type(found).__name__}; "
            "return (actions, None) where nothing is remembered"
        )
    action = numbers("action", found[0])
    n = len(observation)
    if action.shape != (n, size):
        raise ValueError(
            f"action must have shape {(n, size)}, got {action.shape}; "
            f"return one number for each of {size} actuator(s) and {n} car(s)"
        )
    return action, found[1]


def shown_to(policy: Any, most: Observe) -> tuple[Observe, bool]:
    """Return what a policy is shown, by default `most`, and whether it sees the force limit."""
    return getattr(policy, "reads", most), bool(getattr(policy, "observe_limit", False))
