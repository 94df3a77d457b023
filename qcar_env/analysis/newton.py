"""Newton's method with a line search, and derivatives, for many systems of equations at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]


@dataclass(frozen=True, kw_only=True)
class Roots:
    """What Newton's method found; columns that did not converge hold the last iterate."""

    z: Array  # (m, n) unknowns
    converged: NDArray[np.bool_]  # (n,)
    residual: Array  # (n,) largest entry of the residual, in the residual's unit
    iterations: int  # of the slowest column


def newton(
    residual: Function,
    jacobian: Function,
    z: Array,
    *,
    tolerance: float = 1e-11,
    max_iterations: int = 60,
) -> Roots:
    """Solve ``residual(z) = 0`` column by column.

    Parameters
    ----------
    residual : callable
        (m, n) to (m, n), each column by itself.
    jacobian : callable
        (m, n) to (n, m, m).
    z : ndarray (m, n)
        Start.
    tolerance : float, optional
        A column has converged when a step changes it by less than this part of its largest
        entry [-].
    max_iterations : int, optional
        Steps at most.

    Returns
    -------
    Roots

    Notes
    -----
    A step that does not lessen the residual is halved, up to ten times; a column that does not get
    better then, or meets a singular Jacobian, ends unconverged.
    """
    z = np.array(z, dtype=float)
    n = z.shape[1]
    error = _size(residual(z))
    converged = np.zeros(n, dtype=bool)
    dead = ~np.isfinite(error)
    trial_error, worse = error, np.zeros(n, dtype=bool)
    iterations = 0
    while iterations < max_iterations and not np.all(converged | dead):
        iterations += 1
        step = -_solve(jacobian(z), residual(z))
        dead |= ~np.all(np.isfinite(step), axis=0)
        step[:, converged | dead] = 0.0
        length = np.ones(n)
        for _ in range(11):
            trial = z + length * step
            trial_error = _size(residual(trial))
            worse = ~(trial_error <= error) & (np.max(np.abs(step), axis=0) > 0.0)
            small = length * np.max(np.abs(step), axis=0) <= tolerance * _largest(z)
            worse &= ~small
            if not np.any(worse):
                break
            length = np.where(worse, length / 2.0, length)
        dead |= worse  # a minimum of the residual that is no root
        step[:, dead] = 0.0
        z = z + length * step
        error = np.where(converged | dead, error, trial_error)
        moved = np.max(np.abs(step), axis=0)
        converged |= ~dead & (moved <= tolerance * _largest(z))
    return Roots(z=z, converged=converged, residual=_size(residual(z)), iterations=iterations)


def numerical_jacobian(function: Callable[[Array], Array], z: Array) -> Array:
    """Differentiate a vectorised function by central differences.

    Parameters
    ----------
    function : callable
        Maps (m, k) to (m', k), column by column; called once, with all shifted columns, in the
        order of the columns of `z` repeated ``2 m`` times.
    z : ndarray (m, n)
        Where.

    Returns
    -------
    ndarray (n, m', m)

    Notes
    -----
    The step is the cube root of the rounding unit times the largest entry of the column: the
    relative error is about 1e-10 for entries of the size of the largest.
    """
    m, n = z.shape
    step = np.cbrt(np.finfo(float).eps) * np.maximum(np.max(np.abs(z), axis=0), 1e-6)
    shifts = step[None, None, :] * np.eye(m)[:, :, None]  # (component, shifted one, n)
    columns = np.concatenate(
        [(z[:, None, :] + shifts).reshape(m, -1), (z[:, None, :] - shifts).reshape(m, -1)], axis=1
    )
    values = function(columns).reshape(-1, 2, m, n)
    slopes = (values[:, 0] - values[:, 1]) / (2.0 * step)
    return np.moveaxis(slopes, 2, 0)


def _size(values: Array) -> Array:
    with np.errstate(invalid="ignore", over="ignore"):
        return np.max(np.abs(values), axis=0)


def _largest(z: Array) -> Array:
    return np.maximum(np.max(np.abs(z), axis=0), 1e-9)


def _solve(matrices: Array, right: Array) -> Array:
    """Return the solutions (m, n) of n systems; NaN where a matrix is singular."""
    good = np.all(np.isfinite(matrices), axis=(1, 2)) & np.all(np.isfinite(right), axis=0)
    found = np.full_like(right, np.nan)
    if np.any(good):
        try:
            found[:, good] = np.linalg.solve(matrices[good], right.T[good][:, :, None])[:, :, 0].T
        except np.linalg.LinAlgError:
            for column in np.flatnonzero(good):
                if np.linalg.cond(matrices[column]) < 1e15:
                    found[:, column] = np.linalg.solve(matrices[column], right[:, column])
    return found
