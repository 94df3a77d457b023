"""The least vibration that any force within the limit can leave: a linear program.

The controlled plant is linear in state and force, so the smallest amplitude under ``|u_j| <= L_j``
is a convex problem. With forces held over intervals and the exact transition between nodes,

    minimise  a    subject to    x_{k+1} = A x_k + B u_k + d_k,    |u_k| <= L,
                                 -a <= w_i x_i(t_k) / A_i <= a    for every node k, mass i,

and ``x_n = x_0`` for a steady motion, or `x_0` given for a crossing. A_i are the uncontrolled
amplitudes, so that with weights 1 the value is rho = max_i(a_i / A_i): the share of the vibration
that must remain.

**Why it bounds every policy.** Take any policy, feedback or not, with memory or without, holding
its force for any time or none. Let u(t) be the force that it applies, |u_j| <= L_j, and x(t) the
bounded motion, in the limit |w_i x_i| / A_i <= r. The forcing repeats with period T. Shift force
and motion by 0, T, 2T, ... and average over the first N shifts: the average is again a motion of
the linear plant under the same forcing, its force is within L because L is a convex set, its
displacement within r for the same reason, and ``x(T) - x(0)`` of the average is that of the
original over N periods divided by N, which vanishes. A subsequence converges to a T-periodic
motion within r. Hence r is at least the least value over T-periodic forces u(t), whatever their
shape: the optimum of continuous time, which no sampling enters. (Forcing that only changes its
sign after T/2 allows the same with half periods and alternating signs: half the program.)

**The certificate.** For numbers y (one for each node and mass) with sum |y| <= 1 the largest
|w_i x_i| / A_i is at least sum y w x / A. The least of that sum over all forces is explicit, with
the adjoint lambda:

    lambda_k = C^T y_k + A^T lambda_{k+1}      z(t) = B^T exp(A^T (t_{k+1} - t)) lambda_{k+1}
    bound = sum_k lambda_{k+1} . d_k  -  sum_j L_j  integral |z_j(t)| dt.

The integral runs over continuous time, so `Optimum.bound` holds for forces of every shape and for
every control interval; it needs the program's dual only as a good y, and no trust in the solver.
|z| is integrated by the trapezoidal rule, which errs upward except for its curvature term
``max|z''| step^2 / 12``; that term is added.

**The margin.** `Optimum.upper` is what the found force achieves at every instant, between nodes
too; the optimum of continuous time lies in ``[bound, upper]``, and `Optimum.margin` is the width.

Source: S. Boyd, L. Vandenberghe, Convex Optimization, 2004, sections 5.2 and 5.8 (weak duality);
the averaging argument and the certificate in continuous time are worked out here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog, lsq_linear
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from qcar_env.physics import linear
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import (
    entries,
    finite,
    finite_array,
    known,
    non_negative,
    positive,
    shown,
    whole,
)

Array = NDArray[np.float64]
Objective = Literal["max", "sum", "rms"]
OBJECTIVES: tuple[Objective, ...] = ("max", "sum", "rms")

SUBDIVISION = 16  # parts of a step between nodes, in which integrals and peaks are bounded
LARGEST_RATIO = 32  # numerator and denominator of omega / Omega that still share a period
MOST_HOLDS = 2000  # holds in a program over the periods that a control interval nearly divides
MOST_NODES = 1_000_000  # in a program, chosen here: gigabytes and hours of the solver
HOLD_TOLERANCE = 1e-4  # how nearly [-]
FINE = 256  # holds in a period from which on one node in each is enough
COUNTED = 512  # nodes in a period at which the displacement is limited, at most
DENSE = 600  # forces up to which least squares uses an active set, exact to rounding
# The programs ask for no less than these [-], far below what anybody can tell from stillness: at
# zero every force that cancels is as good as another, and the solver wanders among them.
PERIOD_FLOOR = 1e-6
CROSSING_FLOOR = 1e-5


@dataclass(frozen=True, kw_only=True)
class Optimum:
    """The least vibration, the force that reaches it, and the proof that none does better.

    Values are in shares of the uncontrolled amplitudes: with ``objective="max"`` and weights 1,
    rho. States and nodes belong to the found force.
    """

    objective: Objective
    weights: tuple[float, float]  # of wheel and body [-]
    value: float  # of the program: the found force, measured at the nodes [-]
    dual: float  # value of the program's dual [-]
    upper: float  # the found force, measured at every instant (rms: at the nodes) [-]
    bound: float  # no force within the limit, of any shape, leaves less [-]
    amplitudes: tuple[float, float]  # largest |x1|, |x2| of the found force, at every instant [m]
    t: Array  # (n + 1,) nodes [s]
    x: Array  # (n + 1, 4) state at the nodes [m, m, m/s, m/s]
    u: Array  # (n, m) force held from each node to the next [m/s^2] or [N]
    hold: float  # time for which a force is held [s]
    status: str  # the solver's own words
    iterations: int  # of the solver

    @property
    def gap(self) -> float:
        """Distance between the values of program and dual [-]: what the solver left."""
        return abs(self.value - self.dual)

    @property
    def margin(self) -> float:
        """Width of the bracket around the optimum of continuous time [-]."""
        return self.upper - self.bound

    @property
    def rho(self) -> float:
        """Share of vibration that the found force leaves, ``max_i(a_i / A_i)``, as `upper`."""
        return self.upper


def period_optimum(
    scenario: str | Scenario,
    *,
    samples: int = 64,
    dt: float | None = None,
    inside: int | None = None,
    objective: Objective = "max",
    weights: Sequence[float] = (1.0, 1.0),
) -> Optimum:
    """Return the optimum of the steady motion on a harmonic road.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road, external force and actuator with its limit. What it draws is not looked at.
    samples : int
        Forces held in one period.
    dt : float, optional
        Instead of `samples`: hold each force for this long [s], as an environment does. A control
        interval that does not divide the period is taken over as many periods as it nearly does
        (to 1e-4, at most 2000 holds); `Optimum.hold` has what was used.
    inside : int, optional
        Nodes in each hold at which the displacement is limited. With 1 the program may buy calm
        samples with motion between them. By default 2, and 1 from 257 holds on, when the holds
        are short for that.
    objective : {"max", "sum", "rms"}
        ``max_i w_i a_i / A_i``, ``sum_i w_i a_i / A_i`` with `a_i` the largest |x_i|, or
        ``sqrt(mean(sum_i (w_i x_i / A_i)^2))`` over the nodes.
    weights : sequence of float
        ``(w1, w2)`` [-]; not negative. ``(1, 0)`` asks for the wheel alone.

    Returns
    -------
    Optimum

    Raises
    ------
    ValueError
        If the road is not harmonic, road and force share no period, or an argument is out of
        range.
    RuntimeError
        If the solver fails.
    """
    case = find_scenario(scenario)
    samples = whole("samples", samples, 2, MOST_NODES)
    w = _weights(weights)
    known("objective", objective, OBJECTIVES)
    period, half = _common_period(case)
    periods = 1
    if dt is not None:
        samples, periods = _commensurate(period, positive("dt", dt, "s"))
    nodes = 2 if samples <= FINE else 1
    if inside is not None:
        nodes = whole("inside", inside, most=max(1, MOST_NODES // samples))
    half = half and samples % 2 == 0 and periods % 2 == 1
    holds = samples // 2 if half else samples
    times: Array = periods * period / (samples * nodes) * np.arange(holds * nodes + 1.0)
    grid = _grid(case, times, nodes, closing=-1.0 if half else 1.0)
    every = max(1, samples * nodes // (COUNTED * periods))
    hold = period * periods / samples
    found = _solve(case, grid, None, objective, w, hold, every=every)
    return _unfold(found) if half else found


def crossing_optimum(
    scenario: str | Scenario,
    *,
    state: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    start: float = 0.0,
    duration: float | None = None,
    dt: float | None = None,
    inside: int = 1,
    after: float = 0.0,
    objective: Objective = "max",
    weights: Sequence[float] = (1.0, 1.0),
) -> Optimum:
    """Return the optimum of a crossing of finite length that begins in a given state.

    The force may know the whole road beforehand: no policy, which only sees the road as it comes,
    does better.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road of any profile, external force and actuator with its limit.
    state : array_like (4,)
        Start ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    start : float
        Time on the road at the start [s].
    duration : float, optional
        Length of the crossing [s]; the scenario's if left out.
    dt : float, optional
        How long each force is held [s]; the scenario's if left out.
    inside : int
        Nodes in each hold (see `period_optimum`); a kink of the road adds one.
    after : float
        Displacements count from this long after the start [s].
    objective, weights
        See `period_optimum`; the uncontrolled amplitudes are the scenario's reference.

    Returns
    -------
    Optimum

    Raises
    ------
    ValueError
        If an argument is out of range.
    RuntimeError
        If the solver fails.
    """
    case = find_scenario(scenario)
    x0 = finite_array("state", state)
    if x0.shape != (4,):
        raise ValueError(
            f"state must be four finite numbers (x1, x2, v1, v2), got {shown(state)}; "
            "give metres and metres a second"
        )
    w = _weights(weights)
    known("objective", objective, OBJECTIVES)
    inside = whole("inside", inside, most=MOST_NODES)
    hold = case.dt if dt is None else positive("dt", dt, "s")
    length = case.duration if duration is None else positive("duration", duration, "s")
    if length / hold * inside > MOST_NODES:
        raise ValueError(
            f"duration must be at most {MOST_NODES} nodes, got {length:g} s with dt = {hold:g} s "
            f"and inside = {inside}; give a shorter duration or a longer dt"
        )
    holds = round(length / hold)
    if holds < 1:
        raise ValueError(
            f"duration must hold a control interval, got {length:g} s with dt = {hold:g} s; "
            f"give {hold:g} s or more"
        )
    if non_negative("after", after, "s") >= holds * hold:
        raise ValueError(
            f"after must be below the duration of {holds * hold:g} s, got {after:g} s; "
            "give an earlier time"
        )
    begin = finite("start", start, "s")
    times: Array = begin + hold / inside * np.arange(holds * inside + 1, dtype=np.float64)
    kinks = np.array(case.road.kinks(times[0], times[-1]))
    number = np.arange(len(times)) / inside
    if kinks.size:  # a kink that falls on a node takes its place
        near = np.min(np.abs(times[:, np.newaxis] - kinks), axis=1) < 1e-9 * hold
        number = np.concatenate([number[~near], np.round((kinks - begin) / hold * 1e9) / 1e9])
        times = np.concatenate([times[~near], kinks])
        order = np.argsort(times)
        times, number = times[order], number[order]
    grid = _grid(case, times, inside, holds=np.floor(number[:-1] + 1e-9).astype(np.intp))
    return _solve(case, grid, x0, objective, w, hold, after=after)


@dataclass(frozen=True, kw_only=True)
class _Step:
    """The scaled plant over one length of step: states over A, forces over their limit."""

    A: Array  # (4, 4)
    B: Array  # (4, m)
    parts: Array  # (SUBDIVISION + 1, 4, 4) transition over j / SUBDIVISION of the step
    held: Array  # (SUBDIVISION + 1, 4, m) answer to a held force over the same
    length: float  # [s]


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Nodes, the steps between them, and what the world adds in each."""

    t: Array  # (n + 1,) [s]
    kind: NDArray[np.intp]  # (n,) which of `steps`
    steps: tuple[_Step, ...]
    drive: Array  # (n, 4) scaled
    drive_parts: Array  # (n, SUBDIVISION + 1, 4) scaled, over the parts of a step
    hold: NDArray[np.intp]  # (n,) which force acts
    closing: float  # 1: x_n = x_0, -1: x_n = -x_0, 0: x_0 is given
    scale: Array  # (4,) of the state
    limit: Array  # (m,) [m/s^2] or [N]
    matrix: Array  # (4, 4) scaled plant matrix
    into: Array  # (4, m) scaled input matrix


