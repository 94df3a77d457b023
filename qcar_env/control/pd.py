"""Proportional-derivative control: ``u_i = -(p_i x_i + d_i v_i)``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.control.static_stability import check_static_stiffness
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import finite, non_negative, store


class PDGains(NamedTuple):
    """Gains of `command`."""

    p1: Any  # wheel, proportional [1/s^2]
    p2: Any  # body, proportional [1/s^2]
    d1: Any  # wheel, derivative [1/s]
    d2: Any  # body, derivative [1/s]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``-(p x + d v)`` of each mass [m/s^2] (arguments: `qcar_env.control.law.Law`)."""
    return (
        -(gains.p1 * x.x1 + gains.d1 * x.v1),
        -(gains.p2 * x.x2 + gains.d2 * x.v2),
    )


@dataclass(frozen=True, kw_only=True)
class PD:
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

    p1: float = 30.0
    p2: float = 30.0
    d1: float = 1.2
    d2: float = 1.2
    name = "PD"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(
            self,
            p1=finite("gain p1", self.p1, "1/s^2"),
            p2=finite("gain p2", self.p2, "1/s^2"),
            d1=non_negative("gain d1", self.d1, "1/s"),
            d2=non_negative("gain d2", self.d2, "1/s"),
        )

    @property
    def gains(self) -> PDGains:
        """The gains as plain floats."""
        return PDGains(float(self.p1), float(self.p2), float(self.d1), float(self.d2))

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: the law has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Raise ValueError if the proportional gains take the car's static stability.

        See `qcar_env.control.static_stability.check_static_stiffness`.
        """
        check_static_stiffness(car, softening=(-self.p1, -self.p2), gains=("-p1", "-p2"))
