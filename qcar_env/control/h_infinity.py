"""H-infinity control of a suspension from its sensors: the least worst case over all roads.

    xi' = A xi + B1 w + B2 F      w = (y' / s, noise)                       what disturbs, of size 1
    z = C1 xi + D12 F             z = (a2 / a, travel / d, tyre / e, F / f)     what shall be small
    r = C2 xi + D21 w

A road whose rate has the energy ``int y'^2 dt = s^2 E`` leaves ``int |z|^2 dt <= gamma^2 E``. The
central controller of a gamma is an observer that expects the worst, ``w = F1 q``:

    q' = A q + B1 F1 q + B2 F - Z L2 (r - C2 q - D21 F1 q),     F = F2 q                        (1)
    F1 = B1' X / gamma^2,  F2 = -(D12' D12)^-1 (B2' X + D12' C1)
    L2 = -(Y C2' + B1 D21') (D21 D21')^-1,  Z = (1 - Y X / gamma^2)^-1

X and Y solve the Riccati equations of state feedback and of the filter. A gamma is possible where
both exist, neither has a negative eigenvalue, and the largest eigenvalue of X Y is below gamma^2;
bisection finds the least. The controller is that of a gamma some percent above. It is sampled by
the bilinear rule in r, with the force that was given held, as it is; the readings are freed of that
force first.

Source: J. C. Doyle, K. Glover, P. P. Khargonekar, B. A. Francis, State-space solutions to standard
H2 and H-infinity control problems, IEEE Trans. Automatic Control 34(8), 1989; K. Zhou, J. C. Doyle,
K. Glover, Robust and Optimal Control, 1996, theorem 17.1 with D11 = D22 = 0. The bound is that of
the continuous loop within the actuator's limits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_are

from qcar_env.control.controller import Controller
from qcar_env.control.preview import WEIGHTED, Acceptable
from qcar_env.control.suspension import Suspension
from qcar_env.validation import finite, finite_array, positive

Array = NDArray[np.float64]

HIGHEST = (
    1e6  # gamma with which the search begins; chosen here: a controller beyond it does nothing
)
CLOSE = 1e-4  # how near the least gamma is found [-]
# Chosen here. No controller is better at the one frequency ``sqrt(k1 / m1)``, where the
# wheel decides; near the least gamma all effort goes there, 20 % above it the body is calmer.
ABOVE = 1.2
NEGATIVE = 1e-9  # of the largest eigenvalue: rounding of a zero one


@dataclass(frozen=True, kw_only=True, eq=False)
class Generalised:
    """The plant from (w, F) to (z, r); r are k readings over their noise, freed of the force."""

    A: Array  # (4, 4)
    B1: Array  # (4, 1 + k)
    B2: Array  # (4, 1) [1/f]
    C1: Array  # (4, 4)
    D12: Array  # (4, 1) [1/f]
    C2: Array  # (k, 4)
    D21: Array  # (k, 1 + k)


@dataclass(frozen=True, kw_only=True, eq=False)
class HInfinity:
    """A controller with its bound."""

    controller: Controller  # sampled
    gamma: float  # bound of the continuous loop [-]
    least: float  # the least gamma, within 0.01 % [-]
    plant: Generalised
    observer: tuple[Array, Array, Array]  # q' = N q + M r + B2 F, F = F2 q: N, M, F2 of (1)


def generalised(
    plant: Suspension,
    signals: tuple[str, ...],
    noise: Array,
    *,
    road: float,
    acceptable: Acceptable,
) -> Generalised:
    """Return the plant with its weights; arguments and errors as of `h_infinity`."""
    sigma = finite_array("noise", noise)
    if not signals or sigma.shape != (len(signals),) or np.any(sigma <= 0.0):
        raise ValueError(
            f"noise must be positive, one number for each of {signals}, got {sigma}; an ideal "
            "sensor has a small one"
        )
    s, k = positive("road", road, "m/s"), len(signals)
    c, d, _ = plant.rows(WEIGHTED)
    C2, _, through = plant.rows(signals)
    size = np.array([acceptable.acceleration, acceptable.travel, acceptable.tyre])
    return Generalised(
        A=plant.A,
        B1=np.hstack([s * plant.G[:, np.newaxis], np.zeros((4, k))]),
        B2=acceptable.force * plant.B[:, np.newaxis],
        C1=np.vstack([c / size[:, np.newaxis], np.zeros(4)]),
        D12=np.append(acceptable.force * d / size, 1.0)[:, np.newaxis],
        C2=C2 / sigma[:, np.newaxis],
        D21=np.hstack([s * (through / sigma)[:, np.newaxis], np.eye(k)]),
    )


def h_infinity(
    plant: Suspension,
    signals: tuple[str, ...],
    noise: Array,
    *,
    road: float = 0.3,
    acceptable: Acceptable | None = None,
    above: float = ABOVE,
) -> HInfinity:
    """Design the controller.

    Parameters
    ----------
    plant : Suspension
        The car.
    signals : tuple of str
        What is read, of `qcar_env.control.suspension.OUTPUTS`.
    noise : array_like (k,)
        Size of the noise of each reading, in the signal's unit; positive.
    road : float
        Size of the road's rate [m/s].
    acceptable : Acceptable, optional
        Sizes of the outputs.
    above : float
        Gamma of the controller over the least one [-]; above 1.

    Raises
    ------
    ValueError
        If a number is out of range, or there is no controller.
    """
    if finite("above", above) <= 1.0:
        raise ValueError(f"above must be above 1, got {above:g}; give 1.2")
    limits = Acceptable() if acceptable is None else acceptable
    g = generalised(plant, signals, noise, road=road, acceptable=limits)
    low, high = 0.0, HIGHEST
    if _riccati(g, high) is None:
        raise ValueError(f"no H-infinity controller for {limits}; give numbers of a car")
    while high - low > CLOSE * high:
        middle = np.sqrt(low * high) if low else 0.1 * high
        if middle < 1.0 / HIGHEST:
            break
        low, high = (low, middle) if _riccati(g, middle) is not None else (middle, high)
    gamma = above * high
    found = _riccati(g, gamma)
    if found is None:
        raise ValueError(f"no H-infinity controller at gamma {gamma:g}; give another `above`")
    X, Y = found
    F1 = g.B1.T @ X / gamma**2
    F2 = -np.linalg.solve(g.D12.T @ g.D12, g.B2.T @ X + g.D12.T @ g.C1)
    L2 = -np.linalg.solve(g.D21 @ g.D21.T, g.C2 @ Y + g.D21 @ g.B1.T).T
    M = -np.linalg.solve(np.eye(4) - Y @ X / gamma**2, L2)
    N = g.A + g.B1 @ F1 - M @ (g.C2 + g.D21 @ F1)
    sigma = finite_array("noise", noise)
    controller = _sampled(
        plant, signals, N, M / sigma, g.B2[:, 0] / limits.force, limits.force * F2[0]
    )
    return HInfinity(controller=controller, gamma=gamma, least=high, plant=g, observer=(N, M, F2))


def _riccati(g: Generalised, gamma: float) -> tuple[Array, Array] | None:
    """Return X and Y, or None where this gamma is not possible."""
    w, k = g.B1.shape[1], len(g.C2)
    below = -gamma * gamma
    r_x = np.zeros((w + 1, w + 1))
    r_x[:w, :w], r_x[w:, w:] = below * np.eye(w), g.D12.T @ g.D12
    r_y = np.zeros((4 + k, 4 + k))
    r_y[:4, :4], r_y[4:, 4:] = below * np.eye(4), g.D21 @ g.D21.T
    s_x = np.hstack([np.zeros((4, w)), g.C1.T @ g.D12])
    s_y = np.hstack([np.zeros((4, 4)), g.B1 @ g.D21.T])
    try:
        X = solve_continuous_are(g.A, np.hstack([g.B1, g.B2]), g.C1.T @ g.C1, r_x, s=s_x)
        Y = solve_continuous_are(g.A.T, np.vstack([g.C1, g.C2]).T, g.B1 @ g.B1.T, r_y, s=s_y)
    except np.linalg.LinAlgError:
        return None
    for each in (X, Y):
        values = np.linalg.eigvalsh(0.5 * (each + each.T))
        if values[0] < -NEGATIVE * values[-1]:
            return None
    if np.max(np.abs(np.linalg.eigvals(X @ Y))) >= gamma * gamma:
        return None
    return X, Y


def _sampled(
    plant: Suspension, signals: tuple[str, ...], N: Array, M: Array, B2: Array, F2: Array
) -> Controller:
    """Return the observer ``q' = N q + M r + B2 f``, F = F2 q, sampled; in SI units.

    q_k is ``p_k + through r_k``, so that the newest reading counts at once. The last memory is the
    force of the interval before, which r is freed of.
    """
    _, d, _ = plant.rows(signals)
    half = 0.5 * plant.dt
    left = np.linalg.inv(np.eye(4) - half * N)
    turn, through = left @ (np.eye(4) + half * N), half * left @ M
    into = turn @ through + through
    A, B = np.zeros((5, 5)), np.zeros((5, len(signals)))
    A[:4, :4], A[:4, 4], B[:4] = turn, -into @ d, into
    direct = F2 @ through
    return Controller(
        name="H-infinity",
        signals=signals,
        A=A,
        B=B,
        E=np.append(left @ B2 * plant.dt, 1.0),
        C=np.append(F2, -direct @ d),
        D=direct,
    )