def _grid(
    case: Scenario,
    times: Array,
    inside: int,
    *,
    closing: float = 0.0,
    holds: NDArray[np.intp] | None = None,
) -> _Grid:
    amplitudes = np.array(case.reference_amplitudes)
    scale = np.concatenate([amplitudes, case.reference_frequency * amplitudes])
    limit = np.array(case.actuator.limit)
    push = np.diag(case.actuator.specific_limits(case.car))
    if case.actuator.actuation == "suspension":
        push = push.sum(axis=1, keepdims=True)  # one force on both masses
    plant = linear.matrices(case.car)
    into = plant.B @ push / scale[:, np.newaxis]
    matrix = plant.A * scale / scale[:, np.newaxis]
    lengths = np.diff(times)
    if closing:
        unique, kind = lengths[:1], np.zeros(len(lengths), dtype=np.intp)
    else:
        rounded = np.round(lengths, 12)
        unique, kind = np.unique(rounded, return_inverse=True)
    steps: list[_Step] = []
    drive = np.empty((len(kind), SUBDIVISION + 1, 4))
    on_road, on_force = case.road.phasor(times[:-1]), case.force.phasor(times[:-1])
    for each, length in enumerate(unique):
        parts, held, road, force = _parts(case, float(length))
        here = kind == each
        drive[here] = (
            np.einsum("jab,kb->kja", road, np.stack([on_road.s[here], on_road.c[here]], axis=1))
            + np.einsum(
                "jab,kb->kja", force, np.stack([on_force.s[here], on_force.c[here]], axis=1)
            )
        ) / scale
        parts = parts * scale / scale[:, np.newaxis]
        held = held @ push / scale[:, np.newaxis]
        steps.append(_Step(A=parts[-1], B=held[-1], parts=parts, held=held, length=float(length)))
    return _Grid(
        t=times,
        kind=kind.astype(np.intp),
        steps=tuple(steps),
        drive=drive[:, -1],
        drive_parts=drive,
        hold=np.arange(len(kind)) // inside if holds is None else holds,
        closing=closing,
        scale=scale,
        limit=limit,
        matrix=matrix,
        into=into,
    )


