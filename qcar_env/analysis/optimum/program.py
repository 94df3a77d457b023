"""The program: the least largest displacement over all forces within their limits.

With forces held over intervals and the exact transition between nodes,

    minimise  a    subject to    x_{k+1} = A x_k + B u_k + d_k,    |u_k| <= L,
                                 -a <= w_i x_i(t_k) / A_i <= a    for every node k, mass i,

and ``x_n = x_0`` for a steady motion, or `x_0` given for an episode. A_i are the uncontrolled
amplitudes, so that with weights 1 the value is rho = max_i(a_i / A_i): the share of the vibration
that must remain. The mean square is a bounded least-squares problem in the forces.

Source: S. Boyd, L. Vandenberghe, Convex Optimization, 2004, sections 5.2 and 5.8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, lsq_linear
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from qcar_env.analysis.optimum.certificate import least, peaks_of
from qcar_env.analysis.optimum.grid import Grid
from qcar_env.analysis.optimum.result import Aim, Optimum

Array = NDArray[np.float64]

DENSE = 600  # forces up to which least squares uses an active set, exact to rounding
# The programs ask for no less than these [-], far below what anybody can tell from stillness: at
# zero every force that cancels is as good as another, and the solver wanders among them.
PERIOD_FLOOR = 1e-6
EPISODE_FLOOR = 1e-5


@dataclass(frozen=True, kw_only=True)
class _Solution:
    u: Array  # (holds, m) forces over their limits
    y: Array  # (n, 2) multipliers of the displacements
    dual: float  # value of the dual [-]
    status: str  # the solver's own words
    iterations: int


def solve(grid: Grid, aim: Aim, *, every: int = 1) -> Optimum:
    """Return the optimum on a grid, the displacement limited at one node of `every` so many.

    The mean square takes all nodes. A solver that fails raises RuntimeError.
    """
    n, w = len(grid.kind), np.array(aim.weights)
    first = 0 if grid.start is None else 1  # unknown nodes: see `certificate.least`
    counted = grid.t[first : first + n] >= grid.begin - 1e-12
    equations, right = _dynamics(grid)
    if aim.objective == "rms":
        found = _least_squares(grid, equations, right, w, counted)
    else:
        counted &= np.arange(n) % every == 0
        found = _linear_program(grid, equations, right, w, counted, together=aim.objective == "max")
    x = _motion(grid, equations, right, found.u)
    ends = (x, grid.closing * x[:1]) if grid.start is None else (grid.start, x)
    nodes, forces = np.vstack(ends), found.u[grid.held]
    peaks = peaks_of(grid, nodes, forces)
    at_nodes: Array = np.max(np.abs(x[counted, :2]), axis=0)
    mean_square = np.mean(np.sum((w * x[counted, :2]) ** 2, axis=1))
    value, upper = {
        "max": (np.max(w * at_nodes), np.max(w * peaks)),
        "sum": (w @ at_nodes, w @ peaks),
        "rms": (np.sqrt(mean_square), np.sqrt(mean_square)),
    }[aim.objective]
    return Optimum(
        objective=aim.objective,
        weights=(float(w[0]), float(w[1])),
        value=float(value),
        dual=found.dual,
        upper=float(upper),
        bound=max(0.0, least(grid, found.y)),
        amplitudes=(float(peaks[0] * grid.scale[0]), float(peaks[1] * grid.scale[1])),
        t=grid.t,
        x=nodes * grid.scale,
        u=forces * grid.limit,
        hold=grid.hold,
        status=found.status,
        iterations=found.iterations,
    )


def _dynamics(grid: Grid) -> tuple[csc_array, Array]:
    """Return the equations of motion as ``M (x, u) = right``, unknown states first."""
    n, m = len(grid.kind), grid.into.shape[1]
    a, b, k = grid.A, grid.B, np.arange(n)
    row = 4 * k[:, np.newaxis, np.newaxis] + np.arange(4)[:, np.newaxis]  # (n, 4, 1)
    right = grid.drive.copy()
    if grid.start is None:
        now, following, sign = k, (k + 1) % n, np.where(k == n - 1, grid.closing, 1.0)
    else:
        now, following, sign = k - 1, k, np.ones(n)
        right[0] += a[0] @ grid.start
    columns = 4 * now[:, np.newaxis, np.newaxis] + np.arange(4)
    forces = 4 * n + m * grid.held[:, np.newaxis, np.newaxis] + np.arange(m)
    keep = slice(0 if grid.start is None else 1, None)  # a first state that is given is no unknown
    blocks = [
        (np.broadcast_to(row, a.shape)[keep], np.broadcast_to(columns, a.shape)[keep], -a[keep]),
        (
            row[:, :, 0],
            4 * following[:, np.newaxis] + np.arange(4),
            np.repeat(sign[:, np.newaxis], 4, axis=1),
        ),
        (np.broadcast_to(row, b.shape), np.broadcast_to(forces, b.shape), -b),
    ]
    rows, cols, values = (np.concatenate([part[i].ravel() for part in blocks]) for i in range(3))
    size = 4 * n + m * (int(grid.held[-1]) + 1)
    return csc_array(coo_array((values, (rows, cols)), shape=(4 * n, size))), right.ravel()


def _linear_program(
    grid: Grid,
    equations: csc_array,
    right: Array,
    w: Array,
    counted: NDArray[np.bool_],
    *,
    together: bool,
) -> _Solution:
    """Solve for the least of one bound on both masses `together`, or of the sum of one on each."""
    n, m = len(grid.kind), grid.into.shape[1]
    size = equations.shape[1]
    masses = np.flatnonzero(w)
    extra = 1 if together else len(masses)
    node = np.flatnonzero(counted)
    # Rows: for each counted node and mass, +w x - a <= 0 and -w x - a <= 0.
    column = (4 * node[:, np.newaxis] + masses).ravel()
    which = size + (np.zeros_like(column) if extra == 1 else np.tile(np.arange(extra), len(node)))
    factor = np.tile(w[masses] if together else np.ones(extra), len(node))
    count = len(column)
    rows = np.concatenate([np.arange(2 * count), np.arange(2 * count)])
    cols = np.concatenate([column, column, which, which])
    values = np.concatenate([factor, -factor, -np.ones(2 * count)])
    inequalities = coo_array((values, (rows, cols)), shape=(2 * count, size + extra))
    cost = np.zeros(size + extra)
    cost[size:] = 1.0 if together else w[masses]
    bounds = np.empty((size + extra, 2))
    bounds[: 4 * n] = (-np.inf, np.inf)
    bounds[4 * n : size] = (-1.0, 1.0)
    floor = PERIOD_FLOOR if grid.start is None else EPISODE_FLOOR
    bounds[size:] = (floor, np.inf)
    widened = coo_array(equations)
    # HiGHS drops entries below 1e-9, which short steps have: multiply the equations up.
    up = max(1.0, grid.scale[0] / (grid.scale[2] * float(np.min(np.diff(grid.t)))))
    solve: Any = linprog  # its stubs know no sparse matrices
    result = solve(
        cost,
        A_ub=csc_array(inequalities),
        b_ub=np.zeros(2 * count),
        A_eq=csc_array(
            coo_array((up * widened.data, widened.coords), shape=(equations.shape[0], size + extra))
        ),
        b_eq=up * right,
        bounds=bounds,
        method="highs-ipm",
        options={"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9},
    )
    if result.status != 0:
        raise RuntimeError(
            f"the linear program was not solved (status {result.status}: {result.message}); "
            "try another number of samples or nodes"
        )
    on_bounds = result.lower.marginals[4 * n : size], result.upper.marginals[4 * n : size]
    dual = up * (right @ result.eqlin.marginals) - on_bounds[0].sum() + on_bounds[1].sum()
    dual += floor * result.lower.marginals[size:].sum()
    multiplier = -result.ineqlin.marginals.reshape(2, -1)
    y = np.zeros((n, 2))
    total = (multiplier.sum(axis=0) * np.ones(count)).reshape(len(node), len(masses))
    signed = (multiplier[0] - multiplier[1]).reshape(len(node), len(masses))
    # the multipliers add up to 1: of both masses together, or of each to its weight
    norm = float(total.sum()) if together else total.sum(axis=0)
    y[np.ix_(node, masses)] = signed * w[masses] / np.maximum(norm, 1e-300)
    return _Solution(
        u=np.clip(result.x[4 * n : size].reshape(-1, m), -1.0, 1.0),
        y=y,
        dual=float(dual),
        status=str(result.message),
        iterations=int(result.nit),
    )


def _least_squares(
    grid: Grid, equations: csc_array, right: Array, w: Array, counted: NDArray[np.bool_]
) -> _Solution:
    """Solve for the least mean square."""
    n, m = len(grid.kind), grid.into.shape[1]
    factors = splu(equations[:, : 4 * n])
    unforced = factors.solve(right).reshape(n, 4)
    answers = -factors.solve(equations[:, 4 * n :].toarray()).reshape(n, 4, -1)
    weight = counted[:, np.newaxis] * w / math.sqrt(np.count_nonzero(counted))  # (n, 2)
    result: Any = lsq_linear(
        (weight[:, :, np.newaxis] * answers[:, :2]).reshape(2 * n, -1),
        -(weight * unforced[:, :2]).ravel(),
        (-1.0, 1.0),
        method="bvls" if answers.shape[2] <= DENSE else "trf",
        tol=1e-14,
        max_iter=10_000,
    )
    if result.status < 1:
        raise RuntimeError(
            f"the least-squares problem was not solved ({result.message}); "
            "try another number of samples or nodes"
        )
    u = np.clip(result.x.reshape(-1, m), -1.0, 1.0)
    x = _motion(grid, equations, right, u)
    norm = math.sqrt(float(np.sum((weight * x[:, :2]) ** 2)))
    y = weight * weight * x[:, :2] / max(norm, 1e-300)
    # The certificate for forces held as here: sum y x is linear in them.
    slope = _slope(grid, equations, y)
    dual = float(np.sum(y * x[:, :2]) - np.sum(slope * u) - np.sum(np.abs(slope)))
    return _Solution(
        u=u, y=y, dual=max(dual, 0.0), status=str(result.message), iterations=int(result.nit)
    )


def _motion(grid: Grid, equations: csc_array, right: Array, u: Array) -> Array:
    """Return the states at the nodes that follow from the forces, shape (n, 4)."""
    n = len(grid.kind)
    rest = right - equations[:, 4 * n :] @ u.ravel()
    return splu(equations[:, : 4 * n]).solve(rest).reshape(n, 4)


def _slope(grid: Grid, equations: csc_array, y: Array) -> Array:
    """Return the gradient of ``sum y x`` to each held force, shape (holds, m)."""
    n, m = len(grid.kind), grid.into.shape[1]
    into = np.zeros((n, 4))
    into[:, :2] = y
    factors: Any = splu(equations[:, : 4 * n])
    adjoint: Array = factors.solve(into.ravel(), trans="T")
    return -(equations[:, 4 * n :].T @ adjoint).reshape(-1, m)
