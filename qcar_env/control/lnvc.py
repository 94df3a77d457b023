"""Linear negative velocity control: ``u_i = -G_i v_i``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import non_negative, store


class LNVCGains(NamedTuple):
    """Gains of `command`."""

    G1: Any  # wheel [1/s]
    G2: Any  # body [1/s]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``(-G1 v1, -G2 v2)`` [m/s^2] (arguments: `qcar_env.control.law.Law`)."""
    return -gains.G1 * x.v1, -gains.G2 * x.v2


@dataclass(frozen=True, kw_only=True)
class LNVC:
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

    G1: float = 1.2
    G2: float = 1.2
    name = "LNVC"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(
            self,
            G1=non_negative("gain G1", self.G1, "1/s"),
            G2=non_negative("gain G2", self.G2, "1/s"),
        )

    @property
    def gains(self) -> LNVCGains:
        """The gains as plain floats."""
        return LNVCGains(float(self.G1), float(self.G2))

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
