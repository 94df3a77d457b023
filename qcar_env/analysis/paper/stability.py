"""Stability of the averaged motion: Jacobian, Routh-Hurwitz conditions, maps (paper, eqs 32-40).

A small disturbance of a fixed point of (24)-(27) obeys a linear system with the Jacobian J of
(37). Its eigenvalues are the roots of

    lambda^4 + Gamma1 lambda^3 + Gamma2 lambda^2 + Gamma3 lambda + Gamma4 = 0                (39)

and all of them (the paper writes "both") lie in the left half-plane if and only if

    Gamma1 > 0    Gamma1 Gamma2 - Gamma3 > 0
    Gamma3 (Gamma1 Gamma2 - Gamma3) - Gamma1^2 Gamma4 > 0    Gamma4 > 0                      (40)

A loss through ``Gamma4 = 0`` is a fold or another real eigenvalue at zero; one through the third
condition a pair of imaginary eigenvalues (Hopf: the amplitudes begin to beat).

What the averaged statement is worth is measured with Floquet multipliers of the full equations,
see `compare_with_floquet` and `qcar_env.analysis.periodic_orbit`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.averaging import Form, SlowFlow
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack
from qcar_env.analysis.paper.frequency_response import FixedPoints, balanced_start, fixed_points
from qcar_env.analysis.periodic_orbit import periodic_orbits
from qcar_env.control.cnvc import CNVC
from qcar_env.control.passive import Passive
from qcar_env.validation import finite, finite_array, shown, whole

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MOST_SAMPLES = 1_000_000  # of a parameter, chosen here: hours
CONDITIONS = (
    "Gamma1 > 0",
    "Gamma1 Gamma2 - Gamma3 > 0",
    "Gamma3 (Gamma1 Gamma2 - Gamma3) - Gamma1^2 Gamma4 > 0",
    "Gamma4 > 0",
)


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


@dataclass(frozen=True, kw_only=True)
class RouthHurwitz:
    """The four conditions (40), one by one, for n matrices."""

    gammas: Array  # (4, n) Gamma1 ... Gamma4 [1/s, 1/s^2, 1/s^3, 1/s^4]
    values: Array  # (4, n) left sides of the conditions, in the order of `CONDITIONS`
    margins: Array  # (4, n) the same, each over the sum of its terms' sizes [-]; -1 to 1

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Which condition holds, (4, n)."""
        return self.values > 0.0

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether all hold, (n,)."""
        return np.all(self.holds, axis=0)

    def failing(self, index: int = 0) -> tuple[str, ...]:
        """Return the conditions that matrix `index` breaks, by name."""
        return tuple(
            name for name, holds in zip(CONDITIONS, self.holds[:, index], strict=True) if not holds
        )


def characteristic_polynomial(matrices: Array) -> Array:
    """Return Gamma1 ... Gamma4 of (39) for matrices (n, 4, 4), shape (4, n).

    Faddeev and LeVerrier's recursion: exact in the entries, without eigenvalues.

    Raises
    ------
    ValueError
        If the matrices have another shape.
    """
    if np.shape(matrices)[1:] != (4, 4):
        raise ValueError(
            f"matrices must have shape (n, 4, 4), got {shown(np.shape(matrices))}; "
            "give one or more of them"
        )
    identity = np.eye(4)
    gammas = np.empty((4, matrices.shape[0]))
    helper = np.broadcast_to(identity, matrices.shape)
    for k in range(1, 5):
        product = matrices @ helper
        gammas[k - 1] = -np.trace(product, axis1=1, axis2=2) / k
        helper = product + gammas[k - 1][:, None, None] * identity
    return gammas


def routh_hurwitz(matrices: Array) -> RouthHurwitz:
    """Evaluate the conditions (40) for matrices (n, 4, 4)."""
    g1, g2, g3, g4 = gammas = characteristic_polynomial(matrices)
    inner = g1 * g2 - g3
    values = np.array([g1, inner, g3 * inner - g1 * g1 * g4, g4])  # (40)
    # the size of each condition's terms, from the magnitudes of the eigenvalues
    size = np.array([_sums_of_products(np.abs(np.linalg.eigvals(m))) for m in matrices]).T
    scale = np.array(
        [
            size[0],
            size[0] * size[1] + size[2],
            size[2] * (size[0] * size[1] + size[2]) + size[0] * size[0] * size[3],
            size[3],
        ]
    )
    margins = values / np.maximum(scale, 1e-300)
    return RouthHurwitz(gammas=gammas, values=values, margins=margins)


@dataclass(frozen=True, kw_only=True)
class StabilityLoss:
    """Where a branch first becomes unstable as a parameter moves."""

    parameter: str
    value: float  # of the parameter
    condition: str  # which of `CONDITIONS` fails there
    kind: str  # "real eigenvalue" or "Hopf"
    a1: float  # [m]
    a2: float  # [m]


def first_loss(
    car: ForcedCar,
    parameter: str,
    start: float,
    end: float,
    *,
    form: Form = "frozen",
    samples: int = 101,
) -> StabilityLoss | None:
    """Return where a Routh-Hurwitz condition first fails between two values of a parameter.

    Parameters
    ----------
    car : ForcedCar
        The car.
    parameter : str
        Which parameter moves (a gain, for example), see `ForcedCar.vary`.
    start, end : float
        From where to where; the motion at `start` should be stable.
    form : {"frozen", "natural", "rotating"}
        Form of averaging.
    samples : int, optional
        Values looked at, before the crossing is refined by root finding.

    Returns
    -------
    StabilityLoss or None
        ``None`` if every value is stable.

    Raises
    ------
    ValueError
        If the parameter is unknown or a number out of range.

    Notes
    -----
    Meant for a response without folds: the fixed point nearest to rest is taken at each value.
    On a folded response follow the branch with `frequency_response.response`.
    """
    start, end = finite("start", start), finite("end", end)
    values = np.linspace(start, end, whole("samples", samples, 2, MOST_SAMPLES))

    def conditions(p: float) -> tuple[RouthHurwitz, FixedPoints]:
        cars = stack([car.vary(parameter, p)])
        points = fixed_points(cars, form=form)
        return routh_hurwitz(_cartesian_jacobian(cars, points, form)), points

    before, _ = conditions(float(values[0]))
    for left, right in itertools.pairwise(values):
        after, points = conditions(float(right))
        failing = np.flatnonzero(~after.holds[:, 0])
        if failing.size:
            crossings: list[tuple[float, int]] = []
            for index in failing:
                if not before.holds[index, 0]:
                    crossings.append((float(left), int(index)))
                    continue

                def margin(p: float, index: int = int(index)) -> float:
                    return float(conditions(p)[0].values[index, 0])

                root: float = brentq(margin, left, right, xtol=1e-10)  # type: ignore[assignment]
                crossings.append((root, int(index)))
            at, which = min(crossings, key=lambda pair: abs(pair[0] - start))
            _, points = conditions(at)
            values_at = points.eigenvalues[0]
            nearest = values_at[np.argmin(np.abs(values_at.real))]
            real = abs(nearest.imag) < 1e-6 * float(np.max(np.abs(values_at)))
            return StabilityLoss(
                parameter=parameter,
                value=at,
                condition=CONDITIONS[which],
                kind="real eigenvalue" if real else "Hopf",
                a1=float(points.a1[0]),
                a2=float(points.a2[0]),
            )
        before = after
    return None


@dataclass(frozen=True, kw_only=True)
class StabilityMap:
    """Stability over two parameters."""

    x: str  # name of the parameter along the columns
    y: str  # name of the parameter along the rows
    x_values: Array  # (nx,)
    y_values: Array  # (ny,)
    growth: Array  # (ny, nx) largest real part of an eigenvalue [1/s]; NaN where none was found
    failing: NDArray[np.int_]  # (ny, nx) index of the first failing condition; -1 if none
    a1: Array  # (ny, nx) [m]
    a2: Array  # (ny, nx) [m]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every eigenvalue has a negative real part, (ny, nx)."""
        return self.growth < 0.0


