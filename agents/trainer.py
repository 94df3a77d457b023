"""What a trainer is: one interface for PPO, SAC, TD3, CMA-ES and the analytic gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

Hook = Callable[[], bool]  # called where a trainer is whole; False stops it


class Trainer(Protocol):
    """Trains one agent from a recipe and a seed, in steps that can be interrupted and resumed."""

    def learn(self, hook: Hook) -> None:
        """Train until the recipe's steps are done or `hook` returns False.

        Parameters
        ----------
        hook : callable
            Called between iterations, when `snapshot` holds all there is.
        """
        ...

    @property
    def steps(self) -> int:
        """Environment steps so far (control intervals of all cars)."""
        ...

    def actor(self) -> nn.Module:
        """Return the policy so far: raw observations (n, k) to actions (n, m)."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """Return all that training needs to go on, as tensors and plain values."""
        ...

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot of the same recipe and seed."""
        ...


class ActorPolicy:
    """A torch actor with the `predict` of Stable-Baselines3.

    Parameters
    ----------
    actor : torch.nn.Module
        Raw observations (n, k) to actions (n, m).
    """

    def __init__(self, actor: nn.Module) -> None:
        self._actor = actor.eval()

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Return the actor's actions and no memory."""
        with torch.no_grad():
            seen = torch.as_tensor(np.asarray(observation, dtype=np.float32))
            return self._actor(seen).numpy(), None


def generator_state(rng: np.random.Generator) -> list[str]:
    """Return the state of a PCG64 generator as plain text."""
    state = rng.bit_generator.state
    words = (*state["state"].values(), state["has_uint32"], state["uinteger"])
    return [str(word) for word in words]


def set_generator_state(rng: np.random.Generator, words: list[str]) -> None:
    """Bring a PCG64 generator back to a state."""
    state, inc, has_uint32, uinteger = (int(word) for word in words)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }


def tensors(arrays: Mapping[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    """Return arrays, such as the snapshot of a fleet, as tensors."""
    return {name: torch.tensor(each) for name, each in arrays.items()}


def arrays(tensors: Mapping[str, torch.Tensor]) -> dict[str, NDArray[Any]]:
    """Return tensors as arrays."""
    return {name: each.numpy() for name, each in tensors.items()}


def annealed(ends: tuple[float, float], progress: float) -> float:
    """Return the value at `progress` in [0, 1] of a linear schedule."""
    first, last = ends
    return first + (last - first) * min(1.0, max(0.0, progress))
