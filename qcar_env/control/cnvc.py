"""Cubic negative velocity control: ``u_i = -G_i v_i^3``, the paper's (3)-(4) with control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import non_negative, store


class CNVCGains(NamedTuple):
    """Gains of `command`."""

    G1: Any  # wheel [s/m^2]
    G2: Any  # body [s/m^2]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``(-G1 v1^3, -G2 v2^3)`` [m/s^2] (arguments: `qcar_env.control.law.Law`)."""
    return -gains.G1 * (x.v1 * x.v1 * x.v1), -gains.G2 * (x.v2 * x.v2 * x.v2)


@dataclass(frozen=True, kw_only=True)
class CNVC:
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

    G1: float = 1.2
    G2: float = 1.2
    name = "CNVC"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(
            self,
            G1=non_negative("gain G1", self.G1, "s/m^2"),
            G2=non_negative("gain G2", self.G2, "s/m^2"),
        )

    @property
    def gains(self) -> CNVCGains:
        """The gains as plain floats."""
        return CNVCGains(float(self.G1), float(self.G2))

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: the law has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car: the law only takes energy out."""
