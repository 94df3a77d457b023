"""The environment of many cars as Stable-Baselines3 wants it.

Episodes begin again in the step that ends them; the last observation is in
``info["terminal_observation"]`` and a time limit in ``info["TimeLimit.truncated"]``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from qcar_env.envs import task
from qcar_env.envs.vector import TERMS, QuarterCarHumpVectorEnv
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import known, positive


class QuarterCarHumpVecEnv(VecEnv):
    """`QuarterCarHumpVectorEnv` with the interface of Stable-Baselines3.

    Parameters
    ----------
    num_envs : int
        Number of cars.
    **arguments
        As for `qcar_env.envs.vector.QuarterCarHumpVectorEnv`, except `autoreset_mode`.

    Notes
    -----
    A step makes one `info` for each car that has finished, with its force, reward terms and last
    observation. The others share an empty one, so that no Python loop runs over all cars.
    `get_attr`, `set_attr` and `env_method` reach a `Car` for each index.
    """

    def __init__(self, num_envs: int, **arguments: Any) -> None:
        self.vector = QuarterCarHumpVectorEnv(
            num_envs, **arguments, autoreset_mode=AutoresetMode.SAME_STEP
        )
        self.cars = [Car(self.vector, i) for i in range(self.vector.num_envs)]
        super().__init__(
            self.vector.num_envs,
            self.vector.single_observation_space,
            self.vector.single_action_space,
        )
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
            known("reset option", name, task.RESET_OPTIONS)
        options = {name: [each.get(name) for each in self._options] for name in names}
        seeds = None if all(each is None for each in self._seeds) else self._seeds
        observations, _ = self.vector.reset(seed=seeds, options=options)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

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
        observations, rewards, terminated, truncated, info = self.vector.step(self._actions)
        infos: list[dict[str, Any]] = [{}] * self.num_envs
        dones = terminated | truncated
        if "final_obs" in info:
            last = info["final_info"]
            for i in np.flatnonzero(dones).tolist():
                infos[i] = {
                    "terminal_observation": info["final_obs"][i],
                    "TimeLimit.truncated": bool(truncated[i]),
                    "force": last["force"][i],
                    **{name: float(last[name][i]) for name in TERMS},
                }
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Close the vector environment."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each chosen car."""
        return [getattr(car, attr_name) for car in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each chosen car: `force_scale` and `scenario` from its next start."""
        for car in self._chosen(indices):
            setattr(car, attr_name, value)

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
        self._index = index

    @property
    def scenario(self) -> Scenario:
        """The scenario from which the next episodes are drawn."""
        return self._vector.scenario_of(self._index)

    @scenario.setter
    def scenario(self, value: str | Scenario) -> None:
        self._vector.assign([self._index], scenario=find_scenario(value))

    @property
    def force_scale(self) -> float:
        """Factor on the scenario's force limit [-]."""
        return self._vector.force_scale_of(self._index)

    @force_scale.setter
    def force_scale(self, value: float) -> None:
        self._vector.assign([self._index], force_scale=positive("force_scale", value))

    @property
    def state(self) -> State:
        """State of the plant in SI units."""
        return State(*self._vector.states[self._index].tolist())

    @property
    def force_limit(self) -> NDArray[np.float64]:
        """Force that action 1 makes in this episode, shape (m,) [m/s^2] or [N]."""
        return self._vector.force_limits[self._index]

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._vector.dt

    def get_wrapper_attr(self, name: str) -> Any:
        """Return an attribute by name, as Gymnasium's environments do."""
        return getattr(self, name)
