"""Sine, humps, bars and steps; x = s - start is the distance since a shape's beginning.

Dimensions of built humps: UK LTN 1/07 (round top, 50 to 100 mm; 3.7 m recalled), IRC 99-1988 (arc
of 3.7 m, 100 mm), CONTRAN 600/2016 (1.5 m, 60 to 80 mm and 3.7 m, 80 to 100 mm), the Belgian royal
decrees of 1998 and 2002 (4.8 m, 120 mm, sinusoidal; flat tops with ramps of 10 to 14 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from qcar_env.parts.part import number
from qcar_env.roads.profile import Road, Shape
from qcar_env.validation import finite, positive


@dataclass(frozen=True, kw_only=True)
class Sine(Road):
    """The paper's road ``y = h sin(wavenumber (s - start))``, without beginning and end.

    Parameters
    ----------
    h : float
        Amplitude [m].
    wavenumber : float
        Angle per distance [rad/m]: ``omega = wavenumber * speed``.
    start : float
        Where it passes zero, rising [m].

    Notes
    -----
    Paper, section 2: ``omega = pi V / (3.6 L)``, V in km/h, L the length of half a wave.
    """

    turning: ClassVar[bool] = True

    h: float = number("amplitude", "m", finite)
    wavenumber: float = number("wavenumber", "rad/m", positive)
    start: float = number("start", "m", finite, 0.0)

    @classmethod
    def of_length(cls, *, h: float, L: float, start: float = 0.0) -> Sine:
        """Return the sine whose half wave is `L` [m] long."""
        return cls(h=h, wavenumber=math.pi / positive("half wave L", L, "m"), start=start)

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        return p.h * math.sin(p.wavenumber * (s - p.start))

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        return p.h * p.wavenumber * math.cos(p.wavenumber * (s - p.start))


@dataclass(frozen=True, kw_only=True)
class HalfSine(Shape):
    """The paper's hump ``y = h sin(wavenumber x)``, half a wave; the slope jumps at its feet.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    wavenumber : float
        Angle per distance [rad/m]; the hump is ``L = pi / wavenumber`` long.
    """

    turning: ClassVar[bool] = True

    wavenumber: float = number("wavenumber", "rad/m", positive)

    @classmethod
    def of_length(cls, *, h: float, L: float, start: float = 0.0) -> HalfSine:
        """Return the hump that is `L` [m] long."""
        return cls(h=h, wavenumber=math.pi / positive("hump length L", L, "m"), start=start)

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        return p.h * math.sin(p.wavenumber * (s - p.start)) if piece == 1 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        if piece != 1:
            return 0.0
        return p.h * p.wavenumber * math.cos(p.wavenumber * (s - p.start))

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        if piece == 0:
            return p.start
        return p.start + math.pi / p.wavenumber if piece == 1 else math.inf


@dataclass(frozen=True, kw_only=True)
class Hump(Shape):
    """Base of the shapes of one piece and of length L [m]."""

    L: float = number("hump length", "m", positive)

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        if piece == 0:
            return p.start
        return p.start + p.L if piece == 1 else math.inf


@dataclass(frozen=True, kw_only=True)
class OneMinusCosine(Hump):
    """The sinusoidal hump ``y = h (1 - cos(2 pi x / L)) / 2``, tangent to the road at its feet.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    L : float
        Length [m].

    Notes
    -----
    Also called haversine or versed sine; the Belgian and Dutch hump (1998 decree: 4.8 m, 120 mm).
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        if piece != 1:
            return 0.0
        return 0.5 * p.h * (1.0 - math.cos(2.0 * math.pi / p.L * (s - p.start)))

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        if piece != 1:
            return 0.0
        return p.h * math.pi / p.L * math.sin(2.0 * math.pi / p.L * (s - p.start))


STEEPEST_ARC = 0.4  # |h| / L, chosen here: an arc leaves the road at well below a right angle


@dataclass(frozen=True, kw_only=True)
class CircularArc(Hump):
    """Watts' round-topped hump: an arc of a circle of radius ``R = (L^2 / 4 + h^2) / (2 h)``.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m]; at most 0.4 L high.
    L : float
        Length [m].

    Notes
    -----
    ``y = h - kappa u^2 / (1 + sqrt(1 - kappa^2 u^2))`` with ``u = x - L / 2``, ``kappa = 1 / R``:
    the circle without the difference of two large numbers. IRC 99-1988: L 3.7 m, h 0.1 m, R 17 m.
    """

    def __post_init__(self) -> None:
        """Check every number."""
        super().__post_init__()
        if abs(self.h) > STEEPEST_ARC * self.L:
            raise ValueError(
                f"height h of an arc must be at most {STEEPEST_ARC} L = "
                f"{STEEPEST_ARC * self.L:g} m, got {self.h:g} m; give a lower or longer hump"
            )

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        if piece != 1:
            return 0.0
        u = s - p.start - 0.5 * p.L
        a = 8.0 * p.h / (p.L * p.L + 4.0 * p.h * p.h) * u  # sine of the angle from the top
        return p.h - a * u / (1.0 + math.sqrt(1.0 - a * a))

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        if piece != 1:
            return 0.0
        a = 8.0 * p.h / (p.L * p.L + 4.0 * p.h * p.h) * (s - p.start - 0.5 * p.L)
        return -a / math.sqrt(1.0 - a * a)