def _parts(case: Scenario, length: float) -> tuple[Array, Array, Array, Array]:
    """Return the maps of state, held force, road and external force over the parts of a step.

    Each has shape (SUBDIVISION + 1, 4, ...), entry j for ``j / SUBDIVISION`` of `length` [s].
    """
    part = length / SUBDIVISION
    one = linear.exact_transition(case.car, case.road, case.force, part)
    power = np.zeros((SUBDIVISION + 1, 10, 10))
    power[0] = np.eye(10)
    step = np.block(
        [
            [one.A, one.B, one.road, one.force],
            [np.zeros((2, 4)), np.eye(2), np.zeros((2, 4))],
            [np.zeros((2, 6)), _turn(case.road.omega * part), np.zeros((2, 2))],
            [np.zeros((2, 8)), _turn(case.force.Omega * part)],
        ]
    )
    for j in range(SUBDIVISION):
        power[j + 1] = step @ power[j]
    return power[:, :4, :4], power[:, :4, 4:6], power[:, :4, 6:8], power[:, :4, 8:]


def _turn(angle: float) -> Array:
    """Return the matrix that turns a phasor ``(sin, cos)`` by `angle` [rad]."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, s], [-s, c]])


def _solve(
    case: Scenario,
    grid: _Grid,
    x0: Array | None,
    objective: Objective,
    w: Array,
    hold: float,
    *,
    every: int = 1,
    after: float = 0.0,
) -> Optimum:
    start = None if x0 is None else x0 / grid.scale
    n = len(grid.kind)
    # Nodes that are unknown: 0 .. n - 1 of a closed motion, 1 .. n of a crossing.
    first = 0 if start is None else 1
    counted = grid.t[first : first + n] >= grid.t[0] + after - 1e-12
    if objective != "rms":
        counted &= np.arange(n) % every == 0
    equations, right = _dynamics(grid, start)
    if objective == "rms":
        x, u, y, dual, status, iterations = _least_squares(grid, equations, right, w, counted)
    else:
        x, u, y, dual, status, iterations = _program(grid, equations, right, w, counted, objective)
    nodes = np.vstack([x, grid.closing * x[:1]]) if start is None else np.vstack([start, x])
    forces = u[grid.hold]
    peaks = _peaks(grid, nodes, forces, after)
    at_nodes: Array = np.max(np.abs(x[counted, :2]), axis=0)
    mean_square = np.mean(np.sum((w * x[counted, :2]) ** 2, axis=1))
    value, upper = {
        "max": (np.max(w * at_nodes), np.max(w * peaks)),
        "sum": (w @ at_nodes, w @ peaks),
        "rms": (np.sqrt(mean_square), np.sqrt(mean_square)),
    }[objective]
    bound = max(0.0, _bound(grid, start, y))
    return Optimum(
        objective=objective,
        weights=(float(w[0]), float(w[1])),
        value=float(value),
        dual=float(dual),
        upper=float(upper),
        bound=float(bound),
        amplitudes=(float(peaks[0] * grid.scale[0]), float(peaks[1] * grid.scale[1])),
        t=grid.t,
        x=nodes * grid.scale,
        u=forces * grid.limit,
        hold=hold,
        status=status,
        iterations=iterations,
    )


def _dynamics(grid: _Grid, start: Array | None) -> tuple[csc_array, Array]:
    """Return the equations of motion as ``M (x, u) = right``, unknown states first."""
    n, m = len(grid.kind), grid.into.shape[1]
    a = np.stack([step.A for step in grid.steps])[grid.kind]  # (n, 4, 4)
    b = np.stack([step.B for step in grid.steps])[grid.kind]  # (n, 4, m)
    k = np.arange(n)
    row = 4 * k[:, np.newaxis, np.newaxis] + np.arange(4)[:, np.newaxis]  # (n, 4, 1)
    right = grid.drive.copy()
    if start is None:
        now, following, sign = k, (k + 1) % n, np.where(k == n - 1, grid.closing, 1.0)
    else:
        now, following, sign = k - 1, k, np.ones(n)
        right[0] += a[0] @ start
    columns = 4 * now[:, np.newaxis, np.newaxis] + np.arange(4)
    keep = slice(None) if start is None else slice(1, None)  # the first state is given
    blocks = [
        (np.broadcast_to(row, a.shape)[keep], np.broadcast_to(columns, a.shape)[keep], -a[keep]),
        (
            row[:, :, 0],
            4 * following[:, np.newaxis] + np.arange(4),
            np.repeat(sign[:, np.newaxis], 4, axis=1),
        ),
        (
            np.broadcast_to(row, b.shape),
            np.broadcast_to(
                4 * n + m * grid.hold[:, np.newaxis, np.newaxis] + np.arange(m), b.shape
            ),
            -b,
        ),
    ]
    rows, cols, values = (np.concatenate([part[i].ravel() for part in blocks]) for i in range(3))
    size = 4 * n + m * (int(grid.hold[-1]) + 1)
    return csc_array(coo_array((values, (rows, cols)), shape=(4 * n, size))), right.ravel()


def _program(
    grid: _Grid,
    equations: csc_array,
    right: Array,
    w: Array,
    counted: NDArray[np.bool_],
    objective: Objective,
) -> tuple[Array, Array, Array, float, str, int]:
    """Solve the linear program; return states, forces, multipliers y, dual value and status."""
    n, m = len(grid.kind), grid.into.shape[1]
    size = equations.shape[1]
    masses = np.flatnonzero(w)
    extra = 1 if objective == "max" else len(masses)
    node = np.flatnonzero(counted)
    # Rows: for each counted node and mass, +w x - a <= 0 and -w x - a <= 0.
    column = (4 * node[:, np.newaxis] + masses).ravel()
    which = size + (np.zeros_like(column) if extra == 1 else np.tile(np.arange(extra), len(node)))
    factor = np.tile(w[masses] if objective == "max" else np.ones(extra), len(node))
    count = len(column)
    rows = np.concatenate([np.arange(2 * count), np.arange(2 * count)])
    cols = np.concatenate([column, column, which, which])
    values = np.concatenate([factor, -factor, -np.ones(2 * count)])
    inequalities = coo_array((values, (rows, cols)), shape=(2 * count, size + extra))
    cost = np.zeros(size + extra)
    cost[size:] = 1.0 if objective == "max" else w[masses]
    bounds = np.empty((size + extra, 2))
    bounds[: 4 * n] = (-np.inf, np.inf)
    bounds[4 * n : size] = (-1.0, 1.0)
    floor = PERIOD_FLOOR if grid.closing else CROSSING_FLOOR
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
    if objective == "max":  # sum of all multipliers is 1
        y[np.ix_(node, masses)] = signed * w[masses] / max(float(total.sum()), 1e-300)
    else:  # of each mass its weight
        y[np.ix_(node, masses)] = signed * w[masses] / np.maximum(total.sum(axis=0), 1e-300)
    u = np.clip(result.x[4 * n : size].reshape(-1, m), -1.0, 1.0)
    return (
        _motion(grid, equations, right, u),
        u,
        y,
        float(dual),
        str(result.message),
        int(result.nit),
    )


def _least_squares(
    grid: _Grid, equations: csc_array, right: Array, w: Array, counted: NDArray[np.bool_]
) -> tuple[Array, Array, Array, float, str, int]:
    """Solve for the least mean square: bounded least squares in the forces (see `_program`)."""
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
    # The module's certificate for forces held as here: sum y x is linear in them.
    slope = _slope(grid, equations, y)
    dual = float(np.sum(y * x[:, :2]) - np.sum(slope * u) - np.sum(np.abs(slope)))
    return x, u, y, max(dual, 0.0), str(result.message), int(result.nit)


def _motion(grid: _Grid, equations: csc_array, right: Array, u: Array) -> Array:
    """Return the states at the nodes that follow from the forces, shape (n, 4)."""
    n = len(grid.kind)
    rest = right - equations[:, 4 * n :] @ u.ravel()
    return splu(equations[:, : 4 * n]).solve(rest).reshape(n, 4)


def _slope(grid: _Grid, equations: csc_array, y: Array) -> Array:
    """Return the gradient of ``sum y x`` to each held force, shape (holds, m)."""
    n, m = len(grid.kind), grid.into.shape[1]
    into = np.zeros((n, 4))
    into[:, :2] = y
    factors: Any = splu(equations[:, : 4 * n])
    adjoint: Array = factors.solve(into.ravel(), trans="T")
    return -(equations[:, 4 * n :].T @ adjoint).reshape(-1, m)


def _bound(grid: _Grid, start: Array | None, y: Array) -> float:
    """Return the least of ``sum y x`` over all forces of continuous time (see the module)."""
    n = len(grid.kind)
    a = np.stack([step.A for step in grid.steps])[grid.kind]
    into = np.zeros((n, 4))
    into[:, :2] = y
    adjoint = np.zeros((n, 4))  # adjoint[k] belongs to the node at the end of step k
    if start is None:
        # Backward from an unknown end: first the part that y makes, then the closing condition.
        free, through = np.zeros(4), np.eye(4)
        for k in range(n - 1, 0, -1):
            free = into[k] + a[k].T @ free
            through = a[k].T @ through
        matrix = grid.closing * np.eye(4) - a[0].T @ through
        adjoint[-1] = np.linalg.solve(matrix, into[0] + a[0].T @ free)
        for k in range(n - 1, 0, -1):
            adjoint[k - 1] = into[k] + a[k].T @ adjoint[k]
    else:
        adjoint[-1] = into[-1]
        for k in range(n - 1, 0, -1):
            adjoint[k - 1] = into[k - 1] + a[k].T @ adjoint[k]
    total = float(np.sum(adjoint * grid.drive))
    if start is not None:
        total += float(adjoint[0] @ a[0] @ start)
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


def _peaks(grid: _Grid, nodes: Array, forces: Array, after: float) -> Array:
    """Return the largest scaled |x1|, |x2| at any instant, bounded from above, shape (2,)."""
    peaks = np.zeros(2)
    for each, step in enumerate(grid.steps):
        here = (grid.kind == each) & (grid.t[1:] > grid.t[0] + after + 1e-12)
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


def _unfold(half: Optimum) -> Optimum:
    """Return a motion over half a period and its mirror image as one over the whole."""
    period = half.t[-1] - half.t[0]
    return Optimum(
        objective=half.objective,
        weights=half.weights,
        value=half.value,
        dual=half.dual,
        upper=half.upper,
        bound=half.bound,
        amplitudes=half.amplitudes,
        t=np.concatenate([half.t, half.t[1:] + period]),
        x=np.concatenate([half.x, -half.x[1:]]),
        u=np.concatenate([half.u, -half.u]),
        hold=half.hold,
        status=half.status,
        iterations=half.iterations,
    )


def _weights(weights: Sequence[float]) -> Array:
    found = np.array([non_negative("weight", each) for each in entries(weights)])
    if found.shape != (2,) or not np.any(found):
        raise ValueError(
            f"weights must be two numbers, one of them positive, got {shown(weights)}; give (1, 1)"
        )
    return found


def _common_period(case: Scenario) -> tuple[float, bool]:
    """Return the period of road and force together [s], and whether half of it turns their sign."""
    road, force = case.road, case.force
    if road.profile != "harmonic":
        raise ValueError(
            f"a steady motion needs a harmonic road, got {road.profile!r}; use crossing_optimum"
        )
    moving = [w for w, on in ((road.omega, road.h), (force.Omega, force.f)) if on and w > 0.0]
    if not moving:
        raise ValueError("nothing moves the car, got h = 0 and f = 0; give road or force a size")
    constant = bool(force.f) and force.Omega == 0.0
    if len(moving) == 1:
        return 2.0 * math.pi / moving[0], not constant
    ratio = moving[0] / moving[1]
    near = Fraction(ratio).limit_denominator(LARGEST_RATIO)
    if near == 0 or near.numerator > LARGEST_RATIO or abs(ratio / float(near) - 1.0) > 1e-9:
        raise ValueError(
            f"road and force must share a period, got omega / Omega = {ratio:.6g}, no ratio of "
            f"whole numbers up to {LARGEST_RATIO}; use crossing_optimum over a long time"
        )
    odd = near.numerator % 2 == 1 and near.denominator % 2 == 1
    return 2.0 * math.pi * near.numerator / moving[0], odd


def _commensurate(period: float, dt: float) -> tuple[int, int]:
    """Return the fewest holds and periods of equal length, to `HOLD_TOLERANCE`."""
    for periods in range(1, MOST_HOLDS):
        if periods * period / dt > MOST_HOLDS + 0.5:
            break
        holds = round(periods * period / dt)
        if holds >= 2 and abs(holds * dt / (periods * period) - 1.0) <= HOLD_TOLERANCE:
            return holds, periods
    raise ValueError(
        f"dt = {dt:g} s nearly divides no number of periods of {period:g} s within "
        f"{MOST_HOLDS} holds; give samples instead"
    )
