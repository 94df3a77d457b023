"""Proportional-derivative control: ``u_i = -(p_i x_i + d_i v_i)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law
from qcar_env.control.static_stability import check_static_stiffness
from qcar_env.parts.part import number
from qcar_env.physics.car import Car
from qcar_env.validation import finite, non_negative


@dataclass(frozen=True, kw_only=True)
class PD(Law):
    """Proportional-derivative control.

    Parameters
    ----------
    p1, p2 : float
        Proportional gains of wheel and body [1/s^2]. Chosen here: 30, small beside
        ``omega^2 = 3025``, as the paper names the law and prints no row for it.
    d1, d2 : float
        Derivative gains [1/s]; not negative. Chosen here: 1.2, the paper's gain for LNVC.

    Raises
    ------
    ValueError
        If a gain is not finite, or a derivative gain is negative.

    Notes
    -----
    The law adds `p` to the stiffness and `d` to the damping of its mass. A negative `p` softens
    the car and loses static stability where `check` says.
    """

    p1: float = number("gain", "1/s^2", finite, 30.0)
    p2: float = number("gain", "1/s^2", finite, 30.0)
    d1: float = number("gain", "1/s", non_negative, 1.2)
    d2: float = number("gain", "1/s", non_negative, 1.2)

    name = "PD"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``-(p x + d v)`` of each mass [m/s^2]."""
        return -(p.p1 * x.x1 + p.d1 * x.v1), -(p.p2 * x.x2 + p.d2 * x.v2)

    def check(self, car: Car) -> None:
        """Raise ValueError if the proportional gains take the car's static stability.

        See `qcar_env.control.static_stability.check_static_stiffness`.
        """
        check_static_stiffness(car, softening=(-self.p1, -self.p2), gains=("-p1", "-p2"))
