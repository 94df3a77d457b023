"""How cars drive through a control interval, compiled once for a car, a road and an actuator.

Cars in a block advance together over the whole interval. One that meets a kink of its road within
it advances once more by itself, cut at the kink.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from qcar_env.engine.compile import LANES, compiled, compiled_apart, disjoint, source_stamp, widen
from qcar_env.engine.composition import QUIET, Composition
from qcar_env.engine.course import Course, Pieces, course
from qcar_env.engine.exact import exact as exact_of
from qcar_env.engine.layout import Layout
from qcar_env.engine.starts import Clock, Driven, Force
from qcar_env.engine.tuples import (
    holds,
    load,
    load_wide,
    save,
)
from qcar_env.physics.car import REST
from qcar_env.physics.motion import (
    Input,
    Phasor,
    Phasors,
    angle,
    given_step,
    turning as turning_of,
    turning_step,
)
from qcar_env.physics.plant import PlantState, plant_functions
from qcar_env.physics.rk4 import Step, step_fractions
from qcar_env.physics.signals import Moment

PHASORS = Phasors(Phasor(0.0, 0.0), Phasor(0.0, 0.0))
CLOCK = Clock(*(0.0,) * len(Clock._fields))
CLOCKS = Layout(clock=CLOCK)
ELAPSED, DONE, KINK, NEXT = (
    CLOCKS.find(f"clock.{name}") for name in ("elapsed", "done", "kink", "next")
)
NEVER = 2**62  # [intervals] a kink that does not come
RESEED = 64  # [intervals] after which phasors in single precision are computed anew

compiled(given_step)


class Driving(NamedTuple):
    """Compiled functions, and the shapes that they take."""

    state: Any  # PlantState
    command: Any  # of the actuators, a tuple
    driven: Any  # Driven
    map_size: int  # numbers of an exact map, which follow the latter in its slab
    stages: Any  # stages(n): rows for what a road that is read does in an interval of n steps
    road: Course
    start: Any  # start(numbers, phase, endless, step) -> Driven, time on the road [s]
    keep: Any  # keep(p, stride, j, driven, step): write what stays the same
    at_end: Any  # at_end(block, j, w, driven) -> y, y', input, of a car that is at no kink
    moment: Any  # moment(x, w, command, driven, y, y_dot, input) -> Moment
    look: Any  # look(x, w, command, driven, kink, t, table) -> Moment
    drive: Any  # drive(x, w, command, driven, kink, next, t, dt, n, table) -> x, w, kink, next
    advance: Any  # advance(block) -> whether a kink may have been met
    quiet_of: Any  # quiet_of(clock, j, dt): intervals before a car can meet a kink
    sources: str


@cache
def driving(what: Composition, single: bool, exact: bool) -> Driving:
    """Compile how a composition drives; see `qcar_env.engine.stepping.compose`.

    What moves begins with state, phasors and the command that is held; so does the scratch, where
    they are kept as they were before an interval with a kink.
    """
    real = np.float32 if single else np.float64
    NONE = real(0.0)
    car, kind, numbers = what.car, what.actuator, what.like.numbers
    road = course(what.road, car)
    plant = plant_functions(car, kind)
    for each in (*plant, kind.command, kind.force, kind.largest):
        compiled(each)
    turning = what.road.pieces is not None
    ready, on_road = car.prepare(numbers.car), car.road_input(0.0, 0.0, car.prepare(numbers.car))
    STATE = PlantState(REST, kind.State(*(0.0 for _ in kind.State._fields)))
    COMMAND = (0.0,) * kind.size
    DRIVEN = Driven(
        ready,
        Pieces(*(0.0,) * 6) if turning else numbers.road,
        0.0,
        0.0,
        Force(0.0, 0.0),
        turning_of(on_road, on_road, 0.0, 1.0, 1.0, 1.0),
        numbers.actuator,
    )
    moving = Layout(x=STATE, w=PHASORS, held=COMMAND)
    W, HELD = moving.row("w"), moving.row("held")
    ROAD_INPUT, READ_SIZE = on_road, 2 + Layout(input=on_road).size
    ROOM = READ_SIZE * LANES
    mapped = exact_of(plant.rate, STATE, COMMAND) if exact else None
    MAP = Layout(driven=DRIVEN).size

    plant_rate, plant_forces = plant.rate, plant.forces
    prepare, kick, tyre_load, largest = car.prepare, car.kick, car.tyre_load, kind.largest
    begin_road, amplitudes, phasor_at, next_kink = road[:4]
    jump_at, after, reading, steps_of = road[4:]

    @compiled_apart
    def start(numbers, phase, endless, step):
        """Return what an episode fixes, and when it begins."""
        ready = prepare(numbers.car)
        made, time, omega = begin_road(numbers, phase, endless)
        road_s, road_c = amplitudes(made, ready)
        force = numbers.force
        turns = turning_of(road_s, road_c, force.f, omega, force.Omega, step)
        return Driven(ready, made, numbers.speed, omega, force, turns, numbers.actuator), time

    if mapped:
        steps_of, keep_map, apply_map = mapped.steps, mapped.keep, mapped.apply

        @compiled
        def keep(p, stride, j, driven, step):
            if not holds(p, 0, stride, j, driven):  # cars that are alike share a map
                keep_map(p, MAP, stride, j, driven, step)
            save(p, 0, stride, j, driven)

    else:

        @compiled
        def keep(p, stride, j, driven, step):
            save(p, 0, stride, j, driven)

    # Reading ----------------------------------------------------------------------------------

    @compiled
    def moment(x, w, command, driven, y, y_dot, input):
        u1, u2 = plant_forces(x, command, driven)
        rate = plant_rate(x, input, command, driven)
        F_dot = -driven.force.f * driven.force.Omega * w.force.s
        load_now = tyre_load(x.car, input, driven.car)
        limit = largest(driven.actuator)
        return Moment(x.car, rate.car, y, y_dot, input.F, F_dot, u1, u2, load_now, limit)

    @compiled
    def look(x, w, command, driven, kink, t, table):
        """Return the moment of a car, at a kink on the piece that begins."""
        while next_kink(kink, driven.road, driven.speed, table) <= t:
            w = after(w, kink, driven)
            kink += 1
        y, y_dot, input = reading(t, kink, w, driven, table)
        return moment(x, w, command, driven, y, y_dot, input)

    # One car ----------------------------------------------------------------------------------

    @compiled_apart
    def part(x, w, end, n, t, kink, c, driven, table):
        """Advance a car to a time `end`, by `n` steps of another size than the usual one."""
        size, usual = (end - t) / n, driven.turning
        turns = turning_of(
            usual.road_s, usual.road_c, usual.F, driven.omega, driven.force.Omega, size
        )
        step = step_fractions(size)
        return steps_of(plant_rate, x, w, turns, step, n, t, kink, c, driven, table)

    @compiled_apart
    def drive(x, w, c, driven, kink, next, t, dt, n, table):
        """Advance one car over an interval that may hold kinks of its road."""
        end = t + dt
        if next >= end:
            step = step_fractions(dt / n)
            x, w = steps_of(plant_rate, x, w, driven.turning, step, n, t, kink, c, driven, table)
            return x, w, kink, next
        while next < end:
            if next > t:
                x, w = part(x, w, next, n, t, kink, c, driven, table)
                t = next
            x = PlantState(kick(x.car, jump_at(kink, driven, table), driven.car), x.memory)
            w = after(w, kink, driven)
            kink += 1
            next = next_kink(kink, driven.road, driven.speed, table)
        if end > t:
            x, w = part(x, w, end, n, t, kink, c, driven, table)
        return x, w, kink, next

    # A block of cars --------------------------------------------------------------------------
    # Where a road needs a table, that of a car lies in `tables` between its two of `bounds`.

    @compiled
    def quiet_of(clock, j, dt):
        """Return how many control intervals will pass before a car can meet a kink."""
        time = load(clock, 0, LANES, j, CLOCK)
        ahead = (time.next - (time.start + time.elapsed * dt)) / dt
        return max(0, int(ahead) - 2) if ahead < 1e12 else NEVER

    @compiled
    def typed(step):
        return Step(real(step.full), real(step.half), real(step.third), real(step.sixth))

    @compiled_apart
    def reseed(b):
        """Set the phasors of the force and of endless roads to their exact values."""
        for j in range(b.lanes):
            driven = load_wide(b.p, 0, LANES, j, DRIVEN)
            time = load(b.clock, 0, LANES, j, CLOCK)
            t = time.start + time.elapsed * b.dt
            w = load_wide(b.z, W, LANES, j, PHASORS)
            endless = time.next == math.inf and time.kink == 0.0
            road = phasor_at(t, 0, driven.road) if endless else w.road
            save(b.z, W, LANES, j, Phasors(road, angle(driven.force.Omega * t)))

    if mapped:

        @compiled_apart
        def advance_all(b):
            """Advance all cars of a block over an interval without a kink."""
            widen()
            for j in range(b.lanes):
                x, w = load(b.z, 0, LANES, j, STATE), load(b.z, W, LANES, j, PHASORS)
                c, turns = (
                    load(b.z, HELD, LANES, j, COMMAND),
                    load(b.p, 0, LANES, j, DRIVEN).turning,
                )
                x, w = apply_map(b.p, MAP, LANES, j, x, w, c, turns)
                save(b.z, 0, LANES, j, x)
                save(b.z, W, LANES, j, w)

    elif turning:

        @compiled_apart(allocates=False)
        def advance_all(b):
            """Advance all cars of a block over an interval without a kink."""
            widen()
            step = typed(step_fractions(b.dt / b.n))
            for _ in range(b.n):
                for j in range(b.lanes):
                    driven = load(b.p, 0, LANES, j, DRIVEN)
                    x, w = load(b.z, 0, LANES, j, STATE), load(b.z, W, LANES, j, PHASORS)
                    c = load(b.z, HELD, LANES, j, COMMAND)
                    x, w = turning_step(plant_rate, x, w, driven.turning, step, c, driven)
                    save(b.z, 0, LANES, j, x)
                    save(b.z, W, LANES, j, w)

    else:

        @compiled
        def read_at(b, j, k, table):
            """Return what the road does to a car after `k` half steps, or at the end if -1."""
            driven, time = load_wide(b.p, 0, LANES, j, DRIVEN), load(b.clock, 0, LANES, j, CLOCK)
            end = time.start + (time.elapsed + 1.0) * b.dt
            t = time.start + time.elapsed * b.dt + 0.5 * k * (b.dt / b.n) if k >= 0 else end
            w = load_wide(b.z, W, LANES, j, PHASORS)
            y, y_dot, input = reading(t, int(time.kink), w, driven, table)
            return y, y_dot, input.road

        @compiled_apart(allocates=False)
        def read_together(b, table):
            """Read the road of cars that share a table at the end and at the stage times."""
            widen()
            disjoint()
            for k in range(-1, 2 * b.n + 1):
                out = b.stages[(k + 1) * ROOM : (k + 2) * ROOM]
                for j in range(b.lanes):
                    save(out, 0, LANES, j, read_at(b, j, k, table))

        @compiled_apart(allocates=False)
        def read_ahead(b):
            """Read the road at the end of the interval and at its stage times."""
            begin, end = b.bounds[0]
            shared = True
            for j in range(b.lanes):
                shared &= b.bounds[j, 0] == begin
            if shared:
                read_together(b, b.tables[begin:end])
                return
            for j in range(b.lanes):
                table = b.tables[b.bounds[j, 0] : b.bounds[j, 1]]
                for k in range(-1, 2 * b.n + 1):
                    save(b.stages, (k + 1) * READ_SIZE, LANES, j, read_at(b, j, k, table))

        @compiled_apart(allocates=False)
        def advance_all(b):
            """Advance all cars of a block over an interval without a kink."""
            widen()
            step = typed(step_fractions(b.dt / b.n))
            read_ahead(b)
            for k in range(b.n):
                row = (2 * k + 1) * READ_SIZE + 2
                for j in range(b.lanes):
                    driven, w = load(b.p, 0, LANES, j, DRIVEN), load(b.z, W, LANES, j, PHASORS)
                    x, w = given_step(
                        *(plant_rate, load(b.z, 0, LANES, j, STATE), w, driven.turning, step),
                        load(b.stages, row, LANES, j, ROAD_INPUT),
                        load(b.stages, row + READ_SIZE, LANES, j, ROAD_INPUT),
                        load(b.stages, row + 2 * READ_SIZE, LANES, j, ROAD_INPUT),
                        *(load(b.z, HELD, LANES, j, COMMAND), driven),
                    )
                    save(b.z, 0, LANES, j, x)
                    save(b.z, W, LANES, j, w)

    if turning:

        @compiled
        def read_again(b, j):
            pass

        @compiled
        def at_end(b, j, w, driven):
            return reading(NONE, 0, w, driven, ())

    else:

        @compiled
        def read_again(b, j):
            table = b.tables[b.bounds[j, 0] : b.bounds[j, 1]]
            save(b.stages, 0, LANES, j, read_at(b, j, -1, table))

        @compiled
        def at_end(b, j, w, driven):
            y, y_dot = load(b.stages, 0, LANES, j, (0.0, 0.0))
            road = load(b.stages, 2, LANES, j, ROAD_INPUT)
            return y, y_dot, Input(road, driven.turning.F * w.force.c)

    @compiled_apart
    def drive_again(b):
        """Advance the cars that meet a kink, from where they were before the interval."""
        for j in range(b.lanes):
            time = load(b.clock, 0, LANES, j, CLOCK)
            t = time.start + time.elapsed * b.dt
            if time.next < t + b.dt:
                x, w, kink, next = drive(
                    load_wide(b.s, 0, LANES, j, STATE),
                    load_wide(b.s, W, LANES, j, PHASORS),
                    load_wide(b.z, HELD, LANES, j, COMMAND),
                    load_wide(b.p, 0, LANES, j, DRIVEN),
                    int(time.kink),
                    time.next,
                    t,
                    b.dt,
                    b.n,
                    b.tables[b.bounds[j, 0] : b.bounds[j, 1]],
                )
                save(b.z, 0, LANES, j, x)
                save(b.z, W, LANES, j, w)
                b.clock[KINK * LANES + j] = kink
                b.clock[NEXT * LANES + j] = next
                read_again(b, j)

    @compiled
    def advance(b):
        """Advance a block; return whether a car may be at a kink at the end of the interval."""
        kinks = False
        if b.own[QUIET] > 0:
            b.own[QUIET] -= 1
        else:
            quiet = NEVER
            for j in range(b.lanes):
                time = load(b.clock, 0, LANES, j, CLOCK)
                end = time.start + (time.elapsed + 1.0) * b.dt  # beside the same, rounded otherwise
                kinks |= time.next <= max(time.start + time.elapsed * b.dt + b.dt, end)
                quiet = min(quiet, quiet_of(b.clock, j, b.dt))
            b.own[QUIET] = 0 if kinks else quiet
            if kinks:
                for i in range(HELD * LANES):
                    b.s[i] = b.z[i]
        if single and int(b.clock[ELAPSED * LANES]) % RESEED == 0:
            reseed(b)
        advance_all(b)
        if kinks:
            drive_again(b)
        for j in range(b.lanes):
            b.clock[ELAPSED * LANES + j] += 1.0
        return kinks

    roads = (what.road.pieces, what.road.height)
    return Driving(
        state=STATE,
        command=COMMAND,
        driven=DRIVEN,
        map_size=mapped.size if mapped else 0,
        stages=lambda n: 0 if turning else (2 * n + 2) * READ_SIZE,
        road=road,
        start=start,
        keep=keep,
        at_end=at_end,
        moment=moment,
        look=look,
        drive=drive,
        advance=advance,
        quiet_of=quiet_of,
        sources=source_stamp(
            driving, car.prepare, kind.command, exact_of, *(each for each in roads if each)
        ),
    )
