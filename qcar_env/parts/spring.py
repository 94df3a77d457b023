"""Springs between wheel and body, and the stops at the ends of their travel.

The travel is ``x2 - x1`` [m] from static equilibrium, positive extended. A force [N] is the change
from the static one and pulls the masses together when positive: down on the body, up on the wheel.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.parts.part import Part, number, positive_part
from qcar_env.parts.table import (
    Side,
    both_sides,
    not_falling,
    outward,
    rising,
    several,
    side,
    through_zero,
)
from qcar_env.validation import finite, non_negative, positive


class Spring(Part):
    """What a car takes as its spring: subclasses give `force`, and say whether it is linear."""

    linear = False

    @staticmethod
    @abstractmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""


@dataclass(frozen=True, kw_only=True)
class LinearSpring(Spring):
    """A linear spring, ``F = k travel``.

    Parameters
    ----------
    k : float
        Stiffness at the wheel [N/m]; positive.

    Notes
    -----
    Hooke's law; a coil spring between its seats, with the suspension's lever ratio squared in `k`.
    Not validated: travel beyond the ends of a real coil (see `Stops`), friction, air springs.
    """

    k: float = number("stiffness", "N/m", positive)
    linear = True

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""
        return p.k * travel


@dataclass(frozen=True, kw_only=True)
class CubicSpring(Spring):
    """A spring that hardens or softens, ``F = k travel + k3 travel^3``.

    Parameters
    ----------
    k : float
        Stiffness at rest [N/m]; positive.
    k3 : float
        Cubic stiffness [N/m^3]: positive hardens, negative softens, as far as
        ``travel^2 = -k / (3 k3)``, where the stiffness is gone.

    Notes
    -----
    The Duffing spring, the first odd terms of any symmetric spring. In print `k3` is of order 1e5
    to 1e7 N/m^3; ``k3 = k / (3 d^2)`` doubles the stiffness at travel `d`. Not validated: against
    a measured spring; a real one is not symmetric.
    """

    k: float = number("stiffness", "N/m", positive)
    k3: float = number("cubic stiffness", "N/m^3", finite, 0.0)

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""
        return p.k * travel + p.k3 * travel * travel * travel


@dataclass(frozen=True, kw_only=True)
class TableSpring(Spring):
    """A spring from a table: straight lines between its points, the outer ones continued.

    Parameters
    ----------
    travels : tuple of float
        Travels [m], rising, from static equilibrium; 0 is one of them.
    forces : tuple of float
        Forces [N] there, as the change from the static load; 0 at travel 0.

    Notes
    -----
    Linear interpolation (`qcar_env.parts.table`). The force is continuous, its slope jumps at the
    points. Forces may fall; that such a spring carries the body is not checked. Not validated:
    hysteresis, dependence on speed.
    """

    travels: tuple[float, ...] = number("spring", "m", rising)
    forces: tuple[float, ...] = number("spring", "N", several)

    def __post_init__(self) -> None:
        """Check the points."""
        super().__post_init__()
        _ = self.numbers

    @property
    def numbers(self) -> Any:
        """The lines of the table."""
        return through_zero("spring table", self.travels, self.forces)

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""
        return both_sides(travel, p)


class TravelStops(Part):
    """What a car takes as its stops: subclasses give `force`, and say whether it is linear."""

    linear = False

    @staticmethod
    @abstractmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""


@dataclass(frozen=True, kw_only=True)
class NoStops(TravelStops):
    """No stops: the travel has no end. True as long as the travel stays within the real one."""

    linear = True

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return no force [N]."""
        return 0.0


@dataclass(frozen=True, kw_only=True)
class Stops(TravelStops):
    """Rubber stops at both ends, ``F = k d + k3 d^3`` at a depth `d` beyond the clearance.

    Parameters
    ----------
    bump, rebound : float
        Clearances from static equilibrium [m] until the suspension is compressed, or extended, to
        its stop; not negative.
    k : float
        Stiffness of a stop at contact [N/m]; not negative.
    k3 : float
        Its hardening [N/m^3]; not negative.

    Notes
    -----
    A hardening rubber; the same at both ends. The force is zero inside and continuous; its slope
    jumps by `k` at contact, so that a Runge-Kutta step over a contact keeps second order only.
    With ``k = 0`` the first two derivatives are continuous too. Typical: 0.08 m, twice the
    spring's stiffness. Not validated: loss in the rubber, speed, temperature.
    """

    bump: float = number("bump clearance", "m", non_negative)
    rebound: float = number("rebound clearance", "m", non_negative)
    k: float = number("stop stiffness", "N/m", non_negative)
    k3: float = number("stop hardening", "N/m^3", non_negative, 0.0)

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""
        out, into = positive_part(travel - p.rebound), positive_part(-travel - p.bump)
        return p.k * (out - into) + p.k3 * (out * out * out - into * into * into)


class TableStopsNumbers(NamedTuple):
    """Numbers of `TableStops`."""

    bump: Any  # [m]
    rebound: Any  # [m]
    lines: Side


@dataclass(frozen=True, kw_only=True)
class TableStops(TravelStops):
    """Stops from a table of force over depth beyond the clearance, the same at both ends.

    Parameters
    ----------
    bump, rebound : float
        Clearances from static equilibrium [m] until the suspension is compressed, or extended, to
        its stop; not negative.
    depths : tuple of float
        Depths beyond the clearance [m], rising, the first one 0.
    forces : tuple of float
        Forces [N] there, not falling, the first one 0.

    Notes
    -----
    Linear interpolation, the last line continued (`qcar_env.parts.table`). Zero inside, continuous;
    the slope jumps at contact and at each point. Example: the stops of the FEDA vehicle in Project
    Chrono, 0.01 m: 1 kN, 0.02: 2.5, 0.03: 4.5, 0.04: 7.5, 0.05: 12.5, 0.06: 125 kN, clearances
    0.11 and 0.08 m. Not validated: loss in the rubber, speed, temperature.
    """

    bump: float = number("bump clearance", "m", non_negative)
    rebound: float = number("rebound clearance", "m", non_negative)
    depths: tuple[float, ...] = number("stop", "m", rising)
    forces: tuple[float, ...] = number("stop", "N", not_falling)

    def __post_init__(self) -> None:
        """Check clearances and points."""
        super().__post_init__()
        _ = self.numbers

    @property
    def numbers(self) -> Any:
        """The clearances and the lines of the table."""
        lines = outward("stop table", self.depths, self.forces)
        return TableStopsNumbers(self.bump, self.rebound, lines)

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        """Return the force [N] at a travel [m]."""
        return side(travel - p.rebound, p.lines) - side(-travel - p.bump, p.lines)
