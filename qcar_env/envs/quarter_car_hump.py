"""The environment of one car."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from qcar_env.envs import task
from qcar_env.physics import engine, engine_sampled
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario as find_scenario, vary
from qcar_env.validation import finite, known

SHOWN = np.dtype(np.float32)

if TYPE_CHECKING:
    from qcar_env.envs.rendering import Picture, Renderer


class QuarterCarHumpEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A quarter car crosses speed humps; an actuator keeps wheel and body still.

    ## Description

    Two masses, the wheel on its tyre and the car body on its suspension, are shaken by the road
    under the tyre and by an external force on the body. The plant is that of Alluhydan, Amer,
    EL-Sayed and Agwa, *Stability and Control of Car Dynamics with a Quarter Model via a Novel
    Simple Harmonic Hump under External Force*, Mathematics 2024, 12(19), 3046, equations (3)-(4),
    integrated with fourth-order Runge-Kutta. The policy sets the actuator force, which is held
    over each control interval `dt`. Signs: everything is positive upward.

    ## Action space

    `Box(-1, 1, (m,), float32)`: the force as a fraction of the actuator's limit. With
    ``independent`` actuation (the paper's) m = 2: specific forces on wheel and body. With
    ``suspension`` actuation m = 1: one actuator between them, +1 lifts the body. Values outside
    the box are clipped, as an actuator saturates. `info["force"]` has the force in SI units, and
    `env.unwrapped.force_limit` the limits.

    ## Observation space

    `Box(-10, 10, (8,), float32)` with ``observe="full"``; the first four entries, which is what
    the paper's laws use, with ``observe="feedback"``. A and omega are the reference amplitudes
    and the reference frequency of the scenario.

    | # | entry | meaning |
    |---|---|---|
    | 0 | x1 / A1 | wheel displacement |
    | 1 | x2 / A2 | body displacement |
    | 2 | v1 / (omega A1) | wheel velocity |
    | 3 | v2 / (omega A2) | body velocity |
    | 4 | y / h | road height under the tyre |
    | 5 | y' / (h omega) | its rate |
    | 6 | F / f | external force |
    | 7 | F' / (f Omega) | its rate |

    With `observe_limit=True` one more entry follows: the force limit over the scenario's own.

    ## Reward

    Minus ten times the mean of the envelope amplitudes ``a_i = sqrt(x_i^2 + (v_i / omega)^2)`` over
    the reference amplitudes: -10 is the uncontrolled steady motion, 0 is stillness. `info` has the
    terms `reward_x1`, `reward_x2` and `reward_travel`; their sum is the reward.

    ## Start of an episode

    A quarter of the episodes starts from rest, the others with amplitudes between 0.01 and 1.5 of
    the uncontrolled ones, with random phases of the masses and, on a harmonic road, of the road.
    `reset(options=...)` fixes them: `state` (x1, x2, v1, v2) in SI units, `phase` of the road in
    rad; `force_scale` and `scenario` (a name or a `Scenario` with as many actuators) hold for this
    and the following episodes.

    ## End of an episode

    Terminated when a displacement exceeds `travel_limit` reference amplitudes, at the reward
    `reward_travel`; truncated after `duration` seconds. Nothing else ends an episode.

    ## Rendering

    ``render_mode="rgb_array"`` gives frames of 640 x 480 and needs no display, ``"human"`` opens a
    window (extra `render`). A frame shows the road rolling under the tyre, the forces as arrows,
    and the envelope amplitudes over the uncontrolled ones. `env.unwrapped.caption = (name,
    colour)` says who drives. `metadata["render_fps"]` is the real time of ``dt`` = 5 ms.

    ## Arguments

    ```python
    import gymnasium as gym
    import qcar_env

    env = gym.make("QuarterCarHump-v0", scenario="paper", observe="full")
    ```

    `scenario` is a name from `qcar_env.SCENARIOS` or a `Scenario`; `observe` is ``"full"`` or
    ``"feedback"``; `observe_limit` adds the force limit to the observation; `force_scale`
    multiplies the scenario's force limit; `duration` [s] replaces the scenario's.

    ## Version history

    v0: first version.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 200}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        scenario: str | Scenario = "paper",
        *,
        observe: task.Observe = "full",
        observe_limit: bool = False,
        force_scale: float = 1.0,
        duration: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            known("render mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.caption = ("", "#0072B2")
        self._renderer: Renderer | None = None
        known("observe", observe, task.OBSERVE)
        self._observe: task.Observe = observe
        self._observe_limit = bool(observe_limit)
        self._force_scale = task.force_scale(force_scale)
        self._duration = duration
        self._named = find_scenario(scenario)
        self._base = self._configured(self._named, self._force_scale)
        self._take(self._base)
        self._episode: task.Factors | None = None
        high = task.OBSERVATION_LIMIT
        shape = (task.observation_size(observe, self._observe_limit),)
        self.observation_space = gym.spaces.Box(-high, high, shape, np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self._base.actuator.size,), np.float32)
        self._shape = shape
        self._action_shape = (self._base.actuator.size,)
        self._car = np.zeros(engine_sampled.ONE_CAR)
        self._car[engine_sampled.DONE] = 1.0
        self._compile()

    def _compile(self) -> None:
        functions: Any = task
        kernels = engine_sampled.kernels(
            functions,
            task.observation_size(self._observe, False),
            self._observe_limit,
            self._base.actuator.size,
            False,
        )
        self._begin = kernels.reset_one
        self._held = np.array([self._car.ctypes.data, *engine.array_makers()], np.int64)
        self._place = self._held.ctypes.data
        self._advance = engine.direct(kernels.step_one, self._place, engine.OBJECT)
        self._human = self.render_mode == "human"

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code and the window behind; they are made anew."""
        made = ("_held", "_place", "_begin", "_advance")
        kept = {name: value for name, value in vars(self).items() if name not in made}
        return {**kept, "_renderer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore everything else, and compile."""
        vars(self).update(state)
        self._compile()

    @property
    def scenario(self) -> Scenario:
        """The scenario with this environment's force limit and duration, not randomised."""
        return self._base

    @property
    def episode(self) -> Scenario:
        """The scenario of the running episode, as drawn."""
        if self._episode is None:
            return self._base
        if self._base.randomisation is None:
            return self._base
        return vary(self._base, *self._episode)

    @property
    def force_limit(self) -> NDArray[np.float64]:
        """Force that action 1 makes in this episode, shape (m,) [m/s^2] or [N]."""
        if self._episode is None:
            return np.array(self._base.actuator.limit)
        first = engine_sampled.FORCES
        return self._car[first : first + self._action_shape[0]].copy()

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._base.dt

    @property
    def _elapsed(self) -> int:
        """Control intervals since the episode began."""
        return int(self._car[engine_sampled.ELAPSED])

    @property
    def state(self) -> State:
        """State of the plant in SI units."""
        self._check_running("state")
        return State(*self._car[: engine_sampled.WORLD].tolist())

    @property
    def time(self) -> float:
        """Time on the road [s], which begins at the drawn phase."""
        self._check_running("time")
        return float(self._car[engine_sampled.START]) + self._elapsed * self._base.dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Parameters
        ----------
        seed : int, optional
            Seed of this environment's generator.
        options : dict, optional
            `state` (4,) [m, m, m/s, m/s], `phase` [rad], `force_scale` [-], `scenario`.

        Returns
        -------
        observation : ndarray (n,) float32
        info : dict

        Raises
        ------
        ValueError
            If an option is unknown or out of range.
        """
        options = options or {}
        for key in options:
            known("reset option", key, task.RESET_OPTIONS)
        scale = task.force_scale(options.get("force_scale", self._force_scale))
        named = find_scenario(options.get("scenario", self._named))
        base = self._base
        if named is not self._named or scale != self._force_scale:
            base = self._configured(named, scale)
        given = [math.nan] * 5
        if "state" in options:
            given[:4] = task.given_state(options["state"], base).tolist()
        if "phase" in options:
            given[4] = finite("phase", options["phase"], "rad")
        super().reset(seed=seed)  # nothing changes before every option is known to be good
        self._named, self._force_scale = named, scale
        if base is not self._base:
            self._base = base
            self._take(base)
        self._car[engine_sampled.DT] = base.dt
        self._car[engine_sampled.SUBSTEPS] = base.substeps
        draws = self.np_random.random(task.DRAWS)
        observation = self._begin(
            self._car, engine.array_makers(), draws, tuple(given), np.array(self._numbers)
        )
        self._episode = task.draw_factors(draws.tolist(), self._numbers)
        if self.render_mode == "human":
            self.render()
        phase = float(self._car[engine_sampled.PHASE])
        return observation, {"force": np.zeros(self._action_shape), "phase": phase}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold a force for one control interval.

        Parameters
        ----------
        action : ndarray (m,)
            Force over its limit, clipped to [-1, 1].

        Returns
        -------
        observation : ndarray (n,) float32
        reward : float
        terminated, truncated : bool
        info : dict
            `force` (m,) [m/s^2] or [N], `reward_x1`, `reward_x2`, `reward_travel`.

        Raises
        ------
        ValueError
            If the action has the wrong shape or is not a number, or the episode is over.
        """
        advance = self._advance
        code, observation, reward, terminated, truncated, force, x1, x2, travel = advance(
            self._place, action
        )
        if code:
            return self._step_again(code, action)
        if self._human:
            self.render()
        info = {"force": force, "reward_x1": x1, "reward_x2": x2, "reward_travel": travel}
        return observation, reward, terminated, truncated, info

    def _step_again(
        self, code: int, action: Any
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Take a step with an action that the engine has not taken as it is, or refuse it."""
        if code == -3:
            return self.step(self._checked(action))
        self._check_running("step")
        if code == -2:
            raise ValueError("the episode is over; call reset before the next step")
        raise ValueError(f"action must be finite, got {action}; allowed range is [-1, 1]")

    def _checked(self, action: Any) -> NDArray[np.float32]:
        """Return a copy of an action as an array of the kind that the engine takes."""
        return task.checked_actions("action", action, self._action_shape, "actuator")

    def render(self) -> NDArray[np.uint8] | None:
        """Return a frame (480, 640, 3) in the mode "rgb_array"; show it in the mode "human".

        Raises
        ------
        ResetNeeded
            Before the first reset.
        DependencyNotInstalled
            If pygame is absent.
        """
        if self.render_mode is None:
            gym.logger.warn("nothing to render: make the environment with render_mode='rgb_array'")
            return None
        picture = self.picture()
        if self._renderer is None:
            from qcar_env.envs.rendering import Renderer

            self._renderer = Renderer(self.render_mode, 1.0 / self.dt)
        return self._renderer.render(picture)

    def picture(self) -> Picture:
        """Return what a frame shows, for a `qcar_env.envs.rendering.Painter` of one's own.

        Raises
        ------
        ResetNeeded
            Before the first reset.
        DependencyNotInstalled
            If pygame is absent.
        """
        self._check_running("render")
        try:
            from qcar_env.envs.rendering import Picture
        except ImportError as error:
            raise gym.error.DependencyNotInstalled(
                "rendering needs pygame; pip install 'qcar_env[render]'"
            ) from error
        name, colour = self.caption
        return Picture(
            name=name,
            colour=colour,
            nominal=self._base,
            episode=self.episode,
            time=self.time,
            elapsed=self._elapsed * self._base.dt,
            state=self.state,
            action=tuple(self._car[engine_sampled.HELD :][: self._action_shape[0]].tolist()),
        )

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _configured(self, named: Scenario, scale: float) -> Scenario:
        if hasattr(self, "_base") and named.actuator.size != self._base.actuator.size:
            raise ValueError(
                f"scenario {named.name!r} has {named.actuator.size} actuator(s), this environment "
                f"{self._base.actuator.size}; make a new environment for it"
            )
        found = named.with_force_scale(scale)
        if self._duration is not None:
            found = dataclasses.replace(found, duration=self._duration)
        return found

    def _take(self, base: Scenario) -> None:
        self._numbers = task.nominal_numbers(base, self._named)
        self._dt, self._substeps = base.dt, base.substeps

    def _check_running(self, what: str) -> None:
        if self._episode is None:
            raise gym.error.ResetNeeded(f"no episode yet; call reset before {what}")
