"""A fleet: many cars, or one, of any make, whose actions are held over control intervals.

Every environment, and every result of this library, comes from here.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import LANES, aligned
from qcar_env.engine.held_law import driver
from qcar_env.engine.layout import columns
from qcar_env.engine.random import streams
from qcar_env.engine.stepping import (
    FINE,
    NOT_FINITE,
    OVER,
    Composition,
    Kernels,
    compose,
)
from qcar_env.physics import tree
from qcar_env.validation import whole

Array = NDArray[np.float64]
SHOWN, FLOAT = np.dtype(np.float32), np.dtype(np.float64)
BOOL, COUNT = np.dtype(np.bool_), np.dtype(np.int64)

CARS_A_THREAD = 16384  # at least: handing fewer over to another thread costs what it saves
DISABLED, NEXT_STEP, SAME_STEP = range(3)  # what becomes of a car whose episode is over
MOVING = ("_slabs", "_clocks", "_fixed", "_of_block", "_streams", "uniforms")
NOTHING_GIVEN = np.full((1, 5), np.nan)


class Source(NamedTuple):
    """What a car draws its episodes from, as plain numbers."""

    row: Array  # (k,) a `qcar_env.engine.starts.Nominal`
    draws: Array  # (d, e) distributions, see `qcar_env.engine.starts.drawn`
    targets: Array  # (t, 3) what they change, see `qcar_env.engine.starts.vary`
    uniforms: int  # how many uniform numbers an episode takes
    table: Array  # (e,) of the road


class Plan(Protocol):
    """What a fleet is made for (see `qcar_env.envs.episode`)."""

    @property
    def composition(self) -> Composition:
        """What is compiled."""
        ...

    @property
    def source(self) -> Source:
        """What the cars draw from at first."""
        ...

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        ...

    @property
    def substeps(self) -> int:
        """RK4 steps in it."""
        ...


class Interval(NamedTuple):
    """What a control interval brings; the arrays are the caller's own."""

    seen: NDArray[np.float32]  # (n, k) observations
    rewards: Array  # (t + 2, n) reward; its terms; the penalty for leaving the travel
    force: Array  # (n, m) forces of the actuators, in their unit
    ends: NDArray[np.bool_]  # (2, n) terminated, truncated
    begun: NDArray[np.int64] | None  # cars that have begun their next episode
    finals: NDArray[np.float32] | None  # their last observations, in the mode `SAME_STEP`


