"""The road ahead, for controllers that know it: one road at one speed, from its beginning."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from qcar_env.scenarios import Scenario
from qcar_env.validation import non_negative

MOST_INTERVALS = 1_000_000  # of a plan, chosen here: 83 min at 200 Hz


def knows_road(scenario: Scenario) -> bool:
    """Return whether every episode of a scenario has the same road, met at the same time."""
    drawn = {path for each in scenario.randomisation for path in each.numbers}
    same = not any(path.startswith(("road.", "speed")) for path in drawn)
    return same and not scenario.excitation.harmonic


def check_same_road(scenario: Scenario, what: str) -> None:
    """Raise ValueError where `knows_road` is false."""
    if not knows_road(scenario):
        raise ValueError(
            f"{what} needs one road that all episodes meet alike, got {scenario.road} of scenario "
            f"{scenario.name!r}; give a road with a beginning, and do not let it vary"
        )


def heights_ahead(scenario: Scenario) -> NDArray[np.float64]:
    """Return the road's heights at the control instants of an episode [m], and on to its end.

    Raises
    ------
    ValueError
        If road or speed vary, or the road is an endless sine, whose phase is drawn.
    """
    check_same_road(scenario, "preview")
    steps, end = scenario.steps, scenario.excitation.end
    if math.isfinite(end):
        steps = max(steps, math.ceil(end / scenario.dt) + 1)
    return scenario.excitation.height(scenario.dt * np.arange(min(steps, MOST_INTERVALS) + 1))


def intervals(scenario: Scenario, name: str, time: float) -> int:
    """Return a time [s] as the nearest number of control intervals."""
    return round(non_negative(name, time, "s") / scenario.dt)
