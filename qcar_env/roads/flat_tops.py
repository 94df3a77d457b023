"""Humps with a flat top between straight or sinusoidal ramps: speed tables and cushions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from qcar_env.parts.part import number
from qcar_env.roads.profile import Shape
from qcar_env.validation import finite, non_negative, positive


@dataclass(frozen=True, kw_only=True)
class RampedTop(Shape):
    """Base of the flat tops: a ramp up, a plateau, a ramp down.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    ramp : float
        Length of each ramp [m].
    top : float
        Length of the plateau [m].
    """

    kink_count: ClassVar[int] = 4

    ramp: float = number("ramp length", "m", positive)
    top: float = number("plateau length", "m", non_negative)

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        if piece == 0:
            return p.start
        if piece == 1:
            return p.start + p.ramp
        if piece == 2:
            return p.start + (p.ramp + p.top)
        return p.start + (p.ramp + p.top + p.ramp) if piece == 3 else math.inf


@dataclass(frozen=True, kw_only=True)
class FlatTop(RampedTop):
    """A table with straight ramps, ``y = h x / ramp``; the slope jumps at four places.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    ramp, top : float
        Length of each ramp and of the plateau [m].

    Notes
    -----
    UK practice: h 75 mm, ramps 1:10 to 1:15; in Leicestershire 1:13 and a plateau of 7 m or more.
    """

    @classmethod
    def of_gradient(cls, *, h: float, L: float, gradient: float, start: float = 0.0) -> FlatTop:
        """Return the table of length `L` [m] whose ramps rise by `gradient` [-], as 1/13.

        Raises
        ------
        ValueError
            If the two ramps are longer than `L`.
        """
        ramp = abs(finite("height h", h, "m")) / positive("gradient", gradient)
        if 2.0 * ramp > positive("length L", L, "m"):
            raise ValueError(
                f"length L must hold two ramps of {ramp:g} m, got {L:g} m; "
                "give a longer one, a lower h or a steeper gradient"
            )
        return cls(h=h, ramp=ramp, top=L - 2.0 * ramp, start=start)

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        if piece == 1:
            return p.h * (s - p.start) / p.ramp
        if piece == 3:
            return p.h * (p.start + (p.ramp + p.top + p.ramp) - s) / p.ramp
        return p.h if piece == 2 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        if piece == 1:
            return p.h / p.ramp
        return -p.h / p.ramp if piece == 3 else 0.0


def cushion(*, h: float, L: float, gradient: float = 1.0 / 8.0, start: float = 0.0) -> FlatTop:
    """Return a speed cushion as the wheel that drives over it meets it.

    Parameters
    ----------
    h, L : float
        Height and length [m]; UK: 65 to 75 mm, 2 to 3 m.
    gradient : float, optional
        Rise of its ends [-]; UK: 1/8 (recalled).
    start : float, optional
        Where it begins [m].
    """
    return FlatTop.of_gradient(h=h, L=L, gradient=gradient, start=start)


@dataclass(frozen=True, kw_only=True)
class SmoothFlatTop(RampedTop):
    """A table with sinusoidal ramps, ``y = h (1 - cos(pi x / ramp)) / 2``: the slope is continuous.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    ramp, top : float
        Length of each ramp and of the plateau [m].

    Notes
    -----
    Belgian decrees of 1998 and 2002: ramps of 0.85, 1.2 and 1.9 m for 100, 120 and 150 mm.
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        if piece == 1:
            return 0.5 * p.h * (1.0 - math.cos(math.pi / p.ramp * (s - p.start)))
        if piece == 3:
            left = p.start + (p.ramp + p.top + p.ramp) - s
            return 0.5 * p.h * (1.0 - math.cos(math.pi / p.ramp * left))
        return p.h if piece == 2 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        if piece == 1:
            return 0.5 * p.h * math.pi / p.ramp * math.sin(math.pi / p.ramp * (s - p.start))
        if piece == 3:
            left = p.start + (p.ramp + p.top + p.ramp) - s
            return -0.5 * p.h * math.pi / p.ramp * math.sin(math.pi / p.ramp * left)
        return 0.0
