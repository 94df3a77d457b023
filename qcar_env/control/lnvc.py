"""Linear negative velocity control: ``u_i = -G_i v_i``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law
from qcar_env.parts.part import number
from qcar_env.validation import non_negative


@dataclass(frozen=True, kw_only=True)
class LNVC(Law):
    """Linear negative velocity control.

    Parameters
    ----------
    G1, G2 : float
        Gains of wheel and body [1/s]; not negative. The paper's are 1.2.

    Raises
    ------
    ValueError
        If a gain is negative or not finite.

    Notes
    -----
    The gains add to the damping coefficients `b1` and `b2`, whatever the amplitude; the force
    takes power ``G v^2 >= 0`` out of the plant, so the law destabilises no car in continuous time.
    """

    G1: float = number("gain", "1/s", non_negative, 1.2)
    G2: float = number("gain", "1/s", non_negative, 1.2)

    name = "LNVC"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(-G1 v1, -G2 v2)`` [m/s^2]."""
        return -p.G1 * x.v1, -p.G2 * x.v2
