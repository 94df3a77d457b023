"""Frequency response: a steady motion followed against any parameter, round every fold.

A point of the response is a steady motion ``x_i = a_i cos(omega t + theta_i)``. It is found in two
ways, by name, and the branch is followed with pseudo-arclength continuation:

averaging            fixed points of (24)-(27), stability from their Jacobian (33)-(38)
harmonic balance     periodic motions of the full equations, stability from Floquet multipliers
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis import continuation
from qcar_env.analysis.harmonic_balance import MOST_HARMONICS, HarmonicBalance
from qcar_env.analysis.paper.averaging import Form, SlowFlow, two_amplitudes
from qcar_env.analysis.paper.fixed_points import (
    FixedPoints,
    balanced_start,
    eigenvalues,
    fixed_points,
    points_at,
)
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack, sweep
from qcar_env.analysis.periodic_orbit import monodromy
from qcar_env.validation import finite, known, whole

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Method = Literal["averaging", "harmonic balance"]
METHODS: tuple[Method, ...] = ("averaging", "harmonic balance")


@dataclass(frozen=True, kw_only=True)
class Bifurcation:
    """A point of a response curve at which the number or the stability of motions changes."""

    kind: str  # "fold", or "Hopf" (a pair of eigenvalues crosses the imaginary axis)
    value: float  # of the parameter
    a1: float  # [m]
    a2: float  # [m]


@dataclass(frozen=True, kw_only=True)
class Response:
    """A branch of steady motions followed against one parameter."""

    parameter: str  # name of the parameter that moves
    method: str  # how the points were found
    values: Array  # (n,) of the parameter, in the order followed
    a1: Array  # (n,) amplitude of the wheel [m]; harmonic balance: largest displacement
    theta1: Array  # (n,) phase at the forcing frequency [rad]
    a2: Array  # (n,) of the body [m]
    theta2: Array  # (n,) [rad]
    eigenvalues: ComplexArray  # (n, m) or Floquet exponents [1/s], largest real part first
    bifurcations: tuple[Bifurcation, ...]  # in the order followed
    complete: bool  # whether the end of the range was reached
    message: str  # how it ended; at which value, if the solver did not converge

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every eigenvalue has a negative real part, (n,)."""
        return self.eigenvalues[:, 0].real < 0.0

    @property
    def folds(self) -> tuple[Bifurcation, ...]:
        """The turning points alone."""
        return tuple(each for each in self.bifurcations if each.kind == "fold")


def response(
    car: ForcedCar,
    parameter: str,
    start: float,
    end: float,
    *,
    method: Method = "averaging",
    form: Form = "frozen",
    harmonics: int = 7,
    guess: tuple[complex, complex] | None = None,
    longest: float = 0.05,
    max_points: int = 4000,
) -> Response:
    """Follow the steady motion against one parameter, round every fold.

    Parameters
    ----------
    car : ForcedCar
        The car; its own value of the parameter does not matter.
    parameter : str
        Any name that `ForcedCar.vary` knows.
    start, end : float
        Range of the parameter.
    method : {"averaging", "harmonic balance"}
        How a motion is found.
    form : {"frozen", "natural", "rotating"}
        Form of averaging.
    harmonics : int, optional
        Highest harmonic of harmonic balance.
    guess : tuple of complex, optional
        ``(A1, A2)`` near the motion at `start` [m], to choose between coexisting ones.
    longest : float, optional
        Largest step, in widths of the range and largest amplitudes [-].
    max_points : int, optional
        Points at most.

    Returns
    -------
    Response
        What was reached, with `complete` and `message`, if the solver lost the branch.

    Raises
    ------
    ValueError
        If the parameter is unknown, or if either end of the range is no car (for example a
        detuning that brings a natural frequency to zero); if an argument is out of range.
    """
    known("method", method, METHODS)
    start, end = finite("start", start), finite("end", end)
    harmonics = whole("harmonics", harmonics, most=MOST_HARMONICS)
    some = stack(list(sweep(car, parameter, np.linspace(start, end, 9))))
    at = _at(car, parameter)
    if guess is None:
        z0 = fixed_points(some.select([0]), form=form).z[:, 0]
    else:
        A1, A2 = two_amplitudes("guess", guess)
        z0 = np.array([A1.real, A1.imag, A2.real, A2.imag])
    if method == "averaging":
        equations, name = _averaging_equations(at, form), "averaging"
        scale = _scale_of(some, form)
        tests = {"Hopf": _hopf_test(equations)}
    else:
        equations, name = _balance_equations(at, harmonics), f"{method}, {harmonics} harmonics"
        amplitudes = balanced_start(at(start), z0[:, None])
        z0 = _balance(at(start), 1, harmonics).unknowns(amplitudes)[:, 0]
        scale = _scale_of(some, "rotating")
        tests = {}
    branch = continuation.follow(
        equations,
        z0,
        start,
        end,
        z_scale=scale,
        longest=longest,
        max_points=max_points,
        tests=tests,
    )
    found = _motions(car, parameter, branch, method, form, harmonics)
    special: list[Bifurcation] = []
    for point in branch.points:
        if point.kind == "Hopf" and _is_real(equations, point):
            continue  # two opposite real eigenvalues: no change of stability
        there = dataclasses.replace(branch, p=np.array([point.p]), z=point.z[:, None])
        at_point = _motions(car, parameter, there, method, form, harmonics)
        a1, a2 = float(at_point.a1[0]), float(at_point.a2[0])
        special.append(Bifurcation(kind=point.kind, value=point.p, a1=a1, a2=a2))
    return Response(
        parameter=parameter,
        method=name,
        values=branch.p,
        a1=found.a1,
        theta1=found.theta1,
        a2=found.a2,
        theta2=found.theta2,
        eigenvalues=found.eigenvalues,
        bifurcations=tuple(special),
        complete=branch.complete,
        message=f"{parameter}: {branch.message}",
    )


