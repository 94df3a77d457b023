"""The linear-quadratic regulator of a suspension, with weights on outputs and preview of the road.

    xi_{k+1} = A xi_k + B F_k + G s_k         s_k = (y_{k+1} - y_k) / dt, slope of the road in time
    J = sum_k  (a2_k / a)^2 + (travel_k / d)^2 + (tyre_k / e)^2 + (F_k / f)^2

a2 is the acceleration of the body itself, ``c xi + F / m2``, so that J has terms in ``xi F``:
weights on the state alone cannot say what a passenger feels. P solves the discrete Riccati
equation, and with ``S = R + B' P B``, ``K = (B' P A + N') / S`` and ``Ac = A - B K`` the best force
is

    F_k = -K xi_k - sum_{j=0}^{n-1} K_j s_{k+j},       K_j = B' (Ac')^j P G / S                  (1)

where the next n intervals of the road are known and it is taken as level after them. With n = 0 it
is the regulator.

Source: D. Hrovat, Automatica 33(10), 1997 (weights); M. Tomizuka, Optimum linear preview control
with application to vehicle suspension, ASME J. Dynamic Systems, Measurement and Control 98(3),
1976; A. Hac, Optimal linear preview control of active vehicle suspension, Vehicle System Dynamics
21(3), 1992. (1) is derived by completing the square; the tests compare it with the Riccati equation
of the plant with a shift register for the road.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from qcar_env.control.controller import Controller
from qcar_env.control.suspension import STATES, Suspension
from qcar_env.validation import finite_array, positive, store, whole

Array = NDArray[np.float64]

WEIGHTED = ("body_acceleration", "travel", "tyre_deflection")
MOST_INTERVALS = 10_000  # of a preview, chosen here: 50 s at 200 Hz


@dataclass(frozen=True, kw_only=True)
class Acceptable:
    """What is acceptable of each output; a weight is the reciprocal of its square.

    Parameters
    ----------
    acceleration : float
        Of the body [m/s^2].
    travel : float
        Of the suspension [m].
    tyre : float
        Deflection of the tyre [m].
    force : float
        Of the actuator [N].

    Raises
    ------
    ValueError
        If one is not positive.

    Notes
    -----
    Bryson's rule: A. E. Bryson, Y. C. Ho, Applied Optimal Control, 1975, section 5.2. Chosen here:
    1 m/s^2, a tenth of g; 80 mm, what most cars have; 10 mm, half of a car's static tyre
    deflection, with which the tyre of an Escort keeps the road of class C at 20 m/s; 5 kN, so that
    the force costs little against its effect.
    """

    acceleration: float = 1.0
    travel: float = 0.08
    tyre: float = 0.01
    force: float = 5_000.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        units = {"acceleration": "m/s^2", "travel": "m", "tyre": "m", "force": "N"}
        for name, unit in units.items():
            given = positive(f"acceptable {name}", getattr(self, name), unit)
            store(self, **{name: given})


@dataclass(frozen=True, kw_only=True, eq=False)
class Regulator:
    """The regulator and what its cost is made of."""

    K: Array  # (4,) of the state [N per unit]
    P: Array  # (4, 4) of the cost to go
    Q: Array  # (4, 4)
    N: Array  # (4,) of xi F
    R: float
    plant: Suspension

    @property
    def closed(self) -> Array:
        """Return ``Ac = A - B K`` (4, 4)."""
        return self.plant.Ad - np.outer(self.plant.Bd, self.K)

    @property
    def controller(self) -> Controller:
        """The controller that reads the state."""
        return Controller(name="LQR", signals=STATES, D=-self.K)

    def preview_gains(self, count: int) -> Array:
        """Return ``K_j`` of (1) for j = 0 ... count - 1 [N s/m], shape (count,).

        Raises
        ------
        ValueError
            If `count` is no whole number from 0 to 10 000.
        """
        count = whole("intervals of preview", count, least=0, most=MOST_INTERVALS)
        B, closed = self.plant.Bd, self.closed
        ahead, gains = self.P @ self.plant.Gd, np.empty(count)
        for j in range(count):
            gains[j] = B @ ahead
            ahead = closed.T @ ahead
        return gains / (self.R + B @ self.P @ B)

    def plan(self, heights: Array, count: int) -> Array:
        """Return the forces [N] that the sum of (1) adds, interval by interval.

        Parameters
        ----------
        heights : ndarray (k + 1,)
            Height of the road under the tyre at the control instants [m]; level after the last.
        count : int
            Intervals of preview.

        Returns
        -------
        ndarray (k,)
        """
        slopes = np.diff(finite_array("heights", heights, "m")) / self.plant.dt
        gains = self.preview_gains(count)
        padded = np.concatenate([slopes, np.zeros(max(count - 1, 0))])
        return -np.convolve(padded, gains[::-1], "valid") if count else np.zeros(len(slopes))


def regulator(plant: Suspension, acceptable: Acceptable | None = None) -> Regulator:
    """Design the regulator.

    Parameters
    ----------
    plant : Suspension
        The car.
    acceptable : Acceptable, optional
        Weights of the cost.

    Raises
    ------
    ValueError
        If the Riccati equation has no solution that stabilises the plant.
    """
    limits = Acceptable() if acceptable is None else acceptable
    c, d, _ = plant.rows(WEIGHTED)
    w = np.array([limits.acceleration, limits.travel, limits.tyre]) ** -2.0
    Q, N, R = c.T @ (w[:, np.newaxis] * c), c.T @ (w * d), float(d @ (w * d) + limits.force**-2.0)
    A, B = plant.Ad, plant.Bd[:, np.newaxis]
    # The force in units of 1 / sqrt(R), so that the equation's numbers are of one size.
    size = R**-0.5
    try:
        found = solve_discrete_are(A, B * size, Q, np.eye(1), s=N[:, np.newaxis] * size)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"no regulator for {limits}: {error}; give numbers nearer to those of a car"
        ) from None
    P = np.asarray(found, dtype=np.float64)
    K = (plant.Bd @ P @ A + N) / (R + plant.Bd @ P @ plant.Bd)
    return Regulator(K=K, P=P, Q=Q, N=N, R=R, plant=plant)
