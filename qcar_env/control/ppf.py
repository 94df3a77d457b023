"""Positive position feedback: a second-order filter driven by position, fed back positively.

    eta'' + 2 zeta omega_f eta' + omega_f^2 eta = omega_f^2 x_i,    u_i = +G_i eta

Source: J. L. Fanson and T. K. Caughey, Positive position feedback control for large space
structures, AIAA Journal 28(4), 1990. The paper compares PPF and does not print its filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Law
from qcar_env.control.static_stability import check_static_stiffness
from qcar_env.parts.part import number
from qcar_env.physics.car import Car
from qcar_env.physics.state import Filter
from qcar_env.validation import non_negative, positive


class PPFNumbers(NamedTuple):
    """Gains and filter coefficients as `PPF.command` and `PPF.filter_rate` take them."""

    G1: Any  # wheel [1/s^2]
    G2: Any  # body [1/s^2]
    stiffness1: Any  # omega_f1^2 [1/s^2]
    stiffness2: Any  # omega_f2^2 [1/s^2]
    damping1: Any  # 2 zeta1 omega_f1 [1/s]
    damping2: Any  # 2 zeta2 omega_f2 [1/s]


@dataclass(frozen=True, kw_only=True)
class PPF(Law):
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

    G1: float = number("gain", "1/s^2", non_negative, 30.0)
    G2: float = number("gain", "1/s^2", non_negative, 30.0)
    omega_f1: float = number("", "rad/s", positive, 55.0)
    omega_f2: float = number("", "rad/s", positive, 55.0)
    zeta1: float = number("", "-", positive, 0.13)
    zeta2: float = number("", "-", positive, 2.5)

    name = "PPF"
    State = Filter

    @property
    def numbers(self) -> PPFNumbers:
        """Gains and filter coefficients."""
        return PPFNumbers(
            self.G1,
            self.G2,
            self.omega_f1 * self.omega_f1,
            self.omega_f2 * self.omega_f2,
            2.0 * self.zeta1 * self.omega_f1,
            2.0 * self.zeta2 * self.omega_f2,
        )

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(G1 eta1, G2 eta2)`` [m/s^2]."""
        return p.G1 * eta.eta1, p.G2 * eta.eta2

    @staticmethod
    def filter_rate(  # pyright: ignore[reportIncompatibleVariableOverride]
        x: Any, eta: Any, p: Any
    ) -> Filter:
        """Return the rate of the filter."""
        return Filter(
            eta.eta1_dot,
            eta.eta2_dot,
            p.stiffness1 * (x.x1 - eta.eta1) - p.damping1 * eta.eta1_dot,
            p.stiffness2 * (x.x2 - eta.eta2) - p.damping2 * eta.eta2_dot,
        )

    def check(self, car: Car) -> None:
        """Raise ValueError if the gains take the car's static stability."""
        check_static_stiffness(car, softening=(self.G1, self.G2), gains=("G1", "G2"))
