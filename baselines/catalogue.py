"""The scripted policies by name."""

from __future__ import annotations

import dataclasses
from typing import Any

from qcar_env.control import LAWS
from qcar_env.physics.validation import known
from qcar_env.scenarios import Scenario
from qcar_env.scenarios import scenario as find_scenario

from .law_policy import LawPolicy


def names() -> tuple[str, ...]:
    """Return the names of all baselines."""
    return tuple(LAWS)


def make(name: str, scenario: str | Scenario = "paper", **gains: float) -> LawPolicy:
    """Make a baseline.

    Parameters
    ----------
    name : str
        One of `names`.
    scenario : str or Scenario
        What it will act in.
    **gains : float
        Gains and filter parameters, as the law's class names them; the published ones otherwise.

    Returns
    -------
    LawPolicy

    Raises
    ------
    ValueError
        If name or gain is unknown (the nearest name is given), or a gain is out of range.
    """
    law = LAWS[known("baseline", name, LAWS)]
    for gain in gains:
        known(f"gain of {name}", gain, [field.name for field in dataclasses.fields(law)])
    return LawPolicy(law(**gains), find_scenario(scenario))


def describe(name: str) -> dict[str, Any]:
    """Return what a baseline reads and its published gains."""
    law = LAWS[known("baseline", name, LAWS)]()
    return {"name": law.name, "reads": LawPolicy.reads, "gains": dataclasses.asdict(law)}
