"""Crossings of many cars on harmonic roads, each control interval one matrix product.

With a held force and harmonic forcing an interval is exactly a linear map of the state, the two
phasors and the forces. `qcar_env.physics.linear.rk4_transition` makes that map from the equations
of motion themselves, so nothing is integrated here and nothing written a second time:

    z = (x1, x2, v1, v2, road s, c, force s, c)      z' = z Z + a U      observation = z O

Search and training need millions of intervals with one map for many cars; this is the fastest way
to have them. Trajectories agree with the environment to rounding (a test).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs import task
from qcar_env.evaluation.tracks import Episode
from qcar_env.physics import linear
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]

SIZE = 8  # entries of z: state, road phasor, force phasor


@dataclass(frozen=True, kw_only=True)
class Plants:
    """Maps of n cars."""

    Z: Array  # (n, 8, 8) of state and phasors over an interval
    U: Array  # (n, m, 8) of the action over an interval
    O: Array  # (n, 8, 8) of state and phasors to the full observation  # noqa: E741
    limit: Array  # (n,) force limit over the nominal one [-]
    own: Array  # (n, 2) each car's own uncontrolled amplitudes [m]
    dt: float  # [s]

    def __len__(self) -> int:
        """Return the number of cars."""
        return len(self.Z)

    def pick(self, index: NDArray[np.int64]) -> Plants:
        """Return the plants at `index` (k,)."""
        return Plants(
            Z=self.Z[index],
            U=self.U[index],
            O=self.O[index],
            limit=self.limit[index],
            own=self.own[index],
            dt=self.dt,
        )


def plants(nominal: Scenario, episodes: Sequence[Scenario]) -> Plants:
    """Return the maps of scenarios that do not vary any more.

    Parameters
    ----------
    nominal : Scenario
        Scales the observation (see `qcar_env.envs.task.scales`), and gives limit 1.
    episodes : sequence of Scenario
        What the cars drive, on harmonic roads.

    Raises
    ------
    ValueError
        If a road is not harmonic: its kinks are no linear map.
    """
    Z, U, O, limit = [], [], [], []  # noqa: E741
    known: dict[Scenario, tuple[Array, Array, Array, float]] = {}
    for each in episodes:
        if each not in known:
            known[each] = _maps(nominal, each)
        for stack, value in zip((Z, U, O, limit), known[each], strict=True):
            stack.append(value)
    return Plants(
        Z=np.array(Z),
        U=np.array(U),
        O=np.array(O),
        limit=np.array(limit),
        own=np.array([each.reference_amplitudes for each in episodes]),
        dt=nominal.dt,
    )


def start(state: Array, phase: Array) -> Array:
    """Return z at the start, shape (n, 8).

    Parameters
    ----------
    state : ndarray (n, 4)
        ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    phase : ndarray (n,)
        Phase of the road [rad]; the external force has the same where ``Omega = omega``, which
        is the only case that this is used for.
    """
    s, c = np.sin(phase)[:, None], np.cos(phase)[:, None]
    return np.concatenate([state, s, c, s, c], axis=1)


def observations(
    z: Array, plants: Plants, observe: task.Observe, observe_limit: bool
) -> NDArray[np.float32]:
    """Return what the cars' policies see, shape (n, k), as the environment shows it."""
    size = task.observation_size(observe, False)
    full = np.matmul(z[:, None, :], plants.O)[:, 0, :size]
    if observe_limit:
        full = np.concatenate([full, plants.limit[:, None]], axis=1)
    return np.clip(full, -task.OBSERVATION_LIMIT, task.OBSERVATION_LIMIT).astype(np.float32)


def advance(z: Array, action: Array, plants: Plants) -> Array:
    """Return z after an interval under a held `action` (n, m), which is clipped to [-1, 1]."""
    a = np.clip(action, -1.0, 1.0)
    return np.matmul(z[:, None, :], plants.Z)[:, 0] + np.matmul(a[:, None, :], plants.U)[:, 0]


def of_track(episodes: Sequence[Episode], full_limit: Scenario) -> tuple[Plants, Array]:
    """Return plants and starts of a track's episodes.

    Parameters
    ----------
    episodes : sequence of Episode
        From `qcar_env.evaluation.tracks.episodes`.
    full_limit : Scenario
        The track's nominal scenario, whose force limit counts as 1 in the observation.
    """
    found = plants(full_limit, [each.scenario for each in episodes])
    z = start(
        np.array([each.state for each in episodes]), np.array([each.phase for each in episodes])
    )
    return found, z


def _maps(nominal: Scenario, episode: Scenario) -> tuple[Array, Array, Array, float]:
    if episode.road.profile != "harmonic" or episode.force.Omega != episode.road.omega:
        raise ValueError(
            f"cars in one linear map need a harmonic road and Omega = omega, got "
            f"{episode.road.profile!r}; use the environment itself"
        )
    step = linear.rk4_transition(
        episode.car, episode.road, episode.force, episode.dt, episode.substeps
    )
    Z = np.zeros((SIZE, SIZE))
    Z[:4, :4] = step.A.T
    Z[4:6, :4] = step.road.T
    Z[6:8, :4] = step.force.T
    for at, omega in ((4, episode.road.omega), (6, episode.force.Omega)):
        s, c = np.sin(omega * episode.dt), np.cos(omega * episode.dt)
        Z[at : at + 2, at : at + 2] = [[c, -s], [s, c]]
    limits = episode.actuator.specific_limits(episode.car)
    if episode.actuator.size == 1:
        U = (step.B @ np.array(limits))[None, :]
    else:
        U = (step.B * np.array(limits)).T
    scales = task.scales(nominal, episode)
    O = np.zeros((SIZE, SIZE))  # noqa: E741
    for row, column, scale in (
        (0, 0, scales.x1),
        (1, 1, scales.x2),
        (2, 2, scales.v1),
        (3, 3, scales.v2),
        (4, 4, scales.y),
        (5, 5, scales.y_dot),
        (7, 6, scales.F),
        (6, 7, -scales.F_dot),
    ):
        O[row, column] = scale
    return Z, np.concatenate([U, np.zeros((len(U), 4))], axis=1), O, float(scales.limit)
