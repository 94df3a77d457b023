"""What agents are trained in: the task of the environment, with a reward that teaches fast.

A Stable-Baselines3 `VecEnv` over the linear maps of `agents.crossing`. Observation, action, starts
and ends are those of ``QuarterCarHump-v0``. The reward of an interval is

    r = sum_i  w_i (a_i - a_i') / d_i  -  c_i a_i'        d_i = u_i dt / (omega A_i)

with the envelope amplitudes a_i / A_i before and after it: the amplitude that was removed, in
units of what the actuator's full force could remove in phase. Every actuator's terms are then of
order one, however strong it is. The first term telescopes: discounted with gamma it is the cost
``(1 - gamma) w_i a_i / d_i`` with the potential ``w_i a_i / d_i`` (A. Y. Ng, D. Harada, S. Russell,
Policy invariance under reward transformations, ICML 1999), so that a horizon of half a period of
the forcing suffices where the force can remove everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from agents import crossing
from agents.crossing import Plants
from qcar_env.envs import task
from qcar_env.evaluation.tracks import Track, episodes
from qcar_env.validation import non_negative, whole

PENALTY = 10.0  # [-] for leaving the travel limits, about ten intervals of full force in phase
POOL = 1024  # cars drawn at the beginning where the scenario varies; episodes pick among them


@dataclass(frozen=True, kw_only=True)
class Reward:
    """Weights of the training reward.

    Parameters
    ----------
    removed : tuple of float
        Weights `w` of what wheel's and body's amplitude lost [-].
    remaining : tuple of float
        Weights `c` of what they still are [-].
    worst : float
        Weight of the larger relative amplitude, which is what the benchmark scores [-].

    Raises
    ------
    ValueError
        If a weight is negative.
    """

    removed: tuple[float, float] = (1.0, 1.0)
    remaining: tuple[float, float] = (0.0, 0.0)
    worst: float = 0.0

    def __post_init__(self) -> None:
        """Check the weights."""
        for weight in (*self.removed, *self.remaining, self.worst):
            non_negative("reward weight", weight)


def amplitudes(observation: NDArray[Any]) -> NDArray[np.float64]:
    """Return the relative envelope amplitudes ``a_i / A_i``, shape (n, 2), of observations."""
    x = np.asarray(observation, dtype=np.float64)
    return np.hypot(x[:, 0:2], x[:, 2:4])


class CrossingVecEnv(VecEnv):
    """Many cars of one track's training set.

    Parameters
    ----------
    track : Track
        Gives scenario, observation and the training draws.
    force_scales : sequence of float
        Force limits over the scenario's own [-]; each episode takes one of them.
    n : int
        Number of cars.
    seed : int
        Of starts and draws.
    observe_limit : bool
        Whether the observation ends with the force limit.
    reward : Reward
        Weights of the reward.
    steps : int
        Control intervals in an episode.
    """

    render_mode = None  # there is nothing to see
    _moving = ("_z", "_count", "_amplitudes", "_return", "_index")

    def __init__(
        self,
        track: Track,
        force_scales: Sequence[float],
        *,
        n: int,
        seed: int,
        observe_limit: bool = False,
        reward: Reward | None = None,
        steps: int = 1000,
    ) -> None:
        whole("number of cars", n)
        self._rng = np.random.default_rng([seed, 20])
        self._nominal = track.nominal
        self._observe: task.Observe = track.observe
        self._observe_limit = observe_limit
        self._weights = Reward() if reward is None else reward
        self._steps = whole("steps", steps)
        self._pool = training_plants(track, force_scales, seed)
        self._cars: Plants = self._pool.pick(np.zeros(n, dtype=np.int64))
        self._shared = len(self._pool) == 1
        omega, dt = self._nominal.reference_frequency, self._nominal.dt
        limits = np.array(self._nominal.actuator.specific_limits(self._nominal.car))
        # d of full force, at limit 1; shape (2,)
        self._removable = limits * dt / (omega * np.array(self._nominal.reference_amplitudes))
        super().__init__(
            n,
            space(self._observe, observe_limit),
            gym.spaces.Box(-1.0, 1.0, (self._nominal.actuator.size,), np.float32),
        )
        self._z = np.zeros((n, crossing.SIZE))
        self._count = np.zeros(n, dtype=np.int64)
        self._amplitudes = np.zeros((n, 2))
        self._return = np.zeros(n)
        self._actions = np.zeros((n, 2))
        self._index = np.zeros(n, dtype=np.int64)

    def reset(self) -> NDArray[np.float32]:
        """Start all cars, at staggered times, so that not all episodes end together."""
        self._begin(np.arange(self.num_envs))
        self._count = self._rng.integers(self._steps, size=self.num_envs)
        observation = self._observation()
        self._amplitudes = amplitudes(observation)
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions of the next interval."""
        self._actions = np.asarray(actions, dtype=np.float64)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], Any]:
        """Advance all cars by an interval; finished ones begin anew."""
        if self._shared:
            cars = self._cars
            a = np.clip(self._actions, -1.0, 1.0)
            self._z = self._z @ cars.Z[0] + a @ cars.U[0]
        else:
            self._z = crossing.advance(self._z, self._actions, self._cars)
        self._count += 1
        observation = self._observation()
        now = amplitudes(observation)
        w = self._weights
        removable = self._removable * self._cars.limit[:, None]
        reward = ((self._amplitudes - now) / removable) @ np.array(w.removed)
        reward -= now @ np.array(w.remaining) + w.worst * now.max(axis=1)
        out = np.any(np.abs(observation[:, :2]) > self._nominal.travel_limit, axis=1)
        reward -= PENALTY * out
        self._return += reward
        done = out | (self._count >= self._steps)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            ended = np.flatnonzero(done)
            for i in ended:
                infos[i] = {
                    "terminal_observation": observation[i].copy(),
                    "TimeLimit.truncated": not out[i],
                    "episode": {"r": self._return[i], "l": int(self._count[i]), "t": 0.0},
                }
            self._begin(ended)
            observation = self._observation()
            now = amplitudes(observation)
        self._amplitudes = now
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of this object, once for each car asked for."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: the cars share everything that could be set."""
        raise NotImplementedError("the cars have no attributes of their own; make a new one")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: the cars are rows of one array, not environments."""
        raise NotImplementedError("the cars have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each car asked for."""
        return [False] * len(list(self._get_indices(indices)))

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the starts of the episodes to come."""
        self._rng = np.random.default_rng([0 if seed is None else seed, 21])
        return [seed] * self.num_envs

    def snapshot(self) -> dict[str, Any]:
        """Return all that moves, as tensors and plain values."""
        return {
            "arrays": {name: torch.tensor(getattr(self, name)) for name in self._moving},
            "generator": generator_state(self._rng),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot of the same environment."""
        for name, values in snapshot["arrays"].items():
            setattr(self, name, values.numpy().copy())
        if not self._shared:
            self._cars = self._pool.pick(self._index)
        set_generator_state(self._rng, snapshot["generator"])

    def _begin(self, which: NDArray[np.int64]) -> None:
        state, phase = task.draw_start(self._rng, self._nominal, len(which))
        self._z[which] = crossing.start(state, phase)
        self._count[which] = 0
        self._return[which] = 0.0
        if not self._shared:
            self._index[which] = self._rng.integers(len(self._pool), size=len(which))
            drawn = self._pool.pick(self._index[which])
            self._cars.Z[which], self._cars.U[which] = drawn.Z, drawn.U
            self._cars.O[which], self._cars.limit[which] = drawn.O, drawn.limit

    def _observation(self) -> NDArray[np.float32]:
        if not self._shared:
            return crossing.observations(self._z, self._cars, self._observe, self._observe_limit)
        size = task.observation_size(self._observe, False)
        full = self._z @ self._cars.O[0][:, :size]
        if self._observe_limit:
            full = np.concatenate([full, self._cars.limit[:, None]], axis=1)
        return np.clip(full, -task.OBSERVATION_LIMIT, task.OBSERVATION_LIMIT).astype(np.float32)


def space(observe: task.Observe, observe_limit: bool) -> gym.spaces.Box:
    """Return the observation space, as the environment's."""
    high = task.OBSERVATION_LIMIT
    return gym.spaces.Box(-high, high, (task.observation_size(observe, observe_limit),), np.float32)


def generator_state(rng: np.random.Generator) -> list[str]:
    """Return the state of a PCG64 generator as plain text."""
    state = rng.bit_generator.state
    words = (*state["state"].values(), state["has_uint32"], state["uinteger"])
    return [str(word) for word in words]


def set_generator_state(rng: np.random.Generator, words: list[str]) -> None:
    """Bring a PCG64 generator back to a state."""
    state, inc, has_uint32, uinteger = (int(word) for word in words)
    rng.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": inc},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }


def training_plants(track: Track, force_scales: Sequence[float], seed: int) -> Plants:
    """Return the cars that training draws from: one for each limit, or `POOL` that vary."""
    varies = track.nominal.randomisation is not None
    count = max(1, POOL // len(force_scales)) if varies else 1
    drawn = [
        each.scenario
        for scale in force_scales
        for each in episodes(track, "training", force_scale=scale, seed=seed, count=count)
    ]
    return crossing.plants(track.nominal, drawn)
