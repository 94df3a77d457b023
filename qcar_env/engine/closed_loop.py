"""Closed loops of many cases at once: what they start from, threads, and what they have done.

`qcar_env.engine.loop_kernels` has what is compiled.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import LANES, aligned
from qcar_env.engine.course import Course, RoadFunctions, course
from qcar_env.engine.loop_kernels import NEVER, Clock, Composition, Fixed, compose
from qcar_env.engine.starts import Force
from qcar_env.physics.car import CarFunctions
from qcar_env.physics.closed_loop import ControlledState
from qcar_env.physics.motion import Phasors, angle, turning as turning_of
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.tree import flat

Array = NDArray[np.float64]

THREADED_WORK = 1_000_000  # [car steps] 10 ms on one core: below, a thread costs what it saves
_BLANK = (0.0,) * 8  # command, peaks, squares


@dataclass(frozen=True)
class Drive:
    """A car on a road under an external force, prepared for steps of one length."""

    fixed: tuple[Any, ...]  # the entries of `Fixed` before the law's
    phasors: Phasors  # of road and force at time 0
    kink: int  # number of the road's next kink then
    next: float  # its time [s]
    table: Array  # of the road

    @cached_property
    def rows(self) -> tuple[float, ...]:
        """What a slab holds of it, from the phasors on; the window is that of no measurement."""
        clock = Clock(float(self.kink), self.next, float(NEVER))
        return (*flat((self.phasors, clock)), *_BLANK, *flat(self.fixed))

    def under(self, law: Any, limits: Any) -> Fixed:
        """Return all numbers that stay the same, with those of a law and its limits."""
        return Fixed(*self.fixed, law, limits)  # pyright: ignore


def drive(
    car: CarFunctions,
    road: RoadFunctions,
    numbers: tuple[Any, Any, float, Force],
    table: Array,
    step: float,
) -> Drive:
    """Prepare a car on a road; it is at distance 0 at time 0, just before a kink there.

    Parameters
    ----------
    car, road
        Their functions, those of the road as it is declared (not `loop_road`).
    numbers : tuple
        Of car and road, speed [m/s], and `Force`.
    table : ndarray
        Of the road.
    step : float
        RK4 step [s].
    """
    of_car, of_road, speed, force = numbers
    on: Course = course(road, car)
    ready = car.prepare(of_car)
    made, _, omega = on.begin(_RoadAtSpeed(of_road, speed), 0.0, 0.0)
    road_s, road_c = on.amplitudes(made, ready)
    kink = 0
    while (next := on.next_kink(kink, made, speed, table)) < 0.0:
        kink += 1
    turning = turning_of(road_s, road_c, force.f, omega, force.Omega, step)
    phasors = Phasors(on.phasor(0.0, kink, made), angle(0.0))
    return Drive((ready, made, speed, omega, force, turning), phasors, kink, next, table)


class _RoadAtSpeed(NamedTuple):
    road: Any
    speed: Any


class Case(NamedTuple):
    """One closed loop."""

    drive: Drive
    state: ControlledState  # at time 0, before a jump of the road then
    law: Any  # numbers of the law
    limits: Any  # see `Fixed`
    window: float = NEVER  # first step that is measured


class Outcome(NamedTuple):
    """What n cases have done."""

    record: Array  # (records, 6, n) x1, x2, v1, v2 [m, m/s], u1, u2 [m/s^2]
    final: Array  # (4, n) state of the cars at the end
    peaks: Array  # (4, n) `Peaks`
    squares: Array  # (2, n) `Squares`
    phasors: Array  # (4, n) of road and force at the end


def run(
    what: Composition,
    cases: Sequence[Case],
    *,
    step: float,
    steps: int,
    hold: int = 0,
    every: int = 0,
    fused: bool = False,
) -> Outcome:
    """Integrate cases of one composition, on several threads if there is enough to do.

    Parameters
    ----------
    what : Composition
        What they are made of.
    cases : sequence of Case
        The cases.
    step : float
        RK4 step [s].
    steps : int
        Number of steps.
    hold : int
        Steps from one sample of the law to the next; 0 where it acts at every instant.
    every : int
        Steps from one record to the next; 0 for none.
    fused : bool
        Whether products and sums may be fused (see `qcar_env.engine.compile.kernel`).
    """
    n = len(cases)
    layout, advance = compose(what, hold > 0, bool(fused))
    rows = np.zeros((layout.size, n))
    lead = layout.row("scratch")
    same: dict[
        int, tuple[float, ...]
    ] = {}  # by identity: cases share most of what they are made of
    for i, each in enumerate(cases):
        shared = each.state, each.limits
        for one in shared:
            if id(one) not in same:
                same[id(one)] = flat(one)
        state, limits = (same[id(one)] for one in shared)
        rows[:lead, i] = (*state, *each.drive.rows, *flat(each.law), *limits)
    rows[layout.find("clock.window")] = [each.window for each in cases]
    z = slabs(rows)
    sizes = [len(each.drive.table) for each in cases]
    tables = np.concatenate([np.zeros(0), *(each.drive.table for each in cases)])
    last = np.cumsum(sizes)
    bounds = np.stack([last - sizes, last], axis=1)
    record = np.empty((steps // every + 1 if every else 0, 6, n))
    fractions = step_fractions(step)
    over_blocks(
        lambda begin, end: advance(
            z, begin, end, n, fractions, steps, max(hold, 1), every, tables, bounds, record
        ),
        blocks=z.shape[0],
        work=steps * n,
    )
    end = from_slabs(z, n)
    places = {name: layout.row(name) for name in ("state", "phasors", "peaks", "squares")}
    return Outcome(
        record,
        *(
            end[places[name] : places[name] + count]
            for name, count in (("state", 4), ("peaks", 4), ("squares", 2), ("phasors", 4))
        ),
    )


# Slabs and threads -----------------------------------------------------------------------------


def slabs(rows: Array) -> Array:
    """Lay quantities of cars (rows, n), one a row, out for kernels: (blocks, rows * LANES).

    The last block is filled up with zeros.
    """
    count, n = rows.shape
    blocks = -(-n // LANES)
    whole = np.zeros((count, blocks * LANES))
    whole[:, :n] = rows
    made = aligned((blocks, count * LANES))
    made.reshape(blocks, count, LANES)[...] = whole.reshape(count, blocks, LANES).transpose(1, 0, 2)
    return made


def from_slabs(blocks: Array, n: int) -> Array:
    """Return the quantities of `n` cars, one a row: the inverse of `slabs`, shape (rows, n)."""
    parts = blocks.reshape(blocks.shape[0], -1, LANES).transpose(1, 0, 2)
    return parts.reshape(parts.shape[0], -1)[:, :n]


def over_blocks(run: Callable[[int, int], None], *, blocks: int, work: int) -> None:
    """Call ``run(begin, end)`` so that it covers all blocks, on threads where they pay.

    Parameters
    ----------
    run : callable
        Runs compiled code that lets go of the interpreter's lock.
    blocks : int
        Number of blocks.
    work : int
        Car steps to be done; threads start at `THREADED_WORK`.
    """
    threads = min(cores(), blocks) if work >= THREADED_WORK else 1
    if threads == 1:
        run(0, blocks)
        return
    edges = [blocks * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, edges[:-1], edges[1:]))


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
