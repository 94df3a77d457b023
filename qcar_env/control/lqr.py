"""Linear-quadratic control of the sampled car, alone and with a model of the disturbance.

    x_{k+1} = A x_k + B (u_k + d_k)        cost = sum  |x_k|^2_Q + |u_k + d_k|^2_R

States in reference amplitudes, forces in limits. The regulator's gain K solves the discrete
Riccati equation; `u = -K x` leaves what the disturbance d keeps exciting. Road and external force
both act where the actuators do (on the rates of v1 and v2), so a known d can be cancelled:
``u = -K x - d``. Two ways of knowing it:

- **feedforward**: road and force are read now and continued over the held interval as the sinusoids
  that they are (one interval of preview);
- **internal model**: an oscillator of the forcing's frequency for each mass stands in for d, and a
  Kalman filter finds its state from the car's motion alone. The filter is told the force that the
  actuators really gave, so a saturated actuator does not wind it up.

Source: B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods, 1990, chapters 2
and 7; B. A. Francis, W. M. Wonham, The internal model principle of control theory, Automatica
12(5), 1976; C. D. Johnson, Accommodation of external disturbances in linear regulator and
servomechanism problems, IEEE Trans. Automatic Control 16(6), 1971.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from qcar_env.physics import linear
from qcar_env.physics.car import Car
from qcar_env.validation import non_negative, positive, store

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SampledPlant:
    """The car under a held force, scaled: states over their reference, forces over their limit."""

    A: Array  # (4, 4)
    B: Array  # (4, m)
    matrix: Array  # (4, 4) of the continuous plant, scaled [1/s]
    into: Array  # (4, m) of the continuous plant, scaled [1/s]
    dt: float  # [s]


def sampled_plant(car: Car, scale: Array, push: Array, dt: float) -> SampledPlant:
    """Return the scaled plant.

    Parameters
    ----------
    car : Car
        The plant.
    scale : ndarray (4,)
        What the states ``(x1, x2, v1, v2)`` are divided by [m, m, m/s, m/s]; positive.
    push : ndarray (2, m)
        Specific forces on wheel and body [m/s^2] that action 1 of each actuator makes.
    dt : float
        Control interval [s].
    """
    plant = linear.matrices(car)
    a, b = linear.held_transition(car, dt)
    return SampledPlant(
        A=a * scale / scale[:, np.newaxis],
        B=b @ push / scale[:, np.newaxis],
        matrix=plant.A * scale / scale[:, np.newaxis],
        into=plant.B @ push / scale[:, np.newaxis],
        dt=positive("dt", dt, "s"),
    )


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the quadratic cost.

    Parameters
    ----------
    q1, q2 : float
        Of the motion of wheel and body in reference amplitudes (displacement and rate alike) [-].
    r1, r2 : float
        Of the force on wheel and body in limits [-].

    Raises
    ------
    ValueError
        If a weight is not positive.
    """

    q1: float = 1.0
    q2: float = 1.0
    r1: float = 1e-3
    r2: float = 1e-3

    def __post_init__(self) -> None:
        """Check the weights."""
        names = ("q1", "q2", "r1", "r2")
        store(self, **{name: positive(f"weight {name}", getattr(self, name)) for name in names})


def regulator(plant: SampledPlant, weights: Weights) -> Array:
    """Return the gain K of ``u = -K x``, shape (m, 4), in scaled units.

    Raises
    ------
    ValueError
        If the Riccati equation has no solution that stabilises the plant.
    """
    value = cost_to_go(plant, weights)
    r = _force_weight(plant, weights)
    b = plant.B
    return np.linalg.solve(r + b.T @ value @ b, b.T @ value @ plant.A)


def cost_to_go(plant: SampledPlant, weights: Weights) -> Array:
    """Return P of the optimal cost ``x^T P x``, shape (4, 4) (see `regulator`)."""
    q = np.diag([weights.q1, weights.q2, weights.q1, weights.q2])
    try:
        found = solve_discrete_are(plant.A, plant.B, q, _force_weight(plant, weights))
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"no regulator for weights {weights}: {error}; give weights nearer to one another"
        ) from None
    return np.asarray(found, dtype=np.float64)


