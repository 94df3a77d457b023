"""What no force within the limits can beat on a hump, from any multipliers.

Let e be the outputs whose p-norm is the objective, d the travel and f the change of the tyre's load
at the nodes, over their limits. For any y with ``|y|_q <= 1`` (``1/p + 1/q = 1``), any tau and rho,
and any kappa >= 0, every motion within the limits has

    |e|_p  >=  y.e + sum (tau d - |tau|) - sum kappa (1 + f) + sum (rho (u_k - u_{k-1}) - |rho| r)

The right side is linear in the forces, but for constants, and its least value over ``|u| <= 1`` is
explicit. With the adjoint

    lambda_k = A^T lambda_{k+1} + C^T (multipliers of interval k)
    z_k = B^T lambda_{k+1} + D^T (multipliers of interval k) + rho_k - rho_{k+1}
    bound = sum (lambda_{k+1} . drive_k + multipliers . free_k) - penalties - sum |z_k|.

For forces of every shape the last sum becomes the integral of |z(t)|, with z(t) between the nodes
by the exact adjoint of continuous time; e are means over cells then, which no peak, root of the
mean square or fourth power exceeds (Jensen), and r limits the mean force from one control interval
to the next, which a force held over the interval and one of a limited rate keep alike.

The solver's multipliers serve as a good choice and are not trusted. What is lost to rounding is
bounded by `ROUNDING` times the sum of the sizes of all terms, and taken off.

Source: S. Boyd, L. Vandenberghe, Convex Optimization, 2004, section 5.2 (weak duality); the form
for forces of every shape is worked out here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from qcar_env.analysis.optimum.sampled import Sampled

Array = NDArray[np.float64]

ROUNDING = 1e-10  # chosen here: maps and road are good to 1e-12, tests/analysis/test_hump.py
PARTS = 16  # of an interval, in which |z| is integrated


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Prices of the limits; in the units of the scaled car."""

    objective: Array  # (n, r) y; all are divided by its norm where that is above 1
    travel: Array  # (n, nodes) tau
    load: Array  # (n, nodes) kappa; what is negative counts as zero
    rate: Array  # (control intervals,) rho


def least(car: Sampled, given: Multipliers, *, any_shape: bool) -> float:
    """Return the least scaled objective that any force within the limits leaves.

    With an objective of zeros: a positive number proves that no force keeps the limits.
    """
    dual = 1.0 if car.norm == math.inf else car.norm / (car.norm - 1.0)  # q
    size = max(1.0, float(np.linalg.norm(given.objective.ravel(), dual)))
    y, tau, rho = given.objective / size, given.travel / size, given.rate / size
    kappa = np.maximum(given.load, 0.0) / size
    # multipliers times rows, interval by interval
    into = y @ car.objective.C
    onto = y @ car.objective.D
    terms = [y * car.objective.free, -np.abs(rho) * min(car.rate, np.finfo(float).max)]
    if car.travel is not None:
        into, onto = into + tau @ car.travel.C, onto + tau @ car.travel.D
        terms += [tau * car.travel.free, -np.abs(tau)]
    if car.load is not None:
        into, onto = into - kappa @ car.load.C, onto - kappa @ car.load.D
        terms += [-kappa * car.load.free, -kappa]
    adjoint = np.zeros((car.count + 1, len(car.B)))
    for k in range(car.count - 1, -1, -1):
        adjoint[k] = adjoint[k + 1] @ car.A + into[k]
    terms.append(adjoint[1:] * car.drive)
    price = np.repeat(rho - np.append(rho[1:], 0.0), car.group)[: car.count] / car.group
    if any_shape:
        terms.append(-_integral(car, adjoint[1:], y[:, 0], tau, kappa, price))
    else:
        terms.append(-np.abs(adjoint[1:] @ car.B + onto + price))
    total = sum(float(np.sum(each)) for each in terms)
    return total - ROUNDING * sum(float(np.sum(np.abs(each))) for each in terms)


def _integral(
    car: Sampled, adjoint: Array, y: Array, tau: Array, kappa: Array, price: Array
) -> Array:
    """Return the integral of |z| over each interval, (n,), from above.

    By the trapezoidal rule, which errs upward except for its curvature term
    ``max|z''| part^2 / 12``; that term is added. One cell to the interval.
    """
    ends = adjoint + tau[:, :1] * car.node_travel - kappa[:, :1] * car.node_load
    ends = np.column_stack([ends, y / car.length])
    part = car.length / PARTS
    step = expm(car.matrix * part)
    back = [car.into]
    for _ in range(PARTS):
        back.append(step @ back[-1])
    z = ends @ np.stack(back, axis=1) + price[:, np.newaxis] / car.length  # (n, PARTS + 1)
    sizes = np.abs(z)
    area = part * (sizes.sum(axis=1) - 0.5 * (sizes[:, 0] + sizes[:, -1]))
    growth = float(np.max(np.linalg.eigvalsh(0.5 * (car.matrix + car.matrix.T))))
    bend = np.linalg.norm(car.matrix @ car.matrix @ car.into)
    largest = math.exp(max(growth, 0.0) * car.length) * np.linalg.norm(ends, axis=1)
    return area + car.length * part * part / 12.0 * bend * largest
