"""Pseudo-arclength continuation: follow the solutions of ``g(z, p) = 0`` round every fold.

The branch is a curve in the space of unknowns and parameter. From a point on it, a step along the
tangent predicts the next one; Newton's method corrects it in the plane normal to the tangent, so
that the parameter may turn back. H. B. Keller, in Applications of Bifurcation Theory, Academic
Press 1977, pp. 359-384; R. Seydel, Practical Bifurcation and Stability Analysis, Springer 2010,
chapter 4. Written here because no maintained Python library does it under a free licence.

Unknowns and parameter are scaled before lengths are measured; results carry their own units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from qcar_env.analysis.newton import newton
from qcar_env.validation import finite, positive, shown, whole

Array = NDArray[np.float64]
Residual = Callable[[Array, float], Array]
Test = Callable[[Array, float], float]

CORRECTIONS = 8  # Newton steps before a point is tried again with half the arc length
MOST_POINTS = 1_000_000  # of a branch, chosen here: hours
STRAIGHT = 0.9  # cosine of the angle by which the branch may turn in one step [-]
SHORTEST = 1e-7  # arc length at which the branch is given up, in scaled units [-]


@dataclass(frozen=True, kw_only=True)
class Equations:
    """``g(z, p) = 0`` with as many equations as unknowns.

    Parameters
    ----------
    residual : callable
        ``residual(z, p)`` for unknowns (m, k), column by column, and one parameter value.
    jacobian : callable
        ``jacobian(z, p)``, (k, m, m): derivative by the unknowns.
    """

    residual: Residual
    jacobian: Residual


@dataclass(frozen=True, kw_only=True)
class SpecialPoint:
    """A point of a branch at which something happens."""

    kind: str  # "fold", or the name of the test function that vanished
    p: float  # parameter
    z: Array  # (m,) unknowns


@dataclass(frozen=True, kw_only=True)
class Branch:
    """A followed branch; what was reached if it is not complete."""

    p: Array  # (n,) parameter, in the order in which the branch was followed
    z: Array  # (m, n) unknowns
    points: tuple[SpecialPoint, ...]  # folds and zeros of the test functions, in order
    complete: bool  # whether an end of the parameter's range was reached
    message: str  # how it ended; where, if the solver failed

    @property
    def folds(self) -> tuple[SpecialPoint, ...]:
        """Turning points of the parameter."""
        return tuple(each for each in self.points if each.kind == "fold")


def follow(
    equations: Equations,
    z: Array,
    p_start: float,
    p_end: float,
    *,
    p_scale: float | None = None,
    z_scale: float | None = None,
    step: float = 0.02,
    longest: float = 0.05,
    max_points: int = 4000,
    tests: Mapping[str, Test] | None = None,
) -> Branch:
    """Follow the branch through a solution, from one parameter value towards another.

    Parameters
    ----------
    equations : Equations
        The system.
    z : ndarray (m,)
        Guess of the solution at `p_start`.
    p_start, p_end : float
        Range of the parameter. The branch ends where it leaves the range, at either end: one that
        turns back may end at `p_start`.
    p_scale : float, optional
        Length of the parameter's axis; the width of the range by default.
    z_scale : float, optional
        Length of the unknowns' axes; the largest unknown at `p_start` by default.
    step : float, optional
        First arc length, in scaled units [-].
    longest : float, optional
        Largest arc length [-].
    max_points : int, optional
        Points at most.
    tests : mapping of str to callable, optional
        Functions of (z, p) whose zeros along the branch are wanted, by name.

    Returns
    -------
    Branch
        Never raises for a branch that is lost: `complete` is false then and the message says
        where.

    Raises
    ------
    ValueError
        If the range is empty or a number is out of range.
    """
    p_start, p_end = finite("p_start", p_start), finite("p_end", p_end)
    step, longest = positive("step", step), positive("longest", longest)
    max_points = whole("max_points", max_points, 2, MOST_POINTS)
    if p_start == p_end:
        raise ValueError(f"parameter range must not be empty, got {p_start:g} at both ends")
    z0 = np.array(z)
    if z0.ndim != 1 or not z0.size or z0.dtype.kind not in "iuf":
        raise ValueError(f"z must be the unknowns (m,) in a row, got {shown(z)}; give a guess")
    first = newton(
        lambda c: equations.residual(c, p_start),
        lambda c: equations.jacobian(c, p_start),
        z0[:, None],
    )
    if not first.converged[0]:
        return Branch(
            p=np.empty(0),
            z=np.empty((len(z0), 0)),
            points=(),
            complete=False,
            message=f"no solution found at the start, p = {p_start:g} "
            f"(residual {first.residual[0]:.2g}); give another guess",
        )
    size = float(np.max(np.abs(first.z)))
    scale = _Scaled(
        equations=equations,
        p_scale=positive("p_scale", abs(p_end - p_start) if p_scale is None else p_scale),
        z_scale=positive("z_scale", (size if size > 0.0 else 1.0) if z_scale is None else z_scale),
        low=min(p_start, p_end),
        high=max(p_start, p_end),
    )
    point = np.append(first.z[:, 0] / scale.z_scale, p_start / scale.p_scale)
    toward = np.zeros_like(point)
    toward[-1] = np.sign(p_end - p_start)
    tangent = scale.tangent(point, toward)
    if tangent is None:
        return _branch(scale, [point], [], complete=False, how="singular at the start, p = ")
    if tangent[-1] * toward[-1] < 0.0:
        tangent = -tangent
    followed = [point]
    special: list[SpecialPoint] = []
    watched = dict(tests or {})
    length = step
    while len(followed) < max_points:
        ahead = point + length * tangent
        landing = scale.landing(point, ahead)  # at the end of the range, if the step crosses it
        if landing is None:
            found = scale.correct(ahead, tangent)
        else:
            found = scale.correct(landing, np.abs(toward))
        new_tangent = None if found is None else scale.tangent(found[0], tangent)
        bent = new_tangent is not None and float(new_tangent @ tangent) < STRAIGHT
        if found is None or (bent and length > 100.0 * SHORTEST):
            length /= 2.0
            if length < SHORTEST:
                return _branch(
                    scale, followed, special, complete=False, how="did not converge beyond p = "
                )
            continue
        new, corrections = found
        if new_tangent is None:
            return _branch(
                scale, followed, special, complete=False, how="singular Jacobian beyond p = "
            )
        special += _between(scale, point, tangent, new, new_tangent, watched)
        followed.append(new)
        if landing is not None:
            return _branch(scale, followed, special, complete=True, how="reached p = ")
        point, tangent = new, new_tangent
        if corrections <= 3:
            length = min(1.4 * length, longest)
        elif corrections >= 6:
            length /= 1.5
    return _branch(scale, followed, special, complete=False, how="points ran out at p = ")


@dataclass(frozen=True, kw_only=True)
class _Scaled:
    """The system in scaled unknowns ``(z / z_scale, p / p_scale)``.

    Nothing is evaluated outside the parameter's range: there may be no system there.
    """

    equations: Equations
    p_scale: float
    z_scale: float
    low: float  # range of the parameter
    high: float

    def parameter(self, point: Array) -> float:
        return min(max(float(point[-1] * self.p_scale), self.low), self.high)

    def inside(self, point: Array) -> bool:
        slack = 1e-12 * (self.high - self.low)
        return self.low - slack <= point[-1] * self.p_scale <= self.high + slack

    def landing(self, point: Array, ahead: Array) -> Array | None:
        """Return where the line from `point` to `ahead` meets an end of the range, if it does."""
        if self.low < ahead[-1] * self.p_scale < self.high:
            return None
        edge = (self.low if ahead[-1] < point[-1] else self.high) / self.p_scale
        part = (edge - point[-1]) / (ahead[-1] - point[-1])
        there = point + part * (ahead - point)
        there[-1] = edge
        return there

    def residual(self, point: Array) -> Array:
        z = point[:-1] * self.z_scale
        return self.equations.residual(z[:, None], self.parameter(point))[:, 0]

    def derivative(self, point: Array) -> Array:
        """Return the derivative by unknowns and parameter, (m, m + 1)."""
        z, p = point[:-1] * self.z_scale, self.parameter(point)
        by_z = self.equations.jacobian(z[:, None], p)[0] * self.z_scale
        shift = np.cbrt(np.finfo(float).eps) * max(abs(point[-1]), 1e-2)
        step = shift * self.p_scale

        def at(multiple: float) -> Array:
            return self.equations.residual(z[:, None], p + multiple * step)[:, 0]

        if p - step < self.low:
            by_p = (-3.0 * at(0.0) + 4.0 * at(1.0) - at(2.0)) / (2.0 * shift)
        elif p + step > self.high:
            by_p = (3.0 * at(0.0) - 4.0 * at(-1.0) + at(-2.0)) / (2.0 * shift)
        else:
            by_p = (at(1.0) - at(-1.0)) / (2.0 * shift)
        return np.column_stack([by_z, by_p])

    def tangent(self, point: Array, along: Array) -> Array | None:
        """Return the unit tangent on the side of `along`; None where there is no single one."""
        rows = self.derivative(point)
        rows = rows / np.maximum(np.max(np.abs(rows), axis=1, keepdims=True), 1e-300)
        if not np.all(np.isfinite(rows)):
            return None
        bordered = np.vstack([rows, along])
        right = np.zeros(len(point))
        right[-1] = 1.0
        try:
            tangent = np.linalg.solve(bordered, right)
        except np.linalg.LinAlgError:
            null = np.linalg.svd(rows)[2][-1]
            tangent = null if null @ along >= 0.0 else -null
        size = np.linalg.norm(tangent)
        return tangent / size if np.isfinite(size) and size > 0.0 else None

    def correct(self, guess: Array, normal: Array) -> tuple[Array, int] | None:
        """Newton's method in the plane through `guess` with the given normal."""
        point = guess.copy()
        for count in range(1, CORRECTIONS + 1):
            rows = np.vstack([self.derivative(point), normal])
            right = np.append(self.residual(point), normal @ (point - guess))
            if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(right))):
                return None
            try:
                change = np.linalg.solve(rows, -right)
            except np.linalg.LinAlgError:
                return None
            point = point + change
            if not self.inside(point):
                return None
            if np.max(np.abs(change)) <= 1e-10 * max(1.0, float(np.max(np.abs(point)))):
                return point, count
        return None

    def special(self, kind: str, point: Array) -> SpecialPoint:
        return SpecialPoint(kind=kind, p=self.parameter(point), z=point[:-1] * self.z_scale)


