"""Dampers between wheel and body.

The rate is ``v2 - v1`` [m/s], positive in rebound (extension), negative in compression. A force [N]
pulls the masses together when positive: down on the body, up on the wheel. A damper is passive:
``force * rate >= 0``.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from qcar_env.parts.part import Part, number, positive_part
from qcar_env.parts.table import both_sides, not_falling, rising, through_zero
from qcar_env.validation import non_negative, positive


class Damper(Part):
    """What a car takes as its damper: subclasses give `force`, and say whether it is linear."""

    linear = False

    @staticmethod
    @abstractmethod
    def force(rate: Any, p: Any) -> Any:
        """Return the force [N] at a rate [m/s]."""


@dataclass(frozen=True, kw_only=True)
class LinearDamper(Damper):
    """A linear damper, ``F = c rate``.

    Parameters
    ----------
    c : float
        Damping at the wheel [N s/m]; not negative.

    Notes
    -----
    Viscous damping, the model of most quarter cars in print. Not validated: a real damper is
    weaker in compression and at high speed, so that this one overstates fast strokes over short
    humps (see `BilinearDamper`).
    """

    c: float = number("damping", "N s/m", non_negative)
    linear = True

    @staticmethod
    def force(rate: Any, p: Any) -> Any:
        """Return the force [N] at a rate [m/s]."""
        return p.c * rate


@dataclass(frozen=True, kw_only=True)
class BilinearDamper(Damper):
    """A damper with a slope for each direction and a knee, beyond which its valves blow off.

    ``F = c_rebound g(rate)`` for rate > 0 and ``-c_compression g(-rate)`` for rate < 0, with
    ``g(w) = min(w, knee) + fast max(w - knee, 0)``.

    Parameters
    ----------
    c_compression, c_rebound : float
        Damping below the knee [N s/m]; not negative.
    knee : float
        Speed of the knee [m/s]; positive.
    fast : float
        Slope beyond the knee as a share of that below [-]: 1 has no knee, below 1 is digressive.

    Notes
    -----
    Typical of print: 1000 and 1500 N s/m, knee at 0.1 to 0.3 m/s. The slope jumps at zero and at
    the knee. Not validated: hysteresis, friction, gas force, temperature.
    """

    c_compression: float = number("damping", "N s/m", non_negative)
    c_rebound: float = number("damping", "N s/m", non_negative)
    knee: float = number("speed of the", "m/s", positive)
    fast: float = number("slope beyond the knee", "-", non_negative)

    @staticmethod
    def force(rate: Any, p: Any) -> Any:
        """Return the force [N] at a rate [m/s]."""
        out, into = positive_part(rate), positive_part(-rate)
        over, under = positive_part(out - p.knee), positive_part(into - p.knee)
        rebound = p.c_rebound * (out - over + p.fast * over)
        return rebound - p.c_compression * (into - under + p.fast * under)


@dataclass(frozen=True, kw_only=True)
class TableDamper(Damper):
    """A damper from a table of force over speed: straight lines, the outer ones continued.

    Parameters
    ----------
    rates : tuple of float
        Rates [m/s], rising, negative in compression; 0 is one of them.
    forces : tuple of float
        Forces [N] there, not falling; 0 at rate 0.

    Notes
    -----
    Linear interpolation (`qcar_env.parts.table`) of what a damper's test bench gives. Forces that
    do not fall make it passive at every rate. Example: MathWorks' Simscape vehicle template,
    -1: -5700, -0.5: -2250, 0: 0, 0.5: 2250, 1: 6000 N. Not validated: hysteresis, dependence on
    travel, temperature.
    """

    rates: tuple[float, ...] = number("damper", "m/s", rising)
    forces: tuple[float, ...] = number("damper", "N", not_falling)

    def __post_init__(self) -> None:
        """Check the points."""
        super().__post_init__()
        _ = self.numbers

    @property
    def numbers(self) -> Any:
        """The lines of the table."""
        return through_zero("damper table", self.rates, self.forces)

    @staticmethod
    def force(rate: Any, p: Any) -> Any:
        """Return the force [N] at a rate [m/s]."""
        return both_sides(rate, p)
