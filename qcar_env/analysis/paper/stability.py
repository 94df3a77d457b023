"""Stability of the averaged motion: where it is lost, maps over parameters (paper, eqs 32-40).

What the averaged statement is worth is measured with Floquet multipliers of the full equations,
see `compare_with_floquet` and `qcar_env.analysis.periodic_orbit`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.averaging import Form, SlowFlow
from qcar_env.analysis.paper.fixed_points import FixedPoints, balanced_start, fixed_points
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack
from qcar_env.analysis.paper.routh_hurwitz import CONDITIONS, RouthHurwitz, routh_hurwitz
from qcar_env.analysis.periodic_orbit import periodic_orbits
from qcar_env.validation import finite, finite_array, whole

Array = NDArray[np.float64]

MOST_SAMPLES = 1_000_000  # of a parameter, chosen here: hours


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
        return routh_hurwitz(SlowFlow(cars=cars, form=form).jacobian(points.z)), points

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
    conditions = routh_hurwitz(SlowFlow(cars=cars, form=form).jacobian(points.z))
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
