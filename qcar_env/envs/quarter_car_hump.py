"""The environment of one car. Its docstring is its page in the documentation: hence the length."""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from qcar_env.engine.car import NOT_FINITE, OVER, Car
from qcar_env.engine.storage import SHOWN
from qcar_env.envs import episode as task
from qcar_env.envs.picture import Picture, forces
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.scenarios.files import to_json
from qcar_env.validation import finite, known

_empty, _array = np.empty, np.ndarray  # names of this module are found quicker

if TYPE_CHECKING:
    from qcar_env.envs.rendering import Renderer


class QuarterCarHumpEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A quarter car crosses a road; an actuator keeps wheel and body still.

    ## Description

    Two masses, the wheel on its tyre and the car body on its suspension, are shaken by the road
    under the tyre and by an external force on the body. By default they are those of Alluhydan,
    Amer, EL-Sayed and Agwa, *Stability and Control of Car Dynamics with a Quarter Model via a Novel
    Simple Harmonic Hump under External Force*, Mathematics 2024, 12(19), 3046, equations (3)-(4),
    in their worst case: every frequency is 55 rad/s. A `Scenario` of one's own has any car, linear
    or not, any road (humps, steps, ISO 8608, measured, from a function) at any speed, and any
    actuator. The plant is integrated with fourth-order Runge-Kutta, cut at the kinks of the road.
    The policy sets a command, which is held over each control interval `dt`, 5 ms in the presets.
    Signs: everything is positive upward.

    ## Action space

    `Box(-1, 1, (m,), float32)`: what is asked of the actuator, over its limit. The paper's
    ``IndependentActuators`` have m = 2, specific forces on wheel and body [m/s^2], with limits of
    280 and 33 m/s^2. One actuator between wheel and body has m = 1: +1 lifts the body with the
    limit [N], 1500 N in the presets; of a semi-active damper, -1 asks for the least damping and +1
    for the largest. Values outside the box are clipped, as an actuator saturates. `info["force"]`
    has the forces that act, in SI units; `env.unwrapped.force_limit` the limits.

    ## Observation space

    `Box(-10, 10, (k,), float32)`: k signals, each over its scale, clipped. `observe` names them:
    ``"full"`` (k = 8, the default) or ``"feedback"`` (the first four, which the paper's laws use),
    or a sequence of names of `qcar_env.physics.signals.SIGNALS` and of `Signal` objects of one's
    own, for example ``observe=("body_acceleration", "travel", "travel_rate")``.

    | # | signal | meaning | scale in `paper` |
    |---|---|---|---|
    | 0 | x1 | wheel displacement | 1.116 m |
    | 1 | x2 | body displacement | 1.589 m |
    | 2 | v1 | wheel velocity | 61.40 m/s |
    | 3 | v2 | body velocity | 87.41 m/s |
    | 4 | y | road height under the tyre | 0.1 m |
    | 5 | y_dot | its rate as the car drives | 5.5 m/s |
    | 6 | F | external force on the body | 24.8 m/s^2 |
    | 7 | F_dot | its rate | 1364 m/s^3 |

    A signal's scale is the largest value that it has without control, from rest and from starts as
    episodes draw them; `scenario.reference.scales` has them, and a scenario can state its own
    (`Scenario.scales`), as `paper`, `paper-hump` and `paper-randomised` do. A signal that is always
    zero is shown as zero. With `observe_limit=True` one more entry follows: the force limit over
    the scenario's own. At a kink of the road `y_dot` is that of the piece that begins.

    ## Reward

    Minus a sum of costs. By default (``reward="amplitudes"``) ten times the mean of the envelope
    amplitudes ``a_i = sqrt(x_i^2 + (v_i / omega_i)^2)`` over those of the uncontrolled motion, that
    is ``sqrt`` of the squared entries x_i and v_i of the observation: -10 is the paper's
    uncontrolled steady motion, 0 is stillness. `reward` may also be ``"removed"`` (for training,
    with an actuator on each mass), a `qcar_env.envs.reward.Reward`, or terms, for example
    ``reward=(squared("body_acceleration"), absolute("travel", 0.1))``. `info` has the terms
    (`reward_x1` and `reward_x2` by default) and `reward_travel`, the penalty below; their sum is
    the reward.

    ## Start of an episode

    A quarter of the episodes starts from rest, the others with amplitudes between 0.01 and 1.5 of
    the uncontrolled ones, with random phases of the masses and, on an endless sine, of the road,
    which `info["phase"]` has. `reset(options=...)` fixes them: `state` (x1, x2, v1, v2) in SI
    units, `phase` of the road in rad; `force_scale` and `scenario` (a name or a `Scenario` with as
    many actuators, in the vector environment also of the same classes of parts) hold for this and
    the following episodes.

    What a scenario lets vary (`Scenario.randomisation`: any of its numbers, by its path, with a
    distribution) is drawn anew for each episode, always from the nominal numbers.
    `env.unwrapped.episode` is the scenario of the running episode, as drawn.

    ## End of an episode

    Terminated when a displacement exceeds `travel_limit`, 3 in the presets, times its scale, at the
    reward `reward_travel`, -3000 then; truncated after `duration` seconds (5 s in the paper's
    presets, 1000 intervals). Nothing else ends an episode. `env.spec.max_episode_steps` is the
    number of intervals. The `max_episode_steps` of `gymnasium.make` only cuts episodes short:
    longer ones are had by `duration`.

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

    - `scenario`: a name from `qcar_env.SCENARIOS`, a `Scenario`, one as TOML or JSON, a file or a
      text, or where one is found, as ``module:object``;
    - `observe`, `observe_limit`: see the observation space;
    - `reward`: see the reward;
    - `force_scale`: factor on the actuator's limit, 1 by default;
    - `duration`: length of an episode in seconds, instead of the scenario's;
    - `render_mode`: see rendering.

    `env.unwrapped.force_scale` and `env.unwrapped.scenario` can be set (`set_wrapper_attr` and
    `set_attr` of Gymnasium); both hold from the next reset on. Stable-Baselines3's `set_attr` sets
    the attribute of its outermost wrapper instead, which nothing reads: there,
    ``env_method("set_wrapper_attr", "force_scale", 0.5)`` or ``set_options({"force_scale": 0.5})``.

    ## Version history

    v0: first version. Since release 0.2.0 a step of the road kicks a damped wheel, signals other
    than those of the three scenarios above have scales of their own, and `y_dot` at a kink that
    falls on a control instant is not an interval late.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 200}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        scenario: str | Scenario = "paper",
        *,
        observe: task.Observe = "full",
        observe_limit: bool = False,
        reward: task.RewardLike = "amplitudes",
        force_scale: float = 1.0,
        duration: float | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            known("render mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.caption = ("", "#0072B2")
        self._renderer: Renderer | None = None
        self._spec: EnvSpec | None = None
        self._settings = task.Settings(observe, bool(observe_limit), reward, duration, None)
        self._named = find_scenario(scenario)
        self._force_scale = task.force_scale(force_scale)
        self._take(self._named, self._force_scale)
        self._started = False
        high, plan = task.OBSERVATION_LIMIT, self._plan
        self.observation_space = gym.spaces.Box(-high, high, (len(plan.observed),), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, self._action_shape, np.float32)
        self._uniforms = np.zeros(0)
        self._human = render_mode == "human"

    def _take(self, named: Scenario, scale: float) -> None:
        """Let the next episode begin with another scenario or force limit."""
        plan = self._settings.plan(named, scale)
        if not hasattr(self, "_car"):
            self._car = Car(plan)
        size = plan.scenario.actuator.size
        if size != self._car.actions:
            raise ValueError(
                f"scenario {named.name!r} has {size} actuator(s), this environment "
                f"{self._car.actions}; make a new environment for it"
            )
        self._plan, self._named, self._force_scale = plan, named, scale
        self._base = plan.scenario
        self._action_shape = (self._base.actuator.size,)
        if self._spec is not None:
            self._spec.max_episode_steps = self._base.steps
        self._usual = [each.name for each in plan.terms] == ["x1", "x2"]
        self._keys = ("force", *(f"reward_{each.name}" for each in plan.terms), "reward_travel")

    def __getstate__(self) -> dict[str, Any]:
        """Leave the window behind; it is made anew."""
        return {**vars(self), "_renderer": None}

    @property
    def spec(self) -> EnvSpec | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What made the environment; it can be written as JSON and read back."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        if given is not None:
            named = given.kwargs.get("scenario")
            if isinstance(named, Scenario):
                with contextlib.suppress(ValueError):  # of a class that has no name of its own
                    given.kwargs["scenario"] = to_json(named)
            given.max_episode_steps = self._base.steps
        self._spec = given

    @property
    def scenario(self) -> Scenario:
        """The scenario that episodes are drawn from, with this environment's limit and duration.

        Another one can be set, with as many actuators; it holds from the next reset on.
        """
        return self._base

    @scenario.setter
    def scenario(self, given: str | Scenario) -> None:
        self._take(find_scenario(given), self._force_scale)

    @property
    def force_scale(self) -> float:
        """Factor on the scenario's force limit [-]; another one holds from the next reset on."""
        return self._force_scale

    @force_scale.setter
    def force_scale(self, given: float) -> None:
        self._take(self._named, task.force_scale(given))

    @property
    def episode(self) -> Scenario:
        """The scenario of the running episode, as drawn."""
        return self._drawn_from.drawn(self._uniforms) if self._started else self._base

    @property
    def force_limit(self) -> NDArray[np.float64]:
        """What action 1 asks for in this episode, shape (m,).

        A force [m/s^2] or [N], of a semi-active damper its damping [N s/m].
        """
        actuator: Any = self.episode.actuator
        return np.array(actuator.limit)

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._base.dt

    @property
    def state(self) -> State:
        """State of the plant in SI units."""
        self._check_running("state")
        return State(*self._car.state.tolist())

    @property
    def time(self) -> float:
        """Time on the road [s], which begins at the drawn phase."""
        self._check_running("time")
        return self._car.clock("start") + self._car.clock("elapsed") * self._drawn_from.dt

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
        changed = named is not self._named or scale != self._force_scale
        given = [math.nan] * 5
        if "state" in options:
            base = self._settings.scenario(named, scale) if changed else self._base
            given[:4] = task.given_state(options["state"], base).tolist()
        if "phase" in options:
            given[4] = finite("phase", options["phase"], "rad")
        if changed:
            self._take(named, scale)
        if self._plan.composition != self._car.plan.composition:
            self._car = Car(self._plan)
        elif self._plan is not self._car.plan:
            self._car.take(self._plan)
        super().reset(seed=seed)  # nothing is drawn before every option is known to be good
        self._uniforms = self.np_random.random(self._plan.source.uniforms)
        observation = self._car.begin(self._uniforms, np.array(given))
        self._drawn_from, self._started = self._base, True
        if self._human:
            self.render()
        force = np.zeros(self._action_shape)
        return observation, {"force": force, "phase": self._car.clock("phase")}

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
            `force` (m,) [m/s^2] or [N], ``reward_<term>`` of each term, `reward_travel`.

        Raises
        ------
        ValueError
            If the action has the wrong shape or is not a number, or the episode is over.
        """
        car = self._car
        observation, force = _empty(car.size, SHOWN), _empty(car.actions)
        try:
            # numba would read swapped bytes as they lie, and no mask
            if action.dtype is not SHOWN or type(action) is not _array:
                raise TypeError
            outcome = car.advance(car.array, action, observation, force)
        except (TypeError, AttributeError):  # no array of float32
            checked = task.checked_actions("action", action, self._action_shape, "actuator")
            return self.step(checked)
        if outcome[0]:
            self._refuse(outcome[0], action)
        if self._human:
            self.render()
        if self._usual:  # written out, which is quicker
            _, reward, terminated, truncated, x1, x2, travel = outcome
            info = {"force": force, "reward_x1": x1, "reward_x2": x2, "reward_travel": travel}
        else:
            _, reward, terminated, truncated, *terms = outcome
            info = dict(zip(self._keys, (force, *terms), strict=True))
        return observation, reward, terminated, truncated, info

    def _refuse(self, code: int, action: Any) -> None:
        """Say why a step was not taken."""
        self._check_running("step")
        if code == OVER:
            raise ValueError("the episode is over; call reset before the next step")
        if code == NOT_FINITE:
            raise ValueError(f"action must be finite, got {action}; allowed range is [-1, 1]")
        task.checked_actions("action", action, self._action_shape, "actuator")

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
            try:
                from qcar_env.envs.rendering import Renderer
            except ImportError as error:
                raise task.no_pygame() from error

            self._renderer = Renderer(self.render_mode, 1.0 / self.dt)
        return self._renderer.render(picture)

    def picture(self) -> Picture:
        """Return what a frame shows, for a `qcar_env.envs.rendering.Painter` of one's own.

        Raises
        ------
        ResetNeeded
            Before the first reset.
        """
        self._check_running("render")
        name, colour = self.caption
        episode, state = self.episode, self.state
        held, memory = self._car.held.tolist(), self._car.memory.tolist()
        return Picture(
            name=name,
            colour=colour,
            nominal=self._drawn_from,
            episode=episode,
            time=self.time,
            elapsed=self._car.clock("elapsed") * self._drawn_from.dt,
            state=state,
            force=forces(episode.actuator, held, memory, state),
        )

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _check_running(self, what: str) -> None:
        if not self._started:
            raise gym.error.ResetNeeded(f"no episode yet; call reset before {what}")
