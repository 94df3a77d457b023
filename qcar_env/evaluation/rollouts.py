"""Roll a policy out through the fleet, over one episode or many at once, and keep the histories.

Every number of an experiment comes from here: of any scenario that an environment takes, stepped as
the environments step it, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.engine.cars import NEXT_STEP, Cars
from qcar_env.engine.random import streams
from qcar_env.engine.starts import MOTION_DRAWS, NOISE_DRAWS
from qcar_env.envs import episode as task
from qcar_env.evaluation import metrics
from qcar_env.evaluation.policy import Policy, actions_of, check_policy, shown_to
from qcar_env.evaluation.tracks import Episode
from qcar_env.physics.peaks import largest_between
from qcar_env.physics.signals import Signal, signal
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.plan import Plan
from qcar_env.validation import finite, positive, whole

Array = NDArray[np.float64]

REST = (0.0, 0.0, 0.0, 0.0)
UNSCALED = 1e6  # what a kept signal is divided by: far within the bound of an observation


@dataclass(frozen=True, kw_only=True)
class Rollout:
    """Time histories of one episode, one row for each control interval."""

    t: Array  # (k,) time since the start, at the end of each interval [s]
    x1: Array  # (k,) wheel displacement [m]
    x2: Array  # (k,) body displacement [m]
    v1: Array  # (k,) wheel velocity [m/s]
    v2: Array  # (k,) body velocity [m/s]
    force: Array  # (k, m) force of each actuator then [m/s^2] or [N]
    reward: Array  # (k,) [-]
    terminated: bool  # whether a displacement left its limit
    scenario: Scenario  # as drawn
    before: tuple[float, float, float, float]  # x1, x2, v1, v2 when the first interval begins
    signals: Mapping[str, Array] = field(default_factory=dict[str, Array])  # (k,) others, by name
    phase: float = 0.0  # of an endless road at the start [rad]

    def window(self, periods: int | None) -> slice:
        """Return the rows that amplitudes are taken over: the last whole periods, or all for None.

        All as well of an episode that left its limits.

        Raises
        ------
        ValueError
            If the episode is shorter than that, or its road has no periods.
        """
        check_periods(periods, self.scenario)
        if periods is None or self.terminated:
            return slice(None)
        return metrics.last_periods(self.t, self.scenario.excitation.omega, periods)

    def amplitudes(self, periods: int | None) -> tuple[float, float]:
        """Return the largest ``|x1|`` and ``|x2|`` at every instant [m] (see `window`)."""
        first = self.window(periods).start or 0
        rows = (each[max(first - 1, 0) :] for each in (self.x1, self.x2, self.v1, self.v2))
        states = np.stack(tuple(rows), axis=1)
        if not first:
            states = np.vstack([self.before, states])
        (x0, v0), (x1, v1) = ((each[:, :2], each[:, 2:]) for each in (states[:-1], states[1:]))
        a1, a2 = largest_between(x0, v0, x1, v1, self.scenario.dt).max(axis=0)
        return float(a1), float(a2)

    def rho(self, periods: int | None) -> float:
        """Return `metrics.rho` of the episode (see `window`): the share of its vibration left."""
        return metrics.rho(self.amplitudes(periods), self.scenario.reference_amplitudes)


@dataclass(frozen=True, kw_only=True)
class Rollouts:
    """Time histories of n episodes; a car that leaves its limits stays where it left them."""

    episodes: tuple[Episode, ...]  # n
    duration: float  # of each [s]
    t: Array  # (k,) time since the start, at the end of each interval [s]
    before: Array  # (n, 4) states when the first interval that is kept begins
    x: Array  # (k, n, 4) states (x1, x2, v1, v2) [m, m, m/s, m/s]
    force: Array  # (k, n, m) force of each actuator then [m/s^2] or [N]
    reward: Array  # (k, n) [-]
    signals: Mapping[str, Array]  # (k, n) others, by name
    lasted: NDArray[np.intp]  # (n,) rows until the episode's end
    terminated: NDArray[np.bool_]  # (n,) whether a displacement left its limit

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.episodes)

    def __getitem__(self, j: int) -> Rollout:
        """Return one episode until its end."""
        scenario = self.episodes[j].scenario
        if scenario.duration != self.duration:
            scenario = dataclasses.replace(scenario, duration=self.duration)
        return self._one(j, scenario)

    def _one(self, j: int, scenario: Scenario) -> Rollout:
        k = slice(0, int(self.lasted[j]))
        state = dict(zip(("x1", "x2", "v1", "v2"), self.x[k, j].T, strict=True))
        x1, x2, v1, v2 = self.before[j].tolist()
        return Rollout(
            **state,
            t=self.t[k],
            force=self.force[k, j],
            reward=self.reward[k, j],
            terminated=bool(self.terminated[j]),
            scenario=scenario,
            before=(x1, x2, v1, v2),
            signals={name: each[k, j] for name, each in self.signals.items()},
            phase=self.episodes[j].phase,
        )

    def rho(self, periods: int | None) -> Array:
        """Return `Rollout.rho` of each episode, shape (n,)."""
        return np.array(
            [
                metrics.rho(self._one(j, each.scenario).amplitudes(periods), each.uncontrolled)
                for j, each in enumerate(self.episodes)
            ]
        )


def check_periods(periods: int | None, scenario: Scenario) -> None:
    """Refuse a steady motion where there is none."""
    if periods is not None and not scenario.excitation.harmonic:
        raise ValueError(
            f"the last {periods} periods need a steady motion, and scenario {scenario.name!r} has "
            "none: its road is not harmonic; give periods=None for the largest of the whole episode"
        )


def rollout(
    policy: Policy,
    scenario: Scenario,
    *,
    duration: float | None = None,
    observe: task.Observe | None = None,
    state: ArrayLike = REST,
    phase: float = 0.0,
    seed: int = 0,
    signals: Sequence[str | Signal] = (),
) -> Rollout:
    """Run one episode.

    Parameters
    ----------
    policy : Policy
        What acts.
    scenario : Scenario
        What it acts in.
    duration : float, optional
        Length of the episode [s]; the scenario's if left out.
    observe : {"full", "feedback"} or sequence, optional
        What the policy is shown; what it says itself that it reads if left out, and ``"full"`` if
        it says nothing.
    state : array_like (4,)
        Start ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    phase : float
        Phase of the road at the start [rad].
    seed : int
        Of the draw, for scenarios that vary: that of the environment's episode.
    signals : sequence
        What is kept besides (see `rollouts`).

    Raises
    ------
    ValueError
        If the policy has no `predict`, or returns an action of the wrong shape or one that is not
        a number, or an argument is out of range.
    """
    whole("seed", seed, least=0)
    draws = np.random.default_rng(seed).random(len(scenario.randomisation))
    x1, x2, v1, v2 = task.given_state(state, scenario).tolist()
    case = Episode(
        nominal=scenario,
        force_scale=1.0,
        uniforms=tuple(draws.tolist()),
        state=(x1, x2, v1, v2),
        phase=finite("phase", phase, "rad"),
    )
    return rollouts(policy, [case], duration=duration, observe=observe, signals=signals)[0]


def rollouts(
    policy: Policy,
    episodes: Sequence[Episode],
    *,
    duration: float | None = None,
    observe: task.Observe | None = None,
    observe_limit: bool | None = None,
    signals: Sequence[str | Signal] = (),
    last: int | None = None,
) -> Rollouts:
    """Run one policy over many episodes at once.

    Parameters
    ----------
    policy : Policy
        What acts. It is shown all cars in one batch, and which of them have just begun; a car whose
        episode has ended early begins another, which is not kept.
    episodes : sequence of Episode
        With the same parts, control interval and number of actuators.
    duration : float, optional
        Length of each [s]; the scenario's if left out.
    observe : {"full", "feedback"} or sequence, optional
        What the policy is shown; what it says itself that it reads if left out, and ``"full"`` if
        it says nothing.
    observe_limit : bool, optional
        Whether the force limit follows in the observation; as the policy says if left out.
    signals : sequence
        Names of `qcar_env.physics.signals.SIGNALS`, or signals of one's own, which are kept besides
        state, forces and rewards; to single precision.
    last : int, optional
        Keep so many rows at the end; all if left out.

    Raises
    ------
    ValueError
        If there is no episode or they do not fit together; if the duration holds no control
        interval; if the policy has no `predict`, or returns actions of the wrong shape or not a
        number.
    """
    check_policy(policy)
    reads, with_limit = shown_to(policy, "full")
    shown = task.observed(
        reads if observe is None else observe,
        with_limit if observe_limit is None else observe_limit,
    )
    kept = tuple(dataclasses.replace(signal(each), scale=UNSCALED) for each in signals)
    cars, lasting = fleet(episodes, (*shown, *kept), duration)
    n, size, dt, steps = cars.n, cars.actions, lasting.dt, lasting.steps
    rows = steps if last is None else min(whole("last", last), steps)
    x, force = np.empty((rows, n, 4)), np.empty((rows, n, size))
    reward, others = np.empty((rows, n)), np.empty((rows, n, len(kept)))
    given = np.array([(*each.state, each.phase) for each in episodes], dtype=np.float64)
    # State and phase are given, so that what they would be drawn from does not matter. Sensors
    # have noise of their own in each episode.
    uniforms = np.zeros((n, cars.uniforms.shape[1]))
    uniforms[:, -MOTION_DRAWS - NOISE_DRAWS] = np.random.default_rng(0).random(n)
    for row, each in zip(uniforms, episodes, strict=True):
        row[: len(each.uniforms)] = each.uniforms
    seen = cars.reset(np.ones(n, dtype=bool), given, uniforms)
    begins, over = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    lasted = np.full(n, rows)
    end: Any = None  # states of cars whose episodes are over
    memory: Any = None
    before = cars.states
    for k in range(steps):
        shown_now = np.ascontiguousarray(seen[:, : len(shown)])
        action, memory = actions_of(policy, shown_now, memory, begins, size)
        if not np.isfinite(action).all():
            raise ValueError(
                f"action must be finite, got {action[~np.isfinite(action).all(axis=1)][0]} "
                f"{k * dt:g} s after the start; allowed range is [-1, 1]"
            )
        clipped = np.clip(action, -1.0, 1.0).astype(np.float32)
        seen, rewards, pushed, ends, begun = cars.step(clipped, NEXT_STEP)
        begins = np.zeros(n, dtype=bool)
        if begun is not None:
            begins[begun.cars] = True
        row = k - (steps - rows)
        out = ends[0] & ~over
        if row >= -1 or out.any():
            states = cars.states
            if over.any():
                states[over] = end[over]
            if row == -1:
                before = states
            if row >= 0:
                x[row], force[row], reward[row] = states, pushed, rewards[0]
                others[row] = seen[:, len(shown) :]
            if out.any():
                lasted[out] = max(1, row + 1)
                end, over = states, over | out
    return Rollouts(
        episodes=tuple(episodes),
        duration=lasting.duration,
        t=dt * np.arange(steps - rows + 1, steps + 1, dtype=np.float64),
        before=before,
        x=x,
        force=force,
        reward=reward,
        signals={each.name: others[:, :, i] * UNSCALED for i, each in enumerate(kept)},
        lasted=lasted,
        terminated=over,
    )


def fleet(
    episodes: Any, observed: tuple[Signal, ...], duration: float | None = None
) -> tuple[Cars, Scenario]:
    """Return cars that draw from what the episodes do, and a scenario of their length.

    Parameters
    ----------
    episodes : sequence of Episode
        With the same parts, control interval and number of actuators; one car each.
    observed : tuple of Signal
        What the cars show.
    duration : float, optional
        Length of each [s]; the scenario's if left out.
    """
    if not isinstance(episodes, Sequence) or not all(isinstance(e, Episode) for e in episodes):
        raise ValueError(
            f"episodes must be a sequence of Episode, got {type(episodes).__name__}; take them "
            "from qcar_env.evaluation.tracks.episodes"
        )
    if not episodes:
        raise ValueError("episodes must not be empty; give at least one")
    length = None if duration is None else positive("duration", duration, "s")
    settings = task.Settings(observed, False, "amplitudes", length, None)
    plans: dict[tuple[Scenario, float], Plan] = {}
    members: dict[tuple[Scenario, float], list[int]] = {}
    for i, each in enumerate(episodes):
        key = (each.nominal, each.force_scale)
        if key not in plans:
            plans[key] = settings.plan(*key)
        members.setdefault(key, []).append(i)
    first, *others = plans.values()
    for each in others:
        if _shape(each) != _shape(first):
            raise ValueError(
                "episodes rolled out together must share parts, control interval and duration, got "
                f"{first.scenario.name!r} (dt = {first.dt:g} s) and {each.scenario.name!r} "
                f"(dt = {each.dt:g} s); roll them out apart"
            )
    cars = Cars(len(episodes), first)
    cars.seed(np.arange(cars.n), streams(range(cars.n)))  # of what follows an end
    if others:
        cars.assign([(np.array(members[key]), each.source) for key, each in plans.items()])
    return cars, first.scenario


def _shape(plan: Plan) -> tuple[Any, ...]:
    return plan.composition, plan.dt, plan.substeps, plan.scenario.steps
