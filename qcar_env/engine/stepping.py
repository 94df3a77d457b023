"""Cars whose actions are held over control intervals: the compiled steps of the environments.

An interval has three passes over a block of cars: actions to commands, Runge-Kutta steps, and what
is read at their end. A car that meets a kink of its road within the interval is then integrated
once more by itself, cut at the kink; a car whose episode is over starts the next one.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from qcar_env.engine.compile import (
    LANES,
    compiled,
    compiled_apart,
    holds,
    kernel,
    load,
    load_wide,
    negative_sum,
    outcome,
    save,
    source_stamp,
    together,
)
from qcar_env.engine.course import Pieces, RoadFunctions, course
from qcar_env.engine.exact import exact as exact_of
from qcar_env.engine.layout import Layout
from qcar_env.engine.random import uniform
from qcar_env.engine.sensing import Sensed, delaying, sensing
from qcar_env.engine.starts import (
    CIRCLE,
    MOTION_DRAWS,
    NOISE_DRAWS,
    OBSERVATION_LIMIT,
    Clock,
    Fixed,
    Force,
    Nominal,
    drawn_motion,
    vary,
)
from qcar_env.physics.car import REST, CarFunctions
from qcar_env.physics.motion import (
    Phasor,
    Phasors,
    angle,
    four_turning_steps,
    given_step,
    turning as turning_of,
    turning_step,
)
from qcar_env.physics.plant import PlantState, plant_functions
from qcar_env.physics.rk4 import Step, step_fractions
from qcar_env.physics.signals import Moment, Signal
from qcar_env.physics.state import State
from qcar_env.physics.tree import alike, bounded, flat, times, unflat

NEVER = 2**62  # [intervals] a kink that does not come
RESEED = 64  # [intervals] after which phasors in single precision are computed anew

FINE, OVER, NOT_FINITE, WRONG_SHAPE = 0, 1, -1, -2  # codes of a step
HIGHEST = np.finfo(np.float32).max  # an action beyond is not a finite number

for _each in (four_turning_steps, given_step, uniform):
    compiled(_each)


@dataclass(frozen=True)
class Composition:
    """What is compiled: classes and functions, no numbers."""

    car: CarFunctions
    road: RoadFunctions
    actuator: type
    observed: tuple[Signal, ...]
    terms: tuple[type, ...]  # of the reward
    delay: int  # of the actuator [intervals]
    sensed: tuple[Sensed | None, ...]  # how each entry of the observation is read
    like: Nominal  # shapes of the numbers; their values do not matter

    def __hash__(self) -> int:
        """Ignore `like`: classes decide the shapes."""
        return hash(self._classes)

    def __eq__(self, other: object) -> bool:
        """Compare classes and shapes."""
        if not isinstance(other, Composition):
            return False
        return self._classes == other._classes and alike(self.like, other.like)

    @property
    def _classes(self) -> tuple[Any, ...]:
        made_of = (self.car, self.road, self.actuator, self.observed, self.terms)
        return *made_of, self.delay, self.sensed


class Own(NamedTuple):
    """Places in the array of a car by itself, which begins with what moves."""

    clock: int
    dt: int  # and the substeps after it
    table: int  # of the road, to the end


@dataclass(frozen=True)
class Kernels:
    """Compiled functions, and where things lie."""

    moving: Layout  # slab of what moves: state, phasors, what reward terms remember
    clock: Layout  # slab in double precision
    fixed: Layout  # slab of what stays the same during an episode
    scratch: int  # rows that are passed on within an interval, without `stages`
    stages: int  # and for each stage time of a road that is read
    step: Any
    begin: Any
    show: Any
    ending: Any
    entries: Any  # entries(x, phasors, command, fixed) of the observation on a turning road
    step_one: Any
    reset_one: Any
    own: Own  # where things lie in the array of a car by itself


@cache
def compose(what: Composition, single: bool, exact: bool = False) -> Kernels:
    """Compile the steps of a composition.

    Parameters
    ----------
    what : Composition
        The composition.
    single : bool
        Whether slabs have single precision.
    exact : bool
        Whether an interval is one exact map of a linear plant on a turning road, instead of
        Runge-Kutta steps; there must be one step in an interval then.
    """
    real = np.float32 if single else np.float64
    # Their values must not reach the key under which compiled code is stored.
    like: Any = unflat(what.like, (1.0,) * len(flat(what.like)))
    car, kind = what.car, what.actuator
    road = course(what.road, car)
    plant = plant_functions(car, kind)
    m, K, T = kind.size, len(what.observed), len(what.terms)
    read = together(tuple(each.reading for each in what.observed))
    measure = together(
        tuple(together(tuple(each.reading for each in term.reads)) for term in what.terms)
    )
    costs_of = together(tuple(term.cost for term in what.terms), each_its_own=True)
    for each in (*plant, kind.command, kind.force, kind.largest):
        compiled(each)

    # Shapes of what lies in slabs; the numbers do not matter.
    ready = car.prepare(like.numbers.car)
    road_like = like.numbers.road if what.road.pieces is None else Pieces(*(0.0,) * 6)
    on_road = car.road_input(0.0, 0.0, ready)
    memory = kind.State(*(0.0 for _ in kind.State._fields))
    STATE = PlantState(REST, memory)
    PHASORS = Phasors(Phasor(0.0, 0.0), Phasor(0.0, 0.0))
    COMMAND = tuple(0.0 for _ in range(m))
    COSTS = tuple(0.0 for _ in range(T))
    ENTRIES, BEFORE, NOMINAL = like.scales, like.term_scales, like
    CLOCK = Clock(*(0.0,) * len(Clock._fields))
    FIXED = Fixed(
        ready,
        road_like,
        0.0,
        0.0,
        Force(0.0, 0.0),
        turning_of(on_road, on_road, 0.0, 1.0, 1.0, 1.0),
        like.numbers.actuator,
        like.numbers.sensors,
        like.scales,
        like.terms,
        like.term_scales,
        *(0.0,) * 4,
    )
    senses = any(what.sensed)
    remembered, sense = sensing(what.sensed)
    moving = Layout(
        state=STATE,
        phasors=PHASORS,
        before=BEFORE,
        held=COMMAND,
        later=(0.0,) * (what.delay * m),
        sensors=(0.0,) * remembered,
        shown=ENTRIES if senses else (),
    )
    later = delaying(what.delay, m, COMMAND)
    clocks = Layout(clock=CLOCK)
    mapped = exact_of(plant.rate, STATE, COMMAND) if exact else None
    fixed_rows = Layout(fixed=FIXED, map=(0.0,) * mapped.size if mapped else ())
    MAP = fixed_rows.row("map")
    passed = Layout(
        command=COMMAND,
        entries=ENTRIES,
        forces=COMMAND,
        costs=COSTS,
        ends=(0.0, 0.0, 0.0, 0.0),
        measured=BEFORE,
        saved=(STATE, PHASORS),
    )
    X, W, BEFORE_ROW, HELD, LATER, SENSORS, SHOWN = (moving.row(name) for name in moving.trees)
    C, E, U, COST, END, MEASURED, SAVED = (passed.row(name) for name in passed.trees)
    MEMORY = len(flat(BEFORE))
    MOVES = moving.row("before")  # state and phasors lie first
    ELAPSED, LAST, DONE, KINK, NEXT = (
        clocks.find(f"clock.{name}") for name in ("elapsed", "last", "done", "kink", "next")
    )
    STAGES, INPUT_SIZE = passed.size, len(flat(on_road))
    ROAD_INPUT = on_road
    NONE = real(0.0)
    NO_TABLE = ()

    plant_rate, plant_forces = plant.rate, plant.forces
    command_of, prepare, kick, tyre_load = kind.command, car.prepare, car.kick, car.tyre_load
    largest = kind.largest
    begin_road, amplitudes, phasor_at, next_kink = road[:4]
    jump_at, after, reading, steps_of = road[4:]
    sources = source_stamp(
        compose,
        prepare,
        command_of,
        *(each for each in (what.road.pieces, what.road.height) if each is not None),
        *(each.reading for each in what.observed),
        *(term.cost for term in what.terms),
        exact_of,
    )

    if m == 2:

        @compiled
        def forces_of(now: Any) -> Any:
            return now.u1, now.u2

    else:  # the force of one actuator is that on the body

        @compiled
        def forces_of(now: Any) -> Any:
            return (now.u2,)

    if mapped:
        steps_of, keep_map, apply_map = mapped.steps, mapped.keep, mapped.apply

        @compiled
        def save_fixed(p: Any, stride: Any, j: Any, fixed: Any, step: Any) -> None:
            if not holds(p, 0, stride, j, fixed):  # cars that are alike share a map
                keep_map(p, MAP, stride, j, fixed, step)
            save(p, 0, stride, j, fixed)

    else:

        @compiled
        def save_fixed(p: Any, stride: Any, j: Any, fixed: Any, step: Any) -> None:
            save(p, 0, stride, j, fixed)

    @compiled
    def typed(step: Any) -> Any:
        return Step(real(step.full), real(step.half), real(step.third), real(step.sixth))

    # Reading ----------------------------------------------------------------------------------

    @compiled
    def moment(x: Any, w: Any, command: Any, fixed: Any, y: Any, y_dot: Any, input: Any) -> Any:
        u1, u2 = plant_forces(x, command, fixed)
        rate = plant_rate(x, input, command, fixed)
        F_dot = -fixed.force.f * fixed.force.Omega * w.force.s
        load_now = tyre_load(x.car, input, fixed.car)
        limit = largest(fixed.actuator)
        return Moment(x.car, rate.car, y, y_dot, input.F, F_dot, u1, u2, load_now, limit)

    @compiled
    def judge(now: Any, before: Any, fixed: Any) -> Any:
        """Return the costs, whether the car has left its travel, and what the terms have read."""
        measured = times(measure(now, fixed), fixed.term_scales)
        costs = costs_of(measured, before, fixed.terms)
        inside1 = abs(now.x.x1 * fixed.inverse_X1) <= fixed.travel
        inside2 = abs(now.x.x2 * fixed.inverse_X2) <= fixed.travel
        return costs, not (inside1 & inside2), measured

    @compiled
    def look(x: Any, w: Any, command: Any, fixed: Any, kink: Any, t: Any, table: Any) -> Any:
        """Return the moment of a car, at a kink on the piece that begins."""
        while next_kink(kink, fixed.road, fixed.speed, table) <= t:
            w = after(w, kink, fixed)
            kink += 1
        y, y_dot, input = reading(t, kink, w, fixed, table)
        return moment(x, w, command, fixed, y, y_dot, input)

    def entries_of(x: Any, w: Any, command: Any, fixed: Any) -> Any:
        y, y_dot, input = reading(0.0, 0, w, fixed, NO_TABLE)
        return times(read(moment(x, w, command, fixed, y, y_dot, input), fixed), fixed.scales)

    @compiled
    def entry(value: Any) -> Any:
        return np.float32(min(max(value, -OBSERVATION_LIMIT), OBSERVATION_LIMIT))

    if senses:

        @compiled
        def finished(raw: Any, fixed: Any) -> Any:
            return raw  # sensors read it first

        @compiled
        def read_by_sensors(
            z: Any,
            stride: Any,
            j: Any,
            raw: Any,
            noise: Any,
            elapsed: Any,
            dt: Any,
            p: Any,
            begin: Any,
        ) -> Any:
            seen = times(
                sense(raw, z, SENSORS, stride, j, noise, elapsed, dt, p.sensors, begin), p.scales
            )
            save(z, SHOWN, stride, j, seen)
            return seen

        @compiled
        def shown(z: Any, stride: Any, j: Any, raw: Any, fixed: Any) -> Any:
            return load_wide(z, SHOWN, stride, j, ENTRIES)

    else:

        @compiled
        def finished(raw: Any, fixed: Any) -> Any:
            return bounded(times(raw, fixed.scales), OBSERVATION_LIMIT)

        @compiled
        def read_by_sensors(
            z: Any,
            stride: Any,
            j: Any,
            raw: Any,
            noise: Any,
            elapsed: Any,
            dt: Any,
            p: Any,
            begin: Any,
        ) -> Any:
            return times(raw, p.scales)

        @compiled
        def shown(z: Any, stride: Any, j: Any, raw: Any, fixed: Any) -> Any:
            return times(raw, fixed.scales)

    # One car over an interval -----------------------------------------------------------------

    @compiled
    def part(
        x: Any, w: Any, size: Any, n: Any, t: Any, kink: Any, c: Any, fixed: Any, table: Any
    ) -> Any:
        """Advance a car by `n` steps of another size than the usual one."""
        usual = fixed.turning
        prepared = turning_of(
            usual.road_s, usual.road_c, usual.F, fixed.omega, fixed.force.Omega, size
        )
        return steps_of(
            plant_rate, x, w, prepared, step_fractions(size), n, t, kink, c, fixed, table
        )

    @compiled_apart
    def drive(
        x: Any,
        w: Any,
        c: Any,
        fixed: Any,
        kink: Any,
        next: Any,
        t: Any,
        dt: Any,
        n: Any,
        step: Any,
        table: Any,
    ) -> Any:
        """Advance one car over an interval that may hold kinks of its road."""
        end = t + dt
        if next >= end:
            x, w = steps_of(plant_rate, x, w, fixed.turning, step, n, t, kink, c, fixed, table)
            return x, w, kink, next
        while next < end:
            if next > t:
                x, w = part(x, w, (next - t) / n, n, t, kink, c, fixed, table)
                t = next
            x = PlantState(kick(x.car, jump_at(kink, fixed, table), fixed.car), x.memory)
            w = after(w, kink, fixed)
            kink += 1
            next = next_kink(kink, fixed.road, fixed.speed, table)
        if end > t:
            x, w = part(x, w, (end - t) / n, n, t, kink, c, fixed, table)
        return x, w, kink, next

    # Starts -----------------------------------------------------------------------------------

    @compiled_apart
    def start_car(
        z: Any,
        clock: Any,
        p: Any,
        stride: Any,
        j: Any,
        uniforms: Any,
        given: Any,
        nominal: Any,
        draws: Any,
        targets: Any,
        table: Any,
        step: Any,
        dt: Any,
        seen: Any,
    ) -> None:
        """Begin an episode, in the state and phase of `given` where these are numbers; show it."""
        row = nominal.copy()
        vary(row, uniforms, draws, targets)
        one = load(row, 0, 1, 0, NOMINAL)
        numbers, reference = one.numbers, one.reference
        first = uniforms.shape[0] - MOTION_DRAWS
        x1, x2, v1, v2 = drawn_motion(uniforms, first, reference)
        if not math.isnan(given[0]):
            x1, x2, v1, v2 = given[0], given[1], given[2], given[3]
        phase = one.endless * CIRCLE * uniforms[first + 5]
        if not math.isnan(given[4]):
            phase = given[4]
        x = PlantState(State(x1, x2, v1, v2), memory)
        ready = prepare(numbers.car)
        made, start, omega = begin_road(numbers, phase, one.endless)
        road_s, road_c = amplitudes(made, ready)
        force = numbers.force
        fixed = Fixed(
            ready,
            made,
            numbers.speed,
            omega,
            force,
            turning_of(road_s, road_c, force.f, omega, force.Omega, step),
            numbers.actuator,
            numbers.sensors,
            one.scales,
            one.terms,
            one.term_scales,
            1.0 / reference.X1,
            1.0 / reference.X2,
            reference.travel,
            reference.penalty,
        )
        kink = 0
        while next_kink(kink, made, numbers.speed, table) < start:  # one right now is to come
            kink += 1
        next = next_kink(kink, made, numbers.speed, table)
        w = Phasors(phasor_at(start, kink, made), angle(force.Omega * start))
        save_fixed(p, stride, j, fixed, step)
        save(z, X, stride, j, x)
        save(z, W, stride, j, w)
        noise = uniforms[first - NOISE_DRAWS]
        begun = Clock(0.0, one.steps, 0.0, start, phase, float(kink), next, noise)
        save(clock, 0, stride, j, begun)
        for k in range(SENSORS - LATER):
            z[(LATER + k) * stride + j] = 0.0
        save(z, HELD, stride, j, COMMAND)
        now = look(x, w, COMMAND, fixed, kink, start, table)
        save(z, BEFORE_ROW, stride, j, times(measure(now, fixed), fixed.term_scales))
        entries = read_by_sensors(z, stride, j, read(now, fixed), noise, 0.0, dt, fixed, True)
        for i in range(K):
            seen[i] = entry(entries[i])

    # A car by itself is one array: what moves, its clock, what is fixed, dt, substeps, its road's
    # table.
    OWN_CLOCK = moving.size
    OWN_FIXED = OWN_CLOCK + clocks.size
    DT = OWN_FIXED + fixed_rows.size
    SUBSTEPS, TABLE = DT + 1, DT + 2

    @kernel(nogil=False)
    def reset_one(
        car: Any, uniforms: Any, given: Any, nominal: Any, draws: Any, targets: Any, seen: Any
    ) -> None:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        z, clock, p = car[:OWN_CLOCK], car[OWN_CLOCK:OWN_FIXED], car[OWN_FIXED:DT]
        dt, table = car[DT], car[TABLE:]
        step = dt / int(car[SUBSTEPS])
        start_car(
            z, clock, p, 1, 0, uniforms, given, nominal, draws, targets, table, step, dt, seen
        )

    @kernel(nogil=False)
    def step_one(car: Any, action: Any, seen: Any, push: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        if action.shape[0] != m:
            return outcome(WRONG_SHAPE, 0.0, False, False, COSTS, 0.0)
        time = load(car, OWN_CLOCK, 1, 0, CLOCK)
        if time.done > 0.0:
            return outcome(OVER, 0.0, False, False, COSTS, 0.0)
        first, last = float(action[0]), float(action[m - 1])
        if not (abs(first) <= HIGHEST and abs(last) <= HIGHEST):
            return outcome(NOT_FINITE, 0.0, False, False, COSTS, 0.0)
        fixed = load(car, OWN_FIXED, 1, 0, FIXED)
        dt, n, table = car[DT], int(car[SUBSTEPS]), car[TABLE:]
        given = (first, last)
        c = later(car, LATER, 1, 0, command_of(given, fixed.actuator))
        x, w = load(car, X, 1, 0, STATE), load(car, W, 1, 0, PHASORS)
        t = time.start + time.elapsed * dt
        x, w, kink, next = drive(
            x, w, c, fixed, int(time.kink), time.next, t, dt, n, step_fractions(dt / n), table
        )
        elapsed = time.elapsed + 1.0
        now = look(x, w, c, fixed, kink, time.start + elapsed * dt, table)
        costs, out, measured = judge(now, load(car, BEFORE_ROW, 1, 0, BEFORE), fixed)
        late = elapsed >= time.last and not out
        penalty = -fixed.penalty if out else 0.0
        done = 1.0 if out or late else 0.0
        clock = Clock(
            elapsed, time.last, done, time.start, time.phase, float(kink), next, time.noise
        )
        save(car, X, 1, 0, x)
        save(car, W, 1, 0, w)
        save(car, BEFORE_ROW, 1, 0, measured)
        save(car, OWN_CLOCK, 1, 0, clock)
        save(car, HELD, 1, 0, c)
        raw = read(now, fixed)
        entries = read_by_sensors(car, 1, 0, raw, time.noise, elapsed, dt, fixed, False)
        for i in range(K):
            seen[i] = entry(entries[i])
        save(push, 0, 1, 0, forces_of(now))
        return outcome(FINE, negative_sum(costs) + penalty, out, late, costs, penalty)

    # Blocks of cars ---------------------------------------------------------------------------
    # Where a road needs a table, that of a car lies in `tables` between its two of `bounds`.

    @compiled
    def table_of(tables: Any, bounds: Any, i: Any) -> Any:
        return tables[bounds[i, 0] : bounds[i, 1]]

    @compiled
    def quiet_of(clock: Any, j: Any, dt: Any) -> Any:
        """Return how many control intervals will pass before a car can meet a kink."""
        time = load(clock, 0, LANES, j, CLOCK)
        ahead = (time.next - (time.start + time.elapsed * dt)) / dt
        return max(0, int(ahead) - 2) if ahead < 1e12 else NEVER

    @compiled_apart
    def quiet_intervals(clock: Any, lanes: Any, dt: Any) -> Any:
        least = NEVER
        for j in range(lanes):
            least = min(least, quiet_of(clock, j, dt))
        return least

    @kernel
    def begin(
        slabs: Any,
        clocks: Any,
        fixed_slabs: Any,
        blocks: Any,
        tables: Any,
        bounds: Any,
        streams: Any,
        chosen: Any,
        nominals: Any,
        draws: Any,
        targets: Any,
        counts: Any,
        which: Any,
        given: Any,
        dt: Any,
        n: Any,
        kept: Any,
        draw: Any,
        seen: Any,
    ) -> None:
        """Begin episodes of the cars in `which`; `given` has a row for each, or one for all.

        The numbers that they are drawn from are `kept`; they come from there if not `draw`.
        """
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        for row in range(which.shape[0]):
            i = which[row]
            block, j, k = i // LANES, i % LANES, chosen[i]
            uniforms = kept[i, : counts[k, 0]]
            if draw:
                for each in range(uniforms.shape[0]):
                    uniforms[each] = uniform(streams, i)
            clock = clocks[block]
            start_car(
                slabs[block],
                clock,
                fixed_slabs[blocks[block, 0]],
                LANES,
                j,
                uniforms,
                given[min(row, given.shape[0] - 1)],
                nominals[k],
                draws[k],
                targets[counts[k, 1] : counts[k, 2]],
                table_of(tables, bounds, i),
                dt / n,
                dt,
                seen[i],
            )
            blocks[block, 1] = min(blocks[block, 1], quiet_of(clock, j, dt))

    @kernel
    def show(
        slabs: Any,
        clocks: Any,
        fixed_slabs: Any,
        blocks: Any,
        tables: Any,
        bounds: Any,
        dt: Any,
        seen: Any,
    ) -> None:
        """Write the observations of all cars."""
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        for i in range(seen.shape[0]):
            block, j = i // LANES, i % LANES
            z = slabs[block]
            fixed = load_wide(fixed_slabs[blocks[block, 0]], 0, LANES, j, FIXED)
            time = load(clocks[block], 0, LANES, j, CLOCK)
            now = look(
                load_wide(z, X, LANES, j, STATE),
                load_wide(z, W, LANES, j, PHASORS),
                load_wide(z, HELD, LANES, j, COMMAND),
                fixed,
                int(time.kink),
                time.start + time.elapsed * dt,
                table_of(tables, bounds, i),
            )
            entries = shown(z, LANES, j, read(now, fixed), fixed)
            for k in range(K):
                seen[i, k] = entry(entries[k])

    @compiled
    def reseed(z: Any, clock: Any, p: Any, lanes: Any, dt: Any) -> None:
        """Set the phasors of the force and of endless roads to their exact values."""
        for j in range(lanes):
            fixed = load_wide(p, 0, LANES, j, FIXED)
            time = load(clock, 0, LANES, j, CLOCK)
            t = time.start + time.elapsed * dt
            w = load_wide(z, W, LANES, j, PHASORS)
            endless = time.next == math.inf and time.kink == 0.0
            road = phasor_at(t, 0, fixed.road) if endless else w.road
            save(z, W, LANES, j, Phasors(road, angle(fixed.force.Omega * t)))

    @compiled
    def noted(now: Any, s: Any, z: Any, clock: Any, j: Any, fixed: Any) -> None:
        """Pass on what has been read of one car."""
        costs, out, measured = judge(now, load(z, BEFORE_ROW, LANES, j, BEFORE), fixed)
        save(s, COST, LANES, j, costs)
        save(s, E, LANES, j, finished(read(now, fixed), fixed))
        save(s, U, LANES, j, forces_of(now))
        late = (clock[ELAPSED * LANES + j] >= clock[LAST * LANES + j]) & (not out)
        penalty = -fixed.penalty * out
        save(s, END, LANES, j, (out, late, penalty, negative_sum(costs) + penalty))
        save(s, MEASURED, LANES, j, measured)

    @compiled_apart
    def inspect_one(z: Any, clock: Any, p: Any, s: Any, j: Any, dt: Any, table: Any) -> None:
        """Read one car by itself."""
        fixed = load_wide(p, 0, LANES, j, FIXED)
        time = load(clock, 0, LANES, j, CLOCK)
        now = look(
            load_wide(z, X, LANES, j, STATE),
            load_wide(z, W, LANES, j, PHASORS),
            load_wide(s, C, LANES, j, COMMAND),
            fixed,
            int(time.kink),
            time.start + time.elapsed * dt,
            table,
        )
        noted(now, s, z, clock, j, fixed)

    if what.road.pieces is None:

        @compiled
        def advance_block(
            z: Any,
            clock: Any,
            p: Any,
            s: Any,
            lanes: Any,
            n: Any,
            dt: Any,
            tables: Any,
            bounds: Any,
        ) -> None:
            """Advance all cars of a block over an interval without a kink."""
            step = typed(step_fractions(dt / n))
            size = dt / n
            for j in range(lanes):
                fixed = load_wide(p, 0, LANES, j, FIXED)
                time = load(clock, 0, LANES, j, CLOCK)
                t, kink = time.start + time.elapsed * dt, int(time.kink)
                table = table_of(tables, bounds, j)
                w = load_wide(z, W, LANES, j, PHASORS)
                for k in range(2 * n + 1):
                    _, _, input = reading(t + 0.5 * k * size, kink, w, fixed, table)
                    save(s, STAGES + k * INPUT_SIZE, LANES, j, input.road)
            for k in range(n):
                row = STAGES + 2 * k * INPUT_SIZE
                for j in range(lanes):
                    fixed = load(p, 0, LANES, j, FIXED)
                    x, w = given_step(
                        plant_rate,
                        load(z, X, LANES, j, STATE),
                        load(z, W, LANES, j, PHASORS),
                        fixed.turning,
                        step,
                        load(s, row, LANES, j, ROAD_INPUT),
                        load(s, row + INPUT_SIZE, LANES, j, ROAD_INPUT),
                        load(s, row + 2 * INPUT_SIZE, LANES, j, ROAD_INPUT),
                        load(s, C, LANES, j, COMMAND),
                        fixed,
                    )
                    save(z, X, LANES, j, x)
                    save(z, W, LANES, j, w)

        @compiled
        def inspect(
            z: Any, clock: Any, p: Any, s: Any, lanes: Any, dt: Any, tables: Any, bounds: Any
        ) -> None:
            """Read all cars of a block."""
            for j in range(lanes):
                inspect_one(z, clock, p, s, j, dt, table_of(tables, bounds, j))

    elif mapped:

        @compiled
        def advance_block(
            z: Any,
            clock: Any,
            p: Any,
            s: Any,
            lanes: Any,
            n: Any,
            dt: Any,
            tables: Any,
            bounds: Any,
        ) -> None:
            """Advance all cars of a block over an interval without a kink."""
            for j in range(lanes):
                x, w = apply_map(
                    p,
                    MAP,
                    LANES,
                    j,
                    load(z, X, LANES, j, STATE),
                    load(z, W, LANES, j, PHASORS),
                    load(s, C, LANES, j, COMMAND),
                    load(p, 0, LANES, j, FIXED).turning,
                )
                save(z, X, LANES, j, x)
                save(z, W, LANES, j, w)

    else:

        @compiled
        def advance_block(
            z: Any,
            clock: Any,
            p: Any,
            s: Any,
            lanes: Any,
            n: Any,
            dt: Any,
            tables: Any,
            bounds: Any,
        ) -> None:
            """Advance all cars of a block over an interval without a kink."""
            step = typed(step_fractions(dt / n))
            for _ in range(n // 4):
                for j in range(lanes):
                    fixed = load(p, 0, LANES, j, FIXED)
                    x, w = four_turning_steps(
                        plant_rate,
                        load(z, X, LANES, j, STATE),
                        load(z, W, LANES, j, PHASORS),
                        fixed.turning,
                        step,
                        load(s, C, LANES, j, COMMAND),
                        fixed,
                    )
                    save(z, X, LANES, j, x)
                    save(z, W, LANES, j, w)
            for _ in range(n % 4):
                for j in range(lanes):
                    fixed = load(p, 0, LANES, j, FIXED)
                    x, w = turning_step(
                        plant_rate,
                        load(z, X, LANES, j, STATE),
                        load(z, W, LANES, j, PHASORS),
                        fixed.turning,
                        step,
                        load(s, C, LANES, j, COMMAND),
                        fixed,
                    )
                    save(z, X, LANES, j, x)
                    save(z, W, LANES, j, w)

    if what.road.pieces is not None:

        @compiled
        def inspect(
            z: Any, clock: Any, p: Any, s: Any, lanes: Any, dt: Any, tables: Any, bounds: Any
        ) -> None:
            """Read all cars of a block."""
            for j in range(lanes):
                fixed = load(p, 0, LANES, j, FIXED)
                w = load(z, W, LANES, j, PHASORS)
                y, y_dot, input = reading(NONE, 0, w, fixed, NO_TABLE)
                x, c = load(z, X, LANES, j, STATE), load(s, C, LANES, j, COMMAND)
                noted(moment(x, w, c, fixed, y, y_dot, input), s, z, clock, j, fixed)

    @kernel
    @compiled_apart  # for kernels of many intervals, see `qcar_env.engine.held_law`
    def step(
        slabs: Any,
        clocks: Any,
        fixed_slabs: Any,
        blocks: Any,
        tables: Any,
        bounds: Any,
        scratch: Any,
        worker: Any,
        first_block: Any,
        end_block: Any,
        actions: Any,
        dt: Any,
        n: Any,
        seen: Any,
        rewards: Any,
        push: Any,
        ends: Any,
    ) -> Any:
        """Advance the cars of some blocks.

        Returns 0, `OVER` if an episode is over, now or before, or `NOT_FINITE` if an action is no
        finite number; no car has moved then.
        """
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        s = scratch[worker]
        over, wrong = False, False
        for i in range(first_block * LANES, min(end_block * LANES, actions.shape[0])):
            for k in range(m):
                wrong |= not abs(actions[i, k]) <= HIGHEST
        if wrong:
            return NOT_FINITE
        for block in range(first_block, end_block):
            z, clock, p = slabs[block], clocks[block], fixed_slabs[blocks[block, 0]]
            base = block * LANES
            lanes = min(LANES, actions.shape[0] - base)
            own_bounds = bounds[base : base + lanes]
            given = actions[base : base + lanes]
            for j in range(lanes):
                fixed = load(p, 0, LANES, j, FIXED)
                action = (real(given[j, 0]), real(given[j, m - 1]))
                command = later(z, LATER, LANES, j, command_of(action, fixed.actuator))
                save(s, C, LANES, j, command)
                save(z, HELD, LANES, j, command)  # what is read again when others are reset
            crossing = False
            if blocks[block, 1] > 0:
                blocks[block, 1] -= 1
            else:
                for j in range(lanes):
                    time = load(clock, 0, LANES, j, CLOCK)
                    crossing |= time.next <= time.start + time.elapsed * dt + dt
                if crossing:
                    for i in range(MOVES * LANES):
                        s[SAVED * LANES + i] = z[i]
                else:
                    blocks[block, 1] = quiet_intervals(clock, lanes, dt)
            if single and int(clock[ELAPSED * LANES]) % RESEED == 0:
                reseed(z, clock, p, lanes, dt)
            advance_block(z, clock, p, s, lanes, n, dt, tables, own_bounds)
            if crossing:
                for j in range(lanes):
                    time = load(clock, 0, LANES, j, CLOCK)
                    t = time.start + time.elapsed * dt
                    if time.next < t + dt:
                        fixed = load_wide(p, 0, LANES, j, FIXED)
                        x, w, kink, next = drive(
                            load_wide(s, SAVED, LANES, j, STATE),
                            load_wide(s, SAVED + W, LANES, j, PHASORS),
                            load_wide(s, C, LANES, j, COMMAND),
                            fixed,
                            int(time.kink),
                            time.next,
                            t,
                            dt,
                            n,
                            step_fractions(dt / n),
                            table_of(tables, own_bounds, j),
                        )
                        save(z, X, LANES, j, x)
                        save(z, W, LANES, j, w)
                        clock[KINK * LANES + j] = kink
                        clock[NEXT * LANES + j] = next
            for j in range(lanes):
                clock[ELAPSED * LANES + j] += 1.0
            inspect(z, clock, p, s, lanes, dt, tables, own_bounds)
            if crossing:
                for j in range(lanes):
                    time = load(clock, 0, LANES, j, CLOCK)
                    if time.next <= time.start + time.elapsed * dt:
                        inspect_one(z, clock, p, s, j, dt, table_of(tables, own_bounds, j))
            for i in range(MEMORY * LANES):  # after every car was read, some of them twice
                z[BEFORE_ROW * LANES + i] = s[MEASURED * LANES + i]
            if senses:
                for j in range(lanes):
                    fixed = load_wide(p, 0, LANES, j, FIXED)
                    time = load(clock, 0, LANES, j, CLOCK)
                    raw = load_wide(s, E, LANES, j, ENTRIES)
                    read_now = read_by_sensors(
                        z, LANES, j, raw, time.noise, time.elapsed, dt, fixed, False
                    )
                    save(s, E, LANES, j, bounded(read_now, OBSERVATION_LIMIT))
            over |= put_out(
                s,
                clock,
                lanes,
                seen[base : base + lanes],
                rewards[:, base : base + lanes],
                push[base : base + lanes],
                ends[:, base : base + lanes],
            )
        return OVER if over else FINE

    @compiled
    def put_out(
        s: Any, clock: Any, lanes: Any, seen: Any, rewards: Any, push: Any, ends: Any
    ) -> Any:
        """Write what a block's cars have done; return whether an episode is over."""
        for i in range(m):
            for j in range(lanes):
                push[j, i] = s[(U + i) * LANES + j]
        reward, penalty = rewards[0], rewards[T + 1]
        terminated, truncated = ends[0], ends[1]
        for j in range(lanes):
            reward[j] = s[(END + 3) * LANES + j]
        for j in range(lanes):
            penalty[j] = s[(END + 2) * LANES + j]
        for i in range(T):
            term = rewards[1 + i]
            for j in range(lanes):
                term[j] = -s[(COST + i) * LANES + j]
        for j in range(lanes):
            terminated[j] = s[END * LANES + j] > NONE
        for j in range(lanes):
            truncated[j] = s[(END + 1) * LANES + j] > NONE
        for k in range(K):
            for j in range(lanes):
                seen[j, k] = np.float32(s[(E + k) * LANES + j])
        over = False
        for j in range(lanes):
            over |= s[END * LANES + j] + s[(END + 1) * LANES + j] + clock[DONE * LANES + j] > NONE
        return over

    @kernel
    def ending(clocks: Any, ends: Any, rewards: Any, push: Any) -> Any:
        """Mark the cars whose episode has just ended, and quiet those that had ended before.

        Returns the former and the latter, indices of cars.
        """
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        cars = ends.shape[1]
        now, before = np.empty(cars, np.int64), np.empty(cars, np.int64)
        first, last = 0, 0
        for i in range(cars):
            clock, j = clocks[i // LANES], i % LANES
            if clock[DONE * LANES + j] > 0.0:
                before[last] = i
                last += 1
                push[i] = 0.0
                rewards[:, i] = 0.0
                ends[:, i] = False
            elif ends[0, i] or ends[1, i]:
                clock[DONE * LANES + j] = 1.0
                now[first] = i
                first += 1
        return now[:first], before[:last]

    return Kernels(
        moving=moving,
        clock=clocks,
        fixed=fixed_rows,
        scratch=passed.size,
        stages=INPUT_SIZE,
        step=step,
        begin=begin,
        show=show,
        ending=ending,
        entries=entries_of,
        step_one=step_one,
        reset_one=reset_one,
        own=Own(clock=OWN_CLOCK, dt=DT, table=TABLE),
    )
