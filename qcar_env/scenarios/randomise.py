"""What varies from episode to episode: any number of a scenario, by its path and a distribution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.starts import CHOICE, LOG_UNIFORM, NORMAL, UNIFORM, drawn
from qcar_env.parts.part import Part, number
from qcar_env.validation import entries, finite, instance, non_negative, positive, shown, store


@dataclass(frozen=True, kw_only=True)
class Distribution(Part):
    """Base of the distributions; one number from [0, 1) becomes one value."""

    @property
    def row(self) -> list[float]:
        """The distribution as `qcar_env.engine.starts.drawn` takes it."""
        raise TypeError(f"{type(self).__name__} has no row; take Uniform, LogUniform, ...")

    def value(self, u: float) -> float:
        """Return what it makes of `u` from [0, 1)."""
        return float(drawn(u, self.row))

    @property
    def ends(self) -> tuple[float, ...]:
        """The least and the largest value that is drawn; all values of a choice."""
        return self.value(0.0), self.value(math.nextafter(1.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class Uniform(Distribution):
    """Every value from `low` to `high` alike."""

    low: float = number("lowest value", "-", finite)
    high: float = number("highest value", "-", finite)

    def __post_init__(self) -> None:
        """Check that the range rises."""
        super().__post_init__()
        _check_rising(self.low, self.high)

    @property
    def row(self) -> list[float]:
        """See `Distribution.row`."""
        return [UNIFORM, self.low, self.high]


@dataclass(frozen=True, kw_only=True)
class LogUniform(Distribution):
    """Every power of ten alike, from `low` to `high`; both positive."""

    low: float = number("lowest value", "-", positive)
    high: float = number("highest value", "-", positive)

    def __post_init__(self) -> None:
        """Check that the range rises."""
        super().__post_init__()
        _check_rising(self.low, self.high)

    @property
    def row(self) -> list[float]:
        """See `Distribution.row`."""
        return [LOG_UNIFORM, math.log(self.low), math.log(self.high)]


@dataclass(frozen=True, kw_only=True)
class Normal(Distribution):
    """The bell curve about `mean` with standard deviation `sd`, held within four of these."""

    mean: float = number("mean", "-", finite)
    sd: float = number("standard deviation", "-", non_negative)

    @property
    def row(self) -> list[float]:
        """See `Distribution.row`."""
        return [NORMAL, self.mean, self.sd]


@dataclass(frozen=True, kw_only=True)
class Choice(Distribution):
    """One of some values, each alike."""

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check the values."""
        given = tuple(finite("value of a choice", each) for each in entries(self.values))
        if not given:
            raise ValueError(f"a choice needs values, got {shown(self.values)}; give a tuple")
        store(self, values=given)

    @property
    def row(self) -> list[float]:
        """See `Distribution.row`."""
        return [CHOICE, len(self.values), *self.values]

    @property
    def ends(self) -> tuple[float, ...]:
        """See `Distribution.ends`."""
        return self.values


def _check_rising(low: float, high: float) -> None:
    if high < low:
        raise ValueError(f"a range must rise, got {low:g} to {high:g}; swap the two")


@dataclass(frozen=True, kw_only=True)
class Vary:
    """One number that is drawn for each episode, and what it changes.

    Parameters
    ----------
    by : Distribution
        Where it comes from.
    numbers : mapping of str to float
        Which numbers of the scenario it changes, by their dotted paths (``road.h``, ``speed``,
        ``car.m2``, ``car.spring.k``, ``actuator.limit.0``): each nominal number is multiplied by
        the drawn one to this power; 0 means that the drawn one replaces it. A sequence of paths
        stands for powers of 1.

    Raises
    ------
    ValueError
        If there is no distribution or no path. Whether a scenario has the numbers is checked by
        the scenario.
    """

    by: Distribution
    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        """Check both."""
        instance("distribution", self.by, Distribution)
        given: Any = self.numbers
        if isinstance(given, str):
            given = (given,)
        if not isinstance(given, Mapping):
            given = dict.fromkeys(entries(given), 1.0)
        if not given or not all(isinstance(path, str) for path in given):
            raise ValueError(
                f"numbers must be paths such as 'road.h', got {shown(self.numbers)}; "
                "give at least one"
            )
        powers = {path: finite(f"power of {path}", power) for path, power in given.items()}
        store(self, numbers=_Frozen(powers))


class _Frozen(dict[str, float]):
    """A mapping that can be hashed; nobody changes it."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(tuple(self.items()))


def body_mass_of_paper_car(by: Distribution) -> Vary:
    """Return a factor on the body's mass of a `PaperCar` with the paper's actuators.

    Springs, dampers, external force and actuator keep their newtons, so what is divided by the
    mass falls with it.
    """
    powers = {"car.omega2": -0.5, "car.b2": -1.0, "car.E3": -1.0}
    return Vary(by=by, numbers={**powers, "force.f": -1.0, "actuator.limit.1": -1.0})


def wheel_mass_of_paper_car(by: Distribution) -> Vary:
    """Return the same for the wheel's mass."""
    falling = ("car.b1", "car.E1", "car.E2", "car.mu1", "car.mu2", "actuator.limit.0")
    return Vary(by=by, numbers={"car.omega1": -0.5, **dict.fromkeys(falling, -1.0)})


def speed_and_force_frequency(by: Distribution) -> Vary:
    """Return a factor on the speed and on the frequency of the external force alike."""
    return Vary(by=by, numbers={"speed": 1.0, "force.Omega": 1.0})


def arrays(
    randomisation: tuple[Vary, ...], index: Mapping[str, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distributions (d, k) and targets (t, 3) for compiled code.

    Parameters
    ----------
    randomisation : tuple of Vary
        What varies.
    index : mapping
        Where each path lies in the row of numbers.
    """
    rows = [each.by.row for each in randomisation]
    draws = np.zeros((len(rows), max((len(row) for row in rows), default=3)))
    for place, row in zip(draws, rows, strict=True):
        place[: len(row)] = row
    targets = [
        (which, index[path], power)
        for which, each in enumerate(randomisation)
        for path, power in each.numbers.items()
    ]
    return draws, np.array(targets, dtype=np.float64).reshape(-1, 3)
