"""The car as suspension control sees it: relative to the road, with one force between the masses.

    xi = (x2 - x1, v2, x1 - y, v1)        travel, body, tyre, wheel
    xi' = A xi + B F + G y'                F [N] lifts the body, y' is the rate of the road's height

and of the sampled car, F and y' held over an interval,

    xi_{k+1} = Ad xi_k + Bd F_k + Gd (y_{k+1} - y_k) / dt

which is exact on a road that runs straight between samples. The height of the road itself drops
out: a car on a plateau is at rest. What can be read or weighted are rows of xi and F.

Source: D. Hrovat, Survey of advanced suspension developments and related optimal control
applications, Automatica 33(10), 1997.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from qcar_env.physics import linear
from qcar_env.physics.car import Car
from qcar_env.validation import known, positive

Array = NDArray[np.float64]

STATES = ("travel", "v2", "tyre_deflection", "v1")
OUTPUTS = (*STATES, "travel_rate", "body_acceleration", "wheel_acceleration")
# Of the state (x1, x2, v1, v2) on a road of height 0.
_FROM_STATE = np.array(
    [[-1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
)


@dataclass(frozen=True, kw_only=True)
class Suspension:
    """A car in these coordinates."""

    A: Array  # (4, 4)
    B: Array  # (4,) of the force [1/N]
    G: Array  # (4,) of the road's rate
    dt: float  # control interval [s]
    Ad: Array  # (4, 4)
    Bd: Array  # (4,)
    Gd: Array  # (4,)

    def row(self, signal: str) -> tuple[Array, float, float]:
        """Return a signal as ``c xi + d F + e y'``: c (4,), d, e.

        Raises
        ------
        ValueError
            If it is none of `OUTPUTS`: the height of wheel and body is no quantity of this plant.
        """
        known("signal of the suspension", signal, OUTPUTS)
        if signal in STATES:
            return np.eye(4)[STATES.index(signal)], 0.0, 0.0
        if signal == "travel_rate":
            return np.array([0.0, 1.0, 0.0, -1.0]), 0.0, 0.0
        of = 1 if signal == "body_acceleration" else 3
        return self.A[of], float(self.B[of]), float(self.G[of])

    def rows(self, signals: tuple[str, ...]) -> tuple[Array, Array, Array]:
        """Return `row` of k signals: (k, 4), (k,), (k,)."""
        found = [self.row(each) for each in signals]
        return (
            np.array([c for c, _, _ in found]).reshape(len(found), 4),
            np.array([d for _, d, _ in found]),
            np.array([e for _, _, e in found]),
        )


def suspension(car: Car, dt: float) -> Suspension:
    """Return a car as suspension control sees it; of one with nonlinear parts, its tangent at rest.

    Parameters
    ----------
    car : Car
        The car; with masses.
    dt : float
        Control interval [s].

    Raises
    ------
    ValueError
        If the car has no masses, or `dt` is not positive.
    """
    dt = positive("dt", dt, "s")
    if not car.has_masses:
        raise ValueError(
            "suspension control needs a car with masses, got a PaperCar; make it with QuarterCar"
        )
    absolute = linear.matrices(car).A if car.linear else linear.jacobian(car)
    functions = car.functions
    u1, u2 = functions.by_mass(-1.0, 1.0, functions.prepare(car.numbers))
    A = _FROM_STATE @ absolute @ np.linalg.inv(_FROM_STATE)
    B = _FROM_STATE @ np.array([0.0, 0.0, u1, u2])
    # On a road that rises as the whole car does nothing is strained: what the rates of the masses
    # leave over is what the road's rate does.
    damping = -absolute[2:, 2:].sum(axis=1)
    G = np.array([0.0, damping[1], -1.0, damping[0]])
    m = np.zeros((6, 6))
    m[:4] = np.hstack([A, B[:, np.newaxis], G[:, np.newaxis]])
    exact = expm(m * dt)
    return Suspension(A=A, B=B, G=G, dt=dt, Ad=exact[:4, :4], Bd=exact[:4, 4], Gd=exact[:4, 5])
