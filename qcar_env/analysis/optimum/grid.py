"""Nodes in time, and the exact maps of the scaled car from one node to the next.

States are in uncontrolled amplitudes (rates in these times the frequency of the motion), forces in
their limits. Each step is divided further, for what happens between the nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.physics import linear
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]

SUBDIVISION = 16  # parts of a step between nodes, in which integrals and peaks are bounded
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
    amplitudes = np.array(scenario.reference_amplitudes)
    scale = np.concatenate([amplitudes, scenario.reference_frequency * amplitudes])
    push = np.diag(scenario.actuator.specific_limits(scenario.car))
    if scenario.actuator.actuation == "suspension":
        push = push.sum(axis=1, keepdims=True)  # one force on both masses
    lengths = np.diff(t)
    if start is None:
        unique, kind = lengths[:1], np.zeros(len(lengths), dtype=np.intp)
    else:
        unique, kind = np.unique(np.round(lengths, 12), return_inverse=True)
    steps: list[Step] = []
    drive = np.empty((len(kind), SUBDIVISION + 1, 4))
    on_road = np.stack(scenario.road.phasor(t[:-1]), axis=1)
    on_force = np.stack(scenario.force.phasor(t[:-1]), axis=1)
    for each, length in enumerate(unique):
        parts, answers, road, force = _parts(scenario, float(length))
        here = kind == each
        drive[here] = (
            np.einsum("jab,kb->kja", road, on_road[here])
            + np.einsum("jab,kb->kja", force, on_force[here])
        ) / scale
        parts = parts * scale / scale[:, np.newaxis]
        answers = answers @ push / scale[:, np.newaxis]
        steps.append(Step(parts=parts, held=answers, length=float(length)))
    plant = linear.matrices(scenario.car)
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
        limit=np.array(scenario.actuator.limit),
        matrix=plant.A * scale / scale[:, np.newaxis],
        into=plant.B @ push / scale[:, np.newaxis],
    )


def _parts(scenario: Scenario, length: float) -> tuple[Array, Array, Array, Array]:
    """Return the maps of state, held force, road and external force over the parts of a step.

    Each has shape (SUBDIVISION + 1, 4, ...), entry j for ``j / SUBDIVISION`` of `length` [s].
    """
    part = length / SUBDIVISION
    one = linear.exact_transition(scenario.car, scenario.road, scenario.force, part)
    power = np.zeros((SUBDIVISION + 1, 10, 10))
    power[0] = np.eye(10)
    step = np.block(
        [
            [one.A, one.B, one.road, one.force],
            [np.zeros((2, 4)), np.eye(2), np.zeros((2, 4))],
            [np.zeros((2, 6)), _turn(scenario.road.omega * part), np.zeros((2, 2))],
            [np.zeros((2, 8)), _turn(scenario.force.Omega * part)],
        ]
    )
    for j in range(SUBDIVISION):
        power[j + 1] = step @ power[j]
    return power[:, :4, :4], power[:, :4, 4:6], power[:, :4, 6:8], power[:, :4, 8:]


def _turn(angle: float) -> Array:
    """Return the matrix that turns a phasor ``(sin, cos)`` by `angle` [rad]."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, s], [-s, c]])
