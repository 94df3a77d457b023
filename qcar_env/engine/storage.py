"""What a fleet is kept in: the arrays that compiled code steps, and where its draws come from."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import LANES, aligned, entry
from qcar_env.engine.composition import OWN_FIXED, Drawn, Moved, Scratch
from qcar_env.engine.driving import CLOCKS
from qcar_env.engine.layout import columns
from qcar_env.engine.stepping import Kernels, compose
from qcar_env.physics import tree
from qcar_env.validation import whole

Array = NDArray[np.float64]
SHOWN, FLOAT = np.dtype(np.float32), np.dtype(np.float64)
BOOL, COUNT = np.dtype(np.bool_), np.dtype(np.int64)

CARS_A_THREAD = 16384  # at least: handing fewer over to another thread costs what it saves
SLABS = ("slabs", "clocks", "fixed", "numbers", "stages", "shown")  # aligned in memory
MOVING = ("slabs", "clocks", "fixed", "blocks", "streams", "uniforms")
TWO_THREADS = "another thread is stepping these cars; give each its own"
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


class Storage:
    """The arrays of a fleet.

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

    _busy = False  # whether a thread is at work on it

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
        self._gather()

    @contextlib.contextmanager
    def _alone(self) -> Generator[None, None, None]:
        """Keep other threads out; after an error or an interrupt all attributes are as before.

        So are the arrays, but for what is written into them.
        """
        if self._busy:
            raise RuntimeError(TWO_THREADS)
        before = vars(self).copy()
        self._busy, self._arrays = True, self._arrays.copy()
        try:
            yield
        except BaseException:
            vars(self).update(before)
            raise
        finally:
            self._busy = False

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
        made = ("kernels", "_step", "_turn", "_moved", "_drawn", "_of_worker", "_pool", "_busy")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the arrays, and compile."""
        vars(self).update(state)
        for name in SLABS:
            given = self._arrays[name]
            self._arrays[name] = aligned(given.shape, given.dtype)
            self._arrays[name][...] = given
        self._pool = None
        self._compose()
        self._bind()

    def _outputs(self) -> tuple[Any, ...]:
        """Return arrays for observations; rewards, their terms, the penalty; forces; ends."""
        n = self.n
        return (
            np.empty((n, self.size), SHOWN),
            np.empty((self._rows, n), FLOAT),
            np.empty(self._shape, FLOAT),
            np.zeros((2, n), BOOL),
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
        shared, blocks = a["fixed"], len(a["slabs"])
        if not self._alike and len(shared) < blocks:  # numbers of their own from now on
            a["fixed"] = self._slab(blocks, self.kernels.fixed.size)
            a["fixed"][...] = shared
            self._own_fixed(np.arange(blocks))
        self._bind()

    def _own_fixed(self, which: Any) -> None:
        """Say which of `fixed` is each block's own, from when `_bind` has bound it."""
        self._arrays["blocks"] = self._arrays["blocks"].copy()
        self._arrays["blocks"][:, OWN_FIXED] = which

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
        with self._alone():
            chosen = self._arrays["chosen"] = self._arrays["chosen"].copy()
            self._sources = [*self._sources]
            for cars, source in groups:
                for number, known in enumerate(self._sources):
                    if _equal(known, source):
                        chosen[cars] = number
                        break
                else:
                    chosen[cars] = len(self._sources)
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
        """Return `count` numbers of each car's `Driven` (`engine.starts`), shape (count, n)."""
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
