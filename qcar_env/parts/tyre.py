"""Tyres between road and wheel.

The compression is ``y - x1`` [m] and the rate ``y' - v1`` [m/s], both from static equilibrium. A
force [N] is the change of the road's upward force on the wheel from the static load [N].
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from qcar_env.parts.part import Part, most, number, positive_part
from qcar_env.validation import non_negative, positive


class Tyre(Part):
    """What a car takes as its tyre: subclasses give `force` and `kick`."""

    linear = False

    @staticmethod
    @abstractmethod
    def force(compression: Any, rate: Any, load: Any, p: Any) -> Any:
        """Return the change [N] of the road's force at a static load [N]."""

    @staticmethod
    @abstractmethod
    def kick(jump: Any, p: Any) -> Any:
        """Return the impulse [N s] on the wheel of a jump [m] of the road's height."""


@dataclass(frozen=True, kw_only=True)
class LinearTyre(Tyre):
    """A linear tyre that holds on to the road, ``F = k compression + c rate``.

    Parameters
    ----------
    k : float
        Stiffness [N/m]; positive.
    c : float
        Damping [N s/m]; not negative.

    Notes
    -----
    The tyre of (3). It pulls the wheel down where a real one lifts off (`LiftOffTyre`). A jump `h`
    of the road is an infinite rate for no time: the impulse ``c h``. Not validated: the length of
    the contact (a road shorter than two or three contact lengths must be smoothed first), rolling.
    """

    k: float = number("tyre stiffness", "N/m", positive)
    c: float = number("tyre damping", "N s/m", non_negative, 0.0)
    linear = True

    @staticmethod
    def force(compression: Any, rate: Any, load: Any, p: Any) -> Any:
        """Return the change [N] of the road's force; the static load plays no part."""
        return p.k * compression + p.c * rate

    @staticmethod
    def kick(jump: Any, p: Any) -> Any:
        """Return the impulse [N s] on the wheel of a jump [m] of the road's height."""
        return p.c * jump


@dataclass(frozen=True, kw_only=True)
class LiftOffTyre(Tyre):
    """A tyre that can push but not pull, ``F = max(k compression + c rate, -load)``.

    Parameters
    ----------
    k : float
        Stiffness [N/m]; positive.
    c : float
        Damping [N s/m]; not negative.

    Notes
    -----
    The road's whole force, ``load + F``, is never negative; the wheel has left the road where it
    is zero. The slope jumps there. The impulse of a jump `h` upward is ``c h``; the road that
    drops away gives none. Not validated: as `LinearTyre`; a damped tyre lets go a little before
    its compression is gone, and lands so.
    """

    k: float = number("tyre stiffness", "N/m", positive)
    c: float = number("tyre damping", "N s/m", non_negative, 0.0)

    @staticmethod
    def force(compression: Any, rate: Any, load: Any, p: Any) -> Any:
        """Return the change [N] of the road's force at a static load [N], which is not negative."""
        return most(p.k * compression + p.c * rate, -load)

    @staticmethod
    def kick(jump: Any, p: Any) -> Any:
        """Return the impulse [N s] on the wheel of a jump [m] of the road's height."""
        return p.c * positive_part(jump)
