"""What a road is: height and slope over the distance s [m], in smooth pieces between kinks.

Piece 0 ends at kink 0, where piece 1 begins, and so on: a piece's number is that of the kinks
passed. At a kink the slope jumps, or the height does, or the curvature. Each piece is smooth up to
and including both its ends, so that a kink has a limit from either side, and an integrator that
stops at the kinks meets no discontinuity inside a step.

A road of one's own is a subclass with two functions, and `kink` and `jump` where it has any:

    @dataclass(frozen=True, kw_only=True)
    class Ramp(Road):
        h: float = number("height", "m", finite)

        @staticmethod
        def height(s, piece, p, table):
            return 0.01 * p.h * s if piece == 1 else 0.0
        ...

The functions run on floats, one car at a time, in Python and in compiled code: `math`, `if`, `int`
and indices of `table` are theirs to use.
"""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.parts.part import Part, number
from qcar_env.validation import finite, finite_array

NEAREST = 1e-9  # [m] chosen here: kinks as near as that are one
MOST_KINKS = 4_000_000  # chosen here: a road with more goes on for ever
ROUNDING = 1e-12  # [m] chosen here: a smaller jump of the height is that of rounding


@dataclass(frozen=True, kw_only=True)
class Road(Part):
    """Base of every road: four functions for the engine, and what people call, made from them."""

    # True where each piece is h sin(wavenumber * distance since its kink) or at rest
    turning: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def height(s: float, piece: int, p: Any, table: Any) -> Any:
        """Return the height [m] at `s` [m], seen from a piece.

        Parameters
        ----------
        s : float
            Distance [m].
        piece : int
            Number of kinks passed [-].
        p : NamedTuple
            The road's `numbers`.
        table : ndarray (n,)
            The road's `table`.
        """

    @staticmethod
    @abstractmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> Any:
        """Return the derivative of `height` by `s` [-], arguments as there."""

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]; infinite for the last one."""
        return math.inf

    @staticmethod
    def jump(piece: int, p: Any, table: Any) -> float:
        """Return by how much the height jumps where a piece ends [m]."""
        return 0.0

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """What does not fit into numbers, an array (n,) that cannot be written to; often empty."""
        return frozen(np.empty(0))

    @cached_property
    def length(self) -> float:
        """Where the last kink is [m]; infinite where there is none, or no last one."""
        p, table, kink = self.numbers, self._entries, type(self).kink
        last = math.inf
        for piece in range(MOST_KINKS):
            end = kink(piece, p, table)
            if end == math.inf:
                return last
            last = end
        return math.inf

    def heights(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the heights [m] at distances `s` [m] of any shape; at a kink those after it."""
        return self._at(type(self).height, s)

    def slopes(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the slopes [-] at distances `s` [m] of any shape; at a kink those after it."""
        return self._at(type(self).slope, s)

    def kinks(self, s0: float, s1: float) -> list[float]:
        """Return the kinks in the open interval ``(s0, s1)`` [m]."""
        return [where for where, _ in self._kinks_and_jumps(s0, s1)]

    def jumps(self, s0: float, s1: float) -> list[float]:
        """Return the jump of the height [m] at each of `kinks`; 0 where it does not jump."""
        return [jump for _, jump in self._kinks_and_jumps(s0, s1)]

    @cached_property
    def _entries(self) -> list[float]:
        """The table as Python's floats, which are quicker one by one."""
        return self.table.tolist()

    def _kinks_and_jumps(self, s0: float, s1: float) -> list[tuple[float, float]]:
        finite("s0", s0, "m")
        p, table, jump = self.numbers, self._entries, type(self).jump
        found = enumerate(self._kinks_until(finite("s1", s1, "m")))
        return [(s, jump(piece, p, table)) for piece, s in found if s0 < s < s1]

    def _kinks_until(self, s: float) -> list[float]:
        """Return the kinks up to and including `s`, which is finite or minus infinity."""
        p, table, kink = self.numbers, self._entries, type(self).kink
        ends = (kink(piece, p, table) for piece in itertools.count())
        return list(itertools.takewhile(lambda end: end <= s, ends))

    def _at(self, function: Callable[..., float], s: ArrayLike) -> NDArray[np.float64]:
        distances = finite_array("distance s", s, "m")
        flat = distances.ravel()
        kinks = self._kinks_until(float(flat.max(initial=-math.inf)))
        pieces = np.searchsorted(kinks, flat, side="right")
        p, table = self.numbers, self._entries
        each = zip(flat.tolist(), pieces.tolist(), strict=True)
        values = [function(one, piece, p, table) for one, piece in each]
        return np.array(values, dtype=np.float64).reshape(distances.shape)


@dataclass(frozen=True, kw_only=True)
class Shape(Road):
    """Base of what lies on a road at height 0 before and after it: humps, bars, holes.

    Parameters
    ----------
    h : float
        Height [m]; negative for a hole.
    start : float
        Where it begins [m]: its first kink.

    Notes
    -----
    A `qcar_env.roads.train.Train` takes any shape.
    """

    kink_count: ClassVar[int] = 2  # the first at its beginning, the last at its end

    h: float = number("height", "m", finite)
    start: float = number("start", "m", finite, 0.0)

    @property
    def extent(self) -> float:
        """Distance from its first kink to its last [m]."""
        p, table = self.numbers, self.table
        return self.kink(self.kink_count - 1, p, table) - self.kink(0, p, table)


def frozen(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an array made read-only."""
    table.setflags(write=False)
    return table
