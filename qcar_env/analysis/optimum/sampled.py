"""A linear car on a road at control intervals: exact maps, and what is limited in each.

The state is that of car and weighting filter, ``x = (x1, x2, v1, v2, filter)``. With a force held
over an interval,

    x_{k+1} = A x_k + B u_k + drive_k,        output = C x_k + D u_k + free_k

and so for every output inside the interval: `drive` and `free` are what the road does to a car that
starts the interval at rest. Matrix exponentials; the road by Gauss's rule on each smooth piece. The
mean of the weighted acceleration e over a cell is an output too: it is that of the integral q of e,
which the exponential carries as one more state.

Everything is scaled: states by the uncontrolled motion, the force by its limit, the travel by its
limit, the tyre's load by the load at rest, e by the objective of the uncontrolled motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from qcar_env.physics import linear
from qcar_env.physics.car import Car
from qcar_env.physics.motion import Input
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]

PARTS = 4  # of a cell, in which the found motion is read
GAUSS = 4  # points of the road in each part: exact to the seventh power of the distance
TERMS = 24  # of the exponential's series over a part, which is much shorter than a time constant
STIFFEST = 2.0  # rate times part [-] up to which these terms suffice: 2^25 / 25! = 2e-18


@dataclass(frozen=True, kw_only=True)
class Filter:
    """A linear filter ``z' = A z + B a,  e = C z + D a`` of the body's acceleration a."""

    A: Array  # (f, f)
    B: Array  # (f,)
    C: Array  # (f,)
    D: float


NO_FILTER = Filter(A=np.zeros((0, 0)), B=np.zeros(0), C=np.zeros(0), D=1.0)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Outputs of each interval, ``C x_k + D u_k + free_k``."""

    C: Array  # (r, s)
    D: Array  # (r,)
    free: Array  # (n, r)

    def at(self, x: Array, u: Array) -> Array:
        """Return the outputs (n, r) for states (n, s) at the intervals' beginnings, forces (n,)."""
        return x @ self.C.T + u[:, np.newaxis] * self.D + self.free

    def __truediv__(self, scale: float) -> Rows:
        """Return the outputs in units of `scale`."""
        return Rows(C=self.C / scale, D=self.D / scale, free=self.free / scale)


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """The scaled car over n intervals from rest."""

    t: Array  # (n + 1,) [s]
    A: Array  # (s, s)
    B: Array  # (s,)
    drive: Array  # (n, s)
    objective: Rows  # e at points of an interval, or its means over cells
    travel: Rows | None  # at nodes, to be within [-1, 1]; None without a limit
    load: Rows | None  # change of the tyre's load at nodes, to be above -1
    every: Rows  # e at all parts of an interval [m/s^2]: what the found motion is judged by
    travel_every: Rows  # [m]
    load_every: Rows  # load [N]
    rate: float  # largest change of the force from one control interval to the next; or infinite
    group: int  # intervals of the program in a control interval
    norm: float  # p of the objective's norm
    reference: float  # objective of the uncontrolled motion, and what e is scaled by
    scale: Array  # (s,) of the state
    matrix: Array  # (s + 1, s + 1) rate of state and q, scaled [1/s]
    into: Array  # (s + 1,) of the force
    node_travel: Array  # (s,) row of the travel; zeros without a limit
    node_load: Array  # (s,) row of the load; zeros without a limit

    @property
    def count(self) -> int:
        """Number of intervals n."""
        return len(self.drive)

    @property
    def length(self) -> float:
        """Length of an interval [s]."""
        return float(self.t[1] - self.t[0])

    def motion(self, u: Array) -> Array:
        """Return the states (n + 1, s) that follow from forces (n,)."""
        x = np.zeros((self.count + 1, len(self.B)))
        pushed = u[:, np.newaxis] * self.B + self.drive
        for k, push in enumerate(pushed):
            x[k + 1] = self.A @ x[k] + push
        return x


