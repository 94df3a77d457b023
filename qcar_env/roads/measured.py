"""A road from samples: height over distance, uniform or not.

Between kinks the heights are joined by a cubic spline with a continuous second derivative. A spline
and not the monotone PCHIP, which cuts off the tops of sampled waves (of a sine with eight samples
a wave up to 8 %, the spline 0.1 %) and whose curvature jumps at each sample. The price: a spline
swings where the road really has a corner; state the kink there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.part import Nothing, text
from qcar_env.roads.profile import NEAREST, ROUNDING, Road, frozen
from qcar_env.validation import finite, finite_array, positive, shown, store

Floats = NDArray[np.float64]

# The table: number of pieces, then for each piece the HEAD numbers that say where it begins [m],
# its spacing [m], its number of intervals, where in the table its first cubic stands, and the jump
# of the height at its end [m]; then the cubics, four coefficients each, constant first.
HEAD = 5

LEAST_INTERVALS = 8  # of a piece that is sampled here, chosen here: half a sine within 1e-4 of h
EVEN = 1e-6  # of a spacing, chosen here: how far samples may lie from an even grid


@dataclass(frozen=True, kw_only=True)
class Tabulated(Road):
    """Base of the roads that are read from a table in constant time: an index and one cubic.

    The table is made from the road's fields, none of which is a number of its functions. They
    cannot vary from episode to episode: a road of other fields is another road.
    """

    @property
    def numbers(self) -> Nothing:
        """None: everything is in the table."""
        return Nothing()

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        at, x = locate(s, piece, table)
        c2, c3 = table[at + 2], table[at + 3]
        return table[at] + x * (table[at + 1] + x * (c2 + x * c3))

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        at, x = locate(s, piece, table)
        return table[at + 1] + x * (2.0 * table[at + 2] + x * (3.0 * table[at + 3]))

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        return table[1 + HEAD * (piece + 1)] if piece + 1 < table[0] else math.inf

    @staticmethod
    def jump(piece: int, p: Any, table: Any) -> float:
        """Return the jump of the height where a piece ends [m]."""
        return table[1 + HEAD * piece + 4] if piece + 1 < table[0] else 0.0


def locate(s: float, piece: int, table: Any) -> tuple[int, float]:
    """Return where the cubic that holds at `s` stands in the table, and how far into it `s` is."""
    head = 1 + HEAD * piece
    begin, spacing = table[head], table[head + 1]
    steps, last = (s - begin) / spacing, table[head + 2] - 1.0
    steps = steps if steps > 0.0 else 0.0  # also for what is no number
    i = int(last if steps > last else steps)
    return int(table[head + 3]) + 4 * i, s - (begin + i * spacing)


def tabulate(pieces: Sequence[tuple[float, float, Floats]]) -> Floats:
    """Return the table of a road, with a flat stretch before and after it.

    Parameters
    ----------
    pieces : sequence of (begin, end, heights)
        Of each piece its ends [m] and heights [m] on an even grid from one to the other, both
        included. Not-a-knot splines join them: exact for a cubic, up to the ends.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    (begin, _, first), (_, end, last) = pieces[0], pieces[-1]
    every = [(begin, begin + 1.0, first[[0, 0]]), *pieces, (end, end + 1.0, last[[-1, -1]])]
    heads: list[list[float]] = []
    cubics: list[Floats] = []
    offset = 1 + HEAD * len(every)
    for i, (start, stop, heights) in enumerate(every):
        intervals = len(heights) - 1
        following = every[i + 1][2] if i + 1 < len(every) else last
        jump = following[0] - heights[-1]
        spacing = (stop - start) / intervals
        heads.append([start, spacing, intervals, offset, jump * (abs(jump) > ROUNDING)])
        if intervals == 1:  # thousands of them where every sample is a kink
            slope = (heights[1] - heights[0]) / spacing
            cubics.append(np.array([heights[0], slope, 0.0, 0.0]))
        else:
            spline: Any = CubicSpline(np.arange(intervals + 1) * spacing, heights)
            cubics.append(spline.c[::-1].T.ravel())
        offset += cubics[-1].size
    return frozen(np.concatenate([[float(len(every))], *heads, *cubics]))


def grid(
    start: float, end: float, spacing: float, kinks_at: Sequence[float]
) -> tuple[Floats, Floats]:
    """Return an even grid on each piece of a stretch, a kink between two pieces in both.

    Returns
    -------
    tuple of ndarray (n,)
        The distances [m], and from where to see the heights there: from the float before a kink at
        the end of a piece.
    """
    start, end = finite("start", start, "m"), finite("end", end, "m")
    positive("spacing", spacing, "m")
    if end <= start:
        raise ValueError(f"end must lie after start, got {start:g} to {end:g} m; give a larger end")
    edges = [start]
    for kink in sorted(finite("kinks_at", each, "m") for each in kinks_at):
        if edges[-1] + NEAREST < kink < end - NEAREST:
            edges.append(kink)
    edges.append(end)
    pieces: list[Floats] = []
    seen: list[Floats] = []
    for begin, stop in itertools.pairwise(edges):
        intervals = max(LEAST_INTERVALS, math.ceil((stop - begin) / spacing))
        pieces.append(np.linspace(begin, stop, intervals + 1))
        seen.append(pieces[-1].copy())
        seen[-1][-1] = math.nextafter(stop, -math.inf) if stop < end else stop
    return np.concatenate(pieces), np.concatenate(seen)