def held_mean(omega: float, dt: float) -> tuple[float, float]:
    """Return ``(a, b)``: over the next `dt` a sinusoid p averages ``a p + b p' / omega`` [-]."""
    angle = omega * dt
    if angle == 0.0:
        return 1.0, 0.0
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle


def feedforward(car: Car, push: Array, omega: float, Omega: float, dt: float) -> Array:
    """Return the gain on ``(y, y', F, F')`` that cancels road and force over the next interval.

    Parameters
    ----------
    car : Car
        The plant.
    push : ndarray (2, 2)
        Specific forces that action 1 of each actuator makes [m/s^2].
    omega, Omega : float
        Frequencies of road and force, with which both are continued [rad/s].
    dt : float
        Control interval [s].

    Returns
    -------
    ndarray (2, 4)
        Actions for each metre, metre a second, m/s^2 and m/s^3.

    Raises
    ------
    ValueError
        If a frequency is negative or `dt` not positive.
    """
    dt = positive("dt", dt, "s")
    omega, Omega = non_negative("omega", omega, "rad/s"), non_negative("Omega", Omega, "rad/s")
    a, b = held_mean(omega, dt)
    c, d = held_mean(Omega, dt)
    slope_y = b / omega if omega else 0.0
    slope_F = d / Omega if Omega else 0.0
    mean = np.array(  # of (y, y', F), since (y', y'') is (y', -omega^2 y)
        [
            [a, slope_y, 0.0, 0.0],
            [-omega * omega * slope_y, a, 0.0, 0.0],
            [0.0, 0.0, c, slope_F],
        ]
    )
    plant = linear.matrices(car)
    into, disturbance = (plant.B @ push)[2:], (plant.R @ mean)[2:]  # of the rates of v1 and v2
    return np.asarray(-np.linalg.solve(into, disturbance), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class InternalModel:
    """A Kalman filter on plant and disturbance oscillators, with the gain that cancels them.

    The estimate z is ``(x1, x2, v1, v2, p1, q1, p2, q2)``, scaled; p_j is the disturbance where
    actuator j acts, in its limits, and ``p' = omega q``, ``q' = -omega p``.
    """

    transition: Array  # (8, 8)
    into: Array  # (8, m) of the force that really acted
    correction: Array  # (8, 4) of the state that was measured
    cancel: Array  # (m, 8): action that cancels the estimate's disturbance


def internal_model(
    plant: SampledPlant, omega: float, *, drift: float = 1.0, noise: float = 1e-3
) -> InternalModel:
    """Design the filter.

    Parameters
    ----------
    plant : SampledPlant
        The plant, with an actuator on each mass.
    omega : float
        Frequency of the disturbance [rad/s].
    drift : float
        How far the disturbance strays from its oscillator, in limits for each interval [-].
    noise : float
        Noise of the measured state, in reference amplitudes [-]. The ratio to `drift` sets how
        fast the filter follows; the state is in fact measured without noise.

    Returns
    -------
    InternalModel

    Raises
    ------
    ValueError
        If a number is not positive.
    """
    omega = positive("omega", omega, "rad/s")
    drift, noise = positive("drift", drift), positive("noise", noise)
    m = plant.B.shape[1]
    size = 4 + 2 * m
    generator = np.zeros((size + m, size + m))
    generator[:4, :4] = plant.matrix
    generator[:4, size:] = plant.into
    cancel = np.zeros((m, size))
    mean = held_mean(omega, plant.dt)
    for j in range(m):
        p, q = 4 + 2 * j, 5 + 2 * j
        generator[:4, p] = plant.into[:, j]
        generator[p, q], generator[q, p] = omega, -omega
        cancel[j, p], cancel[j, q] = -mean[0], -mean[1]
    exact = expm(generator * plant.dt)
    transition, into = exact[:size, :size], exact[:size, size:]
    measured = np.eye(4, size)
    process = np.diag([1e-12] * 4 + [drift * drift] * (2 * m))
    covariance = solve_discrete_are(transition.T, measured.T, process, noise * noise * np.eye(4))
    innovation = measured @ covariance @ measured.T + noise * noise * np.eye(4)
    correction = np.linalg.solve(innovation, measured @ covariance).T
    return InternalModel(transition=transition, into=into, correction=correction, cancel=cancel)


def _force_weight(plant: SampledPlant, weights: Weights) -> Array:
    return np.diag([weights.r1, weights.r2][-plant.B.shape[1] :])
