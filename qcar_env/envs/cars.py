"""Many cars in one task, stepped by the compiled engine: what the batched environments share."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.envs import task
from qcar_env.physics import engine, engine_sampled
from qcar_env.physics.forcing import World
from qcar_env.physics.motion import angle
from qcar_env.physics.rk4 import step_fractions
from qcar_env.scenarios import Scenario
from qcar_env.validation import whole

FLOAT = np.dtype(np.float64)
SHOWN = np.dtype(np.float32)
BOOL = np.dtype(np.bool_)

CARS_A_THREAD = 16384  # at least: handing fewer over to another thread costs what it saves
DISABLED = engine_sampled.DISABLED
NEXT_STEP = engine_sampled.NEXT_STEP
SAME_STEP = engine_sampled.SAME_STEP


# Cars (indices), the scenario that they draw from, and the same before a force scale.
Group: TypeAlias = tuple[NDArray[np.intp], Scenario, Scenario]

# What a control interval brings; the arrays are the caller's own. A plain tuple, as it is made in
# each step: 0; observations (n, size); rewards (n,); terminated and
# truncated (n,); forces (n, m); the terms of the reward x1, x2 and travel, (n,) each; the number of
# cars whose episode is over now, and of those that have begun their next one; if there are any,
# which have begun and which have not, (n,) each, and the phases of the roads of those [rad], 0
# elsewhere.
Numbers: TypeAlias = NDArray[np.float64]
Interval: TypeAlias = tuple[
    int,
    NDArray[np.float32],
    Numbers,
    NDArray[np.bool_],
    NDArray[np.bool_],
    Numbers,
    Numbers,
    Numbers,
    Numbers,
    int,
    int,
    NDArray[np.bool_] | None,
    NDArray[np.bool_] | None,
    Numbers | None,
]


class Cars:
    """A batch of cars.

    Parameters
    ----------
    n : int
        Number of cars.
    scenario : Scenario
        What all cars drive in at first, see `assign`.
    own : Scenario
        The same before a force scale.
    observe : {"full", "feedback"}
        What is observed.
    observe_limit : bool
        Whether the force limit follows in the observation.
    single : bool
        Whether the engine works in single precision.
    exact : bool
        Whether the exact map of an interval advances the cars, instead of Runge-Kutta steps.
    threads : int
        Threads that share the blocks at most, see `CARS_A_THREAD`.

    Raises
    ------
    ValueError
        If `exact` is asked for on a road with kinks or with parameters that vary.
    """

    def __init__(
        self,
        n: int,
        scenario: Scenario,
        own: Scenario,
        *,
        observe: task.Observe,
        observe_limit: bool,
        single: bool = False,
        exact: bool = False,
        threads: int = 1,
    ) -> None:
        if exact and (scenario.road.profile != "harmonic" or scenario.randomisation is not None):
            varied = "no" if scenario.randomisation is None else "a"
            raise ValueError(
                "method 'exact' needs a harmonic road and no randomisation, got scenario "
                f"{scenario.name!r} with a {scenario.road.profile} road and {varied} "
                "randomisation; take method='rk4'"
            )
        self.n = whole("num_envs", n)
        self._name = scenario.name
        self.size = task.observation_size(observe, observe_limit)
        self.actions = scenario.actuator.size
        self.finals = np.empty((self.n, self.size), SHOWN)
        self.restarted = np.zeros(self.n, BOOL)
        self.restart_phases = np.zeros(self.n)
        self._entries = task.observation_size(observe, False)
        self._with_limit = observe_limit
        self._single = single
        self._exact = exact
        self._sizes = (scenario.dt, scenario.substeps)
        real = np.float32 if single else np.float64
        self._blocks = -(-self.n // engine.LANES)
        self._workers = max(1, min(whole("threads", threads), self.n // CARS_A_THREAD))
        width = engine_sampled.SCRATCH_SIZE
        self._slabs = engine.aligned((self._blocks, engine_sampled.ROWS * engine.LANES), real)
        self._scratch = engine.aligned((self._workers, width), real)
        self._quiet = np.zeros(self._blocks, np.int64)
        self._waiting = np.zeros(self._blocks, np.int64)
        self._streams = np.empty((self.n, 4), np.uint64)
        self._nominals = np.array([_row(scenario, own)])
        self._numbers = {self._nominals[0].tobytes(): 0}  # of the rows of `_nominals`
        self._shared = engine.aligned((engine_sampled.SHARED,), real)
        if exact:
            self._shared[...] = _shared_numbers(scenario, self._nominals[0])
        self._which = np.zeros(self.n, np.int64)
        self._pool: ThreadPoolExecutor | None = None
        self._compile()

    def _compile(self) -> None:
        functions: Any = task
        self._kernels = engine_sampled.kernels(
            functions,
            self._entries,
            self._with_limit,
            self.actions,
            self._single,
            self._exact,
        )
        self._pid = os.getpid()
        self._hold()
        if self._workers == 1:
            self._step = engine.direct(self._kernels.step, 0, engine.OBJECT, NEXT_STEP)
        else:
            self._prepare = engine.direct(self._kernels.prepare, 0, engine.OBJECT)
            self._step_blocks = engine.direct(self._kernels.step_blocks, 0, 0, 1, NEXT_STEP, 0)
            self._restarts = engine.direct(self._kernels.restarts, 0)
            self._step = self._step_on_threads

    def _hold(self) -> None:
        """Note where the arrays lie, for the kernel."""
        dt, substeps = self._sizes
        self._settings = np.array([dt, substeps, *step_fractions(dt / substeps)])
        self._held = np.zeros(engine_sampled.HELD_SIZE, np.int64)
        arrays: list[NDArray[Any]] = [
            self._slabs,
            self._quiet,
            self._waiting,
            self._streams,
            self._nominals,
            self._which,
            self._scratch,
            self.finals,
            self.restarted,
            self.restart_phases,
            self._shared,
            self._settings,
        ]
        numbers = (self.n, len(self._nominals), *engine.array_makers())
        addresses = [each.ctypes.data for each in arrays]
        self._held[: engine_sampled.GIVEN] = [*addresses, *numbers]
        self._place = self._held.ctypes.data

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code and threads behind; they are made anew."""
        code = ("_kernels", "_prepare", "_restarts", "_step", "_step_blocks")
        made = (*code, "_pool", "_pid", "_held", "_place")
        return {k: v for k, v in vars(self).items() if k not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the arrays and compile."""
        vars(self).update(state)
        for name in ("_slabs", "_scratch", "_shared"):
            copy = engine.aligned(state[name].shape, state[name].dtype)
            copy[...] = state[name]
            setattr(self, name, copy)
        self._pool = None
        self._compile()

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self._sizes[0]

    def assign(self, groups: Sequence[Group]) -> None:
        """Let cars draw their next episodes from other scenarios.

        Raises
        ------
        ValueError
            If control interval, substeps or actuators of one differ from those of the batch, or
            anything does where the exact map advances the cars. Nothing has changed then.
        """
        rows = [self._fitting(scenario, own) for _, scenario, own in groups]
        added: list[NDArray[np.float64]] = []
        for (cars, _, _), row in zip(groups, rows, strict=True):
            number = self._numbers.setdefault(row.tobytes(), len(self._numbers))
            if number == len(self._nominals) + len(added):
                added.append(row)
            self._which[cars] = number
        self._nominals = np.vstack([self._nominals, *added])
        if len(self._nominals) > 2 * self.n:  # forget scenarios that no car draws from
            used, self._which[...] = np.unique(self._which, return_inverse=True)
            self._nominals = self._nominals[used]
            self._numbers = {row.tobytes(): i for i, row in enumerate(self._nominals)}
        self._hold()

    def _fitting(self, scenario: Scenario, own: Scenario) -> NDArray[np.float64]:
        """Return the numbers of a scenario from which cars of this batch can draw."""
        given = (scenario.dt, scenario.substeps, scenario.actuator.size)
        if given != (*self._sizes, self.actions):
            raise ValueError(
                f"scenario {scenario.name!r} has (dt, substeps, actuators) = {given}, this "
                f"environment {(*self._sizes, self.actions)}; make a new environment for it"
            )
        row = _row(scenario, own)
        if self._exact and row.tobytes() not in self._numbers:
            raise ValueError(
                f"with method 'exact' all cars share scenario {self._name!r} and its force limit, "
                f"got scenario {scenario.name!r} with other numbers; make a new environment for "
                "it, or take method='rk4'"
            )
        return row

    def seed(self, cars: NDArray[np.intp], states: NDArray[np.uint64]) -> None:
        """Set the random streams of `cars`, see `qcar_env.physics.engine_random.streams`."""
        self._streams[cars] = states

    def reset(self, mask: NDArray[np.bool_], given: ArrayLike) -> NDArray[np.float32]:
        """Begin episodes of the cars in `mask`.

        Parameters
        ----------
        mask : ndarray (n,) of bool
            The cars.
        given : array_like (n, 5)
            State (x1, x2, v1, v2) [m, m, m/s, m/s] and phase [rad] where they are not drawn, else
            not a number.

        Returns
        -------
        ndarray (n, size) of float32
            Observations of all cars.
        """
        observations = np.empty((self.n, self.size), SHOWN)
        self._kernels.reset(
            self._slabs,
            self._quiet,
            self._waiting,
            self._streams,
            self._nominals,
            self._which,
            mask,
            np.ascontiguousarray(given, FLOAT),
            self._sizes[0],
            observations,
        )
        return observations

    def step(self, actions: NDArray[np.float32], mode: int) -> Interval:
        """Hold forces for one control interval.

        Parameters
        ----------
        actions : ndarray (n, m)
            Forces over their limits.
        mode : int
            `DISABLED`, `NEXT_STEP` or `SAME_STEP`: what becomes of a car whose episode is over.

        Returns
        -------
        Interval

        Raises
        ------
        ValueError
            If the actions have the wrong shape, one is not a finite number, or a car's episode is
            over and nothing begins the next one. No car has moved then.
        """
        made = self._step(self._place, actions, mode)
        if made[0]:
            actions = self._checked(actions)
            made = self._step(self._place, actions, mode)
            if made[0]:
                self._refuse(made[0], actions)
        return made

    def _step_on_threads(self, place: int, actions: NDArray[np.float32], mode: int) -> Any:
        """Do what the kernel `step` does, on the threads of a pool."""
        made = self._prepare(place, actions)
        if made[0]:
            return made
        if not np.isfinite(actions).all():  # before any worker moves a car
            return -1, *made[1:]
        if mode == DISABLED and self.done.any():
            return -2, *made[1:]
        if self._pool is None or self._pid != os.getpid():
            self._pool = ThreadPoolExecutor(self._workers - 1)
            self._pid = os.getpid()
        edges = [self._blocks * i // self._workers for i in range(self._workers + 1)]
        jobs = [
            self._pool.submit(self._step_blocks, i, edges[i], edges[i + 1], mode, place)
            for i in range(1, self._workers)
        ]
        results = [self._step_blocks(0, 0, edges[1], mode, place)]
        results += [job.result() for job in jobs]
        if any(each[0] for each in results):
            raise RuntimeError("somebody has written to the actions or cars during the step")
        finished, begun = (sum(each[i] for each in results) for i in (1, 2))
        again = self._restarts(place) if begun else (None, None, None)
        return *made[:9], finished, begun, *again

    def _checked(self, actions: Any) -> NDArray[np.float32]:
        """Return a copy of the actions as an array of the kind that the engine takes."""
        shape = (self.n, self.actions)
        return task.checked_actions("actions", actions, shape, "car and actuator. No car has moved")

    def _refuse(self, code: int, actions: NDArray[np.float32]) -> None:
        if code == -1:
            car = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise ValueError(
                f"actions must be finite, got {actions[car]} for car {car}; allowed range is "
                "[-1, 1]. No car has moved"
            )
        over = np.flatnonzero(self.done)
        raise ValueError(
            f"the episodes of {over.size} car(s) are over (the first is car {over[0]}); call reset "
            "with options={'reset_mask': ...} before the next step. No car has moved"
        )

    def row(self, row: int, count: int = 1) -> NDArray[np.float64]:
        """Return quantities of `qcar_env.physics.engine_sampled` from `row` on, (count, n)."""
        parts = self._slabs.reshape(self._blocks, engine_sampled.ROWS, engine.LANES)
        chosen = parts[:, row : row + count].transpose(1, 0, 2).reshape(count, -1)[:, : self.n]
        return chosen.astype(FLOAT)

    def stagger(self, elapsed: NDArray[np.int64]) -> None:
        """Set the control intervals that the cars' episodes have lasted, (n,)."""
        if np.shape(elapsed) != (self.n,):
            raise ValueError(
                f"elapsed must have shape ({self.n},), got {np.shape(elapsed)}; give one count of "
                "control intervals for each car"
            )
        parts = self._slabs.reshape(self._blocks, engine_sampled.ROWS, engine.LANES)
        for i, count in enumerate(elapsed.tolist()):
            parts[i // engine.LANES, engine_sampled.ELAPSED, i % engine.LANES] = count

    @property
    def states(self) -> NDArray[np.float64]:
        """States (x1, x2, v1, v2) [m, m, m/s, m/s], shape (n, 4)."""
        return self.row(engine_sampled.PLANT, 4).T

    @property
    def done(self) -> NDArray[np.bool_]:
        """Which episodes are over and not begun again, shape (n,)."""
        return self.row(engine_sampled.DONE)[0] > 0.0

    @property
    def phases(self) -> NDArray[np.float64]:
        """Phase of each car's road when its episode began [rad], shape (n,)."""
        return self.row(engine_sampled.PHASE)[0]

    @property
    def nbytes(self) -> int:
        """Memory that the cars take [B]."""
        shared = (self._slabs, self._quiet, self._waiting, self._streams, self._which)
        own = (self.finals, self.restarted, self.restart_phases)
        return sum(each.nbytes for each in (*shared, *own))


def _row(scenario: Scenario, own: Scenario) -> NDArray[np.float64]:
    """Return the numbers of a scenario; the same scenario always has the same bytes."""
    return np.array(task.nominal_numbers(scenario, own)) + 0.0  # no negative zero


def _shared_numbers(scenario: Scenario, nominal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what all cars of a scenario share, (SHARED,): rows of a car, and the exact map."""
    from qcar_env.physics.linear import exact_transition  # scipy: slow to import

    functions: Any = task
    car = np.zeros(engine_sampled.ONE_CAR)
    kernels = engine_sampled.kernels(
        functions, task.FULL_SIZE, False, scenario.actuator.size, False
    )
    given = engine_sampled.NOTHING_GIVEN
    kernels.reset_one(car, engine.array_makers(), np.zeros(task.DRAWS), given, nominal)
    made = exact_transition(scenario.car, scenario.road, scenario.force, scenario.dt)
    weights = np.hstack([made.A, made.B, made.road, made.force]).ravel()
    by = World(angle(scenario.road.omega * made.dt), angle(scenario.force.Omega * made.dt))
    return np.concatenate([car[: engine_sampled.ROWS], weights, *by])