def _between(
    scale: _Scaled,
    point: Array,
    tangent: Array,
    new: Array,
    new_tangent: Array,
    tests: Mapping[str, Test],
) -> list[SpecialPoint]:
    """Return what happens between two points, in the order of arc length."""
    span = float((new - point) @ tangent)
    found: list[tuple[float, SpecialPoint]] = []

    def on_branch(s: float) -> Array:
        if s <= 0.0 or s >= span:
            return point if s <= 0.0 else new
        part = s / span
        guess = point + s * tangent + part * part * (new - point - span * tangent)
        corrected = scale.correct(guess, tangent)
        return guess if corrected is None else corrected[0]

    def zero(function: Callable[[Array], float]) -> float:
        return float(brentq(lambda s: function(on_branch(s)), 0.0, span, xtol=1e-13, rtol=1e-12))  # type: ignore[arg-type]

    def turning(at: Array) -> float:
        direction = scale.tangent(at, tangent)
        return float(tangent[-1] if direction is None else direction[-1])

    if tangent[-1] * new_tangent[-1] < 0.0:
        s = zero(turning)
        found.append((s, scale.special("fold", on_branch(s))))
    for name, test in tests.items():

        def value(at: Array, test: Test = test) -> float:
            return test(at[:-1] * scale.z_scale, scale.parameter(at))

        if value(point) * value(new) < 0.0:
            s = zero(value)
            found.append((s, scale.special(name, on_branch(s))))
    return [each for _, each in sorted(found, key=lambda pair: pair[0])]


def _branch(
    scale: _Scaled, points: list[Array], special: list[SpecialPoint], *, complete: bool, how: str
) -> Branch:
    columns = np.array(points).T
    p = np.clip(columns[-1] * scale.p_scale, scale.low, scale.high)
    return Branch(
        p=p,
        z=columns[:-1] * scale.z_scale,
        points=tuple(special),
        complete=complete,
        message=f"{how}{p[-1]:g} after {len(p)} points",
    )
