"""Skyhook, groundhook and their blend: dampers that seem to hang from the sky or stand on ground.

    skyhook:     the body is damped against the sky       F2 = -G2 m2 v2
    groundhook:  the wheel is damped against the ground   F1 = -G1 m1 v1
    hybrid:      both

An actuator between wheel and body pushes on both: what it does for one mass it does to the other
with the opposite sign. It gives ``F = F2 - F1`` to the body and ``-F`` to the wheel, for every law
(`qcar_env.physics.closed_loop`). Actuators against the ground, as the paper's, give each its own.

Source: D. Karnopp, M. J. Crosby, R. A. Harwood, Vibration control using semi-active force
generators, ASME Journal of Engineering for Industry 96(2), 1974 (skyhook); M. Valasek, M. Novak,
Z. Sika, O. Vaculin, Extended ground-hook, Vehicle System Dynamics 27(5-6), 1997.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law
from qcar_env.parts.part import number
from qcar_env.validation import non_negative


@dataclass(frozen=True, kw_only=True)
class Hybrid(Law):
    """Skyhook on the body and groundhook on the wheel.

    Parameters
    ----------
    G1, G2 : float
        Damping of the wheel against the ground and of the body against the sky [1/s]; not
        negative. Chosen here: 10, well above the paper's passive damping of body and wheel.

    Raises
    ------
    ValueError
        If a gain is negative.

    Notes
    -----
    Against the ground the hybrid is linear velocity feedback, and takes energy out. Between the
    masses the groundhook can feed the body and the skyhook the wheel: no general claim of stability
    is made.
    """

    G1: float = number("gain", "1/s", non_negative, 10.0)
    G2: float = number("gain", "1/s", non_negative, 10.0)

    name = "hybrid"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(-G1 v1, -G2 v2)`` [m/s^2]."""
        return -p.G1 * x.v1, -p.G2 * x.v2


@dataclass(frozen=True, kw_only=True)
class Skyhook(Law):
    """The body damped against the sky, the wheel left to itself.

    Parameters
    ----------
    G : float
        Damping [1/s]; not negative. Chosen here: 10 (see `Hybrid`).

    Raises
    ------
    ValueError
        See `Hybrid`.
    """

    G: float = number("gain", "1/s", non_negative, 10.0)

    name = "skyhook"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(0, -G v2)`` [m/s^2]."""
        return 0.0 * x.v1, -p.G * x.v2


@dataclass(frozen=True, kw_only=True)
class Groundhook(Law):
    """The wheel damped against the ground, the body left to itself.

    Parameters
    ----------
    G : float
        Damping [1/s]; not negative. Chosen here: 10 (see `Hybrid`).

    Raises
    ------
    ValueError
        See `Hybrid`.
    """

    G: float = number("gain", "1/s", non_negative, 10.0)

    name = "groundhook"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(-G v1, 0)`` [m/s^2]."""
        return -p.G * x.v1, 0.0 * x.v2
