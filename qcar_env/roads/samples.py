"""Samples of a road as a file has them, in metres, each with its place in the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_env.validation import positive, store

Floats = NDArray[np.float64]

UNITS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "in": 0.0254}  # [m], exact
FARTHEST = 1e9  # [m] chosen here: what is farther or higher is damaged
GAP = 10.0  # in median distances of neighbours, chosen here: a wider one is a gap


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """What was read from a file.

    Parameters
    ----------
    path : Path
        The file, for messages.
    distances, heights : ndarray (n,)
        In metres.
    place : str
        What `numbers` number in the file: "line", "sample", "cross-section".
    numbers : sequence of int (n,)
        Where each sample stands.
    longest_gap : float, optional
        Largest distance between two neighbours [m]; ten times the median where not given.

    Raises
    ------
    ValueError
        If there are fewer than two samples, one is no number or far too large, distances do not
        rise, or there is a gap.
    """

    path: Path
    distances: Floats
    heights: Floats
    place: str
    numbers: Sequence[int]
    longest_gap: float | None = None

    def __post_init__(self) -> None:
        """Check the samples."""
        s = self.distances
        if s.size < 2:
            raise ValueError(
                f"{self.path} must hold two or more samples, got {s.size}; give a longer profile"
            )
        for name, values in (("distance", s), ("height", self.heights)):
            for i in np.flatnonzero(~(np.abs(values) <= FARTHEST)).tolist():
                raise ValueError(
                    f"{name} must be finite and within {FARTHEST:g} m, got {values[i]} m "
                    f"{self.at(i)}; fill the gap in, or take the sample out and give longest_gap"
                )
        steps = np.diff(s)
        for i in np.flatnonzero(steps == 0.0).tolist():
            raise ValueError(
                f"distance must rise, got {s[i]:g} m twice, the second time {self.at(i + 1)}; "
                "keep one of the two samples"
            )
        for i in np.flatnonzero(steps < 0.0).tolist():
            raise ValueError(
                f"distance must rise, got {s[i + 1]:g} m after {s[i]:g} m {self.at(i + 1)}; sort "
                "the samples by distance, or split a drive to and fro into two files"
            )
        longest = GAP * self.spacing if self.longest_gap is None else self.longest_gap
        store(self, longest_gap=positive("longest_gap", longest, "m"))
        for i in np.flatnonzero(steps > longest).tolist():
            raise ValueError(
                f"samples must be at most {longest:g} m apart, got a gap from {s[i]:g} to "
                f"{s[i + 1]:g} m {self.at(i + 1)}; fill it in, or give a larger longest_gap"
            )

    @property
    def spacing(self) -> float:
        """Median distance between two neighbours [m]."""
        return float(np.median(np.diff(self.distances)))

    def at(self, i: int) -> str:
        """Return where sample `i` stands, for messages."""
        return f"in {self.place} {self.numbers[i]} of {self.path}"


def metres(unit: str, column: str, place: str) -> float:
    """Return how many metres a unit is.

    Raises
    ------
    ValueError
        If the unit is not known.
    """
    found = UNITS.get(unit.strip().lower())
    if found is None:
        raise ValueError(
            f"unit of {column!r} must be one of {', '.join(UNITS)}, got {unit.strip()!r} {place}; "
            "convert the column and write its new unit"
        )
    return found


def chosen(channel: str | None, names: Sequence[str], path: Path) -> int:
    """Return which of the profiles of a file is meant; the only one needs no name.

    Raises
    ------
    ValueError
        If several have no name given, or none has the name that is.
    """
    if channel is None and len(names) == 1:
        return 0
    if names.count(channel or "") != 1:
        raise ValueError(
            f"channel must be one of the profiles of {path}, {', '.join(map(repr, names))}, "
            f"got {channel!r}; give channel=..."
        )
    return list(names).index(channel or "")
