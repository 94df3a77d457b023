"""Springs that stiffen with deflection, and cubic damping, as a law around the linear plant.

    u_i = -(alpha_i x_i^3 + G_i v_i^3)

The paper's plant is linear, and its averaged response has one stable branch. Equations (3)-(4)
with this law are two coupled Duffing oscillators, whose response bends and folds: the test of
every solver that claims to follow a branch round a turning point. With ``G = 0`` it is a model of
a hardening suspension and tyre; with `G` it is CNVC on such a car.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import finite, non_negative, store


class HardeningGains(NamedTuple):
    """Coefficients of `command`."""

    alpha1: Any  # wheel [1/(m^2 s^2)]
    alpha2: Any  # body [1/(m^2 s^2)]
    G1: Any  # wheel [s/m^2]
    G2: Any  # body [s/m^2]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``-(alpha x^3 + G v^3)`` of each mass [m/s^2] (see `qcar_env.control.law.Law`)."""
    return (
        -(gains.alpha1 * (x.x1 * x.x1 * x.x1) + gains.G1 * (x.v1 * x.v1 * x.v1)),
        -(gains.alpha2 * (x.x2 * x.x2 * x.x2) + gains.G2 * (x.v2 * x.v2 * x.v2)),
    )


@dataclass(frozen=True, kw_only=True)
class Hardening:
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

    alpha1: float = 0.0
    alpha2: float = 0.0
    G1: float = 0.0
    G2: float = 0.0
    name = "hardening"

    def __post_init__(self) -> None:
        """Check the coefficients."""
        store(
            self,
            alpha1=finite("alpha1", self.alpha1, "1/(m^2 s^2)"),
            alpha2=finite("alpha2", self.alpha2, "1/(m^2 s^2)"),
            G1=non_negative("gain G1", self.G1, "s/m^2"),
            G2=non_negative("gain G2", self.G2, "s/m^2"),
        )

    @property
    def gains(self) -> HardeningGains:
        """The coefficients as plain floats."""
        return HardeningGains(
            float(self.alpha1), float(self.alpha2), float(self.G1), float(self.G2)
        )

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: a spring has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car: the rest position's stiffness is not changed."""
