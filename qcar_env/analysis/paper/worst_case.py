"""Whether ``omega = omega1 = omega2 = Omega`` is the worst case, as the paper's section 5 says.

Without control the car is linear: road and force have an answer each, and the phase between them
decides how much of both adds up. (3)-(4) have ``h sin(omega t)`` beside ``f cos(omega t)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.physics import linear
from qcar_env.validation import finite, whole

POINTS = 401  # values among which the largest amplitude is bracketed


@dataclass(frozen=True, kw_only=True)
class Largest:
    """The largest steady amplitude of a mass over a parameter."""

    value: float  # of the parameter, in its unit
    amplitude: float  # [m]


def uncontrolled_amplitudes(car: ForcedCar, *, phase: float | None = 0.0) -> tuple[float, float]:
    """Return the steady amplitudes of wheel and body without control [m].

    Parameters
    ----------
    car : ForcedCar
        The car, whose law does not count.
    phase : float, optional
        By which the road is ahead of that of (3) [rad]; None for the worst one of each mass.
    """
    found = linear.steady_state(car.car, car.road, car.force)
    road, force = found.road[:2], found.force[:2]
    if phase is None:
        total = np.abs(road) + np.abs(force)
    else:
        total = np.abs(road * np.exp(1j * finite("phase", phase, "rad")) + force)
    return float(total[0]), float(total[1])


def worst_phases(car: ForcedCar) -> tuple[float, float]:
    """Return by how much the road must be ahead to shake wheel and body most [rad]."""
    found = linear.steady_state(car.car, car.road, car.force)
    turn = np.angle(found.force[:2] * np.conj(found.road[:2]))
    return float(turn[0]), float(turn[1])


def largest(
    car: ForcedCar,
    mass: int,
    parameter: str,
    start: float,
    end: float,
    *,
    phase: float | None = 0.0,
) -> Largest:
    """Return the largest steady amplitude of a mass without control between two values.

    Parameters
    ----------
    car : ForcedCar
        The car.
    mass : {1, 2}
        Wheel or body.
    parameter : str
        What moves, see `ForcedCar.vary`.
    start, end : float
        From where to where.
    phase : float, optional
        See `uncontrolled_amplitudes`.
    """
    mass = whole("mass", mass, 1, 2)

    def amplitude(value: float) -> float:
        return uncontrolled_amplitudes(car.vary(parameter, value), phase=phase)[mass - 1]

    values = np.linspace(finite("start", start), finite("end", end), POINTS)
    top = int(np.argmax([amplitude(float(value)) for value in values]))
    bounds = float(values[max(top - 1, 0)]), float(values[min(top + 1, POINTS - 1)])
    found = minimize_scalar(lambda value: -amplitude(value), bounds=bounds, method="bounded")
    return Largest(value=float(found.x), amplitude=amplitude(float(found.x)))
