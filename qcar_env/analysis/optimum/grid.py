"""Nodes in time, and the exact maps of the scaled car from one node to the next.

States are in uncontrolled amplitudes (rates in these times the frequency of the motion), forces in
their limits. Each step is divided further, for what happens between the nodes.
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
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads.excitation import Excitation, harmonic
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]

SUBDIVISION = 16  # parts of a step between nodes, in which integrals and peaks are bounded
FLAT = harmonic(h=0.0, omega=1.0)  # in place of a road that is read
MOST_NODES = 1_000_000  # in a program, chosen here: gigabytes and hours of the solver


@dataclass(frozen=True, kw_only=True)
class Step:
    """The scaled plant over one length of step."""

    parts: Array  # (SUBDIVISION + 1, 4, 4) transition over j / SUBDIVISION of the step
    held: Array  # (SUBDIVISION + 1, 4, m) answer to a held force over the same
    length: float  # [s]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Nodes, the steps between them, and what the world adds in each."""

    t: Array  # (n + 1,) [s]
    kind: NDArray[np.intp]  # (n,) which of `steps`
    steps: tuple[Step, ...]
    drive_parts: Array  # (n, SUBDIVISION + 1, 4) scaled, over the parts of a step
    held: NDArray[np.intp]  # (n,) which force acts
    hold: float  # time for which a force is held [s]
    start: Array | None  # (4,) scaled x_0; None for a closed motion
    closing: float  # of a closed motion: 1 for x_n = x_0, -1 for x_n = -x_0
    begin: float  # from when on displacements count [s]
    scale: Array  # (4,) of the state
    limit: Array  # (m,) [m/s^2] or [N]
    matrix: Array  # (4, 4) scaled plant matrix
    into: Array  # (4, m) scaled input matrix

    @property
    def A(self) -> Array:
        """Transition over each step, (n, 4, 4)."""
        return np.stack([step.parts[-1] for step in self.steps])[self.kind]

    @property
    def B(self) -> Array:
        """Answer to the held force over each step, (n, 4, m)."""
        return np.stack([step.held[-1] for step in self.steps])[self.kind]

    @property
    def drive(self) -> Array:
        """What the world adds over each step, (n, 4)."""
        return self.drive_parts[:, -1]


def grid_of(
    scenario: Scenario,
    t: Array,  # (n + 1,) nodes [s]
    held: NDArray[np.intp],  # (n,) number of the force that acts in each step
    hold: float,  # time for which a force is held [s]
    *,
    start: Array | None = None,  # (4,) first state; a closed motion has none, and equal steps
    closing: float = 0.0,  # see `Grid`
    after: float = 0.0,  # displacements count from this long after the first node [s]
) -> Grid:
    """Return the grid of a scenario on given nodes."""
    car, road = scenario.car, scenario.excitation
    actuator: Any = scenario.actuator
    plant, push = linear.matrices(car), linear.actuation(car, actuator)
    amplitudes = np.array(scenario.reference_amplitudes)
    scale = np.concatenate([amplitudes, scenario.reference_frequency * amplitudes])
    lengths = np.diff(t)
    if start is None:
        unique, kind = lengths[:1], np.zeros(len(lengths), dtype=np.intp)
    else:
        unique, kind = np.unique(np.round(lengths, 12), return_inverse=True)
    steps: list[Step] = []
    drive = np.empty((len(kind), SUBDIVISION + 1, 4))
    on_road = _road_phasor(road, t) if road.turning else None
    on_force = np.stack(scenario.force.phasor(t[:-1]), axis=1)
    for each, length in enumerate(unique):
        turning = road if road.turning else FLAT
        parts, answers, from_road, from_force = _parts(car, turning, scenario.force, float(length))
        here = kind == each
        drive[here] = np.einsum("jab,kb->kja", from_force, on_force[here])
        if on_road is not None:
            drive[here] += np.einsum("jab,kb->kja", from_road, on_road[here])
        else:
            drive[here] += _read(plant, road, t[:-1][here], float(length), parts)
        for node, jump in _jumps(road, t):
            if here[node]:
                drive[node] += parts @ (plant.R[:, 1] * jump)  # the damped tyre throws the wheel
        drive[here] /= scale
        parts = parts * scale / scale[:, np.newaxis]
        answers = answers @ push / scale[:, np.newaxis]
        steps.append(Step(parts=parts, held=answers, length=float(length)))
    return Grid(
        t=t,
        kind=kind.astype(np.intp),
        steps=tuple(steps),
        drive_parts=drive,
        held=held,
        hold=hold,
        start=None if start is None else start / scale,
        closing=closing,
        begin=float(t[0] + after),
        scale=scale,
        limit=np.array(actuator.limit),
        matrix=plant.A * scale / scale[:, np.newaxis],
        into=plant.B @ push / scale[:, np.newaxis],
    )


