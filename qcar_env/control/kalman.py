"""A Kalman filter that finds the motion of a car from its sensors, and the LQG controller with it.

    xi_{k+1} = A xi_k + B f_k + road noise        r_k = C xi_k + d f_{k-1} + sensor noise

An accelerometer reads the force that still acts, hence f_{k-1}. The rate of a road of ISO 8608 is
white: a spectrum of heights ``Gd (n / n0)^-2`` makes, at speed v, a rate of the intensity

    W = 2 pi^2 n0^2 Gd v       [m^2/s], two-sided                                             (1)

and over an interval the state is shaken by the covariance ``int e^{A s} G W G' e^{A' s} ds``. The
filter is told the force that the actuator gave.

From acceleration and travel alone the body's own velocity is found slowly, within some 20 s for a
car: they say how the masses move against each other, and the road is all that holds the rest.

Source: B. D. O. Anderson, J. B. Moore, Optimal Filtering, 1979, chapter 4; C. F. Van Loan,
Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23(3), 1978; (1)
follows from ISO 8608:2016.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from qcar_env.control.controller import Controller
from qcar_env.control.preview import Regulator
from qcar_env.control.suspension import Suspension
from qcar_env.roads.iso8608 import N0
from qcar_env.validation import finite_array, positive

Array = NDArray[np.float64]


def road_intensity(G: float, speed: float) -> float:
    """Return the intensity W of (1) [m^2/s].

    Parameters
    ----------
    G : float
        ``Gd(n0)`` of the road [m^3]; `qcar_env.roads.iso8608.CLASSES` has those of the classes.
    speed : float
        Of the car [m/s].

    Raises
    ------
    ValueError
        If a number is not positive.
    """
    return (
        2.0
        * (math.pi * N0) ** 2
        * positive("spectrum G", G, "m^3")
        * positive("speed", speed, "m/s")
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Filter:
    """The steady filter of k readings."""

    signals: tuple[str, ...]  # k
    C: Array  # (k, 4)
    d: Array  # (k,) of the force of the interval before
    L: Array  # (4, k): the estimate moves by L (r - C xi - d f)
    covariance: Array  # (4, 4) of the error before a reading
    plant: Suspension


def kalman(plant: Suspension, signals: tuple[str, ...], noise: Array, intensity: float) -> Filter:
    """Design the filter.

    Parameters
    ----------
    plant : Suspension
        The car.
    signals : tuple of str
        What is read, of `qcar_env.control.suspension.OUTPUTS`.
    noise : array_like (k,)
        Standard deviation of each reading, in the signal's unit; positive.
    intensity : float
        Of the road's rate [m^2/s], see `road_intensity`.

    Raises
    ------
    ValueError
        If there is no signal, a noise or the intensity is not positive, or a signal jumps with the
        road's rate, as a wheel's acceleration over a damped tyre does.
    """
    if not signals:
        raise ValueError("a filter must read something, got no signals; give at least one")
    sigma = finite_array("noise", noise)
    if sigma.shape != (len(signals),) or np.any(sigma <= 0.0):
        raise ValueError(
            f"noise must be positive, one number for each of {signals}, got {sigma}; an ideal "
            "sensor has a small one"
        )
    C, d, e = plant.rows(signals)
    for name, through in zip(signals, e.tolist(), strict=True):
        if through != 0.0:
            raise ValueError(
                f"no signal may jump with the road's rate, got {name} of a car with a damped tyre; "
                "leave it out"
            )
    process = _shaken(plant, positive("intensity", intensity, "m^2/s"))
    measured = np.diag(sigma * sigma)
    # In units of the noise, so that the equation's numbers are of one size.
    unit = C / sigma[:, np.newaxis]
    found = solve_discrete_are(plant.Ad.T, unit.T, process, np.eye(len(sigma)))
    P = np.asarray(found, dtype=np.float64)
    L = np.linalg.solve(C @ P @ C.T + measured, C @ P).T
    return Filter(signals=signals, C=C, d=d, L=L, covariance=P, plant=plant)


def _shaken(plant: Suspension, intensity: float) -> Array:
    """Return the covariance that the road adds over an interval (Van Loan)."""
    A, dt = plant.A, plant.dt
    m = np.zeros((8, 8))
    m[:4, :4], m[:4, 4:], m[4:, 4:] = -A, intensity * np.outer(plant.G, plant.G), A.T
    exact = expm(m * dt)
    return exact[4:, 4:].T @ exact[:4, 4:]


def lqg(regulator: Regulator, found: Filter) -> Controller:
    """Return the regulator that acts on the filter's estimate.

    Its memory is the estimate before a reading (4,) and the force of the interval before [N].
    """
    plant, K, L = found.plant, regulator.K, found.L
    keep, shift = np.eye(4) - L @ found.C, L @ found.d
    A, B = np.zeros((5, 5)), np.zeros((5, len(found.signals)))
    A[:4, :4], A[:4, 4] = plant.Ad @ keep, -plant.Ad @ shift
    B[:4] = plant.Ad @ L
    return Controller(
        name="LQG",
        signals=found.signals,
        A=A,
        B=B,
        E=np.append(plant.Bd, 1.0),
        C=np.append(-K @ keep, K @ shift),
        D=-K @ L,
    )