def _at(car: ForcedCar, parameter: str) -> Callable[[float], ForcedCars]:
    """Return a function that gives the car at a parameter value, and remembers the last one."""
    last: dict[float, ForcedCars] = {}

    def at(p: float) -> ForcedCars:
        if p not in last:
            last.clear()
            last[p] = stack([car.vary(parameter, p)])
        return last[p]

    return at


def _averaging_equations(at: Callable[[float], ForcedCars], form: Form) -> continuation.Equations:
    def flow(z: Array, p: float) -> SlowFlow:
        return SlowFlow(cars=at(p).select(np.zeros(z.shape[1], dtype=int)), form=form)

    return continuation.Equations(
        residual=lambda z, p: flow(z, p).flow(z),
        jacobian=lambda z, p: flow(z, p).jacobian(z),
    )


def _balance(cars: ForcedCars, n: int, harmonics: int) -> HarmonicBalance:
    """Return the equations of one car for n motions."""
    return HarmonicBalance(system=cars.select(np.zeros(n, dtype=int)), harmonics=harmonics)


def _balance_equations(at: Callable[[float], ForcedCars], harmonics: int) -> continuation.Equations:
    return continuation.Equations(
        residual=lambda z, p: _balance(at(p), z.shape[1], harmonics).residual(z),
        jacobian=lambda z, p: _balance(at(p), z.shape[1], harmonics).jacobian(z),
    )


def _scale_of(cars: ForcedCars, form: Form) -> float:
    """Return the largest amplitude of some cars, with a floor."""
    z = fixed_points(cars, form=form).z
    finite = z[np.isfinite(z)]
    return max(float(np.max(np.abs(finite))) if finite.size else 0.0, 1e-6)


def _hopf_test(equations: continuation.Equations) -> continuation.Test:
    """Return the product of all sums of two eigenvalues: zero where a pair is ``+- i omega``.

    Each sum is divided by the largest eigenvalue. The product also vanishes where two real
    eigenvalues are opposite; `_is_real` sorts those out.
    """

    def test(z: Array, p: float) -> float:
        values = np.linalg.eigvals(equations.jacobian(z[:, None], p)[0])
        size = float(np.max(np.abs(values)))
        sums = [(values[i] + values[j]) / size for i in range(len(values)) for j in range(i)]
        return float(np.prod(sums).real)

    return test


def _is_real(equations: continuation.Equations, point: continuation.SpecialPoint) -> bool:
    """Return whether the eigenvalue nearest to the imaginary axis is real."""
    at = eigenvalues(equations.jacobian(point.z[:, None], point.p))[0]
    nearest = at[np.argmin(np.abs(at.real))]
    return bool(abs(nearest.imag) < 1e-6 * np.max(np.abs(at)))


def _motions(
    car: ForcedCar, parameter: str, branch: continuation.Branch, method: str, form: Form, h: int
) -> FixedPoints:
    """Return the motions of a branch; of harmonic balance with their Floquet exponents."""
    if not branch.p.size:
        none, no_values = np.empty(0), np.empty((0, 4), dtype=np.complex128)
        return FixedPoints(
            a1=none, theta1=none, a2=none, theta2=none, eigenvalues=no_values, converged=none > 0.0
        )
    cars, found = stack(list(sweep(car, parameter, branch.p))), np.ones(len(branch.p), dtype=bool)
    if method == "averaging":
        return points_at(SlowFlow(cars=cars, form=form), branch.z, found)
    balanced = HarmonicBalance(system=cars, harmonics=h).motions(branch.z, found)
    (a1, a2), (A1, A2) = balanced.peaks[:2], balanced.amplitude()[:2]
    return FixedPoints(
        a1=a1,
        theta1=np.angle(A1),
        a2=a2,
        theta2=np.angle(A2),
        eigenvalues=_exponents(cars, balanced.states(np.zeros(1))[:, :, 0]),
        converged=found,
    )


def _exponents(cars: ForcedCars, state: Array) -> ComplexArray:
    multipliers = np.linalg.eigvals(monodromy(cars, state)).astype(np.complex128)
    rates: ComplexArray = (np.log(multipliers) * (cars.omega / (2.0 * np.pi))[:, None]).astype(
        np.complex128
    )
    order = np.argsort(-rates.real, axis=1, kind="stable")
    return np.take_along_axis(rates, order, axis=1)
