"""Iterative learning of the force over a hump that is met again and again.

One crossing after another, the plan u of forces over the whole crossing moves against what was
measured of it,

    u_{j+1} = Q (u_j - L e_j),     e_j = what was measured: acceleration, travel, tyre deflection
    L = (G' W G + r + s)^-1 G' W,  Q = (G' W G + r + s)^-1 (G' W G + s) = 1 - r (...)^-1        (1)

G is the model's answer to a force, a matrix over time, of the car with the controller that runs
beside the plan. (1) minimises ``e_{j+1}' W e_{j+1} + r u_{j+1}^2 + s (u_{j+1} - u_j)^2`` in the
model: s slows the learning and makes it safe against errors of the model, r is the cost of force.
Where the model is right the plan ends where ``e' W e + r u^2`` is least, whatever the hump.

Source: S. Gunnarsson, M. Norrlof, On the design of ILC algorithms using optimization, Automatica
37(12), 2001; D. A. Bristow, M. Tharayil, A. G. Alleyne, A survey of iterative learning control,
IEEE Control Systems Magazine 26(3), 2006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz

from qcar_env.control.preview import WEIGHTED, Acceptable, Regulator
from qcar_env.validation import finite_array, non_negative, whole

Array = NDArray[np.float64]

MOST_INTERVALS = 4_000  # of a crossing, chosen here: 20 s at 200 Hz, matrices of 1 GB


@dataclass(frozen=True, kw_only=True, eq=False)
class Learner:
    """The matrices of (1) for a crossing of n control intervals."""

    keep: Array  # Q (n, n)
    gain: Array  # L (n, 3 n), of the three outputs one after the other [N per unit]

    def improved(self, plan: Array, outputs: Array) -> Array:
        """Return the next plan.

        Parameters
        ----------
        plan : ndarray (n,)
            Force that was added in each interval [N].
        outputs : ndarray (3, n)
            Acceleration of the body [m/s^2], travel and tyre deflection [m], at the ends of the
            intervals.
        """
        u = finite_array("plan", plan, "N")
        e = finite_array("outputs", outputs)
        n = len(self.keep)
        if u.shape != (n,) or e.shape != (len(WEIGHTED), n):
            raise ValueError(
                f"plan and outputs must be of {n} intervals, got shapes {u.shape} and {e.shape}; "
                f"give {(n,)} and {(len(WEIGHTED), n)}"
            )
        return self.keep @ u - self.gain @ e.ravel()


def learner(
    regulator: Regulator, acceptable: Acceptable, intervals: int, *, caution: float = 1.0
) -> Learner:
    """Return the matrices.

    Parameters
    ----------
    regulator : Regulator
        The controller that runs beside the plan, on the plant.
    acceptable : Acceptable
        Sizes of the outputs and the force.
    intervals : int
        Control intervals n of a crossing.
    caution : float
        s over r [-]; not negative.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    n = whole("intervals", intervals, most=MOST_INTERVALS)
    r = acceptable.force**-2.0
    s = non_negative("caution", caution) * r
    c, d, _ = regulator.plant.rows(WEIGHTED)
    # At the end of an interval the force still acts that was held in it, the plan's and the
    # regulator's, which was set by the state at its beginning.
    answer = np.empty((len(WEIGHTED), n))
    xi, held = np.zeros(4), 1.0
    for k in range(n):
        xi = regulator.plant.Ad @ xi + regulator.plant.Bd * held
        answer[:, k] = c @ xi + d * held
        held = float(-regulator.K @ xi)
    size = np.array([acceptable.acceleration, acceptable.travel, acceptable.tyre])
    blocks = [toeplitz(row, np.zeros(n)) for row in answer]
    whole_G = np.vstack([block / a for block, a in zip(blocks, size, strict=True)])
    square = whole_G.T @ whole_G
    factor = cho_factor(square + (r + s) * np.eye(n))
    gain = cho_solve(factor, whole_G.T)
    return Learner(keep=cho_solve(factor, square + s * np.eye(n)), gain=gain / np.repeat(size, n))
