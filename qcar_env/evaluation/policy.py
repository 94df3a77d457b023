"""What a policy is: anything with the `predict` of Stable-Baselines3."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


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
