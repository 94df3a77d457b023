"""The program of a hump: the least objective over all held forces within the limits.

    minimise    |e|_p     over u_0, u_1, ... and x_1, x_2, ...
    subject to  x_{k+1} = A x_k + B u_k + drive_k,   |u_k| <= 1,
                |travel| <= 1, load >= -1 at the nodes,   |u_k - u_{k-1}| <= r

a linear program for the peak (p infinite), a quadratic one for the mean square (p = 2), and one
with a cone ``t >= e^2`` to each e for the fourth power (p = 4, minimise ``|t|_2 = |e|_4^2``).
States and forces of neighbouring intervals alone meet in a row, so that a factorisation costs in
proportion to the number of intervals.

Source: P. J. Goulart, Y. Chen, Clarabel: an interior-point solver for conic programs with quadratic
objectives, arXiv 2405.12762, 2024.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from qcar_env.analysis.optimum.hump_certificate import Multipliers
from qcar_env.analysis.optimum.sampled import Rows, Sampled

Array = NDArray[np.float64]

TINY = 1e-12  # objective [-] below which nothing is left
TOLERANCE = 1e-9  # of the solver, in objectives of the uncontrolled motion


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What the solver says."""

    u: Array  # (n,) forces over their limit
    multipliers: Multipliers  # of an infeasible program: those that prove it
    feasible: bool
    status: str
    iterations: int


def solve(car: Sampled) -> Solution:
    """Solve the program of a scaled car.

    Raises
    ------
    ImportError
        If Clarabel is not installed.
    """
    clarabel = _clarabel()
    n, s = car.count, len(car.B)
    one, before = sparse.eye_array(n), sparse.eye_array(n, k=-1)
    peak = car.norm == math.inf
    r = len(car.objective.D)
    extra = {math.inf: 1, 2.0: 0, 4.0: n * r + 1}[car.norm]

    def block(rows: Rows) -> Any:
        """Return rows on (x_1 .. x_n, u_0 .. u_{n-1}), interval by interval."""
        return sparse.hstack([sparse.kron(before, rows.C), sparse.kron(one, rows.D[:, np.newaxis])])

    def wide(matrix: Any, last: Any = None) -> Any:
        """Return a matrix with columns for what follows states and forces."""
        if last is None:
            last = sparse.csr_array((matrix.shape[0], extra))
        return sparse.hstack([matrix, last])

    dynamics = sparse.hstack(
        [sparse.eye_array(n * s) - sparse.kron(before, car.A), -sparse.kron(one, car.B[:, None])]
    )
    forces = sparse.hstack([sparse.csr_array((n, n * s)), one])
    objective, free = block(car.objective), car.objective.free.ravel()
    blocks: list[Any] = [wide(dynamics)]
    right: list[Array] = [car.drive.ravel()]
    if peak:
        minus = sparse.csr_array(-np.ones((n * r, 1)))
        blocks += [wide(objective, minus), wide(-objective, minus)]
        right += [-free, free]
    blocks += [wide(forces), wide(-forces)]
    right += [np.ones(n), np.ones(n)]
    if car.travel is not None:
        rows = block(car.travel)
        blocks += [wide(rows), wide(-rows)]
        right += [1.0 - car.travel.free.ravel(), 1.0 + car.travel.free.ravel()]
    if car.load is not None:
        blocks += [wide(-block(car.load))]
        right += [1.0 + car.load.free.ravel()]
    controls = math.ceil(n / car.group)
    if car.rate < math.inf:
        mean = sparse.kron(sparse.eye_array(controls), np.full((1, car.group), 1.0 / car.group))
        change = (sparse.eye_array(controls) - sparse.eye_array(controls, k=-1)) @ mean
        change = change.tocsr()[:, :n] @ forces
        blocks += [wide(change), wide(-change)]
        right += [np.full(controls, car.rate)] * 2
    cones = [clarabel.ZeroConeT(n * s), clarabel.NonnegativeConeT(sum(map(len, right[1:])))]
    size = n * s + n + extra
    quadratic, linear = sparse.csc_array((size, size)), np.zeros(size)
    if car.norm == 2.0:  # |e|^2 / 2
        quadratic = objective.T @ objective
        linear = objective.T @ free
    else:
        linear[n * s + n] = 1.0
    if car.norm == 4.0:  # after states and forces: the norm of t, and t
        which = np.arange(3 * n * r)
        e = sparse.kron(objective, np.array([[0.0], [0.0], [-2.0]]))
        t = sparse.kron(sparse.eye_array(n * r), np.array([[-1.0], [1.0], [0.0]]))
        blocks += [
            sparse.hstack([e, sparse.csr_array((3 * n * r, 1)), t]),  # (1 + t, 1 - t, 2 e)
            sparse.hstack([sparse.csr_array((extra, n * s + n)), -sparse.eye_array(extra)]),
        ]
        right += [np.where(which % 3 == 2, 2.0 * np.repeat(free, 3), 1.0), np.zeros(extra)]
        cones += [clarabel.SecondOrderConeT(3)] * (n * r) + [clarabel.SecondOrderConeT(extra)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(quadratic)),
        linear,
        sparse.csc_matrix(sparse.vstack(blocks)),
        np.concatenate(right),
        cones,
        settings,
    ).solve()
    u = np.clip(np.array(found.x)[n * s : n * s + n], -1.0, 1.0)
    z = np.split(np.array(found.z), np.cumsum([len(each) for each in right]))[1:]
    # the multipliers of a function of the norm, over its slope, are those of the norm
    slope = 1.0
    if peak:
        y = (z.pop(0) - z.pop(0)).reshape(n, r)
    else:
        e = car.objective.at(car.motion(u)[:-1], u)
        norm = max(float(np.linalg.norm(e.ravel(), car.norm)), TINY)
        y = np.sign(e) * (np.abs(e) / norm) ** (car.norm - 1.0)
        slope = norm if car.norm == 2.0 else 2.0 * norm
    del z[:2]  # of the force itself: the certificate needs none
    tau = kappa = np.zeros((n, 1))
    rho = np.zeros(controls)
    if car.travel is not None:
        tau = (z.pop(0) - z.pop(0)).reshape(n, -1) / slope
    if car.load is not None:
        kappa = z.pop(0).reshape(n, -1) / slope
    if car.rate < math.inf:
        rho = (z.pop(0) - z.pop(0)) / slope
    status = str(found.status)
    return Solution(
        u=u,
        multipliers=Multipliers(objective=y, travel=tau, load=kappa, rate=rho),
        feasible="PrimalInfeasible" not in status,
        status=status,
        iterations=int(found.iterations),
    )


def _clarabel() -> Any:
    try:
        return importlib.import_module("clarabel")
    except ImportError as error:
        raise ImportError(
            "the optimum of a hump needs Clarabel; install it with pip install 'qcar_env[headroom]'"
        ) from error
