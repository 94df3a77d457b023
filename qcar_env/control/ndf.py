"""Negative derivative feedback: a band-pass filter driven by velocity, fed back negatively.

    eta'' + 2 zeta omega_f eta' + omega_f^2 eta = omega_f v_i,    u_i = -G_i eta'

Source: G. Cazzulani, F. Resta, F. Ripamonti, R. Zanzi, Negative derivative feedback for vibration
control of flexible structures, Smart Materials and Structures 21, 2012. The paper compares NDF
and does not print its filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Law
from qcar_env.parts.part import number
from qcar_env.physics.state import Filter
from qcar_env.validation import non_negative, positive


class NDFNumbers(NamedTuple):
    """Gains and filter coefficients as `NDF.command` and `NDF.filter_rate` take them."""

    G1: Any  # wheel [1/s]
    G2: Any  # body [1/s]
    omega_f1: Any  # filter frequency, wheel [rad/s]
    omega_f2: Any  # filter frequency, body [rad/s]
    damping1: Any  # 2 zeta1 omega_f1 [1/s]
    damping2: Any  # 2 zeta2 omega_f2 [1/s]


@dataclass(frozen=True, kw_only=True)
class NDF(Law):
    """Negative derivative feedback.

    Parameters
    ----------
    G1, G2 : float
        Gains of wheel and body [1/s]; not negative. The paper's are 1.2.
    omega_f1, omega_f2 : float
        Centre frequency of each band-pass [rad/s]; positive.
    zeta1, zeta2 : float
        Damping ratio of each filter [-]; positive. Calibrated on the paper's Table 1.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    From velocity to force the filter is ``G omega_f s / (s^2 + 2 zeta omega_f s + omega_f^2)``,
    which is positive real: the law takes energy out at every frequency and destabilises no car.
    At `omega_f` it equals velocity feedback with gain ``G / (2 zeta)``.
    """

    G1: float = number("gain", "1/s", non_negative, 1.2)
    G2: float = number("gain", "1/s", non_negative, 1.2)
    omega_f1: float = number("", "rad/s", positive, 55.0)
    omega_f2: float = number("", "rad/s", positive, 55.0)
    zeta1: float = number("", "-", positive, 0.23)
    zeta2: float = number("", "-", positive, 0.23)

    name = "NDF"
    State = Filter

    @property
    def numbers(self) -> NDFNumbers:
        """Gains and filter coefficients."""
        return NDFNumbers(
            self.G1,
            self.G2,
            self.omega_f1,
            self.omega_f2,
            2.0 * self.zeta1 * self.omega_f1,
            2.0 * self.zeta2 * self.omega_f2,
        )

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        """Return ``(-G1 eta1', -G2 eta2')`` [m/s^2]."""
        return -p.G1 * eta.eta1_dot, -p.G2 * eta.eta2_dot

    @staticmethod
    def filter_rate(  # pyright: ignore[reportIncompatibleVariableOverride]
        x: Any, eta: Any, p: Any
    ) -> Filter:
        """Return the rate of the filter."""
        w1, w2 = p.omega_f1, p.omega_f2
        return Filter(
            eta.eta1_dot,
            eta.eta2_dot,
            w1 * (x.v1 - w1 * eta.eta1) - p.damping1 * eta.eta1_dot,
            w2 * (x.v2 - w2 * eta.eta2) - p.damping2 * eta.eta2_dot,
        )
