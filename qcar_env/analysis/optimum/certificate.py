"""What no force can beat, and what the found one does between the nodes.

**The bound.** For numbers y (one for each node and mass) with ``sum |y| <= 1`` the largest
|w_i x_i| / A_i is at least ``sum y w x / A``. The least of that sum over all forces is explicit,
with the adjoint lambda:

    lambda_k = C^T y_k + A^T lambda_{k+1}      z(t) = B^T exp(A^T (t_{k+1} - t)) lambda_{k+1}
    bound = sum_k lambda_{k+1} . d_k  -  sum_j L_j  integral |z_j(t)| dt.

The integral runs over continuous time, so the bound holds for forces of every shape and for every
control interval; it needs the program's dual only as a good y, and no trust in the solver. |z| is
integrated by the trapezoidal rule, which errs upward except for its curvature term
``max|z''| step^2 / 12``; that term is added.

**The peaks** are what the found force achieves at every instant, bounded from above. The optimum
of continuous time lies between the two.

Source: S. Boyd, L. Vandenberghe, Convex Optimization, 2004, section 5.2 (weak duality); the
certificate in continuous time is worked out here.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.optimum.grid import SUBDIVISION, Grid

Array = NDArray[np.float64]


def least(grid: Grid, y: Array) -> float:
    """Return the least of ``sum y x`` over all forces of continuous time.

    The multipliers y (n, 2) are those of the unknown nodes: 0 to n - 1 of a closed motion, 1 to n
    of one from a given start.
    """
    n = len(grid.kind)
    a = grid.A
    into = np.zeros((n, 4))
    into[:, :2] = y
    adjoint = np.zeros((n, 4))  # adjoint[k] belongs to the node at the end of step k
    if grid.start is None:
        # Backward from an unknown end: first the part that y makes, then the closing condition.
        free, through = np.zeros(4), np.eye(4)
        for k in range(n - 1, 0, -1):
            free = into[k] + a[k].T @ free
            through = a[k].T @ through
        matrix = grid.closing * np.eye(4) - a[0].T @ through
        adjoint[-1] = np.linalg.solve(matrix, into[0] + a[0].T @ free)
        into = np.roll(into, -1, axis=0)  # as below: into[k] belongs to the end of step k
    else:
        adjoint[-1] = into[-1]
    for k in range(n - 1, 0, -1):
        adjoint[k - 1] = into[k - 1] + a[k].T @ adjoint[k]
    total = float(np.sum(adjoint * grid.drive))
    if grid.start is not None:
        total += float(adjoint[0] @ a[0] @ grid.start)
    growth = float(np.max(np.linalg.eigvalsh(0.5 * (grid.matrix + grid.matrix.T))))
    curvature = np.linalg.norm(grid.matrix @ grid.matrix @ grid.into, axis=0)  # of each force
    for each, step in enumerate(grid.steps):
        here = adjoint[grid.kind == each]
        z = np.einsum("am,jba,kb->kjm", grid.into, step.parts, here)
        piece = step.length / SUBDIVISION
        integral = piece * (
            np.sum(np.abs(z)) - 0.5 * np.sum(np.abs(z[:, 0])) - 0.5 * np.sum(np.abs(z[:, -1]))
        )
        largest = math.exp(max(growth, 0.0) * step.length) * np.sum(np.linalg.norm(here, axis=1))
        total -= float(integral + step.length * piece * piece / 12.0 * curvature.sum() * largest)
    return total


def peaks_of(grid: Grid, nodes: Array, forces: Array) -> Array:
    """Return the largest scaled |x1|, |x2| at any instant, bounded from above, shape (2,).

    Nodes are scaled states (n + 1, 4), forces (n, m) over their limits.
    """
    peaks = np.zeros(2)
    for each, step in enumerate(grid.steps):
        here = (grid.kind == each) & (grid.t[1:] > grid.begin + 1e-12)
        if not np.any(here):
            continue
        x = (
            np.einsum("jab,kb->kja", step.parts, nodes[:-1][here])
            + np.einsum("jam,km->kja", step.held, forces[here])
            + grid.drive_parts[here]
        )
        rise = np.abs(np.diff(x[:, :, 2:], axis=1)).max()  # |x''| over a part, of scaled rates
        piece = step.length / SUBDIVISION
        slack = 0.25 * piece * rise * grid.scale[2] / grid.scale[0]  # twice piece^2 max|x''| / 8
        peaks = np.maximum(peaks, np.abs(x[:, :, :2]).max(axis=(0, 1)) + slack)
    return peaks
