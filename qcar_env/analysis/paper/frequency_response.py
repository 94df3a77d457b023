"""Frequency response: the fixed points of the slow flow, and how they move (paper, eqs 28-31).

A point of the response is a steady motion ``x_i = a_i cos(omega t + theta_i)``. It is found in two
ways, by name:

averaging            fixed points of (24)-(27), stability from their Jacobian (33)-(38)
harmonic balance     periodic motions of the full equations, stability from Floquet multipliers

`response` follows one branch against any parameter with pseudo-arclength continuation, `solutions`
finds all coexisting motions at one value by starting from many places, and `fixed_points` solves
thousands of cases at once where the response is single-valued.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis import continuation
from qcar_env.analysis.harmonic_balance import DENSE, MOST_HARMONICS, HarmonicBalance, balance
from qcar_env.analysis.newton import newton
from qcar_env.analysis.paper.averaging import Form, SlowFlow, polar, two_amplitudes
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack, sweep
from qcar_env.analysis.periodic_orbit import monodromy
from qcar_env.validation import finite, known, positive, whole

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Method = Literal["averaging", "harmonic balance"]
MOST_STARTS = 100_000  # of one search, chosen here: minutes
METHODS: tuple[Method, ...] = ("averaging", "harmonic balance")


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
    def stable(self) -> NDArray[np.bool_]:
        """Whether every eigenvalue has a negative real part, (n,)."""
        return self.eigenvalues[:, 0].real < 0.0


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
    a1, theta1, a2, theta2 = polar(found.z)
    return FixedPoints(
        a1=a1,
        theta1=theta1,
        a2=a2,
        theta2=theta2,
        eigenvalues=eigenvalues(flow.jacobian(found.z)),
        converged=found.converged,
    )


def eigenvalues(matrices: Array) -> ComplexArray:
    """Return the eigenvalues of matrices (n, m, m), shape (n, m), largest real part first."""
    values = np.linalg.eigvals(matrices).astype(np.complex128)
    order = np.argsort(-values.real, axis=1, kind="stable")
    return np.take_along_axis(values, order, axis=1)


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
        z0 = newton_start(some.select([0]), form)[:, 0]
    else:
        A1, A2 = two_amplitudes("guess", guess)
        z0 = np.array([A1.real, A1.imag, A2.real, A2.imag])
    if method == "averaging":
        equations = _averaging_equations(at, form)
        scale = _scale_of(some, form)
    else:
        equations = _balance_equations(at, harmonics)
        z0 = _as_series(z0, some.dimension, harmonics)
        scale = _scale_of(some, "rotating")
    tests = {"Hopf": _hopf_test(equations)} if method == "averaging" else {}
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
    if method == "averaging":
        return _averaged_response(branch, equations, parameter)
    return _balanced_response(branch, car, parameter, harmonics)


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
    a1, theta1, a2, theta2 = polar(roots)
    here = SlowFlow(cars=one.select(np.zeros(roots.shape[1], dtype=int)), form=form)
    return FixedPoints(
        a1=a1,
        theta1=theta1,
        a2=a2,
        theta2=theta2,
        eigenvalues=eigenvalues(here.jacobian(roots)),
        converged=np.ones(roots.shape[1], dtype=bool),
    )


def newton_start(cars: ForcedCars, form: Form) -> Array:
    """Return the fixed points reached from near rest, (4, n), as a start for other solvers."""
    points = fixed_points(cars, form=form)
    return np.array(
        [
            points.a1 * np.cos(points.theta1),
            points.a1 * np.sin(points.theta1),
            points.a2 * np.cos(points.theta2),
            points.a2 * np.sin(points.theta2),
        ]
    )


def balanced_start(cars: ForcedCars) -> ComplexArray:
    """Return amplitudes (m, n) at the forcing frequency for `harmonic_balance.balance`."""
    z = newton_start(cars, "rotating")
    start = np.zeros((cars.dimension, len(cars)), dtype=np.complex128)
    start[0], start[1] = z[0] + 1j * z[1], z[2] + 1j * z[3]
    start[2:4] = 1j * cars.omega * start[:2]
    return start


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


def _balance_equations(at: Callable[[float], ForcedCars], harmonics: int) -> continuation.Equations:
    def equations(z: Array, p: float) -> HarmonicBalance:
        cars = at(p).select(np.zeros(z.shape[1], dtype=int))
        return HarmonicBalance(system=cars, harmonics=harmonics)

    return continuation.Equations(
        residual=lambda z, p: equations(z, p).residual(z),
        jacobian=lambda z, p: equations(z, p).jacobian(z),
    )


def _as_series(z: Array, dimension: int, harmonics: int) -> Array:
    """Return ``(Re A1, Im A1, Re A2, Im A2)`` as the unknowns of harmonic balance, filter at 0."""
    k = 2 * harmonics + 1
    series = np.zeros((dimension, k))
    series[0, 1], series[0, 2] = z[0], -z[1]
    series[1, 1], series[1, 2] = z[2], -z[3]
    series[2, 1], series[2, 2] = -z[1], -z[0]  # v / omega = Re(i A exp(i omega t))
    series[3, 1], series[3, 2] = -z[3], -z[2]
    return series.ravel()


def _scale_of(cars: ForcedCars, form: Form) -> float:
    """Return the largest amplitude of some cars, with a floor."""
    z = newton_start(cars, form)
    finite = z[np.isfinite(z)]
    return max(float(np.max(np.abs(finite))) if finite.size else 0.0, 1e-6)


def _hopf_test(equations: continuation.Equations) -> continuation.Test:
    """Return the product of all sums of two eigenvalues: zero where a pair is ``+- i omega``.

    Each sum is divided by the largest eigenvalue. The product also vanishes where two real
    eigenvalues are opposite; `_averaged_response` sorts those out.
    """

    def test(z: Array, p: float) -> float:
        values = np.linalg.eigvals(equations.jacobian(z[:, None], p)[0])
        size = float(np.max(np.abs(values)))
        sums = [(values[i] + values[j]) / size for i in range(len(values)) for j in range(i)]
        return float(np.prod(sums).real)

    return test


def _averaged_response(
    branch: continuation.Branch, equations: continuation.Equations, parameter: str
) -> Response:
    a1, theta1, a2, theta2 = polar(branch.z)
    n = len(branch.p)
    values = np.empty((n, 4), dtype=np.complex128)
    for index, p in enumerate(branch.p):
        z = branch.z[:, index : index + 1]
        values[index] = eigenvalues(equations.jacobian(z, float(p)))[0]
    special: list[Bifurcation] = []
    for point in branch.points:
        if point.kind == "Hopf":
            at = eigenvalues(equations.jacobian(point.z[:, None], point.p))[0]
            nearest = at[np.argmin(np.abs(at.real))]
            if abs(nearest.imag) < 1e-6 * np.max(np.abs(at)):
                continue  # two opposite real eigenvalues: no change of stability
        A1, _, A2, _ = polar(point.z[:, None])
        special.append(
            Bifurcation(kind=point.kind, value=point.p, a1=float(A1[0]), a2=float(A2[0]))
        )
    return Response(
        parameter=parameter,
        method="averaging",
        values=branch.p,
        a1=a1,
        theta1=theta1,
        a2=a2,
        theta2=theta2,
        eigenvalues=values,
        bifurcations=tuple(special),
        complete=branch.complete,
        message=f"{parameter}: {branch.message}",
    )


def _balanced_response(
    branch: continuation.Branch, car: ForcedCar, parameter: str, harmonics: int
) -> Response:
    k = 2 * harmonics + 1
    phase = 2.0 * np.pi * np.arange(DENSE) / DENSE
    angle = np.arange(1, harmonics + 1)[:, None] * phase
    series = np.empty((k, DENSE))
    series[0], series[1::2], series[2::2] = 1.0, np.cos(angle), np.sin(angle)

    def peaks(z: Array) -> tuple[Array, Array]:
        c = z.reshape(-1, k, z.shape[1])
        return tuple(np.max(np.abs(c[i].T @ series), axis=1) for i in (0, 1))  # type: ignore[return-value]

    n = len(branch.p)
    exponents = np.empty((n, 0), dtype=np.complex128)
    theta1 = theta2 = np.empty(0)
    if n:
        cars = stack(list(sweep(car, parameter, branch.p)))
        c = branch.z.reshape(cars.dimension, k, n)
        at_zero = (c[:, 0] + np.sum(c[:, 1::2], axis=1)) * cars.scale
        exponents = _exponents(cars, at_zero)
        theta1 = np.angle(c[0, 1] - 1j * c[0, 2])
        theta2 = np.angle(c[1, 1] - 1j * c[1, 2])
    a1, a2 = peaks(branch.z) if n else (np.empty(0), np.empty(0))
    special: list[Bifurcation] = []
    for point in branch.points:
        p1, p2 = peaks(point.z[:, None])
        special.append(
            Bifurcation(kind=point.kind, value=point.p, a1=float(p1[0]), a2=float(p2[0]))
        )
    return Response(
        parameter=parameter,
        method=f"harmonic balance, {harmonics} harmonics",
        values=branch.p,
        a1=a1,
        theta1=theta1,
        a2=a2,
        theta2=theta2,
        eigenvalues=exponents,
        bifurcations=tuple(special),
        complete=branch.complete,
        message=f"{parameter}: {branch.message}",
    )


def _exponents(cars: ForcedCars, state: Array) -> ComplexArray:
    multipliers = np.linalg.eigvals(monodromy(cars, state)).astype(np.complex128)
    rates: ComplexArray = (np.log(multipliers) * (cars.omega / (2.0 * np.pi))[:, None]).astype(
        np.complex128
    )
    order = np.argsort(-rates.real, axis=1, kind="stable")
    return np.take_along_axis(rates, order, axis=1)


def _bound(car: ForcedCar) -> float:
    """Return an amplitude that no steady motion of a damped car exceeds by much [m]."""
    into1 = car.h * abs(complex(car.car.mu1, car.car.mu2 * car.omega))
    damping = max(min(car.car.b1, car.car.b2), 1e-3) * car.omega
    return (into1 + abs(car.f)) / damping if into1 + abs(car.f) > 0.0 else 1.0


__all__ = [
    "METHODS",
    "Bifurcation",
    "FixedPoints",
    "Method",
    "Response",
    "balance",
    "balanced_start",
    "eigenvalues",
    "fixed_points",
    "newton_start",
    "response",
    "solutions",
]
