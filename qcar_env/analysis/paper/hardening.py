"""Springs that stiffen with deflection, and cubic damping, as a law around the linear plant.

    u_i = -(alpha_i x_i^3 + G_i v_i^3)

The paper's plant is linear, and its averaged response has one stable branch. Equations (3)-(4)
with this law are two coupled Duffing oscillators, whose response bends and folds: the test of
every solver that claims to follow a branch round a turning point. With ``G = 0`` it is a model of
a hardening suspension and tyre; with `G` it is CNVC on such a car.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law
from qcar_env.parts.part import number
from qcar_env.validation import finite, non_negative


@dataclass(frozen=True, kw_only=True)
class Hardening(Law):
    """Cubic stiffness and cubic damping on both masses.

    Parameters
    ----------
    alpha1, alpha2 : float
        Cubic stiffness of wheel and body [1/(m^2 s^2)]; positive hardens, negative softens.
    G1, G2 : float
        CNVC's gains [s/m^2]; not negative.

    Raises
    ------
    ValueError
        If a value is not finite or a gain is negative.
    """

    alpha1: float = number("", "1/(m^2 s^2)", finite, 0.0)
    alpha2: float = number("", "1/(m^2 s^2)", finite, 0.0)
    G1: float = number("gain", "s/m^2", non_negative, 0.0)
    G2: float = number("gain", "s/m^2", non_negative, 0.0)

    name = "hardening"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``-(alpha x^3 + G v^3)`` of each mass [m/s^2]."""
        return (
            -(p.alpha1 * (x.x1 * x.x1 * x.x1) + p.G1 * (x.v1 * x.v1 * x.v1)),
            -(p.alpha2 * (x.x2 * x.x2 * x.x2) + p.G2 * (x.v2 * x.v2 * x.v2)),
        )
