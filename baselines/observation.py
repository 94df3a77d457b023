"""What a policy reads of an observation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs import episode as task
from qcar_env.scenarios import Scenario
from qcar_env.validation import numbers


def scales_of(scenario: Scenario, observe: task.Observe = "full") -> NDArray[np.float64]:
    """Return what the entries of a scenario's observation are divided by, in their units."""
    found = scenario.reference
    return np.array([found.scale(each, scenario) for each in task.observed(observe)])


def entries_of(observation: Any, size: int, names: tuple[str, ...] = ()) -> NDArray[np.float64]:
    """Return an observation as numbers.

    Parameters
    ----------
    observation : array_like (n, k) or (k,)
        Observations of n cars, or of one.
    size : int
        Entries that are read: the first of the k.
    names : tuple of str
        The signals that they are, where they are neither "feedback" nor "full".

    Returns
    -------
    ndarray (n, k) or (k,)

    Raises
    ------
    ValueError
        If it has another shape, is not numbers, or has fewer entries.
    """
    try:
        entries = numbers("they", observation)
    except ValueError as error:
        raise ValueError(
            f"observation must be numbers (n, k) or (k,), got {type(observation).__name__} "
            f"({error}); give what the environment returns"
        ) from None
    if entries.ndim not in (1, 2):
        raise ValueError(
            f"observation must have shape (n, k) or (k,), got {entries.shape}; "
            "give what the environment returns"
        )
    if entries.shape[-1] < size:
        observe = "'feedback' or 'full'" if size == task.FEEDBACK_SIZE else "'full'"
        observe = str(names) if names else observe
        raise ValueError(
            f"observation must have at least {size} entries, got {entries.shape[-1]}; "
            f"make the environment with observe={observe}"
        )
    return entries