class Cars:
    """A fleet.

    Parameters
    ----------
    n : int
        Number of cars.
    plan : Plan
        What they are, and what they draw their episodes from.
    single : bool
        Whether the cars' numbers have single precision.
    threads : int
        Threads that share the cars at most, see `CARS_A_THREAD`.
    exact : bool
        Whether an interval is one exact map, see `qcar_env.engine.linear_cars.LinearCars`.
    """

    def __init__(
        self,
        n: int,
        plan: Plan,
        *,
        single: bool = False,
        threads: int = 1,
        exact: bool = False,
    ) -> None:
        self.n = whole("num_envs", n)
        self.plan = plan
        self._single, self._exact = single, exact
        self._blocks = -(-self.n // LANES)
        self._workers = max(1, min(whole("threads", threads), self.n // CARS_A_THREAD))
        kernels = compose(plan.composition, single, exact)
        self._settings = (plan.dt, 1 if exact else plan.substeps)
        real = np.float32 if single else np.float64
        lanes = self._lanes = LANES
        rows = kernels.scratch + (2 * self._settings[1] + 1) * kernels.stages
        self._slabs = aligned((self._blocks, kernels.moving.size * lanes), real)
        self._clocks = aligned((self._blocks, kernels.clock.size * lanes))
        self._fixed = aligned((1, kernels.fixed.size * lanes), real)
        self._scratch = aligned((self._workers, rows * lanes), real)
        # Of a block: which slab of `_fixed` is its own, and for how many intervals none of its cars
        # can meet a kink.
        self._of_block = np.zeros((self._blocks, 2), COUNT)
        self._streams = np.zeros((self.n, 4), np.uint64)
        self._sources = [plan.source]
        self._chosen = np.zeros(self.n, COUNT)  # which source a car draws its next episode from
        self._drawn_from = np.zeros(self.n, COUNT)  # and which it drew the running one from
        self._gather()
        self.uniforms = np.zeros((self.n, plan.source.uniforms))  # what episodes were drawn from
        self._pool: ThreadPoolExecutor | None = None
        self._busy = False
        self._compile(kernels)

    def _compile(self, kernels: Kernels) -> None:
        self.kernels = kernels
        composition = self.plan.composition
        self.size, self.actions = len(composition.observed), composition.actuator.size  # pyright: ignore[reportAttributeAccessIssue]
        self._terms = len(composition.terms)
        self._shape = (self.n, self.actions)
        dt, n = self._settings
        cars = self._moving()
        outputs = self._outputs()
        examples = (*cars, self._scratch, 0, 0, 1, np.empty(self._shape, SHOWN), dt, n, *outputs)
        self._step = kernels.step.compile(tuple(numba.typeof(each) for each in examples))
        self._pid = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code and threads behind; they are made anew."""
        made = ("kernels", "_step", "_pool")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the arrays, and compile."""
        vars(self).update(state)
        for name in ("_slabs", "_clocks", "_fixed", "_scratch"):
            copy = aligned(state[name].shape, state[name].dtype)
            copy[...] = state[name]
            setattr(self, name, copy)
        self._pool, self._busy = None, False
        self._compile(compose(self.plan.composition, self._single, self._exact))

    def _moving(self) -> tuple[Any, ...]:
        return (
            self._slabs,
            self._clocks,
            self._fixed,
            self._of_block,
            self._tables,
            self._bounds,
        )

    def _outputs(self) -> tuple[Any, ...]:
        n = self.n
        return (
            np.empty((n, self.size), SHOWN),
            np.empty((self._terms + 2, n), FLOAT),
            np.empty(self._shape, FLOAT),
            np.empty((2, n), BOOL),
        )

    # What cars draw from ----------------------------------------------------------------------

    def _gather(self) -> None:
        """Lay the sources out as arrays."""
        sources = self._sources
        self._nominals = np.array([each.row for each in sources])
        wide = max(each.draws.shape[1] for each in sources)
        deep = max(each.draws.shape[0] for each in sources)
        self._draws = np.zeros((len(sources), deep, wide))
        for place, each in zip(self._draws, sources, strict=True):
            place[: each.draws.shape[0], : each.draws.shape[1]] = each.draws
        self._targets = np.concatenate([each.targets for each in sources])
        self._tables = np.concatenate([each.table for each in sources])
        ends = np.cumsum([len(each.targets) for each in sources])
        first = ends - [len(each.targets) for each in sources]
        counts = [each.uniforms for each in sources]
        self._counts = np.stack([counts, first, ends], axis=1).astype(COUNT)
        last = np.cumsum([len(each.table) for each in sources])
        begin = last - [len(each.table) for each in sources]
        self._of_table = np.stack([begin, last], axis=1).astype(COUNT)
        self._bounds = self._of_table[self._drawn_from]
        if not self._alike and len(self._fixed) < self._blocks:  # numbers of their own from now on
            own = aligned((self._blocks, self._fixed.shape[1]), self._fixed.dtype)
            own[...] = self._fixed
            self._fixed = own
            self._of_block[:, 0] = np.arange(self._blocks)

    @property
    def _alike(self) -> bool:
        """Whether all cars have the same numbers."""
        return len(self._sources) == 1 and not len(self._sources[0].targets)

    def assign(self, groups: Sequence[tuple[NDArray[np.intp], Source]]) -> None:
        """Let cars draw their next episodes from other sources of the same composition."""
        for cars, source in groups:
            for number, known in enumerate(self._sources):
                if _equal(known, source):
                    self._chosen[cars] = number
                    break
            else:
                self._chosen[cars] = len(self._sources)
                self._sources.append(source)
        self._forget()
        most = max(each.uniforms for each in self._sources)
        if most > self.uniforms.shape[1]:
            self.uniforms = np.pad(self.uniforms, ((0, 0), (0, most - self.uniforms.shape[1])))

    def _forget(self) -> None:
        """Keep the sources of running and of next episodes alone."""
        both = np.stack([self._chosen, self._drawn_from])
        used, places = np.unique(both, return_inverse=True)
        self._chosen, self._drawn_from = places.reshape(both.shape).astype(COUNT)
        self._sources = [self._sources[i] for i in used]
        self._gather()

    # Episodes ---------------------------------------------------------------------------------

    def seed(self, cars: NDArray[np.intp], states: NDArray[np.uint64]) -> None:
        """Set the random streams of `cars`, see `qcar_env.engine.random.streams`."""
        self._streams[cars] = states

    def begin(
        self,
        cars: NDArray[np.int64],
        given: Array,
        seen: NDArray[np.float32],
        uniforms: Array | None = None,
    ) -> None:
        """Begin episodes.

        Parameters
        ----------
        cars : ndarray (k,)
            Which cars.
        given : ndarray (k, 5) or (1, 5)
            State (x1, x2, v1, v2) [m, m, m/s, m/s] and phase [rad] where they are not drawn, else
            not a number.
        seen : ndarray (n, size) of float32
            Their observations are written here.
        uniforms : ndarray (k, count), optional
            Numbers from [0, 1) that the episodes are drawn from, `Source.uniforms` of them for each
            car; from the cars' random streams if left out.
        """
        dt, n = self._settings
        if len(self._sources) > 1:
            self._drawn_from[cars] = self._chosen[cars]
            self._bounds[cars] = self._of_table[self._chosen[cars]]
        if uniforms is not None:
            self.uniforms[cars, : uniforms.shape[1]] = uniforms
        self.kernels.begin(
            *self._moving(),
            self._streams,
            self._chosen,
            self._nominals,
            self._draws,
            self._targets,
            self._counts,
            cars,
            given,
            dt,
            n,
            self.uniforms,
            uniforms is None,
            seen,
        )

    def reset(
        self, mask: NDArray[np.bool_], given: Array, uniforms: Array | None = None
    ) -> NDArray[np.float32]:
        """Begin episodes of the cars in `mask` (n,); return the observations of all cars.

        Parameters
        ----------
        mask : ndarray (n,) of bool
            Which cars.
        given : ndarray (n, 5)
            See `begin`.
        uniforms : ndarray (n, count), optional
            See `begin`.
        """
        cars = np.flatnonzero(mask).astype(COUNT)
        seen = np.empty((self.n, self.size), SHOWN)
        if len(cars) < self.n:
            self.kernels.show(*self._moving(), self._settings[0], seen)
        if len(cars) == self.n:
            self._drawn_from[...] = self._chosen
            self._forget()
            if self._alike and len(self._fixed) > 1:
                self._fixed = aligned((1, self._fixed.shape[1]), self._fixed.dtype)
                self._of_block[:, 0] = 0
        self._of_block[:, 1] = np.iinfo(COUNT).max if len(cars) == self.n else 0
        own = None if uniforms is None else uniforms[cars]
        self.begin(cars, np.ascontiguousarray(given[cars], FLOAT), seen, own)
        return seen

    def step(self, actions: NDArray[np.float32], mode: int) -> Interval:
        """Hold forces for one control interval.

        Parameters
        ----------
        actions : ndarray (n, m) of float32
            Forces over their limits, row by row in memory.
        mode : int
            `DISABLED`, `NEXT_STEP` or `SAME_STEP`: what becomes of a car whose episode is over.

        Returns
        -------
        Interval

        Raises
        ------
        ValueError
            If an action is not a finite number, or a car's episode is over and nothing begins the
            next one. No car has moved then.
        RuntimeError
            If another thread is stepping these cars.
        """
        if self._busy:
            raise RuntimeError("another thread is stepping these cars; give each its own")
        if mode == DISABLED and self.done.any():
            over = np.flatnonzero(self.done)
            raise ValueError(
                f"the episodes of {over.size} car(s) are over (the first is car {over[0]}); call "
                "reset with options={'reset_mask': ...} before the next step. No car has moved"
            )
        self._busy = True
        try:
            outputs = self._outputs()
            code = self._run(actions, outputs)
            if code == NOT_FINITE:
                self._refuse(actions)
            if code == FINE:
                seen, rewards, force, ends = outputs
                return Interval(seen, rewards, force, ends, None, None)
            return self._turn_over(outputs, mode)
        finally:
            self._busy = False

    def _run(self, actions: NDArray[np.float32], outputs: tuple[Any, ...]) -> int:
        cars = self._moving()
        if self._workers == 1:
            return self._step(
                *cars, self._scratch, 0, 0, self._blocks, actions, *self._settings, *outputs
            )
        if not np.isfinite(actions).all():  # before any worker moves a car
            return NOT_FINITE
        if self._pool is None or self._pid != os.getpid():
            self._pool, self._pid = ThreadPoolExecutor(self._workers - 1), os.getpid()
        edges = [self._blocks * i // self._workers for i in range(self._workers + 1)]
        jobs = [
            self._pool.submit(
                self._step,
                *(*cars, self._scratch, i, edges[i], edges[i + 1], actions),
                *self._settings,
                *outputs,
            )
            for i in range(1, self._workers)
        ]
        try:
            own = self._step(
                *cars, self._scratch, 0, 0, edges[1], actions, *self._settings, *outputs
            )
        finally:
            wait(jobs)  # the workers write to these arrays, whatever interrupts this thread
        return max(own, *(job.result() for job in jobs))

    def _turn_over(self, outputs: tuple[Any, ...], mode: int) -> Interval:
        seen, rewards, force, ends = outputs
        now, before = self.kernels.ending(self._clocks, ends, rewards, force)
        begun = now if mode == SAME_STEP else before
        finals = seen[begun] if mode == SAME_STEP else None
        if not len(begun):
            return Interval(seen, rewards, force, ends, None, None)
        self.begin(begun, NOTHING_GIVEN, seen)
        return Interval(seen, rewards, force, ends, begun, finals)

    def _refuse(self, actions: NDArray[np.float32]) -> None:
        car = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
        raise ValueError(
            f"actions must be finite, got {actions[car]} for car {car}; allowed range is "
            "[-1, 1]. No car has moved"
        )

    def drive(
        self,
        act: Any,
        gains: Array,
        seen: NDArray[np.float32],
        *,
        intervals: int,
        window: int,
        shared: tuple[Any, ...] = (),
    ) -> Array:
        """Let laws drive for many control intervals, in compiled code, through ends of episodes.

        Parameters
        ----------
        act : callable
            A law, see `qcar_env.engine.held_law`.
        gains : ndarray (k, ...)
            Of k laws; the first drives the first n / k cars, and so on.
        seen : ndarray (n, size) of float32
            What the cars' policies see now; in the end, what they see then.
        intervals, window : int
            How many control intervals, and how many at their end amplitudes are taken over.
        shared : tuple
            What the laws have in common.

        Returns
        -------
        ndarray (n, 2)
            Largest |x1|, |x2| [m] at the ends of the intervals in the window; infinite for a car
            whose state or action is no finite number.

        Raises
        ------
        ValueError
            If the cars cannot be shared out among the laws.
        """
        laws = len(gains)
        if not laws or self.n % laws:
            raise ValueError(
                f"laws must drive equally many of {self.n} cars, got {laws} laws; give a divisor"
            )
        peak = np.zeros((self.n, 2))
        driver(self.kernels.step.py_func, act)(
            *(*self._moving(), self._scratch, *self._settings, *self._outputs()[1:]),
            *(seen, np.zeros(self._shape, SHOWN), gains, self.n // laws, shared),
            *(intervals, window, self.kernels.moving.row("state"), peak),
        )
        return np.where(np.isnan(peak), np.inf, peak)

    # What can be looked at and kept ------------------------------------------------------------

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return all that moves: enough for a fleet with the same sources to go on from."""
        return {name: getattr(self, name).copy() for name in MOVING}

    def restore(self, kept: dict[str, NDArray[Any]]) -> None:
        """Go on from a snapshot."""
        for name in MOVING:
            getattr(self, name)[...] = kept[name]

    def entries(self, name: str) -> Any:
        """Return the cars' `state`, `phasors` or `fixed`: a named tuple of arrays (n,)."""
        kernels = self.kernels
        own = name == "fixed"
        layout = kernels.fixed if own else kernels.moving
        slabs = self._fixed[self._of_block[:, 0]] if own else self._slabs
        like = layout.trees[name]
        return tree.unflat(like, columns(slabs, layout.row(name), len(tree.flat(like)), self.n))

    @property
    def states(self) -> Array:
        """States (x1, x2, v1, v2) [m, m, m/s, m/s], shape (n, 4)."""
        return columns(self._slabs, self.kernels.moving.row("state"), 4, self.n).T

    @property
    def done(self) -> NDArray[np.bool_]:
        """Which episodes are over and not begun again, shape (n,)."""
        return self.clock("done") > 0.0

    @property
    def phases(self) -> Array:
        """Phase of each car's road when its episode began [rad], shape (n,)."""
        return self.clock("phase")

    def clock(self, name: str) -> Array:
        """Return an entry of each car's `qcar_env.engine.starts.Clock`, shape (n,)."""
        return columns(self._clocks, self.kernels.clock.find(f"clock.{name}"), 1, self.n)[0]

    def fixed(self, path: str, count: int = 1) -> Array:
        """Return `count` numbers of each car's `qcar_env.engine.starts.Fixed`, shape (count, n)."""
        row = self.kernels.fixed.find(f"fixed.{path}")
        own = self._fixed[self._of_block[:, 0]]
        return columns(own, row, count, self.n)

    @property
    def held(self) -> Array:
        """The commands that the actuators hold, shape (n, m)."""
        return columns(self._slabs, self.kernels.moving.row("held"), self.actions, self.n).T

    @property
    def memory(self) -> Array:
        """Memory of the actuators, shape (n, k); k is 0 where they have none."""
        row = self.kernels.moving.row("state")
        count = self.kernels.moving.row("phasors") - row - 4
        if count == 0:
            return np.empty((self.n, 0))
        return columns(self._slabs, row + 4, count, self.n).T

    def stagger(self, elapsed: NDArray[np.int64]) -> None:
        """Set the control intervals that the cars' episodes have lasted, (n,)."""
        if np.shape(elapsed) != (self.n,):
            raise ValueError(
                f"elapsed must have shape ({self.n},), got {np.shape(elapsed)}; give one count of "
                "control intervals for each car"
            )
        row = self.kernels.clock.find("clock.elapsed")
        parts = self._clocks.reshape(self._blocks, -1, LANES)
        for i, count in enumerate(elapsed.tolist()):
            parts[i // LANES, row, i % LANES] = count

    @property
    def nbytes(self) -> int:
        """Memory that the cars take [B]."""
        own = (self._slabs, self._clocks, self._fixed, self._of_block)
        return sum(each.nbytes for each in (*own, self._streams, self._chosen, self._bounds))


class Car:
    """A car by itself: what the scalar environment drives.

    Parameters
    ----------
    plan : Plan
        What it is, and what it draws its episodes from.
    """

    def __init__(self, plan: Plan) -> None:
        self.array = np.zeros(0)
        self.plan = plan
        self._compile()
        self.take(plan)
        self.array[self._clock_row("done")] = 1.0

    def take(self, plan: Plan) -> None:
        """Let the next episode be drawn from another plan of the same composition."""
        own, table = self.kernels.own, plan.source.table
        self.size = len(plan.composition.observed)
        self.actions: int = plan.composition.actuator.size  # pyright: ignore[reportAttributeAccessIssue]
        array = aligned((own.table + len(table),))
        array[: own.table] = self.array[: own.table] if len(self.array) else 0.0
        array[own.dt : own.dt + 2] = plan.dt, plan.substeps
        array[own.table :] = table
        self.array, self._source, self.plan = array, plan.source, plan

    def _compile(self) -> None:
        self.kernels = compose(self.plan.composition, False)
        self.advance = self.kernels.step_one.compile(_ONE)

    def _clock_row(self, name: str) -> int:
        return self.kernels.own.clock + self.kernels.clock.find(f"clock.{name}")

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code behind; it is made anew."""
        made = ("kernels", "advance")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore everything else, and compile."""
        vars(self).update(state)
        self._compile()
        self.take(self.plan)

    def begin(self, uniforms: Array, given: Array) -> NDArray[np.float32]:
        """Begin an episode; return the observation (size,).

        Parameters
        ----------
        uniforms : ndarray (count,)
            Numbers from [0, 1) that it is drawn from, `Source.uniforms` of them.
        given : ndarray (5,)
            State and phase where they are not drawn, else not a number.
        """
        source, seen = self._source, np.empty(self.size, SHOWN)
        self.kernels.reset_one(
            self.array, uniforms, given, source.row, source.draws, source.targets, seen
        )
        return seen

    # A step is ``advance(array, action, seen, force)`` with the action (m,) of float32; observation
    # (size,) of float32 and forces (m,) are written. It returns a code (`FINE`, `OVER`,
    # `NOT_FINITE`, `WRONG_SHAPE`), the reward, whether the episode is terminated or truncated, the
    # reward's terms and the penalty for leaving the travel.

    @property
    def state(self) -> Array:
        """State (x1, x2, v1, v2) [m, m, m/s, m/s], shape (4,)."""
        row = self.kernels.moving.row("state")
        return self.array[row : row + 4].copy()

    @property
    def held(self) -> Array:
        """The commands that the actuators hold, shape (m,)."""
        row = self.kernels.moving.row("held")
        return self.array[row : row + self.actions].copy()

    @property
    def memory(self) -> Array:
        """Memory of the actuators, shape (k,); k is 0 where they have none."""
        row = self.kernels.moving.row("state")
        return self.array[row + 4 : self.kernels.moving.row("phasors")].copy()

    def clock(self, name: str) -> float:
        """Return an entry of `qcar_env.engine.starts.Clock`."""
        return float(self.array[self._clock_row(name)])


_NUMBERS = numba.types.Array(numba.types.float64, 1, "C")
_ONE = (  # what a step takes; an action may lie in memory in any way
    _NUMBERS,
    numba.types.Array(numba.types.float32, 1, "A"),
    numba.types.Array(numba.types.float32, 1, "C"),
    _NUMBERS,
)


def _equal(a: Source, b: Source) -> bool:
    return a.uniforms == b.uniforms and all(
        np.array_equal(c, d)
        for c, d in ((a.row, b.row), (a.draws, b.draws), (a.targets, b.targets), (a.table, b.table))
    )


__all__ = [
    "DISABLED",
    "NEXT_STEP",
    "OVER",
    "SAME_STEP",
    "Cars",
    "Interval",
    "Plan",
    "Source",
    "streams",
]
