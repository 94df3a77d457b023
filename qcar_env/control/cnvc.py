"""Cubic negative velocity control: ``u_i = -G_i v_i^3``, the paper's (3)-(4) with control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from qcar_env.control.law import Law
from qcar_env.parts.part import number
from qcar_env.validation import non_negative


@dataclass(frozen=True, kw_only=True)
class CNVC(Law):
    """Cubic negative velocity control.

    Parameters
    ----------
    G1, G2 : float
        Gains of wheel and body [s/m^2]; not negative. The paper's are 0.5 and 1.2.

    Raises
    ------
    ValueError
        If a gain is negative or not finite.

    Notes
    -----
    The force takes power ``G v^4 >= 0`` out of the plant, so the law destabilises no car in
    continuous time. Its averaged damping is ``(3/4) G omega^2 a^2``: it fades with the square of
    the amplitude. Explicit integration is another matter: the local slope ``3 G v^2`` makes the
    loop stiff at large velocities (27 000 1/s where the paper's worst case is switched on), and a
    step above ``2.78 / (3 G v^2)`` diverges.
    """

    G1: float = number("gain", "s/m^2", non_negative, 1.2)
    G2: float = number("gain", "s/m^2", non_negative, 1.2)

    name = "CNVC"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(-G1 v1^3, -G2 v2^3)`` [m/s^2]."""
        return -p.G1 * (x.v1 * x.v1 * x.v1), -p.G2 * (x.v2 * x.v2 * x.v2)