def stability_map(
    car: ForcedCar,
    x: str,
    x_values: ArrayLike,
    y: str,
    y_values: ArrayLike,
    *,
    form: Form = "frozen",
) -> StabilityMap:
    """Compute the averaged stability over a grid of two parameters, all cases at once.

    Parameters
    ----------
    car : ForcedCar
        The car.
    x, y : str
        Names of the parameters, see `ForcedCar.vary`; different ones.
    x_values : array_like (nx,)
        Values of the first.
    y_values : array_like (ny,)
        Values of the second.
    form : {"frozen", "natural", "rotating"}
        Form of averaging.

    Returns
    -------
    StabilityMap

    Raises
    ------
    ValueError
        If both names are the same, or a value is out of range.
    """
    if x == y:
        raise ValueError(f"a map needs two different parameters, got {x!r} twice")
    columns = finite_array(f"values of {x}", x_values).ravel()
    rows = finite_array(f"values of {y}", y_values).ravel()
    cars = stack([car.vary(y, float(b)).vary(x, float(a)) for b in rows for a in columns])
    points = fixed_points(cars, form=form)
    conditions = routh_hurwitz(_cartesian_jacobian(cars, points, form))
    shape = (len(rows), len(columns))
    failing = np.where(conditions.stable, -1, np.argmin(conditions.holds, axis=0))
    growth = np.where(points.converged, points.eigenvalues[:, 0].real, np.nan)
    return StabilityMap(
        x=x,
        y=y,
        x_values=columns,
        y_values=rows,
        growth=growth.reshape(shape),
        failing=failing.reshape(shape),
        a1=np.where(points.converged, points.a1, np.nan).reshape(shape),
        a2=np.where(points.converged, points.a2, np.nan).reshape(shape),
    )


