"""Roll a policy out over many harmonic crossings at once, by the exact transition.

Under a held force and harmonic forcing the plant's motion over a control interval is exactly
linear in state, force and phasors (`qcar_env.physics.linear`). One matrix product moves all cars,
so that a policy with a batched `predict` costs about as much for fifty crossings as for one. The
environment's RK4 agrees to 1e-6 of the motion; a test holds the two together.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs import task
from qcar_env.evaluation.policy import Policy, actions_of, check_policy
from qcar_env.evaluation.tracks import Episode
from qcar_env.physics import linear
from qcar_env.physics.forcing import World
from qcar_env.physics.roads import Phasor
from qcar_env.physics.state import State
from qcar_env.validation import known, positive, whole

Array = NDArray[np.float64]

CHUNK = 1000  # intervals for which phasors are computed at once


@dataclass(frozen=True, kw_only=True)
class BatchRollout:
    """Time histories of n crossings, one row for each control interval."""

    episodes: tuple[Episode, ...]  # n
    t: Array  # (k,) time since the start, at the end of each interval [s]
    x: Array  # (k, n, 4) states (x1, x2, v1, v2) [m, m, m/s, m/s]
    force: Array  # (k, n, m) force held over the interval [m/s^2] or [N]
    terminated: NDArray[np.bool_]  # (n,) whether a displacement left its limit


class Crossings:
    """The exact maps of n harmonic crossings, ready to be stepped.

    Parameters
    ----------
    episodes : sequence of Episode
        Crossings with the same control interval and the same number of actuators.
    observe : {"full", "feedback"}
        What a policy is shown.
    observe_limit : bool
        Whether the force limit follows in the observation.

    Raises
    ------
    ValueError
        If there is no crossing, a road is not harmonic, or intervals or actuators differ.
    """

    def __init__(
        self,
        episodes: Sequence[Episode],
        *,
        observe: task.Observe = "full",
        observe_limit: bool = False,
    ) -> None:
        if not isinstance(episodes, Sequence) or not all(isinstance(e, Episode) for e in episodes):
            raise ValueError(
                f"episodes must be a sequence of Episode, got {type(episodes).__name__}; take them "
                "from qcar_env.evaluation.tracks.episodes"
            )
        if not episodes:
            raise ValueError("episodes must not be empty; give at least one")
        kinds = {(e.scenario.dt, e.scenario.actuator.size) for e in episodes}
        if len(kinds) > 1:
            raise ValueError(
                f"crossings rolled out together must share control interval and number of "
                f"actuators, got {sorted(kinds)}; roll them out apart"
            )
        for each in episodes:
            if each.scenario.road.profile != "harmonic":
                raise ValueError(
                    f"a batch takes harmonic roads, got {each.scenario.road.profile!r}; "
                    "use rollouts.rollout"
                )
        known("observe", observe, task.OBSERVE)
        self.episodes = tuple(episodes)
        (self.dt, self.actions), *_ = kinds
        shown = task.FULL_SIZE if observe == "full" else task.FEEDBACK_SIZE
        self._shown = [*range(shown), *([task.FULL_SIZE] if observe_limit else [])]
        maps, limits, begun = [], [], []
        for each in episodes:
            case = each.scenario
            step = linear.exact_transition(case.car, case.road, case.force, self.dt)
            push = np.diag(case.actuator.specific_limits(case.car))
            if self.actions == 1:
                push = push.sum(axis=1, keepdims=True)
            maps.append(np.hstack([step.A, step.B @ push, step.road, step.force]))
            limits.append(case.actuator.limit)
            own = each.nominal.with_force_scale(1.0 / each.force_scale)
            begun.append(
                task.begin(
                    State(*each.state),
                    each.phase,
                    each.factors,
                    task.nominal_numbers(each.nominal, own),
                )
            )
        self._maps = np.array(maps)  # (n, 4, 4 + m + 4)
        self.limits = np.array(limits)  # (n, m)
        self._omega = np.array([e.scenario.road.omega for e in episodes])
        self._Omega = np.array([e.scenario.force.Omega for e in episodes])
        self._start = np.array([e.start for e in begun])
        self._scales = task.Scales(*np.array([e.scales for e in begun]).T)
        # The observation is the state and the phasors times constants: those of ones.
        one = np.ones(len(episodes))
        entries = task.observe(
            State(one, one, one, one), World(Phasor(one, one), Phasor(one, one)), self._scales
        )
        self._unit = np.array(np.broadcast_arrays(*entries)).T[:, self._shown]
        self.start_states = np.array([e.state for e in episodes])  # (n, 4)

    def repeated(self, times: int) -> Crossings:
        """Return the same crossings `times` over, one whole set after the other."""
        whole("times", times)
        wide = copy.copy(self)
        wide.episodes = self.episodes * times
        wide._maps = np.tile(self._maps, (times, 1, 1))
        wide.limits = np.tile(self.limits, (times, 1))
        wide._omega, wide._Omega = np.tile(self._omega, times), np.tile(self._Omega, times)
        wide._start = np.tile(self._start, times)
        wide._scales = task.Scales(*(np.tile(each, times) for each in self._scales))
        wide._unit = np.tile(self._unit, (times, 1))
        wide.start_states = np.tile(self.start_states, (times, 1))
        return wide

    def worlds(self, first: int, count: int) -> Array:
        """Return the phasors of road and force at the beginning of some intervals.

        Parameters
        ----------
        first, count : int
            The first interval, and how many.

        Returns
        -------
        ndarray (count, n, 4)
            Sine and cosine of the road's angle, sine and cosine of the force's.
        """
        t = self._start + self.dt * np.arange(first, first + count)[:, np.newaxis]
        road, force = self._omega * t, self._Omega * t
        return np.stack([np.sin(road), np.cos(road), np.sin(force), np.cos(force)], axis=2)

    def observation(self, x: Array, world: Array) -> NDArray[np.float32]:
        """Return what a policy is shown of states `x` (n, 4) and a row of `worlds` (n, 4).

        Returns
        -------
        ndarray (n, entries)
        """
        # In the observation's order: road's sine and cosine, force's cosine and sine, one.
        one = np.ones((len(x), 1))
        everything = np.concatenate([x, world[:, :2], world[:, 3:1:-1], one], axis=1)
        shown = everything[:, self._shown] * self._unit
        high = task.OBSERVATION_LIMIT
        return np.minimum(np.maximum(shown, -high), high).astype(np.float32)

    def step(self, x: Array, action: Array, world: Array) -> Array:
        """Return the states after an interval under `action` (n, m), within [-1, 1]."""
        z = np.concatenate([x, action, world], axis=1)
        return np.matmul(self._maps, z[:, :, np.newaxis])[:, :, 0]

    def left(self, x: Array) -> NDArray[np.bool_]:
        """Return which cars have left their travel limits, shape (n,)."""
        scales = self._scales
        inside = (np.abs(x[:, 0] * scales.x1) <= scales.travel) & (
            np.abs(x[:, 1] * scales.x2) <= scales.travel
        )
        return ~inside


def batch_rollout(
    policy: Policy,
    episodes: Sequence[Episode],
    *,
    duration: float,
    observe: task.Observe = "full",
    observe_limit: bool = False,
) -> BatchRollout:
    """Run one policy over many crossings at once.

    Parameters
    ----------
    policy : Policy
        What acts. It is shown all crossings in one batch, and which of them have just begun.
    episodes : sequence of Episode
        The crossings.
    duration : float
        Length of each [s].
    observe : {"full", "feedback"}
        What the policy is shown.
    observe_limit : bool
        Whether the force limit follows in the observation.

    Returns
    -------
    BatchRollout
        A car that leaves its travel limits stays where it left them.

    Raises
    ------
    ValueError
        If the duration holds no control interval, the policy has no `predict`, or returns actions
        of the wrong shape or not a number, or see `Crossings`.
    """
    check_policy(policy)
    cars = Crossings(episodes, observe=observe, observe_limit=observe_limit)
    n = len(cars.episodes)
    steps = round(positive("duration", duration, "s") / cars.dt)
    if steps < 1:
        raise ValueError(
            f"duration must hold a control interval, got {duration:g} s with dt = {cars.dt:g} s; "
            f"give {cars.dt:g} s or more"
        )
    states = np.empty((steps, n, 4))
    force = np.empty((steps, n, cars.actions))
    x = cars.start_states
    gone = np.zeros(n, dtype=bool)
    memory: Any = None
    worlds = np.empty((0, n, 4))
    begins = np.ones(n, dtype=bool)
    never = np.zeros(n, dtype=bool)
    for k in range(steps):
        if k % CHUNK == 0:
            worlds = cars.worlds(k, min(CHUNK, steps - k))
        world = worlds[k % CHUNK]
        seen = cars.observation(x, world)
        action, memory = actions_of(policy, seen, memory, begins, cars.actions)
        begins = never
        if not np.isfinite(action).all():
            raise ValueError(
                f"action must be finite, got {action[~np.isfinite(action).all(axis=1)][0]} "
                f"{k * cars.dt:g} s after the start; allowed range is [-1, 1]"
            )
        action = np.minimum(np.maximum(action, -1.0), 1.0)
        following = cars.step(x, action, world)
        x = np.where(gone[:, np.newaxis], x, following) if gone.any() else following
        gone |= cars.left(x)
        states[k] = x
        force[k] = action * cars.limits
    return BatchRollout(
        episodes=cars.episodes,
        t=cars.dt * np.arange(1.0, steps + 1.0),
        x=states,
        force=force,
        terminated=gone,
    )


def window_steps(episode: Episode, periods: int) -> int:
    """Return how many control intervals hold the last `periods` whole periods of a crossing."""
    omega, dt = episode.scenario.road.omega, episode.scenario.dt
    return math.ceil(whole("periods", periods) * 2.0 * math.pi / (omega * dt) - 1e-9)


def steady_amplitudes(rollout: BatchRollout, periods: int) -> Array:
    """Return the largest |x1| and |x2| over the last whole periods, shape (n, 2) [m].

    Raises
    ------
    ValueError
        If the crossings are shorter than that.
    """
    found = np.empty((len(rollout.episodes), 2))
    for j, each in enumerate(rollout.episodes):
        count = window_steps(each, periods)
        if count > len(rollout.t):
            raise ValueError(
                f"crossings must hold {periods} periods ({count * each.scenario.dt:.3g} s), got "
                f"{len(rollout.t) * each.scenario.dt:.3g} s; roll out longer"
            )
        found[j] = np.abs(rollout.x[-count:, j, :2]).max(axis=0)
    return found


def steady_rho(rollout: BatchRollout, periods: int) -> Array:
    """Return ``max_i(a_i / A_i)`` over the last whole periods, shape (n,) [-].

    A_i are the crossing's own uncontrolled amplitudes: rho is the share of its vibration left.
    """
    reference = np.array([each.scenario.reference_amplitudes for each in rollout.episodes])
    return np.max(steady_amplitudes(rollout, periods) / reference, axis=1)
