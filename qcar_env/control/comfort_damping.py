"""The damper that gives the calmest body on a random road: a passive car's best.

On a road whose rate is white, of intensity W, a car with an undamped tyre has the mean square

    a2^2 = W / (2 m2^2) ((m1 + m2) k2^2 / c + k1 c),     least at  c = k2 sqrt((m1 + m2) / k1)  (1)

Source: M. Gobbi, G. Mastinu, Analytical description and optimization of the dynamic behaviour of
passively suspended road vehicles, J. Sound and Vibration 245(3), 2001 (recalled); the tests compare
(1) with the Lyapunov equation.
"""

from __future__ import annotations

import math

from qcar_env.control.suspension import Suspension, suspension
from qcar_env.physics.car import Car


def mean_square_acceleration(
    m1: float, m2: float, k1: float, k2: float, c: float, intensity: float
) -> float:
    """Return the mean square of the body's acceleration [m^2/s^4] of (1).

    Parameters
    ----------
    m1, m2 : float
        Masses of wheel and body [kg].
    k1, k2 : float
        Stiffness of tyre and suspension [N/m].
    c : float
        Damping of the suspension [N s/m].
    intensity : float
        W of the road's rate [m^2/s], see `qcar_env.control.kalman.road_intensity`.
    """
    return intensity / (2.0 * m2 * m2) * ((m1 + m2) * k2 * k2 / c + k1 * c)


def comfort_damping(car: Car) -> tuple[float, float]:
    """Return the damping that is best for comfort, and that which the car has [N s/m].

    Of a car with nonlinear parts both are those of its tangent at rest; a tyre's damping is left
    out, as (1) has none.

    Raises
    ------
    ValueError
        If the car has no masses.
    """
    plant: Suspension = suspension(car, 1.0e-3)  # any interval: only the rates are read
    m1, m2 = -1.0 / float(plant.B[3]), 1.0 / float(plant.B[1])
    k2, own = -m2 * float(plant.A[1, 0]), -m2 * float(plant.A[1, 1])
    k1 = -m1 * float(plant.A[3, 2])
    return k2 * math.sqrt((m1 + m2) / k1), own
