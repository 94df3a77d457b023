"""How fast one can drive: the fastest speed at which a criterion holds, and at all lower ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import Observe
from qcar_env.evaluation.policy import Policy
from qcar_env.evaluation.ride import RIDE_SIGNALS, Ride, ride
from qcar_env.evaluation.rollouts import rollout
from qcar_env.scenarios import Scenario
from qcar_env.validation import finite_array, shown


@dataclass(frozen=True, kw_only=True)
class ComfortSpeed:
    """Rides at rising speeds, until one does not meet the criterion."""

    speed: float  # fastest at which it holds [m/s]; 0 if it does not at the lowest
    rides: tuple[tuple[float, Ride], ...]  # speed [m/s] and ride, the one that failed included


def comfort_speed(
    make: Callable[[float], Scenario],
    criterion: Callable[[Ride], bool],
    speeds: Sequence[float],
    *,
    policy: Callable[[Scenario], Policy] | None = None,
    observe: Observe | None = None,
) -> ComfortSpeed:
    """Return the fastest of some speeds at which a criterion holds, and at all lower ones.

    Parameters
    ----------
    make : callable
        ``make(speed)`` is the scenario at a speed [m/s], e.g.
        ``lambda speed: over_hump("escort", "watts", speed=speed)``.
    criterion : callable
        ``criterion(ride)`` says whether a ride will do, e.g. ``lambda r: r.vdv < 2.0``.
    speeds : sequence of float
        Speeds [m/s], in any order.
    policy : callable, optional
        ``policy(scenario)`` makes the policy for a speed; without it actions are 0: no force, or
        the middle of a semi-active damper's range.
    observe : {"full", "feedback"} or sequence, optional
        What the policy is shown (see `rollout`).

    Raises
    ------
    ValueError
        If there is no speed or one is not positive, or a scenario has no `Ride`.

    Notes
    -----
    Comfort need not fall with speed: a car skips a short hump. What lies beyond the first speed
    that fails is not looked at, as one gets there only through it. A drive that leaves its travel
    limits fails.
    """
    given = finite_array("speeds", speeds, "m/s").ravel()
    if not given.size or given.min() <= 0.0:
        raise ValueError(
            f"speeds must be positive and at least one, got {shown(speeds)}; give speeds in m/s"
        )
    rides: list[tuple[float, Ride]] = []
    fastest = 0.0
    for speed in np.unique(given).tolist():
        scenario = make(speed)
        acts = policy(scenario) if policy else _NoControl(scenario.actuator.size)
        drive = rollout(acts, scenario, observe=observe, signals=RIDE_SIGNALS)
        found = ride(drive)
        rides.append((speed, found))
        if drive.terminated or not criterion(found):
            break
        fastest = speed
    return ComfortSpeed(speed=fastest, rides=tuple(rides))


@dataclass(frozen=True)
class _NoControl:
    """A policy whose actions are 0."""

    size: int

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], None]:
        """Return zeros (n, m)."""
        return np.zeros((len(observation), self.size)), None
