"""A fleet: many cars, or one, of any make, whose actions are held over control intervals.

Every environment, and every result of this library, comes from here.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import LANES, aligned, entry
from qcar_env.engine.composition import OWN_FIXED, QUIET, Drawn, Moved, Scratch
from qcar_env.engine.driving import CLOCKS
from qcar_env.engine.held_law import driver
from qcar_env.engine.layout import columns
from qcar_env.engine.stepping import NOT_FINITE, Kernels, compose
from qcar_env.physics import tree
from qcar_env.validation import whole

Array = NDArray[np.float64]
SHOWN, FLOAT = np.dtype(np.float32), np.dtype(np.float64)
BOOL, COUNT = np.dtype(np.bool_), np.dtype(np.int64)

CARS_A_THREAD = 16384  # at least: handing fewer over to another thread costs what it saves
DISABLED, NEXT_STEP, SAME_STEP = range(3)  # what becomes of a car whose episode is over
SLABS = ("slabs", "clocks", "fixed", "numbers", "stages", "shown")  # aligned in memory
MOVING = ("slabs", "clocks", "fixed", "blocks", "streams", "uniforms")
NOTHING_GIVEN = np.full((1, 5), np.nan)


class Source(NamedTuple):
    """What a car draws its episodes from, as plain numbers."""

    row: Array  # (k,) a `qcar_env.engine.starts.Nominal`
    draws: Array  # (d, e) distributions, see `qcar_env.engine.starts.drawn`
    targets: Array  # (t, 3) what they change, see `qcar_env.engine.starts.vary`
    uniforms: int  # how many uniform numbers an episode takes
    table: Array  # (e,) of the road


class Plan(Protocol):
    """What a fleet is made for (see `qcar_env.scenarios.plan`)."""

    composition: Any  # Composition: what is compiled
    source: Any  # Source: what the cars draw from at first
    dt: Any  # control interval [s]
    substeps: Any  # RK4 steps in it


class Begun(NamedTuple):
    """Cars that have begun their next episode in a step."""

    cars: NDArray[np.int64]  # (k,)
    phases: Array  # (n,) of their roads [rad], 0 for the others
    finals: NDArray[np.float32] | None  # (k, size) last observations, in the mode `SAME_STEP`


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
        self._workers = max(1, min(whole("threads", threads), self.n // CARS_A_THREAD))
        self._compose()
        blocks, substeps = -(-self.n // LANES), 1 if exact else plan.substeps
        self._blocks = blocks
        moving, fixed = self.kernels.moving.size, self.kernels.fixed.size
        self._arrays: dict[
            str, Any
        ] = {  # the fields of `Moved` and `Drawn`, and a row of `Scratch` for each worker
            "slabs": self._slab(blocks, moving),
            "clocks": aligned((blocks, CLOCKS.size * LANES)),
            "fixed": self._slab(1, fixed),
            "blocks": np.zeros((blocks, 3), COUNT),
            "numbers": self._slab(self._workers, self.kernels.scratch),
            "stages": self._slab(self._workers, self.kernels.stages(substeps)),
            "shown": aligned((self._workers, self.size * LANES), SHOWN),
            "streams": np.zeros((self.n, 4), np.uint64),
            "chosen": np.zeros(self.n, COUNT),
            "row": plan.source.row.copy(),
            "uniforms": np.zeros((self.n, plan.source.uniforms)),
            "dt": float(plan.dt),
            "substeps": substeps,
        }
        self._drawn_from = np.zeros(self.n, COUNT)  # which source a running episode is drawn from
        self._sources = [plan.source]
        self._pool: ThreadPoolExecutor | None = None
        self._busy = False
        self._gather()

    def _slab(self, count: int, rows: int) -> NDArray[Any]:
        return aligned((count, rows * LANES), np.float32 if self._single else np.float64)

    def _compose(self) -> None:
        composition = self.plan.composition
        self.kernels: Kernels = compose(composition, self._single, self._exact)
        self.size, self.actions = len(composition.observed), composition.actuator.size
        self._rows, self._shape = len(composition.terms) + 2, (self.n, self.actions)

    def _bind(self) -> None:
        """Hand the arrays over to compiled code, and compile."""
        a = self._arrays
        self._moved, self._drawn = (
            kind(*(a[name] for name in kind._fields)) for kind in (Moved, Drawn)
        )
        self._of_worker = [
            (*self._moved, *(a[name][i] for name in Scratch._fields)) for i in range(self._workers)
        ]
        outputs = self._outputs()
        self._step = entry(
            self.kernels.step, *self._of_worker[0], 0, 1, np.empty(self._shape, SHOWN), *outputs
        )
        self._turn = entry(
            *(self.kernels.turn_over, self._moved, self._drawn, NOTHING_GIVEN, True, *outputs),
            *(self._arrays["chosen"], np.zeros(0), outputs[0]),
        )
        self._pid = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code and threads behind; they are made anew."""
        made = ("kernels", "_step", "_turn", "_moved", "_drawn", "_of_worker", "_pool")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the arrays, and compile."""
        vars(self).update(state)
        for name in SLABS:
            given = self._arrays[name]
            self._arrays[name] = aligned(given.shape, given.dtype)
            self._arrays[name][...] = given
        self._pool, self._busy = None, False
        self._compose()
        self._bind()

    def _outputs(self) -> tuple[Any, ...]:
        """Return arrays for observations; rewards, their terms, the penalty; forces; ends."""
        n = self.n
        return (
            np.empty((n, self.size), SHOWN),
            np.empty((self._rows, n), FLOAT),
            np.empty(self._shape, FLOAT),
            np.empty((2, n), BOOL),
        )

    # What cars draw from ----------------------------------------------------------------------

    def _gather(self) -> None:
        """Lay the sources out as arrays."""
        sources, a = self._sources, self._arrays
        deep, wide = np.max([each.draws.shape for each in sources], axis=0)
        draws = np.zeros((len(sources), deep, wide))
        for own, each in zip(draws, sources, strict=True):
            own[: each.draws.shape[0], : each.draws.shape[1]] = each.draws
        targets, tables = (
            [getattr(each, name) for each in sources] for name in ("targets", "table")
        )
        ends, last = (np.cumsum([len(each) for each in own]) for own in (targets, tables))
        counts = ([each.uniforms for each in sources], ends - [len(x) for x in targets], ends)
        self._of_table = np.stack([last - [len(x) for x in tables], last], axis=1).astype(COUNT)
        a["nominals"], a["draws"] = np.array([each.row for each in sources]), draws
        a["targets"], a["tables"] = np.concatenate(targets), np.concatenate(tables)
        a["counts"] = np.stack(counts, axis=1).astype(COUNT)
        a["bounds"] = self._of_table[self._drawn_from]
        if not self._alike and len(a["fixed"]) < len(
            a["slabs"]
        ):  # numbers of their own from now on
            shared = a["fixed"]
            a["fixed"] = self._slab(len(a["slabs"]), self.kernels.fixed.size)
            a["fixed"][...] = shared
            a["blocks"][:, OWN_FIXED] = np.arange(len(a["slabs"]))
        self._bind()

    @property
    def _alike(self) -> bool:
        """Whether all cars have the same numbers."""
        return len(self._sources) == 1 and not len(self._sources[0].targets)

    @property
    def uniforms(self) -> Array:
        """Numbers from [0, 1) that the running episodes were drawn from, shape (n, most)."""
        return self._arrays["uniforms"]

    def assign(self, groups: Sequence[tuple[NDArray[np.intp], Source]]) -> None:
        """Let cars draw their next episodes from other sources of the same composition."""
        for cars, source in groups:
            for number, known in enumerate(self._sources):
                if _equal(known, source):
                    self._arrays["chosen"][cars] = number
                    break
            else:
                self._arrays["chosen"][cars] = len(self._sources)
                self._sources.append(source)
        most = max(each.uniforms for each in self._sources) - self.uniforms.shape[1]
        if most > 0:
            self._arrays["uniforms"] = np.pad(self.uniforms, ((0, 0), (0, most)))
        self._forget()

    def _forget(self) -> None:
        """Keep the sources of running and of next episodes alone."""
        both = np.stack([self._arrays["chosen"], self._drawn_from])
        used, places = np.unique(both, return_inverse=True)
        self._arrays["chosen"], self._drawn_from = places.reshape(both.shape).astype(COUNT)
        self._sources = [self._sources[i] for i in used]
        self._gather()

    # Episodes ---------------------------------------------------------------------------------

    def seed(self, cars: NDArray[np.intp], states: NDArray[np.uint64]) -> None:
        """Set the random streams of `cars`, see `qcar_env.engine.random.streams`."""
        self._arrays["streams"][cars] = states

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
        if len(self._sources) > 1:
            self._draw_from_chosen(cars)
        if uniforms is not None:
            self.uniforms[cars, : uniforms.shape[1]] = uniforms
        self.kernels.begin(self._moved, self._drawn, cars, given, uniforms is None, seen)

    def _draw_from_chosen(self, cars: Any) -> None:
        self._drawn_from[cars] = chosen = self._arrays["chosen"][cars]
        self._arrays["bounds"][cars] = self._of_table[chosen]

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
        cars, a = np.flatnonzero(mask).astype(COUNT), self._arrays
        seen, every = np.empty((self.n, self.size), SHOWN), len(cars) == self.n
        if every:
            self._drawn_from[...] = a["chosen"]
            if len(self._sources) > 1 or len(a["fixed"]) > 1:
                if len(np.unique(a["chosen"])) == 1 and not len(
                    self._sources[a["chosen"][0]].targets
                ):
                    a["fixed"] = self._slab(1, self.kernels.fixed.size)
                    a["blocks"][:, OWN_FIXED] = 0
                self._forget()
        else:
            self.kernels.show(self._moved, seen)
        a["blocks"][:, QUIET] = np.iinfo(COUNT).max if every else 0
        own = None if uniforms is None else uniforms[cars]
        self.begin(cars, np.ascontiguousarray(given[cars], FLOAT), seen, own)
        return seen

    def step(
        self, actions: NDArray[np.float32], mode: int
    ) -> tuple[NDArray[np.float32], Array, Array, NDArray[np.bool_], Begun | None]:
        """Hold forces for one control interval.

        Parameters
        ----------
        actions : ndarray (n, m) of float32
            Forces over their limits, row by row in memory.
        mode : int
            `DISABLED`, `NEXT_STEP` or `SAME_STEP`: what becomes of a car whose episode is over.

        Returns
        -------
        seen : ndarray (n, size) of float32
            Observations. These arrays are the caller's own.
        rewards : ndarray (t + 2, n)
            Reward; its terms; the penalty for leaving the travel.
        force : ndarray (n, m)
            Forces of the actuators, in their unit.
        ends : ndarray (2, n) of bool
            Terminated, truncated.
        begun : Begun or None
            Cars that have begun their next episode.

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
            seen, rewards, force, ends = outputs = self._outputs()
            if self._workers == 1:
                code = self._step(*self._of_worker[0], 0, self._blocks, actions, *outputs)
            else:
                code = self._share_out(actions, outputs)
            if code == NOT_FINITE:
                self._refuse(actions)
            begun = self._turn_over(mode == SAME_STEP, outputs) if code else None
            return seen, rewards, force, ends, begun
        finally:
            self._busy = False

    def _share_out(self, actions: NDArray[np.float32], outputs: tuple[Any, ...]) -> int:
        """Step the cars in several threads."""
        if not np.isfinite(actions).all():  # before any worker moves a car
            return NOT_FINITE
        if self._pool is None or self._pid != os.getpid():
            self._pool, self._pid = ThreadPoolExecutor(self._workers - 1), os.getpid()
        edges = [self._blocks * i // self._workers for i in range(self._workers + 1)]
        calls = [
            (*self._of_worker[i], edges[i], edges[i + 1], actions, *outputs)
            for i in range(self._workers)
        ]
        jobs = [self._pool.submit(self._step, *call) for call in calls[1:]]
        try:
            own = self._step(*calls[0])
        finally:
            wait(jobs)  # the workers write to these arrays, whatever interrupts this thread
        return max(own, *(job.result() for job in jobs))

    def _turn_over(self, same_step: bool, outputs: tuple[Any, ...]) -> Begun | None:
        n = self.n
        if len(self._sources) > 1:
            ended = outputs[3].any(axis=0) if same_step else self.done
            self._draw_from_chosen(np.flatnonzero(ended))
        cars, phases = np.empty(n, COUNT), np.zeros(n)
        finals = np.empty((n if same_step else 0, self.size), SHOWN)
        seen, rewards, force, ends = outputs
        count = self._turn(
            *(self._moved, self._drawn, NOTHING_GIVEN, same_step, seen, rewards, force, ends),
            *(cars, phases, finals),
        )
        if not count:
            return None
        return Begun(cars[:count], phases, finals[:count] if same_step else None)

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
            *(self._moved, Scratch(*self._of_worker[0][-3:]), self._outputs(), seen),
            *(np.zeros(self._shape, SHOWN), gains, self.n // laws, shared, intervals, window, peak),
        )
        return np.where(np.isnan(peak), np.inf, peak)

    # What can be looked at and kept ------------------------------------------------------------

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return all that moves: enough for a fleet with the same sources to go on from."""
        return {name: self._arrays[name].copy() for name in MOVING}

    def restore(self, kept: dict[str, NDArray[Any]]) -> None:
        """Go on from a snapshot."""
        for name in MOVING:
            self._arrays[name][...] = kept[name]

    def _columns(self, name: str, row: int, count: int) -> Array:
        """Return `count` rows of a slab from `row` on, shape (count, n)."""
        slabs = self._arrays[name]
        return columns(
            slabs[self._arrays["blocks"][:, OWN_FIXED]] if name == "fixed" else slabs,
            row,
            count,
            self.n,
        )

    def entries(self, name: str) -> Any:
        """Return the cars' `state`, `phasors`, `driven` or `read`: a named tuple of arrays (n,)."""
        slab = "fixed" if name in self.kernels.fixed.trees else "slabs"
        layout = self.kernels.fixed if slab == "fixed" else self.kernels.moving
        like = layout.trees[name]
        found = self._columns(slab, layout.row(name), len(tree.flat(like)))
        return tree.unflat(like, found)

    @property
    def states(self) -> Array:
        """States (x1, x2, v1, v2) [m, m, m/s, m/s], shape (n, 4)."""
        return self._columns("slabs", self.kernels.moving.row("state"), 4).T

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
        return self._columns("clocks", CLOCKS.find(f"clock.{name}"), 1)[0]

    def driven(self, path: str, count: int = 1) -> Array:
        """Return `count` numbers of each car's `qcar_env.engine.starts.Driven`, shape (count, n)."""
        return self._columns("fixed", self.kernels.fixed.find(f"driven.{path}"), count)

    @property
    def held(self) -> Array:
        """The commands that the actuators hold, shape (n, m)."""
        return self._columns("slabs", self.kernels.moving.row("held"), self.actions).T

    @property
    def memory(self) -> Array:
        """Memory of the actuators, shape (n, k); k is 0 where they have none."""
        row = self.kernels.moving.row("state") + 4
        return self._columns("slabs", row, self.kernels.moving.row("phasors") - row).T

    def stagger(self, elapsed: NDArray[np.int64]) -> None:
        """Set the control intervals that the cars' episodes have lasted, (n,)."""
        if np.shape(elapsed) != (self.n,):
            raise ValueError(
                f"elapsed must have shape ({self.n},), got {np.shape(elapsed)}; give one count of "
                "control intervals for each car"
            )
        rows = self._arrays["clocks"].reshape(-1, CLOCKS.size, LANES)[
            :, CLOCKS.find("clock.elapsed")
        ]
        padded = rows.ravel()
        padded[: self.n] = elapsed
        rows[...] = padded.reshape(rows.shape)

    @property
    def nbytes(self) -> int:
        """Memory that the cars take [B]."""
        own = ("slabs", "clocks", "fixed", "blocks", "streams", "chosen", "bounds")
        return sum(self._arrays[name].nbytes for name in own)


def _equal(a: Source, b: Source) -> bool:
    return a.uniforms == b.uniforms and all(
        np.array_equal(c, d)
        for c, d in ((a.row, b.row), (a.draws, b.draws), (a.targets, b.targets), (a.table, b.table))
    )
