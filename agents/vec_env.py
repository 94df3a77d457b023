"""The environment of many cars as Stable-Baselines3 wants it: what agents are trained in.

Episodes begin again in the step that ends them; the last observation is in
``info["terminal_observation"]`` and a time limit in ``info["TimeLimit.truncated"]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from qcar_env.envs.episode import RESET_OPTIONS, force_scale
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario
from qcar_env.validation import known, whole

SETTABLE = {"force_scale": force_scale, "scenario": scenario}


class QuarterCarHumpVecEnv(VecEnv):
    """`QuarterCarHumpVectorEnv` with the interface of Stable-Baselines3.

    Parameters
    ----------
    num_envs : int
        Number of cars.
    staggered : bool
        Whether a reset of all cars leaves each somewhere in the time of its episode, so that not
        all of them end in the same step.
    **arguments
        As for `qcar_env.envs.vector.QuarterCarHumpVectorEnv`, except `autoreset_mode`.

    Notes
    -----
    The `info` of a car has its `force` and the terms of its reward. `get_attr`, `set_attr` and
    `env_method` reach a `Car` for each index.
    """

    def __init__(self, num_envs: int, *, staggered: bool = False, **arguments: Any) -> None:
        self.vector = QuarterCarHumpVectorEnv(
            num_envs, **arguments, autoreset_mode=AutoresetMode.SAME_STEP
        )
        self.cars = [Car(self.vector, i) for i in range(self.vector.num_envs)]
        super().__init__(
            self.vector.num_envs,
            self.vector.single_observation_space,
            self.vector.single_action_space,
        )
        self._staggered = staggered
        self._names = ("force", *self.vector.terms)
        self._actions: NDArray[np.float32] | None = None

    def reset(self) -> NDArray[np.float32]:
        """Begin episodes of all cars, with the seeds and options given before.

        Raises
        ------
        ValueError
            If there are not as many options as cars, or one is unknown or out of range.
        """
        given: Any = self._options
        if not isinstance(given, (list, tuple)) or not all(isinstance(x, dict) for x in given):
            raise ValueError(
                f"options must be one dict or {self.num_envs} of them, got {given!r}; "
                "give one for each car"
            )
        if len(given) != self.num_envs:
            raise ValueError(
                f"options must be one dict or {self.num_envs} of them, got {len(given)}; "
                "give one for each car"
            )
        names = {name for each in self._options for name in each}
        for name in names:
            known("reset option", name, RESET_OPTIONS)
        options = {name: [each.get(name) for each in self._options] for name in names}
        seeds = None if all(each is None for each in self._seeds) else self._seeds
        observations, _ = self.vector.reset(seed=seeds, options=options)
        if self._staggered:
            first = None if seeds is None else seeds[0]
            steps = [self.vector.scenario_of(i).steps for i in range(self.num_envs)]
            self.vector.stagger(np.random.default_rng(first).integers(steps))
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the cars with `seed`, `seed + 1`, ... at the next reset.

        Raises
        ------
        ValueError
            If it is no whole number of at least 0.
        """
        return super().seed(None if seed is None else whole("seed", seed, least=0))

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Hold forces for one control interval.

        Raises
        ------
        ValueError
            If there are no actions: `step_async` comes first.
        """
        if self._actions is None:
            raise ValueError("actions must be given before they are waited for; call step_async")
        seen, rewards, force, ends, begun = self.vector.advance(self._actions)
        names, columns = self._names, (force, *rewards[1:].tolist())
        infos: list[dict[str, Any]] = [
            dict(zip(names, each))  # noqa: B905 - equal lengths, and quicker
            for each in zip(*columns)  # noqa: B905
        ]
        if begun is not None and begun.finals is not None:
            for i, last in zip(begun.cars.tolist(), begun.finals, strict=True):
                infos[i]["terminal_observation"] = last
                infos[i]["TimeLimit.truncated"] = bool(ends[1, i])
        return seen, rewards[0].astype(np.float32), ends.any(axis=0), infos

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return all that moves, to go on from."""
        return self.vector.snapshot()

    def restore(self, kept: dict[str, NDArray[Any]]) -> None:
        """Go on from a snapshot of an environment made alike."""
        self.vector.restore(kept)

    def close(self) -> None:
        """Close the vector environment."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each chosen car."""
        return [getattr(car, attr_name) for car in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set `force_scale` or `scenario` of the chosen cars, from each one's next start."""
        check = SETTABLE[known("attribute to set", attr_name, SETTABLE)]
        chosen = [car.index for car in self._chosen(indices)]
        self.vector.assign(chosen, **{attr_name: check(value)})

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of each chosen car."""
        return [
            getattr(car, method_name)(*method_args, **method_kwargs)
            for car in self._chosen(indices)
        ]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return that no car is wrapped: wrap the whole batch with SB3's Vec wrappers."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[Car]:
        """Return cars by index, all or none."""
        chosen = list(self._get_indices(indices))
        try:
            return [self.cars[i] for i in chosen]
        except (IndexError, TypeError):
            raise ValueError(
                f"indices must be whole numbers from 0 to {self.num_envs - 1}, got {chosen}; "
                "give indices of the batch"
            ) from None


class Car:
    """One car of a batch, as far as a single environment would show it."""

    render_mode = None

    def __init__(self, vector: QuarterCarHumpVectorEnv, index: int) -> None:
        self._vector = vector
        self.index = index

    @property
    def scenario(self) -> Scenario:
        """The scenario from which the next episodes are drawn."""
        return self._vector.scenario_of(self.index)

    @property
    def force_scale(self) -> float:
        """Factor on the scenario's force limit [-]."""
        return self._vector.force_scale_of(self.index)

    @property
    def state(self) -> State:
        """State of the plant in SI units."""
        return State(*self._vector.states[self.index].tolist())

    @property
    def force_limit(self) -> NDArray[np.float64]:
        """Force that action 1 makes in this episode, shape (m,) [m/s^2] or [N]."""
        return self._vector.force_limits[self.index]

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._vector.dt

    def get_wrapper_attr(self, name: str) -> Any:
        """Return an attribute by name, as Gymnasium's environments do."""
        return getattr(self, name)
