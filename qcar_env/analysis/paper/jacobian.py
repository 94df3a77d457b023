"""The Jacobian (37) of the slow flow under CNVC, entry by entry: the paper's Appendix A.

A small disturbance of a fixed point of (24)-(27) obeys a linear system with this matrix. The paper
prints seven entries wrong; `jacobian_entries` gives the derived ones, and the printed on demand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.paper.averaging import Form, SlowFlow
from qcar_env.analysis.paper.fixed_points import FixedPoints
from qcar_env.analysis.paper.forced_car import ForcedCars
from qcar_env.control.cnvc import CNVC
from qcar_env.control.passive import Passive

Array = NDArray[np.float64]


class JacobianEntries(NamedTuple):
    """N1 to N16 of the paper's Appendix A, row by row, each (n,)."""

    N1: Array
    N2: Array
    N3: Array
    N4: Array
    N5: Array
    N6: Array
    N7: Array
    N8: Array
    N9: Array
    N10: Array
    N11: Array
    N12: Array
    N13: Array
    N14: Array
    N15: Array
    N16: Array

    @property
    def matrix(self) -> Array:
        """The Jacobian (37), (n, 4, 4), for ``(a1, theta1, a2, theta2)``."""
        return np.moveaxis(np.array(np.broadcast_arrays(*self)).reshape(4, 4, -1), 2, 0)


def jacobian_entries(
    cars: ForcedCars, points: FixedPoints, *, form: Form = "frozen", printed: bool = False
) -> JacobianEntries:
    """Return N1 to N16 at fixed points under CNVC or no control.

    Parameters
    ----------
    cars : ForcedCars
        The cars, (n,).
    points : FixedPoints
        Their fixed points; `a1` and `a2` not zero, where the polar form is singular.
    form : {"frozen", "natural", "rotating"}
        See `qcar_env.analysis.paper.averaging.SlowFlow`.
    printed : bool, optional
        ``True``: as the appendix is printed, with E3/omega2 in N9, N10 and N12 and the wrong sign
        of the E term in N3, N8, N14 and N16. For the fidelity report only.

    Returns
    -------
    JacobianEntries

    Raises
    ------
    ValueError
        If the law is another: the appendix is for CNVC.
    """
    if not isinstance(cars.law, (CNVC, Passive)):
        raise ValueError(
            f"the paper's Jacobian is for CNVC or no control, got {cars.law.name}; "
            "use SlowFlow.jacobian"
        )
    car, h, f, omega = cars.car, cars.h, cars.f, cars.omega
    flow = SlowFlow(cars=cars, form=form)
    w1, w2 = flow.frequencies
    sigma1, sigma2 = flow.detunings
    G1, G2 = cars.gains.values[:2] if isinstance(cars.law, CNVC) else (np.zeros_like(h),) * 2
    a1, a2 = points.a1, points.a2
    c, s = np.cos(points.theta1 - points.theta2), np.sin(points.theta1 - points.theta2)
    c1, s1 = np.cos(points.theta1), np.sin(points.theta1)
    c2, s2 = np.cos(points.theta2), np.sin(points.theta2)
    two1, two2 = 2.0 * w1, 2.0 * w2
    flipped = -1.0 if printed else 1.0  # the sign of the E term as printed
    e3 = 2.0 * car.E3 if printed else car.E3  # the factor of E3 as printed
    return JacobianEntries(
        N1=-car.b1 / 2.0 - 9.0 * G1 * w1 * w1 * a1 * a1 / 8.0,
        N2=(
            -car.E2 * w2 * a2 * s / two1
            - car.E1 * a2 * c / two1
            + car.mu1 * h * s1 / two1
            - car.mu2 * omega * h * c1 / two1
        ),
        N3=car.E2 * w2 * c / two1 - flipped * car.E1 * s / two1,
        N4=car.E2 * w2 * a2 * s / two1 + car.E1 * a2 * c / two1,
        N5=sigma1 / a1,
        N6=(-car.E2 * w2 * a2 * c + car.E1 * a2 * s + car.mu1 * h * c1 + car.mu2 * omega * h * s1)
        / (two1 * a1),
        N7=(-car.E2 * w2 * s - car.E1 * c) / (two1 * a1),
        N8=(car.E2 * w2 * a2 * c - flipped * car.E1 * a2 * s) / (two1 * a1),
        N9=w1 * car.b2 * c / two2 + e3 * s / two2,
        N10=-w1 * car.b2 * a1 * s / two2 + e3 * a1 * c / two2,
        N11=-car.b2 / 2.0 - 9.0 * G2 * w2 * w2 * a2 * a2 / 8.0,
        N12=-f * c2 / two2 + w1 * car.b2 * a1 * s / two2 - e3 * a1 * c / two2,
        N13=(w1 * car.b2 * s - car.E3 * c) / (two2 * a2),
        N14=(w1 * car.b2 * a1 * c + flipped * car.E3 * a1 * s) / (two2 * a2),
        N15=sigma2 / a2,
        N16=(f * s2 - w1 * car.b2 * a1 * c - flipped * car.E3 * a1 * s) / (two2 * a2),
    )
