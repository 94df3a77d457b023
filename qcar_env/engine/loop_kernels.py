"""Closed loops, compiled: a law that acts inside the Runge-Kutta stages, or is sampled and held.

Blocks of cars as in `qcar_env.engine.stepping`. All cars of a call have the same functions, those
of their `Composition`, and each its own numbers.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np

from qcar_env.engine.compile import (
    LANES,
    align_stack,
    compiled,
    compiled_apart,
    kernel,
    source_stamp,
    widen,
)
from qcar_env.engine.course import RoadFunctions, course, sine_pieces
from qcar_env.engine.layout import Layout
from qcar_env.engine.tuples import load, save
from qcar_env.physics import tree
from qcar_env.physics.car import REST, CarFunctions
from qcar_env.physics.closed_loop import ControlledState, LawFunctions, Limits, loop_functions
from qcar_env.physics.motion import (
    Phasor,
    Phasors,
    angle,
    given_step,
    turning as turning_of,
    turning_step,
)
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.tree import flat

RESEED = 1024  # [steps] after which turned phasors are computed anew: they stay within 1e-12
NEVER = 2**62  # [steps] a kink that does not come, a window that does not open


class Fixed(NamedTuple):
    """What stays the same in a motion."""

    car: Any  # numbers as the car's functions take them
    road: Any  # the same of the road, `Pieces` of a turning one
    speed: Any  # [m/s]
    omega: Any  # frequency of a turning road, 0 of one that is read [rad/s]
    force: Any  # Force
    turning: Any  # Turning, of whole steps
    law: Any  # numbers of the law
    limits: Any  # Limits, the numbers of an actuator between the masses, or Nothing


class Clock(NamedTuple):
    """Where a motion is on its road, and when it is measured."""

    kink: Any  # number of the road's next kink [-]
    next: Any  # its time [s]
    window: Any  # first step that is measured [-]


class Squares(NamedTuple):
    """Sums over the measured steps."""

    u1: Any  # [(m/s^2)^2]
    u2: Any


class Peaks(NamedTuple):
    """Largest magnitudes of the measured steps."""

    x1: Any  # [m]
    x2: Any
    u1: Any  # [m/s^2]
    u2: Any


@dataclass(frozen=True)
class Composition:
    """What is compiled: functions and shapes, no numbers.

    Parameters
    ----------
    car, road, law
        Their functions.
    like : Fixed
        Shapes of the numbers; their values do not matter.
    actuator : type, optional
        Class of an actuator between the masses.
    """

    car: CarFunctions
    road: RoadFunctions
    law: LawFunctions
    like: Fixed
    actuator: type | None = None

    def __hash__(self) -> int:
        """Look at functions and shapes."""
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        """Compare functions and shapes."""
        return isinstance(other, Composition) and self._key == other._key

    @cached_property
    def _key(self) -> tuple[Any, ...]:
        shapes = type(self.like.limits), *tree.paths(self.like)
        return self.car, self.road, self.law, self.actuator, shapes


def loop_road(road: RoadFunctions) -> RoadFunctions:
    """Return a class of roads as closed loops see it: those that turn are one class in time."""
    return road if road.pieces is None else RoadFunctions(pieces=sine_pieces)


@cache
def compose(what: Composition, held: bool, fused: bool) -> tuple[Layout, Callable[..., None]]:
    """Compile the closed loops of a composition; return where things lie, and what advances them.

    Returns
    -------
    layout : Layout
        Of a slab.
    advance : callable
        ``advance(slabs, begin, end, n, step, steps, hold, every, tables, bounds, record)``
        integrates the blocks from `begin` to `end` in place. `n` is the number of cars in all
        blocks, `step` a `Step`. Where `every` is positive it writes ``(x1, x2, v1, v2, u1, u2)`` at
        each `every`-th step into `record` (records, 6, n).
    """
    car, like, read = what.car, what.like, what.road.pieces is None
    road = course(what.road, car)
    loop = loop_functions(
        car,
        what.law,
        limited=isinstance(like.limits, Limits),
        actuator=what.actuator,
        held=held,
    )
    rate, forces_of = compiled(loop.rate), compiled(loop.forces)
    phasor_at, next_kink, jump_at, after, reading, steps_of = road[2:]
    kick = compiled(car.kick)
    stamp = source_stamp(
        compose,
        loop_functions,
        *(each for each in (*car, *what.law[:2]) if each is not None),
        *(each for each in (what.road.pieces, what.road.height) if each is not None),
    )
    sources = stamp, fused  # which numba's cache does not look at, either

    # Shapes of what lies in a slab; the numbers do not matter.
    memory: Any = what.law.State
    STATE = ControlledState(REST, memory(*(0.0 for _ in memory._fields)))
    PHASORS = Phasors(Phasor(0.0, 0.0), Phasor(0.0, 0.0))
    CLOCK, PEAKS, SQUARES = Clock(0.0, 0.0, 0.0), Peaks(*(0.0,) * 4), Squares(0.0, 0.0)
    COMMAND = (0.0, 0.0)
    FIXED = tree.unflat(like, repeat(0.0))  # numbers would become part of the cache's key
    ROAD_INPUT = car.road_input(0.0, 0.0, FIXED.car)
    scratch = (STATE, PHASORS, ROAD_INPUT, ROAD_INPUT, ROAD_INPUT)
    layout = Layout(
        state=STATE,
        phasors=PHASORS,
        clock=CLOCK,
        command=COMMAND,
        peaks=PEAKS,
        squares=SQUARES,
        fixed=FIXED,
        scratch=scratch,
    )
    X, W, T, C, P, Q, FIX, SAVED = (layout.row(name) for name in layout.trees)
    KINK, NEXT, WINDOW = (layout.find(f"clock.{name}") for name in Clock._fields)
    MOVES = layout.row("clock")  # state and phasors lie first
    ROADS, SIZE = SAVED + MOVES, len(flat(ROAD_INPUT))
    PLANT = len(REST)

    @compiled
    def next_event(z, lanes, step):
        """Return the number of the next step in which some car of the block meets a kink."""
        event = NEVER
        for j in range(lanes):
            event = min(event, kink_step(z[NEXT * LANES + j], step))
        return event

    @compiled
    def reseed(z, lanes, t):
        """Set the phasors of the force and of endless roads to their values at `t` [s]."""
        for j in range(lanes):
            fixed = load(z, FIX, LANES, j, FIXED)
            w = load(z, W, LANES, j, PHASORS)
            time = load(z, T, LANES, j, CLOCK)
            endless = time.next == math.inf and time.kink == 0.0
            on_road = phasor_at(t, 0, fixed.road) if endless else w.road
            save(z, W, LANES, j, Phasors(on_road, angle(fixed.force.Omega * t)))

    @compiled_apart
    def over_kinks(x, w, held, fixed, kink, next, t, end, table):
        """Advance one car from `t` to `end` [s], cut at the kinks of its road.

        A kink at the end is left to the next step.
        """
        usual = fixed.turning
        while t < end:
            stop = min(next, end)
            if stop > t:
                size = stop - t
                prepared = turning_of(
                    usual.road_s, usual.road_c, usual.F, fixed.omega, fixed.force.Omega, size
                )
                x, w = steps_of(
                    rate, x, w, prepared, step_fractions(size), 1, t, kink, held, fixed, table
                )
            if next < end:
                kicked = kick(x.plant, jump_at(kink, fixed, table), fixed.car)
                x = ControlledState(kicked, x.filter)
                w = after(w, kink, fixed)
                kink += 1
                next = next_kink(kink, fixed.road, fixed.speed, table)
            t = stop
        return x, w, kink, next

    if read:

        @compiled
        def read_road(z, j, row, t, table):
            fixed = load(z, FIX, LANES, j, FIXED)
            w = load(z, W, LANES, j, PHASORS)
            _, _, input = reading(t, int(z[KINK * LANES + j]), w, fixed, table)
            save(z, row, LANES, j, input.road)

        @compiled
        def one_step(z, lanes, step, k, again, tables, bounds):
            """Advance all cars of a block by a step without a kink."""
            for j in range(lanes):
                table = tables[bounds[j, 0] : bounds[j, 1]]
                if again:
                    read_road(z, j, ROADS, k * step.full, table)
                else:
                    save(z, ROADS, LANES, j, load(z, ROADS + 2 * SIZE, LANES, j, ROAD_INPUT))
                read_road(z, j, ROADS + SIZE, (k + 0.5) * step.full, table)
                read_road(z, j, ROADS + 2 * SIZE, (k + 1) * step.full, table)
            for j in range(lanes):
                fixed = load(z, FIX, LANES, j, FIXED)
                x, w = given_step(
                    rate,
                    load(z, X, LANES, j, STATE),
                    load(z, W, LANES, j, PHASORS),
                    fixed.turning,
                    step,
                    load(z, ROADS, LANES, j, ROAD_INPUT),
                    load(z, ROADS + SIZE, LANES, j, ROAD_INPUT),
                    load(z, ROADS + 2 * SIZE, LANES, j, ROAD_INPUT),
                    load(z, C, LANES, j, COMMAND),
                    fixed,
                )
                save(z, X, LANES, j, x)
                save(z, W, LANES, j, w)

    else:

        @compiled
        def one_step(z, lanes, step, k, again, tables, bounds):
            """Advance all cars of a block by a step without a kink."""
            for j in range(lanes):
                fixed = load(z, FIX, LANES, j, FIXED)
                x, w = turning_step(
                    rate,
                    load(z, X, LANES, j, STATE),
                    load(z, W, LANES, j, PHASORS),
                    fixed.turning,
                    step,
                    load(z, C, LANES, j, COMMAND),
                    fixed,
                )
                save(z, X, LANES, j, x)
                save(z, W, LANES, j, w)

    @kernel(fused=fused)
    def advance(slabs, begin, end, n, step, steps, hold, every, tables, bounds, record):
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        align_stack()
        widen()
        for block in range(begin, end):
            z = slabs[block]
            first = block * LANES
            lanes = min(LANES, n - first)
            own = bounds[first : first + lanes]
            measured = NEVER
            for j in range(lanes):
                measured = min(measured, np.int64(z[WINDOW * LANES + j]))
            event = next_event(z, lanes, step.full)
            again = True
            for k in range(steps + 1):
                recorded = every > 0 and k % every == 0
                if (held and k % hold == 0) or (not held and (recorded or k >= measured)):
                    for j in range(lanes):
                        fixed = load(z, FIX, LANES, j, FIXED)
                        save(z, C, LANES, j, forces_of(load(z, X, LANES, j, STATE), fixed))
                if recorded or k >= measured:
                    for j in range(lanes):
                        now = np.float64(k >= z[WINDOW * LANES + j])
                        x = load(z, X, LANES, j, STATE).plant
                        u1, u2 = load(z, C, LANES, j, COMMAND)
                        p = load(z, P, LANES, j, PEAKS)
                        q = load(z, Q, LANES, j, SQUARES)
                        peaks = Peaks(
                            max(p.x1, abs(now * x.x1)),
                            max(p.x2, abs(now * x.x2)),
                            max(p.u1, abs(now * u1)),
                            max(p.u2, abs(now * u2)),
                        )
                        save(z, P, LANES, j, peaks)
                        save(z, Q, LANES, j, Squares(q.u1 + now * u1 * u1, q.u2 + now * u2 * u2))
                if recorded:
                    for i in range(PLANT + 2):
                        row = (X + i if i < PLANT else C + i - PLANT) * LANES
                        for j in range(lanes):
                            record[k // every, i, first + j] = z[row + j]
                if k == steps:
                    break
                if k % RESEED == 0:
                    reseed(z, lanes, k * step.full)
                if k == event:
                    for i in range(MOVES * LANES):
                        z[SAVED * LANES + i] = z[i]
                one_step(z, lanes, step, k, again, tables, own)
                again = False
                if k == event:
                    for j in range(lanes):
                        time = load(z, T, LANES, j, CLOCK)
                        if kink_step(time.next, step.full) != k:
                            continue
                        x, w, kink, next = over_kinks(
                            load(z, SAVED, LANES, j, STATE),
                            load(z, SAVED + W, LANES, j, PHASORS),
                            load(z, C, LANES, j, COMMAND),
                            load(z, FIX, LANES, j, FIXED),
                            int(time.kink),
                            time.next,
                            k * step.full,
                            (k + 1) * step.full,
                            tables[own[j, 0] : own[j, 1]],
                        )
                        save(z, X, LANES, j, x)
                        save(z, W, LANES, j, w)
                        z[KINK * LANES + j] = kink
                        z[NEXT * LANES + j] = next
                    event = next_event(z, lanes, step.full)
                    again = True

    return layout, advance


def kink_step(time: float, step: float) -> int:
    """Return the number of the step that holds a kink: ``k step <= time < (k + 1) step``."""
    if not time < 1e15 * step:
        return NEVER
    k = int(time / step)
    while k * step > time:
        k -= 1
    while (k + 1) * step <= time:
        k += 1
    return k


compiled(kink_step)