@dataclass(frozen=True, kw_only=True)
class Parabola(Hump):
    """The parabolic hump ``y = 4 h q (1 - q)``, ``q = x / L``.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    L : float
        Length [m].

    Notes
    -----
    Within 0.08 mm of the circular arc for 3.7 m by 0.1 m (tests/roads/test_shapes.py).
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        q = (s - p.start) / p.L
        return 4.0 * p.h * q * (1.0 - q) if piece == 1 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        q = (s - p.start) / p.L
        return 4.0 * p.h / p.L * (1.0 - 2.0 * q) if piece == 1 else 0.0


@dataclass(frozen=True, kw_only=True)
class Quartic(Hump):
    """The polynomial hump ``y = 16 h q^2 (1 - q)^2``, ``q = x / L``: no slope at its feet.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    L : float
        Length [m].

    Notes
    -----
    The lowest degree with height and slope 0 at both feet, as in Hassaan's polynomial humps
    (recalled, not checked against his coefficients).
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        q = (s - p.start) / p.L
        b = 4.0 * q * (1.0 - q)
        return p.h * b * b if piece == 1 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        q = (s - p.start) / p.L
        b = 4.0 * q * (1.0 - q)
        return 8.0 * p.h / p.L * b * (1.0 - 2.0 * q) if piece == 1 else 0.0


@dataclass(frozen=True, kw_only=True)
class Sextic(Hump):
    """The polynomial hump ``y = 64 h q^3 (1 - q)^3``, ``q = x / L``: no curvature at its feet.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    L : float
        Length [m].

    Notes
    -----
    The lowest degree with height, slope and curvature 0 at both feet; see `Quartic`.
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        q = (s - p.start) / p.L
        b = 4.0 * q * (1.0 - q)
        return p.h * b * b * b if piece == 1 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        q = (s - p.start) / p.L
        b = 4.0 * q * (1.0 - q)
        return 12.0 * p.h / p.L * b * b * (1.0 - 2.0 * q) if piece == 1 else 0.0


@dataclass(frozen=True, kw_only=True)
class SquareBar(Hump):
    """A bar across the road, ``y = h`` on its length; the height jumps up and down again.

    Parameters
    ----------
    h, start : float
        As of `Shape` [m].
    L : float
        Length [m].

    Notes
    -----
    Shorter than a few contact lengths it needs `qcar_env.roads.enveloping`.
    """

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        return p.h if piece == 1 else 0.0

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        return 0.0

    @staticmethod
    def jump(piece: int, p: Any, table: Any) -> float:
        """Return the jump of the height where a piece ends [m]."""
        if piece == 0:
            return p.h
        return -p.h if piece == 1 else 0.0


def pothole(*, depth: float, L: float, start: float = 0.0) -> OneMinusCosine:
    """Return the hole ``y = -depth (1 - cos(2 pi x / L)) / 2``.

    Parameters
    ----------
    depth, L : float
        Depth and length [m], both positive.
    start : float, optional
        Where it begins [m].
    """
    return OneMinusCosine(h=-positive("pothole depth", depth, "m"), L=L, start=start)


@dataclass(frozen=True, kw_only=True)
class Step(Road):
    """A road that rises by h at `start` and stays there: a kerb, the paper's Fig. 11.

    Parameters
    ----------
    h : float
        Height [m]; negative for a step down.
    start : float
        Where it is [m].
    """

    turning: ClassVar[bool] = True
    wavenumber: ClassVar[float] = 0.0  # [rad/m], at rest on both pieces

    h: float = number("height", "m", finite)
    start: float = number("start", "m", finite, 0.0)

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        return 0.0 if piece == 0 else p.h

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        return 0.0

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        return p.start if piece == 0 else math.inf

    @staticmethod
    def jump(piece: int, p: Any, table: Any) -> float:
        """Return the jump of the height where a piece ends [m]."""
        return p.h if piece == 0 else 0.0
