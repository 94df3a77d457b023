"""The environment of many cars, stepped together by the compiled engine.

Its length is that of Gymnasium's interface: one class, with what each method takes and gives.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from qcar_env.engine import cars as batch
from qcar_env.engine.linear_cars import LinearCars, check_linear
from qcar_env.engine.starts import OBSERVATION_LIMIT
from qcar_env.engine.storage import BOOL, SHOWN
from qcar_env.envs import episode as task, starting
from qcar_env.envs.picture import Picture, forces
from qcar_env.envs.starting import Drawn
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import known

if TYPE_CHECKING:
    from qcar_env.envs.rendering import Painter

MODES = {
    AutoresetMode.DISABLED: batch.DISABLED,
    AutoresetMode.NEXT_STEP: batch.NEXT_STEP,
    AutoresetMode.SAME_STEP: batch.SAME_STEP,
}
PRECISIONS = ("double", "single")
METHODS = ("rk4", "exact")


class QuarterCarHumpVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Many quarter cars at once: `QuarterCarHump-v0` as a vector environment.

    `gymnasium.make_vec("QuarterCarHump-v0", num_envs=n)` makes it. Task, spaces, rewards and
    `info` are those of `qcar_env.envs.quarter_car_hump.QuarterCarHumpEnv`, bit for bit: car `i`
    seeded with `s` has the episodes of a single environment seeded with `s`.

    Parameters
    ----------
    num_envs : int
        Number of cars.
    scenario, observe, observe_limit, reward, force_scale, duration
        As for a single environment; the same for all cars (reset options set them one by one).
    max_episode_steps : int, optional
        Control intervals in an episode, instead of the duration.
    autoreset_mode : AutoresetMode or str
        What becomes of a car whose episode is over: the next step begins another (Gymnasium's
        default), the same step does, or `reset` with a `reset_mask` must.
    precision : {"double", "single"}
        Numbers inside the engine. Single precision is up to twice as fast in large batches; an
        episode then departs from the exact one by about 1e-4 of the amplitudes.
    method : {"rk4", "exact"}
        How an interval is integrated: with Runge-Kutta steps, or with the exact map of the linear
        plant, which is the fastest. It needs a linear car and actuator, and a road made of sines:
        an endless one, humps, a step. The two differ by the error of the Runge-Kutta steps, 1e-5
        of the paper's amplitudes with four of them.
    threads : int
        Threads that share the cars, at most: each gets 16384 of them or more, as handing fewer over
        costs what it saves. They change no bit.
    render_mode : {"rgb_array"}, optional
        `render` returns a frame of each car in `render_cars`, a few megabytes of memory each.
    render_cars : sequence of int, optional
        Indices of the cars that are drawn; all if left out, as `RecordVideo` of
        `gymnasium.wrappers.vector` needs. `captions` has a name and a colour for each.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    `reset` takes a seed (car `i` gets ``seed + i``) or one seed for each car, and the options of
    the single environment, each one value for all cars or a sequence with one for each (`state`
    an array (n, 4); None for a car without the option), as well as Gymnasium's `reset_mask`.
    Arrays in `info` have a mask beside them, as in Gymnasium's own vector environments;
    `final_obs` and `final_info` likewise.
    """

    metadata = {  # noqa: RUF012 - Gymnasium's interface
        "render_modes": ["rgb_array"],
        "render_fps": 200,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "paper",
        *,
        observe: task.Observe = "full",
        observe_limit: bool = False,
        reward: task.RewardLike = "amplitudes",
        force_scale: float = 1.0,
        duration: float | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        precision: str = "double",
        method: str = "rk4",
        threads: int = 1,
        render_mode: str | None = None,
        render_cars: Sequence[int] | None = None,
    ) -> None:
        if render_mode is not None:
            known("render mode", render_mode, self.metadata["render_modes"])
        known("precision", precision, PRECISIONS)
        known("method", method, METHODS)
        self.autoreset_mode = _mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._linear = method == "exact"
        steps = task.most_steps(max_episode_steps)
        self._settings = task.Settings(observe, bool(observe_limit), reward, duration, steps)
        drawn = self._drawn(find_scenario(scenario), task.force_scale(force_scale))
        fleet = LinearCars if self._linear else batch.Cars
        self._cars = fleet(num_envs, drawn.plan, single=precision == "single", threads=threads)
        self.num_envs = self._cars.n
        self._given = [drawn] * self.num_envs
        self.single_observation_space = gym.spaces.Box(
            -OBSERVATION_LIMIT, OBSERVATION_LIMIT, (self._cars.size,), np.float32
        )
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (self._cars.actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._shape = (self.num_envs, self._cars.actions)
        self._mode = MODES[self.autoreset_mode]
        names = [each.name for each in drawn.plan.terms]
        self.terms = (*(f"reward_{name}" for name in names), "reward_travel")
        self._names = [(i, name, f"_{name}") for i, name in enumerate(self.terms, 1)]
        self._started = False
        self._later = False  # whether cars may draw from something else than what they run on
        self._every = np.ones(self.num_envs, BOOL)  # the mask of what all cars have
        self._every.flags.writeable = False
        self.render_mode = render_mode
        shown = range(self.num_envs) if render_cars is None else render_cars
        if not isinstance(shown, Iterable):
            raise ValueError(f"render_cars must be indices of cars, got {shown!r}; give a list")
        self._render_cars = [self._known_car(car) for car in shown]
        self.captions = [(f"car {car}", "#0072B2") for car in self._render_cars]
        self._running = list(self._given)  # what the running episodes were drawn from
        self._painters: list[Painter] = []

    @property
    def states(self) -> NDArray[np.float64]:
        """States (x1, x2, v1, v2) of the cars [m, m, m/s, m/s], shape (n, 4)."""
        return self._cars.states

    @property
    def force_limits(self) -> NDArray[np.float64]:
        """What action 1 asks for in the cars' episodes: a force [m/s^2] or [N], a damping [N s/m].

        Shape (n, m).
        """
        semi_active = hasattr(self._given[0].base.actuator, "c_max")
        path = "actuator.c_max" if semi_active else "actuator.limit.0"
        return self._cars.driven(path, self._cars.actions).T

    def scenario_of(self, car: int) -> Scenario:
        """Return the scenario from which a car draws its episodes."""
        return self._given[car].base

    def episode_of(self, car: int) -> Scenario:
        """Return the scenario of a car's running episode, as drawn."""
        uniforms = self._cars.uniforms[car]
        return self._running[car].base.drawn(uniforms.tolist())

    def force_scale_of(self, car: int) -> float:
        """Return the factor on a car's force limit [-]."""
        return self._given[car].force_scale

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._cars.plan.dt

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin episodes of all cars, or of those in ``options["reset_mask"]``.

        Parameters
        ----------
        seed : int or sequence, optional
            Seed; car `i` gets ``seed + i``. Or one for each car.
        options : dict, optional
            `state`, `phase`, `force_scale`, `scenario`: one value or one for each car, None for a
            car without it; and `reset_mask` (n,) of bool, of all cars in the first reset.

        Returns
        -------
        observations : ndarray (n, size) float32
        info : dict
            `force` and `phase` of the cars that have begun.

        Raises
        ------
        ValueError
            If an option is unknown, has the wrong length or is out of range. Nothing has changed
            then.
        """
        options = dict(options or {})
        n, first = self.num_envs, not self._started
        mask = starting.reset_mask(n, options.pop("reset_mask", None), self._started)
        for key in options:
            known("reset option", key, (*task.RESET_OPTIONS, "reset_mask"))
        chosen = np.flatnonzero(mask)
        changes = {name: options[name] for name in ("scenario", "force_scale") if name in options}
        drawn = starting.changed(self._given, chosen, changes, self._drawn) if changes else {}
        following = {i: drawn.get(i) or self._given[i] for i in chosen.tolist()}
        given = starting.starts(following, n, options)
        seeded, states = starting.seeded(n, chosen, seed, first)
        self._take(drawn)  # nothing changes before every option is known to be good
        if isinstance(seed, (int, np.integer)):
            super().reset(seed=int(seed))
        self._cars.seed(seeded, states)
        observations = self._cars.reset(mask, given)
        self._started = True
        if mask.all():
            self._running, self._later = list(self._given), False
        for i in chosen.tolist() if self._later else ():
            self._running[i] = self._given[i]
        info: dict[str, Any] = {
            "force": np.zeros(self._shape),
            "_force": mask.copy(),
            "phase": np.where(mask, self._cars.phases, 0.0),
            "_phase": mask.copy(),
        }
        return observations, info

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        dict[str, Any],
    ]:
        """Hold forces for one control interval.

        Parameters
        ----------
        actions : ndarray (n, m)
            Forces over their limits, clipped to [-1, 1].

        Returns
        -------
        observations : ndarray (n, size) float32
        rewards : ndarray (n,)
        terminations, truncations : ndarray (n,) of bool
        info : dict
            `force` (n, m) [m/s^2] or [N], `reward_x1`, `reward_x2`, `reward_travel`, each with its
            mask; `phase` of cars that begin anew; `final_obs`, `final_info` where they are over.

        Raises
        ------
        ValueError
            If the actions have the wrong shape, one is not a finite number, or a car's episode is
            over and the autoreset mode is "Disabled". No car has moved then.
        ResetNeeded
            Before the first reset.
        """
        seen, rewards, force, ends, begun = self.advance(actions)
        every = self._every
        info: dict[str, Any] = {"force": force, "_force": every}
        for i, name, mask in self._names:
            info[name], info[mask] = rewards[i], every
        if begun is not None:
            self._add_begun(info, begun)
        return seen, rewards[0], ends[0], ends[1], info

    def advance(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, Any]:
        """Do what `step` does; return what `qcar_env.engine.cars.Cars.step` does."""
        if not self._started:
            raise gym.error.ResetNeeded("no episode yet; call reset before step")
        return self._cars.step(self._checked(actions), self._mode)

    def _checked(self, actions: Any) -> NDArray[np.float32]:
        """Return actions as an array of the kind that the engine takes."""
        if (
            type(actions) is np.ndarray
            and actions.dtype == SHOWN
            and actions.shape == self._shape
            and actions.flags.c_contiguous
        ):
            return actions
        each = "car and actuator. No car has moved"
        return task.checked_actions("actions", actions, self._shape, each)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return the frames (480, 640, 3) of the cars in `render_cars`.

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
        if not self._started:
            raise gym.error.ResetNeeded("no episode yet; call reset before render")
        pictures = [
            self._picture(car, *caption)
            for car, caption in zip(self._render_cars, self.captions, strict=True)
        ]
        if not self._painters:
            try:
                from qcar_env.envs.rendering import Painter
            except ImportError as error:
                raise task.no_pygame() from error

            self._painters = [Painter() for _ in pictures]
        return tuple(
            painter.draw(picture) for painter, picture in zip(self._painters, pictures, strict=True)
        )

    def _picture(self, car: int, name: str, colour: str) -> Picture:
        elapsed = self._cars.clock("elapsed")[car] * self.dt
        episode, state = self.episode_of(car), State(*self._cars.states[car].tolist())
        held, memory = self._cars.held[car].tolist(), self._cars.memory[car].tolist()
        return Picture(
            name=name,
            colour=colour,
            nominal=self._running[car].base,
            episode=episode,
            time=self._cars.clock("start")[car] + elapsed,
            elapsed=elapsed,
            state=state,
            force=forces(episode.actuator, held, memory, state),
        )

    def _known_car(self, car: Any) -> int:
        is_index = isinstance(car, (int, np.integer)) and not isinstance(car, bool)
        if not (is_index and 0 <= car < self.num_envs):
            raise ValueError(
                f"a car must be one of 0 to {self.num_envs - 1}, got {car!r}; "
                "give indices of the batch"
            )
        return int(car)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the painters behind; they are made anew."""
        return {**vars(self), "_painters": []}

    def close_extras(self, **kwargs: Any) -> None:
        """Hold nothing that needs closing."""

    def _add_begun(self, info: dict[str, Any], begun: batch.Begun) -> None:
        """Add what is to be known of the cars that have begun their next episode."""
        cars = begun.cars
        again = np.zeros(self.num_envs, BOOL)
        again[cars] = True
        if self._later:
            for i in cars.tolist():
                self._running[i] = self._given[i]
        info["phase"], info["_phase"] = begun.phases, again
        others = ~again
        for _, _, mask in self._names:
            info[mask] = others
        if begun.finals is not None:
            last: dict[str, Any] = {}
            for name in ("force", *self.terms):
                last[name] = np.zeros_like(info[name])
                last[name][cars] = info[name][cars]
                last[f"_{name}"] = again
                info[name][cars] = 0.0  # as after the reset
            # a reward is of the interval that ended; only its terms are
            final = np.full(self.num_envs, None, dtype=object)
            for i, seen in zip(cars.tolist(), begun.finals, strict=True):
                final[i] = seen
            info |= {"final_obs": final, "_final_obs": again}
            info |= {"final_info": last, "_final_info": again}
        if len(cars) == self.num_envs:
            for _, name, mask in self._names:
                del info[name], info[mask]

    @property
    def nbytes(self) -> int:
        """Memory that the cars take [B]."""
        return self._cars.nbytes

    def stagger(self, elapsed: NDArray[np.int64]) -> None:
        """Set how many control intervals of their episodes the cars have behind them, (n,).

        For measurements: cars that all began at once would all end in the same step.
        """
        self._cars.stagger(elapsed)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return all that moves, to go on from."""
        return self._cars.snapshot()

    def restore(self, kept: dict[str, NDArray[Any]]) -> None:
        """Go on from a snapshot of an environment made and assigned alike."""
        self._cars.restore(kept)
        self._started = True

    def assign(self, chosen: Sequence[int] | NDArray[np.intp], **options: Any) -> None:
        """Let cars draw their next episodes from another `scenario` or with another `force_scale`.

        Parameters
        ----------
        chosen : sequence of int
            Indices of the cars.
        **options
            `scenario`, `force_scale`: one value or one for each car of the batch.

        Raises
        ------
        ValueError
            If there is no such car or option, a value is out of range, or the scenario has another
            control interval or actuator. Nothing has changed then.
        """
        for key in options:
            known("option", key, ("scenario", "force_scale"))
        cars = [self._known_car(car) for car in chosen]
        self._take(starting.changed(self._given, cars, options, self._drawn))

    def _drawn(self, own: Scenario, scale: float) -> Drawn:
        plan = self._settings.plan(own, scale)
        if hasattr(self, "_cars"):
            first = self._cars.plan
            given = (plan.dt, plan.substeps, plan.composition)
            if given != (first.dt, first.substeps, first.composition):
                raise ValueError(
                    f"scenario {own.name!r} has another control interval, other substeps, parts or "
                    "actuators than this environment's; make a new environment for it"
                )
            if self._linear:
                check_linear(plan.scenario)
        return Drawn(own, scale, plan)

    def _take(self, drawn: dict[int, Drawn]) -> None:
        """Let cars draw from what `starting.changed` has returned."""
        groups: dict[int, tuple[Drawn, list[int]]] = {}
        for i, each in drawn.items():
            if each is not self._given[i]:
                groups.setdefault(id(each), (each, []))[1].append(i)
        if groups:
            self._cars.assign([(np.array(i), each.plan.source) for each, i in groups.values()])
        for i, each in drawn.items():
            self._given[i] = each
        self._later = self._later or bool(groups)


def _mode(given: AutoresetMode | str) -> AutoresetMode:
    if isinstance(given, AutoresetMode):
        return given
    return AutoresetMode(known("autoreset_mode", given, [mode.value for mode in AutoresetMode]))