@dataclass(frozen=True, kw_only=True)
class FloquetComparison:
    """Growth rates from averaging beside those of the full equations, for n cars."""

    averaged: Array  # (n,) largest real part of an eigenvalue of the slow flow [1/s]
    exact: Array  # (n,) largest real part of a Floquet exponent [1/s]; NaN if no orbit was found
    multiplier: Array  # (n,) largest magnitude of a Floquet multiplier [-]

    @property
    def agree(self) -> NDArray[np.bool_]:
        """Whether both call the motion stable or both unstable, (n,)."""
        return (self.averaged < 0.0) == (self.exact < 0.0)


def compare_with_floquet(
    cars: ForcedCars, *, form: Form = "frozen", harmonics: int = 7
) -> FloquetComparison:
    """Hold the averaged stability against the Floquet multipliers of the full equations.

    Parameters
    ----------
    cars : ForcedCars
        The cars, (n,).
    form : {"frozen", "natural", "rotating"}
        Form of averaging.
    harmonics : int, optional
        Harmonics of the guess from which the periodic orbit is found.
    """
    points = fixed_points(cars, form=form)
    guess = balance(cars, harmonics=harmonics, start=balanced_start(cars))
    orbits = periodic_orbits(cars, guess.states(np.zeros(1))[:, :, 0])
    return FloquetComparison(
        averaged=points.eigenvalues[:, 0].real,
        exact=orbits.exponents[:, 0].real,
        multiplier=np.abs(orbits.multipliers[:, 0]),
    )


def contraction_margin(car: ForcedCar) -> float:
    """Return ``b1 b2 / 2 - (|kappa| + Re kappa)`` [1/s^2]; positive: one stable motion, no fold.

    With ``kappa = (E2 omega2 - i E1)(b2 omega1 - i E3) / (4 omega1 omega2)``, frequencies frozen
    at `omega`. The condition is sufficient, for no control, CNVC and LNVC at any gain: the slow
    flow then shrinks all distances in a weighted norm. Derived here; the weights are those of a
    diagonal Lyapunov function.
    """
    c = car.car
    w = car.omega
    kappa = (c.E2 * w - 1j * c.E1) * (c.b2 * w - 1j * c.E3) / (4.0 * w * w)
    return c.b1 * c.b2 / 2.0 - (abs(kappa) + kappa.real)


def _cartesian_jacobian(cars: ForcedCars, points: FixedPoints, form: Form) -> Array:
    A1, A2 = points.a1 * np.exp(1j * points.theta1), points.a2 * np.exp(1j * points.theta2)
    return SlowFlow(cars=cars, form=form).jacobian(np.array([A1.real, A1.imag, A2.real, A2.imag]))


def _sums_of_products(values: Array) -> list[float]:
    """Return the elementary symmetric sums of four numbers."""
    return [float(c) for c in np.abs(np.poly(-values))[1:]]
