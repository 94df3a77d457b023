"""Steady motions ``x_i = a_i cos(omega t + theta_i)``: the fixed points of the slow flow (28)-(31).

`fixed_points` solves for thousands of cars at once where the motion is single-valued, `solutions`
finds all coexisting motions of one car by starting from many places. Their stability is that of the
Jacobian (33)-(38).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.newton import newton
from qcar_env.analysis.paper.averaging import Form, SlowFlow, polar
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack
from qcar_env.validation import positive, whole

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MOST_STARTS = 100_000  # of one search, chosen here: minutes


@dataclass(frozen=True, kw_only=True)
class FixedPoints:
    """Steady motions of n cars, one each, from the slow flow."""

    a1: Array  # (n,) amplitude of the wheel [m]
    theta1: Array  # (n,) its phase [rad]
    a2: Array  # (n,) amplitude of the body [m]
    theta2: Array  # (n,) its phase [rad]
    eigenvalues: ComplexArray  # (n, 4) of the Jacobian [1/s], largest real part first
    converged: NDArray[np.bool_]  # (n,)

    @property
    def z(self) -> Array:
        """``(Re A1, Im A1, Re A2, Im A2)`` with ``A = a exp(i theta)``, (4, n) [m]."""
        one, two = self.theta1, self.theta2
        return np.array(
            [
                self.a1 * np.cos(one),
                self.a1 * np.sin(one),
                self.a2 * np.cos(two),
                self.a2 * np.sin(two),
            ]
        )

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every eigenvalue has a negative real part, (n,)."""
        return self.eigenvalues[:, 0].real < 0.0


def fixed_points(
    cars: ForcedCars,
    *,
    form: Form = "frozen",
    printed: bool = False,
    start: Array | None = None,
) -> FixedPoints:
    """Solve (28)-(31) for many cars at once.

    Parameters
    ----------
    cars : ForcedCars
        The cars, (n,).
    form, printed
        See `qcar_env.analysis.paper.averaging.SlowFlow`.
    start : ndarray (4, n), optional
        Where to start, ``(Re A1, Im A1, Re A2, Im A2)`` [m]; near rest by default.

    Returns
    -------
    FixedPoints
        One motion for each car; where several coexist, the one that Newton's method reaches from
        the start (see `solutions`).
    """
    flow = SlowFlow(cars=cars, form=form, printed=printed)
    z = np.full((4, len(cars)), 1e-2) if start is None else start
    found = newton(flow.flow, flow.jacobian, z)
    return points_at(flow, found.z, found.converged)


def points_at(flow: SlowFlow, z: Array, converged: NDArray[np.bool_]) -> FixedPoints:
    """Return fixed points `z` (4, n) that are known, with their eigenvalues."""
    a1, theta1, a2, theta2 = polar(z)
    return FixedPoints(
        a1=a1,
        theta1=theta1,
        a2=a2,
        theta2=theta2,
        eigenvalues=eigenvalues(flow.jacobian(z)),
        converged=converged,
    )


def eigenvalues(matrices: Array) -> ComplexArray:
    """Return the eigenvalues of matrices (n, m, m), shape (n, m), largest real part first."""
    values = np.linalg.eigvals(matrices).astype(np.complex128)
    order = np.argsort(-values.real, axis=1, kind="stable")
    return np.take_along_axis(values, order, axis=1)


def solutions(
    car: ForcedCar,
    rng: np.random.Generator,
    *,
    form: Form = "frozen",
    starts: int = 200,
    largest: float | None = None,
) -> FixedPoints:
    """Find all coexisting steady motions of one car by starting from many places.

    Parameters
    ----------
    car : ForcedCar
        The car.
    rng : numpy.random.Generator
        Where the starts come from.
    form : {"frozen", "natural", "rotating"}
        Form of averaging.
    starts : int, optional
        How many: uniform in phase, from 0 to `largest` in amplitude.
    largest : float, optional
        Largest amplitude to start from [m]; by default twice the amplitude at which the static
        forcing alone would balance the damping, which no steady motion exceeds.

    Returns
    -------
    FixedPoints
        The different ones that were found, smallest `a2` first. That there are no others is likely
        for many starts, not proved.

    Raises
    ------
    ValueError
        If `starts` or `largest` is out of range.
    """
    count = whole("starts", starts, most=MOST_STARTS)
    one = stack([car])
    cars = one.select(np.zeros(count, dtype=int))
    flow = SlowFlow(cars=cars, form=form)
    bound = 2.0 * _bound(car) if largest is None else positive("largest", largest, "m")
    radius = bound * rng.random((2, count))
    angle = 2.0 * np.pi * rng.random((2, count))
    A = radius * np.exp(1j * angle)
    z = np.array([A[0].real, A[0].imag, A[1].real, A[1].imag])
    found = newton(flow.flow, flow.jacobian, z)
    different: list[Array] = []
    for column in found.z.T[found.converged]:
        size = max(float(np.max(np.abs(column))), 1e-9)
        if all(np.max(np.abs(column - other)) > 1e-6 * size for other in different):
            different.append(column)
    different.sort(key=lambda c: float(np.hypot(c[2], c[3])))
    roots = np.array(different).T.reshape(4, -1)
    here = SlowFlow(cars=one.select(np.zeros(roots.shape[1], dtype=int)), form=form)
    return points_at(here, roots, np.ones(roots.shape[1], dtype=bool))


def balanced_start(cars: ForcedCars, z: Array | None = None) -> ComplexArray:
    """Return amplitudes (m, n) at the forcing frequency for `harmonic_balance.balance`.

    They are those of `z` (4, n), see `FixedPoints.z`, or of the fixed points in rotating form; of a
    filter 0.
    """
    z = fixed_points(cars, form="rotating").z if z is None else z
    start = np.zeros((cars.dimension, len(cars)), dtype=np.complex128)
    start[0], start[1] = z[0] + 1j * z[1], z[2] + 1j * z[3]
    start[2:4] = 1j * cars.omega * start[:2]
    return start


def _bound(car: ForcedCar) -> float:
    """Return an amplitude that no steady motion of a damped car exceeds by much [m]."""
    into1 = car.h * abs(complex(car.car.mu1, car.car.mu2 * car.omega))
    damping = max(min(car.car.b1, car.car.b2), 1e-3) * car.omega
    return (into1 + abs(car.f)) / damping if into1 + abs(car.f) > 0.0 else 1.0
