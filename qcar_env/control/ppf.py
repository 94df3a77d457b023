"""Positive position feedback: a second-order filter driven by position, fed back positively.

    eta'' + 2 zeta omega_f eta' + omega_f^2 eta = omega_f^2 x_i,    u_i = +G_i eta

Source: J. L. Fanson and T. K. Caughey, Positive position feedback control for large space
structures, AIAA Journal 28(4), 1990. The paper compares PPF and does not print its filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.control.static_stability import check_static_stiffness
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.state import Filter
from qcar_env.validation import non_negative, positive, store


class PPFGains(NamedTuple):
    """Gains and filter coefficients of `command` and `filter_rate`."""

    G1: Any  # wheel [1/s^2]
    G2: Any  # body [1/s^2]
    stiffness1: Any  # omega_f1^2 [1/s^2]
    stiffness2: Any  # omega_f2^2 [1/s^2]
    damping1: Any  # 2 zeta1 omega_f1 [1/s]
    damping2: Any  # 2 zeta2 omega_f2 [1/s]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``(G1 eta1, G2 eta2)`` [m/s^2] (arguments: `qcar_env.control.law.Law`)."""
    return gains.G1 * eta.eta1, gains.G2 * eta.eta2


def filter_rate(x: Any, eta: Any, gains: Any) -> Filter:
    """Return the rate of the filter (arguments: `qcar_env.control.law.Law`)."""
    return Filter(
        eta.eta1_dot,
        eta.eta2_dot,
        gains.stiffness1 * (x.x1 - eta.eta1) - gains.damping1 * eta.eta1_dot,
        gains.stiffness2 * (x.x2 - eta.eta2) - gains.damping2 * eta.eta2_dot,
    )


@dataclass(frozen=True, kw_only=True)
class PPF:
    """Positive position feedback.

    Parameters
    ----------
    G1, G2 : float
        Gains of wheel and body [1/s^2]; not negative. The paper's are 30 and 70.
    omega_f1, omega_f2 : float
        Frequency of each filter [rad/s]; positive, usually that of the mode it damps.
    zeta1, zeta2 : float
        Damping ratio of each filter [-]; positive. Calibrated on the paper's Table 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    At rest the filter repeats the position, so the law lowers the static stiffness by `G`: the
    closed loop is stable only below the limit that `check` computes (``G_i < omega_i^2`` without
    coupling).
    """

    G1: float = 30.0
    G2: float = 30.0
    omega_f1: float = 55.0
    omega_f2: float = 55.0
    zeta1: float = 0.13
    zeta2: float = 2.5
    name = "PPF"

    def __post_init__(self) -> None:
        """Check the arguments."""
        store(
            self,
            G1=non_negative("gain G1", self.G1, "1/s^2"),
            G2=non_negative("gain G2", self.G2, "1/s^2"),
            omega_f1=positive("omega_f1", self.omega_f1, "rad/s"),
            omega_f2=positive("omega_f2", self.omega_f2, "rad/s"),
            zeta1=positive("zeta1", self.zeta1),
            zeta2=positive("zeta2", self.zeta2),
        )

    @property
    def gains(self) -> PPFGains:
        """Gains and filter coefficients as plain floats."""
        return PPFGains(
            float(self.G1),
            float(self.G2),
            self.omega_f1 * self.omega_f1,
            self.omega_f2 * self.omega_f2,
            2.0 * self.zeta1 * self.omega_f1,
            2.0 * self.zeta2 * self.omega_f2,
        )

    @property
    def command(self) -> Command:
        """The law's output."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """The law's filter."""
        return filter_rate

    def check(self, car: QuarterCar) -> None:
        """Raise ValueError if the gains take the car's static stability."""
        check_static_stiffness(car, softening=(self.G1, self.G2), gains=("G1", "G2"))
