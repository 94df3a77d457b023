"""What the cars of a vector environment begin with: options, seeds and scenarios, one for each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.random import streams
from qcar_env.engine.storage import BOOL
from qcar_env.envs import episode as task
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.scenarios.plan import Plan
from qcar_env.validation import finite, numbers, whole


class Drawn(NamedTuple):
    """What a car draws its episodes from."""

    own: Scenario
    force_scale: float
    plan: Plan

    @property
    def base(self) -> Scenario:
        """The scenario with that scale, and the environment's duration."""
        return self.plan.scenario


def each_its_own(n: int, name: str, value: Any, one: tuple[type, ...]) -> list[Any]:
    """Return an option's value for each of `n` cars: the same, or one from each of a sequence.

    Raises
    ------
    ValueError
        If the sequence has another length.
    """
    if isinstance(value, one) or np.ndim(value) == 0:
        return [value] * n
    if len(value) != n:
        raise ValueError(
            f"{name} must be one value or {n} of them, got {len(value)}; give one for each car"
        )
    return list(value)


def reset_mask(n: int, given: Any, started: bool) -> NDArray[np.bool_]:
    """Return which of `n` cars begin, all if `given` is None.

    Raises
    ------
    ValueError
        If it is no mask, marks no car, or not all of them in the first reset.
    """
    if given is None:
        return np.ones(n, BOOL)
    mask = np.asarray(given)
    if mask.shape != (n,) or mask.dtype != BOOL or not mask.any():
        raise ValueError(
            f"reset_mask must be an array ({n},) of bool with a true entry, got "
            f"shape {mask.shape} of {mask.dtype}; mark the cars that begin again"
        )
    if not (started or mask.all()):
        raise ValueError(
            f"reset_mask must mark all cars in the first reset, got {np.count_nonzero(mask)} "
            f"of {n}; leave it out"
        )
    return mask


def seeded(
    n: int, chosen: NDArray[np.intp], seed: int | Sequence[int | None] | None, first: bool
) -> tuple[NDArray[np.intp], NDArray[np.uint64]]:
    """Return which of the chosen cars get other random streams, and these.

    Raises
    ------
    ValueError
        If there are not as many seeds as cars, or one is no whole number.
    """
    if seed is None and not first:
        return np.zeros(0, np.intp), np.zeros((0, 4), np.uint64)
    if seed is None or isinstance(seed, (int, np.integer)):
        start = None if seed is None else whole("seed", seed, 0)
        each = [None if start is None else start + i for i in range(n)]
    elif isinstance(seed, Iterable) and not isinstance(seed, (str, bytes)):
        each = [None if one is None else whole("seed of a car", one, 0) for one in seed]
    else:
        raise ValueError(f"seed must be a whole number or one for each car, got {seed!r}")
    if len(each) != n:
        raise ValueError(
            f"seed must be one number or {n} of them, got {len(each)}; give one for each car"
        )
    cars = [i for i in chosen.tolist() if first or each[i] is not None]
    return np.array(cars, dtype=np.intp), streams(each[i] for i in cars)


def changed(
    given: Sequence[Drawn],
    chosen: Iterable[int],
    options: Mapping[str, Any],
    make: Callable[[Scenario, float], Drawn],
) -> dict[int, Drawn]:
    """Return what the chosen cars draw from with other options.

    Parameters
    ----------
    given : sequence of Drawn
        What all cars draw from.
    chosen : iterable of int
        Which ones change.
    options : mapping
        `scenario`, `force_scale`: one value or one for each car, None for a car that keeps its own.
    make : callable
        ``make(scenario, force_scale)`` returns a `Drawn`.
    """
    n = len(given)
    names = str, Scenario, type(None)
    scenarios = each_its_own(n, "scenario", options.get("scenario"), names)
    scales = each_its_own(n, "force_scale", options.get("force_scale"), (int, float, type(None)))
    made: dict[tuple[int, float], Drawn] = {}
    found: dict[int, Drawn] = {}
    for i in map(int, chosen):
        own = given[i].own if scenarios[i] is None else find_scenario(scenarios[i])
        scale = given[i].force_scale if scales[i] is None else task.force_scale(scales[i])
        key = id(own), scale
        if key not in made:
            made[key] = make(own, scale)
        found[i] = made[key]
    return found


def starts(given: Mapping[int, Drawn], n: int, options: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return states and phases that are given, (n, 5), not a number where they are drawn.

    Parameters
    ----------
    given : mapping
        What each car that begins draws from.
    n : int
        Number of cars.
    options : mapping
        `state`, `phase`: one value or one for each car.
    """
    found = np.full((n, 5), np.nan)
    if "state" in options:
        states = _states(options["state"], n)
        for i, each in given.items():
            if states[i] is not None:
                found[i, :4] = task.given_state(states[i], each.base)
    if "phase" in options:
        phases = each_its_own(n, "phase", options["phase"], (int, float))
        for i in given:
            if phases[i] is not None:
                found[i, 4] = finite("phase", phases[i], "rad")
    return found


def _states(given: Any, n: int) -> Sequence[Any]:
    """Return the state that each car starts in, None where it is drawn."""
    some = isinstance(given, Sequence) and any(each is None for each in given)
    if some and len(given) == n:
        return given
    states = numbers("state", given)
    if states.ndim == 1:
        states = np.tile(states, (n, 1))
    if states.shape != (n, 4):
        raise ValueError(
            f"state must have shape (4,) or ({n}, 4), got {states.shape}; "
            "give (x1, x2, v1, v2) for each car"
        )
    return list(states)