def sampled(
    scenario: Scenario,
    begin: float,  # [s]
    count: int,
    length: float,  # of an interval [s]
    *,
    inside: int,  # nodes in an interval
    group: int,
    norm: float,
    means: bool,  # limit the means of e over cells, and not e at their ends
    over: float,  # e is multiplied by this to the power 1 / norm before its norm is taken
    limit: float,  # of the force [N]
    travel: float | None,  # [m]
    rate: float,  # [N] from one control interval to the next
    contact: bool,
    filter: Filter,
) -> Sampled:
    """Return the car of a scenario over `count` intervals from `begin` on, where it is at rest."""
    parts = PARTS * inside
    plant = _Plant.of(scenario, filter, limit)
    fine = length / parts
    one = expm(plant.full * fine)
    maps = [np.eye(len(one))]
    for _ in range(parts):
        maps.append(one @ maps[-1])
    moved, world = plant.drive(begin, count * parts, fine)
    s = len(plant.matrix) - 1  # without q
    inner = np.zeros((count, parts + 1, s + 1))  # from rest at the interval's beginning
    moved = moved.reshape(count, parts, s + 1)
    for j in range(parts):
        inner[:, j + 1] = inner[:, j] @ maps[1][:-1, :-1].T + moved[:, j]
    index = np.arange(count)[:, np.newaxis] * parts + np.arange(parts + 1)
    world = world[index]  # (n, parts + 1, 3)

    def rows(row: Array, of_world: Array, at: list[int]) -> Rows:
        """Return the outputs ``row x + of_world w`` at some parts of the interval."""
        c = np.stack([row @ maps[j] for j in at])  # of (x, q, u)
        return Rows(
            C=c[:, :s],
            D=c[:, -1],
            free=inner[:, at] @ row[:-1] + world[:, at] @ of_world,
        )

    every, nodes = list(range(parts + 1)), list(range(0, parts + 1, PARTS))
    e = rows(plant.e, plant.e_world, every)
    if means:
        cell = length / inside
        q = np.zeros(s + 2)
        q[s] = 1.0 / cell
        whole = rows(q, np.zeros(3), nodes)
        objective = Rows(
            C=np.diff(whole.C, axis=0), D=np.diff(whole.D), free=np.diff(whole.free, axis=1)
        )
    else:
        objective = rows(plant.e, plant.e_world, nodes)
    distance = rows(plant.travel, np.zeros(3), every)
    load = rows(plant.load, plant.load_world, every)
    # Scales, from the uncontrolled motion
    A, B, drive = maps[-1][:s, :s], maps[-1][:s, -1], inner[:, -1, :s]
    x = np.zeros((count + 1, s))
    for k in range(count):
        x[k + 1] = A @ x[k] + drive[k]
    scale = np.abs(x).max(axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    share = over ** (1.0 / norm)
    free = objective.at(x[:-1], np.zeros(count))
    reference = float(np.linalg.norm(share * free.ravel(), norm))
    if not reference > 0.0:
        raise ValueError(
            "nothing moves the car on this stretch; give a road with a hump, or a longer duration"
        )

    def scaled(each: Rows) -> Rows:
        return Rows(C=each.C * scale, D=each.D, free=each.free)

    node = [PARTS * (j + 1) for j in range(inside)]

    def limited(row: Array, of_world: Array, by: float) -> tuple[Rows, Array]:
        return scaled(rows(row, of_world, node)) / by, row[:s] * scale / by

    at_travel = at_load = None
    node_travel = node_load = np.zeros(s)
    if travel is not None:
        at_travel, node_travel = limited(plant.travel, np.zeros(3), travel)
    if contact:
        at_load, node_load = limited(plant.load, plant.load_world, plant.load_at_rest)
    both = np.append(scale, reference / share)
    return Sampled(
        t=begin + length * np.arange(count + 1, dtype=np.float64),
        A=A * scale / scale[:, np.newaxis],
        B=B / scale,
        drive=drive / scale,
        objective=scaled(objective) / (reference / share),
        travel=at_travel,
        load=at_load,
        every=scaled(e),
        travel_every=scaled(distance),
        load_every=Rows(C=load.C * scale, D=load.D, free=load.free + plant.load_at_rest),
        rate=rate / limit,
        group=group,
        norm=norm,
        reference=reference,
        scale=scale,
        matrix=plant.matrix * both / both[:, np.newaxis],
        into=plant.into / both,
        node_travel=node_travel,
        node_load=node_load,
    )


@dataclass(frozen=True, kw_only=True)
class _Plant:
    """Car and filter in SI units: ``(x, q)' = matrix (x, q) + into u + by_world w``."""

    matrix: Array  # (s + 1, s + 1)
    into: Array  # (s + 1,) of the force over its limit
    by_world: Array  # (s + 1, 3) of ``w = (y, y', F)``
    e: Array  # (s + 2,) of the state, q and the force
    e_world: Array  # (3,)
    travel: Array  # (s + 2,)
    load: Array  # (s + 2,)
    load_world: Array  # (3,)
    load_at_rest: float  # [N]
    scenario: Scenario

    @property
    def full(self) -> Array:
        """Rate of state, q and held force."""
        m = np.zeros((len(self.into) + 1,) * 2)
        m[:-1, :-1], m[:-1, -1] = self.matrix, self.into
        return m

    @classmethod
    def of(cls, scenario: Scenario, filter: Filter, limit: float) -> _Plant:
        car, actuator = scenario.car, scenario.actuator
        plant = linear.matrices(car)
        push = linear.actuation(car, actuator)[:, 0] * (limit / actuator.limit[0])
        f = len(filter.B)
        s = 4 + f
        b = plant.B @ push
        a2, a2_u, a2_world = plant.A[3], b[3], plant.R[3]
        matrix, into, by_world = np.zeros((s + 1, s + 1)), np.zeros(s + 1), np.zeros((s + 1, 3))
        matrix[:4, :4], into[:4], by_world[:4] = plant.A, b, plant.R
        matrix[4:s, :4], matrix[4:s, 4:s] = np.outer(filter.B, a2), filter.A
        into[4:s], by_world[4:s] = filter.B * a2_u, np.outer(filter.B, a2_world)
        e = np.concatenate([filter.D * a2, filter.C, [0.0, filter.D * a2_u]])
        matrix[s], into[s], by_world[s] = e[: s + 1], e[-1], filter.D * a2_world
        travel = np.zeros(s + 2)
        travel[:2] = -1.0, 1.0
        load, load_world, at_rest = _tyre(car)
        return cls(
            matrix=matrix,
            into=into,
            by_world=by_world,
            e=e,
            e_world=filter.D * a2_world,
            travel=travel,
            load=np.concatenate([load, np.zeros(s - 2)]),
            load_world=load_world,
            load_at_rest=at_rest,
            scenario=scenario,
        )

    def drive(self, begin: float, count: int, part: float) -> tuple[Array, Array]:
        """Return what the world adds to state and q over each part, (count, s + 1).

        And the world itself at the parts' ends, (count + 1, 3).
        """
        road, force = self.scenario.excitation, self.scenario.force
        ends = begin + part * np.arange(count + 1)
        kinks = np.array(road.kinks(float(ends[0]), float(ends[-1])))
        jumps = np.array(road.road.jumps(float(ends[0]) * road.speed, float(ends[-1]) * road.speed))
        t = np.sort(np.concatenate([ends, kinks]))
        t = t[np.append(True, np.diff(t) > 1e-9 * part)]
        points, weights = np.polynomial.legendre.leggauss(GAUSS)
        half = 0.5 * np.diff(t)[:, np.newaxis]
        at = t[:-1, np.newaxis] + half * (1.0 + points)  # (pieces, GAUSS)
        into = np.clip(np.searchsorted(ends, t[:-1] + half[:, 0]) - 1, 0, count - 1)
        w = np.stack([road.height(at), road.rate(at), force.value(at)], axis=-1)
        impulse = (half * weights)[..., np.newaxis] * (w @ self.by_world.T)
        left = ends[into + 1][:, np.newaxis] - at
        found = np.zeros((count, len(self.into)))
        np.add.at(found, into, self._carried(impulse, left).sum(axis=1))
        for kink, jump in zip(kinks, jumps, strict=True):
            if jump:  # the damped tyre throws the wheel: y' is a pulse of area `jump`
                k = min(int(np.searchsorted(ends, kink, side="right")) - 1, count - 1)
                thrown = self.by_world[:, 1] * jump
                found[k] += self._carried(thrown, np.array(ends[k + 1] - kink))
        return found, np.stack([road.height(ends), road.rate(ends), force.value(ends)], axis=-1)

    def _carried(self, impulse: Array, left: Array) -> Array:
        """Return ``exp(matrix left) impulse`` by its series, for impulses (..., s + 1)."""
        term, total = impulse, impulse.copy()
        for k in range(1, TERMS + 1):
            term = (term @ self.matrix.T) * (left / k)[..., np.newaxis]
            total += term
        return total


def _tyre(car: Car) -> tuple[Array, Array, float]:
    """Return how the tyre's load follows state and world (4,) (3,), and the load at rest [N]."""
    functions = car.functions
    c = functions.prepare(car.numbers)

    def load(*given: float) -> float:
        x, y, y_dot = State(*given[:4]), given[4], given[5]
        return float(functions.tyre_load(x, Input(functions.road_input(y, y_dot, c), 0.0), c))

    rest = load(*np.zeros(6))
    slopes = [load(*each) - rest for each in np.eye(6)]
    return np.array(slopes[:4]), np.array([*slopes[4:], 0.0]), rest


def stiffness(filter: Filter, car: Car) -> float:
    """Return the fastest rate of car and filter [1/s]."""
    values: Any = [*linear.poles(car), *np.linalg.eigvals(filter.A)]
    return max(math.hypot(each.real, each.imag) for each in values)
