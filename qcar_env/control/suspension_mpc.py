"""Model predictive control of a suspension: the quadratic program of one control interval.

    minimise    sum_{k<N} l(xi_k, F_k) + V(xi_N)  +  slack
    subject to  |F_k| <= limit,  |F_k - F_{k-1}| <= rate dt,  |travel_k| <= stroke + slack

l is the cost of `qcar_env.control.preview`, V the regulator's cost to go on the road that follows,
``xi' P xi + 2 b' xi`` with ``b = sum_j (Ac')^{j+1} P G s_{N+j}``: constraints are kept over N
intervals, the road is seen as far as it is known. Where no constraint acts, the program's first
force is that of the regulator with preview. Forces are in units of the limit, travel in strokes;
the slack makes every program solvable, and costs so much that it is used only where it must be.

Source: J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control, 2nd ed., 2017, sections
1.3 and 2.5; C. Gohrle et al., Design and vehicle implementation of preview active suspension
controllers, IEEE Trans. Control Systems Technology 22(3), 2014 (recalled).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.preview import Regulator
from qcar_env.validation import positive, whole

Array = NDArray[np.float64]

MOST_INTERVALS = 1_000  # of a horizon, chosen here: its program fills 30 MB
# Cost of a slack of one stroke, over that of the limit's force: of its square, and of itself.
# Chosen here: the travel of an Escort on a Watts hump passes 80 mm by 1.3 mm at 500 N, where it
# must, and not at 2 kN. Ten times as much needs ten times the iterations.
SLACK, AT_ONCE = 1e2, 1e1


@dataclass(frozen=True, kw_only=True, eq=False)
class SuspensionProgram:
    """The program ``min 1/2 z' H z + g' z, low <= M z <= high``, z = (F_0 .. F_{N-1}, slack).

    ``g = from_state xi + from_slopes s``, of the n slopes that are known. The rows of M are the
    forces, their changes, the travel from below and from above, and the slack;
    ``travel_state xi + travel_slopes s`` is the travel without force in strokes.
    """

    H: Array  # (N + 1, N + 1)
    M: Array  # (4 N + 1, N + 1)
    from_state: Array  # (N + 1, 4)
    from_slopes: Array  # (N + 1, n)
    travel_state: Array  # (N, 4)
    travel_slopes: Array  # (N, n)
    change: float  # largest change of the force in an interval, in limits [-]
    horizon: int  # N

    def vectors(self, xi: Array, slopes: Array, before: float) -> tuple[Array, Array, Array]:
        """Return g, low and high of one car.

        Parameters
        ----------
        xi : ndarray (4,)
            State of the suspension.
        slopes : ndarray (n,)
            Of the road ahead [m/s].
        before : float
            Force of the interval before, in limits [-].
        """
        n = self.horizon
        g = self.from_state @ xi + self.from_slopes @ slopes
        g[n] = AT_ONCE
        free = self.travel_state @ xi + self.travel_slopes @ slopes
        start = np.zeros(n)
        start[0] = before
        ones, none = np.ones(n), np.full(n, np.inf)
        low = np.concatenate([-ones, start - self.change, -ones - free, -none, [0.0]])
        high = np.concatenate([ones, start + self.change, none, ones - free, [np.inf]])
        return g, low, high


def suspension_program(
    regulator: Regulator, *, limit: float, rate: float, stroke: float, horizon: int, preview: int
) -> SuspensionProgram:
    """Build the program.

    Parameters
    ----------
    regulator : Regulator
        Whose cost it has.
    limit, rate : float
        Largest force [N] and change of it [N/s].
    stroke : float
        Largest travel either way [m].
    horizon : int
        Intervals N in which the constraints hold.
    preview : int
        Intervals n of known road.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    limit, stroke = positive("force limit", limit, "N"), positive("stroke", stroke, "m")
    change = positive("rate", rate, "N/s") * regulator.plant.dt / limit
    n = whole("horizon", horizon, most=MOST_INTERVALS)
    road = whole("intervals of preview", preview, least=0)
    plant = regulator.plant
    A, B, G = plant.Ad, plant.Bd * limit, plant.Gd
    # x_k of k = 0 .. N, of the state at first, the forces and the slopes.
    ofstate, offorces = np.zeros((n + 1, 4, 4)), np.zeros((n + 1, 4, n))
    ofslopes = np.zeros((n + 1, 4, road))
    ofstate[0] = np.eye(4)
    for k in range(n):
        ofstate[k + 1], offorces[k + 1] = A @ ofstate[k], A @ offorces[k]
        ofslopes[k + 1] = A @ ofslopes[k]
        offorces[k + 1, :, k] += B
        if k < road:
            ofslopes[k + 1, :, k] += G
    Q, N, P = regulator.Q, regulator.N * limit, regulator.P
    to = np.array([each.T @ Q for each in offorces[:-1]])  # (N, N, 4), of the cost by the forces
    to[np.arange(n), np.arange(n)] += N
    cost = np.einsum("kis,ksj->ij", to, offorces[:-1]) + regulator.R * limit * limit * np.eye(n)
    cost += np.einsum("ksi,s->ik", offorces[:-1], N) + offorces[n].T @ P @ offorces[n]
    g_state = np.einsum("kis,ksj->ij", to, ofstate[:-1]) + offorces[n].T @ P @ ofstate[n]
    g_slopes = np.einsum("kis,ksj->ij", to, ofslopes[:-1]) + offorces[n].T @ P @ ofslopes[n]
    ahead = P @ G
    for j in range(n, road):
        ahead = regulator.closed.T @ ahead
        g_slopes[:, j] += offorces[n].T @ ahead
    size = float(np.trace(cost)) / n  # so that a solver's tolerance means the same for every car
    with_slack = np.zeros((n + 1, n + 1))
    with_slack[:n, :n], with_slack[n, n] = cost / size, SLACK
    travel = offorces[1:, 0] / stroke
    M = np.zeros((4 * n + 1, n + 1))
    M[:n, :n] = np.eye(n)
    M[n : 2 * n, :n] = np.eye(n) - np.eye(n, k=-1)
    M[2 * n : 3 * n, :n], M[2 * n : 3 * n, n] = travel, 1.0
    M[3 * n : 4 * n, :n], M[3 * n : 4 * n, n] = travel, -1.0
    M[4 * n, n] = 1.0
    return SuspensionProgram(
        H=0.5 * (with_slack + with_slack.T),
        M=M,
        from_state=np.vstack([g_state / size, np.zeros(4)]),
        from_slopes=np.vstack([g_slopes / size, np.zeros(road)]),
        travel_state=ofstate[1:, 0] / stroke,
        travel_slopes=ofslopes[1:, 0] / stroke,
        change=change,
        horizon=n,
    )
