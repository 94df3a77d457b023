"""Crossings under gain-scheduled linear laws, compiled: what policy search spends its time on.

The maps are those of `agents.crossing`, the gain tables those of `agents.networks.LawNet`. Each
law drives each car; only amplitudes and last states come back, and nothing is stored between.
"""

# pyright: basic, reportArgumentType=false
# numba has no types for what it compiles.

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.crossing import SIZE, Plants
from qcar_env.envs.task import OBSERVATION_LIMIT
from qcar_env.physics.engine import kernel

Array = NDArray[np.float64]


def cross(
    gains: Array,
    plants: Plants,
    z: Array,
    *,
    steps: int,
    window: int,
    road_nodes: Sequence[float] = (1.0,),
    force_nodes: Sequence[float] = (1.0,),
) -> tuple[Array, Array]:
    """Let each law drive each car.

    Parameters
    ----------
    gains : ndarray (k, J, m, size)
        Gains of k laws at J = len(road_nodes) len(force_nodes) nodes, the force's fastest; with
        size 4 they are for the state, with 8 for road and external force as well.
    plants : Plants
        Maps of n cars.
    z : ndarray (n, 8)
        Where the cars begin (see `agents.crossing.start`).
    steps, window : int
        Control intervals of a crossing, and how many at its end amplitudes are taken over.
    road_nodes, force_nodes : sequence of float
        Amplitudes over the nominal ones at which the nodes lie, rising [-]. Between them gains are
        interpolated, beyond them constant.

    Returns
    -------
    peak : ndarray (k, n, 2)
        Largest |x1|, |x2| in the window [m].
    last : ndarray (k, n, 8)
        Where the cars end.
    """
    k, n = len(gains), len(plants)
    peak, last = np.empty((k, n, 2)), np.empty((k, n, SIZE))
    source = np.abs(plants.O[0]).argmax(axis=0)  # the entry of z that each entry shows
    _cross(
        np.ascontiguousarray(gains, dtype=np.float64),
        plants.Z,
        plants.U,
        np.ascontiguousarray(plants.O[:, source, np.arange(SIZE)]),
        source,
        np.ascontiguousarray(z, dtype=np.float64),
        steps,
        window,
        np.array(road_nodes, dtype=np.float64),
        np.array(force_nodes, dtype=np.float64),
        OBSERVATION_LIMIT,
        peak,
        last,
    )
    return peak, last


@kernel
def _shares(amplitude: Any, nodes: Any, shares: Any) -> None:
    """Write the share of each node at an amplitude: hat functions, constant outside."""
    count = len(nodes)
    held = min(max(amplitude, nodes[0]), nodes[count - 1])
    for i in range(count):
        up = 1.0 if i == 0 else (held - nodes[i - 1]) / (nodes[i] - nodes[i - 1])
        down = 1.0 if i == count - 1 else (nodes[i + 1] - held) / (nodes[i + 1] - nodes[i])
        shares[i] = max(0.0, min(up, down, 1.0))


@kernel
def _cross(
    gains: Any,
    Z: Any,
    U: Any,
    scales: Any,
    source: Any,
    start: Any,
    steps: Any,
    window: Any,
    road_nodes: Any,
    force_nodes: Any,
    bound: Any,
    peak: Any,
    last: Any,
) -> None:
    laws, nodes, actions, size = gains.shape
    roads, forces = len(road_nodes), len(force_nodes)
    road, force = np.empty(roads), np.empty(forces)
    seen, z, after = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)
    u, here = np.empty(actions), np.empty((actions, size))
    for car in range(len(Z)):
        by, push, scale = Z[car], U[car], scales[car]
        for law in range(laws):
            for i in range(SIZE):
                z[i] = start[car, i]
            here[:, :] = gains[law, 0]
            first = second = 0.0
            for step in range(steps):
                for i in range(SIZE):
                    shown = scale[i] * z[source[i]]
                    seen[i] = min(max(shown, -bound), bound)
                if nodes > 1:
                    _shares(math.sqrt(seen[4] * seen[4] + seen[5] * seen[5]), road_nodes, road)
                    _shares(math.sqrt(seen[6] * seen[6] + seen[7] * seen[7]), force_nodes, force)
                    here[:, :] = 0.0
                    for i in range(roads):
                        for j in range(forces):
                            share = road[i] * force[j]
                            if share > 0.0:
                                for a in range(actions):
                                    for q in range(size):
                                        here[a, q] += share * gains[law, i * forces + j, a, q]
                for a in range(actions):
                    command = 0.0
                    for q in range(size):
                        command += here[a, q] * seen[q]
                    u[a] = min(max(command, -1.0), 1.0)
                for i in range(4):
                    moved = 0.0
                    for j in range(SIZE):
                        moved += z[j] * by[j, i]
                    for a in range(actions):
                        moved += u[a] * push[a, i]
                    after[i] = moved
                for i in range(4, SIZE):  # phasors turn among themselves
                    pair = 4 if i < 6 else 6
                    after[i] = z[pair] * by[pair, i] + z[pair + 1] * by[pair + 1, i]
                for i in range(SIZE):
                    z[i] = after[i]
                if step >= steps - window:
                    first, second = max(first, abs(z[0])), max(second, abs(z[1]))
            peak[law, car, 0], peak[law, car, 1] = first, second
            for i in range(SIZE):
                last[law, car, i] = z[i]
