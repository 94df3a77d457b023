"""Model predictive control that follows a plan: the quadratic program of one control interval.

    minimise    sum_{k=1..N} |x_k - x*_k|^2_{Q_k}  +  sum_{k=0..N-1} |u_k - u*_k|^2_R
    subject to  x_{k+1} = A x_k + B u_k + W w_k,   |u_k| <= 1

over the forces alone: the states are eliminated. w_k is road and external force as the preview
shows them over the horizon. Q_N is the regulator's cost to go, which stands for what follows. The
plan (x*, u*) is the optimal steady motion, and it carries what a horizon of tenths of a second
cannot see: the slow mode, whose envelope takes seconds.

Source: J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control, 2nd ed., 2017, sections
1.3 and 2.5; D. Limon et al., MPC for tracking periodic references, IEEE Trans. Automatic Control
61(4), 2016.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.lqr import SampledPlant, Weights, cost_to_go
from qcar_env.validation import whole

Array = NDArray[np.float64]

MOST_INTERVALS = 10_000  # of a horizon, chosen here: its program fills gigabytes


@dataclass(frozen=True, kw_only=True)
class TrackingProgram:
    """The program ``min 1/2 U^T H U + g^T U, |U| <= 1``, U the forces of the horizon in a row.

    ``g = from_state x_0 + from_world w_0 - from_plan X* - from_forces U*`` with X* the plan's
    states at the ends of the N intervals in a row, and U* its forces.
    """

    H: Array  # (N m, N m)
    from_state: Array  # (N m, 4)
    from_world: Array  # (N m, k)
    from_plan: Array  # (N m, 4 N)
    from_forces: Array  # (N m, N m)
    horizon: int  # N


def tracking_program(
    plant: SampledPlant, world: Array, turn: Array, weights: Weights, horizon: int
) -> TrackingProgram:
    """Build the program.

    Parameters
    ----------
    plant : SampledPlant
        The scaled plant.
    world : ndarray (4, k)
        What the world's k numbers add to the state over an interval, scaled.
    turn : ndarray (k, k)
        How the world's numbers move on over an interval: the preview.
    weights : Weights
        Of the cost.
    horizon : int
        Number of intervals N.

    Returns
    -------
    TrackingProgram

    Raises
    ------
    ValueError
        If `horizon` is no whole number from 1 to 10 000.
    """
    n = whole("horizon", horizon, most=MOST_INTERVALS)
    a, b = plant.A, plant.B
    m = b.shape[1]
    states = np.zeros((4 * n, 4))
    worlds = np.zeros((4 * n, world.shape[1]))
    forces = np.zeros((4 * n, m * n))
    power, ahead = np.eye(4), np.eye(turn.shape[0])
    reached = np.zeros_like(world)
    for k in range(n):
        power = a @ power
        reached = a @ reached + world @ ahead
        ahead = turn @ ahead
        rows = slice(4 * k, 4 * k + 4)
        states[rows], worlds[rows] = power, reached
        for j in range(k + 1):
            forces[rows, m * j : m * j + m] = (
                b if j == k else a @ forces[4 * k - 4 : 4 * k, m * j : m * j + m]
            )
    q = np.kron(np.eye(n), np.diag([weights.q1, weights.q2, weights.q1, weights.q2]))
    q[-4:, -4:] = cost_to_go(plant, weights)
    r = np.zeros((m * n, m * n))
    np.fill_diagonal(r, [weights.r1, weights.r2][-m:] * n)
    weighted = forces.T @ q
    return TrackingProgram(
        H=weighted @ forces + r,
        from_state=weighted @ states,
        from_world=weighted @ worlds,
        from_plan=weighted,
        from_forces=r,
        horizon=n,
    )