def _road_phasor(road: Excitation, t: Array) -> Array:
    """Return the phasor of a turning road at the beginning of each step, (n, 2).

    It is turned back from the middle of the step, which is on the step's own piece of the road.
    """
    middle, omega = 0.5 * (t[:-1] + t[1:]), road.omega
    half = 0.5 * omega * np.diff(t)
    s, c = road.height(middle), road.rate(middle) / omega if omega else np.zeros_like(middle)
    size = 1.0 / road.h if road.h else 0.0
    turned = s * np.cos(half) - c * np.sin(half), c * np.cos(half) + s * np.sin(half)
    return size * np.stack(turned, axis=1)


def _read(
    plant: linear.Matrices, road: Excitation, begin: Array, length: float, parts: Array
) -> Array:
    """Return what a road that is read adds over the parts of steps from `begin` on.

    Each part by Gauss's rule of three points, whose error falls with its seventh power:
    ``integral exp(A (part - s)) R (y, y') ds``. Shape (k, SUBDIVISION + 1, 4).
    """
    part = length / SUBDIVISION
    points, weights = np.polynomial.legendre.leggauss(3)
    into = [
        0.5 * part * weight * expm(plant.A * (0.5 * part * (1.0 - point))) @ plant.R[:, :2]
        for point, weight in zip(points, weights, strict=True)
    ]
    found = np.zeros((len(begin), SUBDIVISION + 1, 4))
    for j in range(SUBDIVISION):
        found[:, j + 1] = found[:, j] @ parts[1].T
        for point, matrix in zip(points, into, strict=True):
            at = begin + part * (j + 0.5 * (1.0 + point))
            found[:, j + 1] += np.stack([road.height(at), road.rate(at)], axis=1) @ matrix.T
    return found


def _jumps(road: Excitation, t: Array) -> list[tuple[int, float]]:
    """Return the node at which each jump of the road's height falls, and the jump [m]."""
    speed = road.speed
    kinks = road.kinks(t[0], t[-1])
    jumps = road.road.jumps(t[0] * speed, t[-1] * speed)
    return [
        (int(np.argmin(np.abs(t - kink))), jump)
        for kink, jump in zip(kinks, jumps, strict=True)
        if jump != 0.0
    ]


def _parts(
    car: Car, road: Excitation, force: ExternalForce, length: float
) -> tuple[Array, Array, Array, Array]:
    """Return the maps of state, held force, turning road and external force over parts of a step.

    Each has shape (SUBDIVISION + 1, 4, ...), entry j for ``j / SUBDIVISION`` of `length` [s].
    """
    part = length / SUBDIVISION
    one = linear.exact_transition(car, road, force, part)
    power = np.zeros((SUBDIVISION + 1, 10, 10))
    power[0] = np.eye(10)
    step = np.block(
        [
            [one.A, one.B, one.road, one.force],
            [np.zeros((2, 4)), np.eye(2), np.zeros((2, 4))],
            [np.zeros((2, 6)), _turn(road.omega * part), np.zeros((2, 2))],
            [np.zeros((2, 8)), _turn(force.Omega * part)],
        ]
    )
    for j in range(SUBDIVISION):
        power[j + 1] = step @ power[j]
    return power[:, :4, :4], power[:, :4, 4:6], power[:, :4, 6:8], power[:, :4, 8:]


def _turn(angle: float) -> Array:
    """Return the matrix that turns a phasor ``(sin, cos)`` by `angle` [rad]."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, s], [-s, c]])