@dataclass(frozen=True, kw_only=True)
class SampledRoad(Tabulated):
    """A road through samples, flat before the first and after the last.

    Parameters
    ----------
    distances : sequence of float (n,)
        Where it was sampled [m], rising, at least two. A distance that stands twice is a kink,
        with the height before it and the height after it.
    heights : sequence of float (n,)
        Heights [m]. They are not shifted: take the first one off if a car is to start on it from
        height 0.
    kinks_at : sequence of float, optional
        Distances among those sampled where the slope jumps [m].
    spacing : float, optional
        Spacing to which the spline is sampled again [m]. Without it samples must be even between
        kinks (to a millionth of their spacing), and are kept.

    Raises
    ------
    ValueError
        If there are fewer than two samples, distances do not rise, something is no number, a kink
        is not a sample, or samples are uneven and no spacing is given.
    """

    distances: tuple[float, ...] = text()
    samples: tuple[float, ...] = text()
    kinks_at: tuple[float, ...] = text(())
    spacing: float | None = text(None)

    def __post_init__(self) -> None:
        """Check the samples."""
        super().__post_init__()
        s = finite_array("distances", self.distances, "m")
        y = finite_array("samples", self.samples, "m")
        kinks = finite_array("kinks_at", list(self.kinks_at) or np.empty(0), "m")
        if s.ndim != 1 or s.shape != y.shape or s.size < 2:
            raise ValueError(
                f"distances and samples must be two or more samples each, as many of one as of "
                f"the other, got shapes {s.shape} and {y.shape}; give one height per distance"
            )
        steps = np.diff(s)
        thrice = np.append((steps[:-1] == 0.0) & (steps[1:] == 0.0), False)
        for i in np.flatnonzero((steps < 0.0) | thrice):
            raise ValueError(
                f"distances must rise, got {s[i]:g} m and then {s[i + 1]:g} m at sample {i + 1}; "
                "sort the samples, and give a distance twice only where the height jumps"
            )
        if steps[0] == 0.0 or steps[-1] == 0.0:
            raise ValueError(
                f"the first and the last of the distances must stand once, got {s[0]:g} and "
                f"{s[-1]:g} m; give a sample before or after the jump"
            )
        for kink in kinks[~np.isin(kinks, s[1:-1])].tolist():
            raise ValueError(
                f"kinks_at must be among the distances between the first and the last, "
                f"got {kink:g} m; give a sampled distance"
            )
        if self.spacing is not None:
            store(self, spacing=positive("spacing", self.spacing, "m"))
        store(
            self,
            distances=tuple(s.tolist()),
            samples=tuple(y.tolist()),
            kinks_at=tuple(kinks.tolist()),
        )
        self.table  # noqa: B018  refuses uneven samples here and not in an engine

    @classmethod
    def from_function(
        cls,
        function: Callable[[float], float],
        *,
        start: float,
        end: float,
        spacing: float,
        kinks_at: Sequence[float] = (),
    ) -> SampledRoad:
        """Return the road through the heights of any Python function.

        Parameters
        ----------
        function : callable
            Height [m] at a distance [m]; at a kink the height after it, before it that of the
            float before. It is called once per sample and need not compile.
        start, end : float
            The stretch that is sampled [m].
        spacing : float
            Largest spacing of the samples [m]; every piece has at least eight intervals.
        kinks_at : sequence of float, optional
            Where it or its derivative jumps [m].
        """
        s, seen_from = grid(start, end, spacing, kinks_at)
        y = [float(function(each)) for each in seen_from.tolist()]
        return cls(distances=tuple(s.tolist()), samples=tuple(y))

    @cached_property
    def table(self) -> Floats:
        """The cubics of every piece, see `HEAD`."""
        s, y = np.array(self.distances), np.array(self.samples)
        twice = np.flatnonzero(np.diff(s) == 0.0)
        single = np.setdiff1d(np.searchsorted(s, self.kinks_at), twice)
        firsts = np.sort(np.concatenate([[0], twice + 1, single]))
        lasts = np.sort(np.concatenate([twice, single, [s.size - 1]]))
        return tabulate(
            [
                self._even(s[i : j + 1], y[i : j + 1])
                for i, j in zip(firsts.tolist(), lasts.tolist(), strict=True)
            ]
        )

    def _even(self, s: Floats, y: Floats) -> tuple[float, float, Floats]:
        """Return a piece on an even grid: as it is, or its spline sampled again."""
        begin, end = float(s[0]), float(s[-1])
        if self.spacing is None:
            step = (end - begin) / (s.size - 1)
            off = np.abs(s - np.linspace(begin, end, s.size)).max()
            if off > EVEN * step + 8.0 * np.spacing(max(abs(begin), abs(end))):
                raise ValueError(
                    f"distances must be even between kinks, got {shown(s[:4].tolist())} ... "
                    f"of {s.size} samples up to {end:g} m; give spacing, to which they are "
                    "sampled again"
                )
            return begin, end, y
        from scipy.interpolate import CubicSpline  # slow to import

        intervals = max(1, math.ceil((end - begin) / self.spacing))
        spline: Any = CubicSpline(s, y)
        return begin, end, spline(np.linspace(begin, end, intervals + 1))
