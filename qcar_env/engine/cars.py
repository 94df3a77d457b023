"""A fleet: many cars, or one, of any make, whose actions are held over control intervals.

Every environment, and every result of this library, comes from here.
"""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import starmap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.composition import QUIET
from qcar_env.engine.held_law import driver
from qcar_env.engine.stepping import NOT_FINITE
from qcar_env.engine.storage import (
    COUNT,
    FLOAT,
    NOTHING_GIVEN,
    SHOWN,
    TWO_THREADS,
    Array,
    Storage,
)

DISABLED, NEXT_STEP, SAME_STEP = range(3)  # what becomes of a car whose episode is over


class Begun(NamedTuple):
    """Cars that have begun their next episode in a step."""

    cars: NDArray[np.int64]  # (k,)
    phases: Array  # (n,) of their roads [rad], 0 for the others
    finals: NDArray[np.float32] | None  # (k, size) last observations, in the mode `SAME_STEP`


class Cars(Storage):
    """A fleet; arguments as of `Storage`."""

    _unfinished: tuple[Any, ...] | None = None  # outputs of a step before its ends are dealt with

    def seed(self, cars: NDArray[np.intp], states: NDArray[np.uint64]) -> None:
        """Set the random streams of `cars`, see `qcar_env.engine.random.streams`."""
        self._turn_over()
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
        with self._alone():
            self._turn_over()
            cars, seen = np.flatnonzero(mask).astype(COUNT), np.empty((self.n, self.size), SHOWN)
            starts = np.ascontiguousarray(given[cars], FLOAT)
            own = None if uniforms is None else uniforms[cars]
            every = len(cars) == self.n
            if every:
                self._drawn_from = self._arrays["chosen"].copy()
                self._share_what_is_alike()
            else:
                self.kernels.show(self._moved, seen)
            self._arrays["blocks"][:, QUIET] = np.iinfo(COUNT).max if every else 0
            self.begin(cars, starts, seen, own)
            return seen

    def _share_what_is_alike(self) -> None:
        """Keep no numbers that no car draws from, and those that all have once."""
        a = self._arrays
        if len(self._sources) > 1 or len(a["fixed"]) > 1:
            used = np.unique(a["chosen"])
            if len(used) == 1 and not len(self._sources[used[0]].targets):
                a["fixed"] = self._slab(1, self.kernels.fixed.size)
                self._own_fixed(0)
            self._forget()

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
            raise RuntimeError(TWO_THREADS)
        self._busy = True  # as `_alone` does it, but quicker
        try:
            if self._unfinished is not None:
                self._turn_over()
            if mode == DISABLED and self.done.any():
                over = np.flatnonzero(self.done)
                raise ValueError(
                    f"the episodes of {over.size} car(s) are over (the first is car {over[0]}); "
                    "call reset with options={'reset_mask': ...} before the next step. No car has "
                    "moved"
                )
            seen, rewards, force, ends = outputs = self._outputs()
            self._unfinished = mode == SAME_STEP, outputs
            if self._workers == 1:
                code = self._step(*self._of_worker[0], 0, self._blocks, actions, *outputs)
            else:
                code = self._share_out(actions, outputs)
            if code == NOT_FINITE:
                self._refuse(actions)
            begun = self._turn_over() if code else None
            self._unfinished = None
            return seen, rewards, force, ends, begun
        finally:
            self._busy = False

    def _share_out(self, actions: NDArray[np.float32], outputs: tuple[Any, ...]) -> int:
        """Step the cars in several threads; an interrupt waits until all have moved."""
        if not np.isfinite(actions).all():  # before any worker moves a car
            return NOT_FINITE
        if self._pool is None or self._pid != os.getpid():
            self._pool, self._pid = ThreadPoolExecutor(self._workers - 1), os.getpid()
        edges = [self._blocks * i // self._workers for i in range(self._workers + 1)]
        calls = iter(
            [
                (*self._of_worker[i], edges[i], edges[i + 1], actions, *outputs)
                for i in range(self._workers)
            ]
        )
        codes: list[int] = []
        work = partial(codes.extend, starmap(self._step, calls))  # no interrupt comes in between
        jobs: list[Future[None]] = []
        caught: KeyboardInterrupt | None = None
        while True:
            try:
                with contextlib.suppress(RuntimeError):  # no memory for another thread
                    while len(jobs) < self._workers - 1:
                        jobs.append(self._pool.submit(work))
                work()
                for each in jobs:
                    each.result()
                break
            except KeyboardInterrupt as interrupt:
                caught = interrupt
        if caught is not None:
            raise caught
        return max(codes)

    def _turn_over(self) -> Begun | None:
        """Deal with the ends of the last step, unless that is done: an interrupt may prevent it."""
        if self._unfinished is None:
            return None
        n = self.n
        same_step, (seen, rewards, force, ends) = self._unfinished
        if len(self._sources) > 1:
            self._draw_from_chosen(np.flatnonzero(ends.any(axis=0) if same_step else self.done))
        cars, phases = np.empty(n, COUNT), np.zeros(n)
        finals = np.empty((n if same_step else 0, self.size), SHOWN)
        count = self._turn(
            *(self._moved, self._drawn, NOTHING_GIVEN, same_step, seen, rewards, force, ends),
            *(cars, phases, finals),
        )
        self._unfinished = None
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
            Largest |x1|, |x2| [m] at every instant of the window; infinite for a car whose state or
            action is no finite number.

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
            *(self._of_worker[0], self._outputs()[1:], seen, np.zeros(self._shape, SHOWN)),
            *(gains, self.n // laws, shared, intervals, window, self.plan.dt, peak),
        )
        return np.where(np.isnan(peak), np.inf, peak)
