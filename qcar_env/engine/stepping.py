"""Cars whose actions are held over control intervals: the compiled steps of the environments.

An interval has three passes over a block of cars: actions to commands, the drive over the interval
(`qcar_env.engine.driving`), and what is read at its end. A car whose episode is over starts the
next one.

One function makes all kernels, as each closes over what a composition is made of: hence its length.
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
    kernel,
    source_stamp,
    together,
    widen,
)
from qcar_env.engine.composition import ENDED, OWN_FIXED, QUIET, Block, Composition
from qcar_env.engine.driving import CLOCK, CLOCKS, DONE, PHASORS, driving
from qcar_env.engine.layout import Layout
from qcar_env.engine.random import uniform
from qcar_env.engine.sensing import delaying, sensing
from qcar_env.engine.starts import (
    CIRCLE,
    MOTION_DRAWS,
    NOISE_DRAWS,
    OBSERVATION_LIMIT,
    Clock,
    Read,
    drawn_motion,
    vary,
)
from qcar_env.engine.tuples import (
    load,
    load_wide,
    negative,
    negative_sum,
    outcome,
    save,
)
from qcar_env.physics.motion import Phasors, angle
from qcar_env.physics.plant import PlantState
from qcar_env.physics.state import State
from qcar_env.physics.tree import bounded, times

FINE, OVER, NOT_FINITE, WRONG_SHAPE = 0, 1, -1, -2  # codes of a step
HIGHEST = np.finfo(np.float32).max  # an action beyond is not a finite number

compiled(uniform)


class Own(NamedTuple):
    """Rows in the array of a car by itself, which begins with what moves."""

    clock: int
    dt: int  # and the substeps after it
    table: int  # of the road, to the end


@dataclass(frozen=True)
class Kernels:
    """Compiled functions, and where things lie."""

    moving: Layout  # slab of what moves: state, phasors, what reward terms remember
    fixed: Layout  # slab of what stays the same during an episode
    scratch: int  # rows that are passed on within an interval
    stages: Any  # stages(n): and for what a road that is read does in an interval of n steps
    step: Any  # step(entries of Moved and Scratch, first block, end, actions, seen, ..., ends)
    turn_over: Any  # turn_over(Moved, Drawn, given, same_step, seen, ..., begun, phases, finals)
    begin: Any  # begin(Moved, Drawn, which, given, draw, seen)
    show: Any  # show(Moved, seen)
    entries: Any  # entries(x, phasors, command, driven, read) of the observation on a turning road
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
    kind, like = what.actuator, what.like
    m, K, T = kind.size, len(what.observed), len(what.terms)
    motion = driving(what.driven, single, exact)
    read = together(tuple(each.reading for each in what.observed))
    measure = together(
        tuple(together(tuple(each.reading for each in term.reads)) for term in what.terms)
    )
    costs_of = together(tuple(term.cost for term in what.terms), each_its_own=True)
    remembered, sense = sensing(what.sensed)
    senses = any(what.sensed)

    # Shapes of what lies in slabs; the numbers do not matter.
    STATE, COMMAND, DRIVEN, NOMINAL = motion.state, motion.command, motion.driven, like
    ENTRIES, BEFORE, COSTS = like.scales, like.term_scales, (0.0,) * T
    READ = Read(like.numbers.sensors, like.scales, like.terms, like.term_scales, *(0.0,) * 4)
    moving = Layout(
        state=STATE,
        phasors=PHASORS,
        held=COMMAND,
        before=BEFORE,
        later=(0.0,) * (what.delay * m),
        sensors=(0.0,) * remembered,
        shown=ENTRIES if senses else (),
    )
    fixed = Layout(driven=DRIVEN, map=(0.0,) * motion.map_size, read=READ)
    passed = Layout(
        state=STATE,
        phasors=PHASORS,
        held=COMMAND,
        before=BEFORE,
        entries=ENTRIES,
        forces=COMMAND,
        rewards=(0.0, *COSTS, 0.0),
        ends=(0.0, 0.0),
    )
    X, W, HELD, REMEMBERED, LATER, SENSORS, SHOWN = (moving.row(name) for name in moving.trees)
    E, U, REWARD, END = (passed.row(name) for name in ("entries", "forces", "rewards", "ends"))
    R = fixed.row("read")
    MY_CLOCK = moving.size
    MY_FIXED = MY_CLOCK + CLOCKS.size
    DT = MY_FIXED + fixed.size
    SUBSTEPS, TABLE = DT + 1, DT + 2
    ELAPSED, LAST = CLOCKS.find("clock.elapsed"), CLOCKS.find("clock.last")
    NONE, NO_TABLE = real(0.0), ()

    start, keep, at_end, moment, look, drive, advance = motion[6:13]
    quiet_of = motion.quiet_of
    next_kink, phasor_at, reading = motion.road.next_kink, motion.road.phasor, motion.road.reading
    memory = STATE.memory
    command_of, later = kind.command, delaying(what.delay, m, COMMAND)
    sources = motion.sources + source_stamp(
        compose, *(each.reading for each in what.observed), *(term.cost for term in what.terms)
    )

    if m == 2:

        @compiled
        def forces_of(now):
            return now.u1, now.u2

    else:  # the force of one actuator is that on the body

        @compiled
        def forces_of(now):
            return (now.u2,)

    # Reading ----------------------------------------------------------------------------------

    @compiled
    def judge(now, before, driven, r):
        """Return the costs, whether the car has left its travel, and what the terms have read."""
        measured = times(measure(now, driven), r.term_scales)
        costs = costs_of(measured, before, r.terms)
        inside1 = abs(now.x.x1 * r.inverse_X1) <= r.travel
        inside2 = abs(now.x.x2 * r.inverse_X2) <= r.travel
        return costs, not (inside1 & inside2), measured

    def entries_of(x, w, command, driven, r):
        y, y_dot, input = reading(0.0, 0, w, driven, NO_TABLE)
        return times(read(moment(x, w, command, driven, y, y_dot, input), driven), r.scales)

    @compiled
    def entry(value):
        return np.float32(min(max(value, -OBSERVATION_LIMIT), OBSERVATION_LIMIT))

    if senses:

        @compiled
        def set_out(b, j, raw, r):
            save(b.s, E, LANES, j, raw)  # sensors read it first

        @compiled
        def read_by_sensors(z, stride, j, raw, noise, elapsed, dt, r, begin):
            found = sense(raw, z, SENSORS, stride, j, noise, elapsed, dt, r.sensors, begin)
            seen = times(found, r.scales)
            save(z, SHOWN, stride, j, seen)
            return seen

        @compiled
        def show_again(z, stride, j, raw, r):
            return load_wide(z, SHOWN, stride, j, ENTRIES)

    else:

        @compiled
        def set_out(b, j, raw, r):
            save(b.shown, 0, LANES, j, bounded(times(raw, r.scales), OBSERVATION_LIMIT))

        @compiled
        def read_by_sensors(z, stride, j, raw, noise, elapsed, dt, r, begin):
            return times(raw, r.scales)

        @compiled
        def show_again(z, stride, j, raw, r):
            return times(raw, r.scales)

    # A car by itself --------------------------------------------------------------------------
    # It is one array: what moves, its clock, what is fixed, dt, substeps, its road's table.

    @compiled_apart
    def start_car(
        z, clock, p, stride, j, uniforms, given, nominal, row, draws, targets, table, dt, n, seen
    ):
        """Begin an episode, in the state and phase of `given` where these are numbers; show it."""
        for i in range(row.shape[0]):
            row[i] = nominal[i]
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
        driven, time = start(numbers, phase, one.endless, dt / n)
        r = Read(
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
        while next_kink(kink, driven.road, driven.speed, table) < time:  # one right now is to come
            kink += 1
        next = next_kink(kink, driven.road, driven.speed, table)
        x = PlantState(State(x1, x2, v1, v2), memory)
        w = Phasors(phasor_at(time, kink, driven.road), angle(driven.force.Omega * time))
        keep(p, stride, j, driven, dt / n)
        save(p, R, stride, j, r)
        save(z, X, stride, j, x)
        save(z, W, stride, j, w)
        noise = uniforms[first - NOISE_DRAWS]
        begun = Clock(0.0, one.steps, 0.0, time, phase, float(kink), next, noise)
        save(clock, 0, stride, j, begun)
        for k in range(LATER, SENSORS):
            z[k * stride + j] = 0.0
        save(z, HELD, stride, j, COMMAND)
        now = look(x, w, COMMAND, driven, kink, time, table)
        save(z, REMEMBERED, stride, j, times(measure(now, driven), r.term_scales))
        entries = read_by_sensors(z, stride, j, read(now, driven), noise, 0.0, dt, r, True)
        for i in range(K):
            seen[i] = entry(entries[i])

    @kernel(nogil=False)
    def reset_one(car, uniforms, given, nominal, row, draws, targets, seen):
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        z, clock, p = car[:MY_CLOCK], car[MY_CLOCK:MY_FIXED], car[MY_FIXED:DT]
        dt, n, table = car[DT], int(car[SUBSTEPS]), car[TABLE:]
        start_car(
            z, clock, p, 1, 0, uniforms, given, nominal, row, draws, targets, table, dt, n, seen
        )

    @kernel(nogil=False, allocates=False)
    def step_one(car, action, seen, push):
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        if action.shape[0] != m:
            return outcome(WRONG_SHAPE, 0.0, False, False, COSTS, 0.0)
        time = load(car, MY_CLOCK, 1, 0, CLOCK)
        if time.done > 0.0:
            return outcome(OVER, 0.0, False, False, COSTS, 0.0)
        first, last = float(action[0]), float(action[m - 1])
        if not (abs(first) <= HIGHEST and abs(last) <= HIGHEST):
            return outcome(NOT_FINITE, 0.0, False, False, COSTS, 0.0)
        driven, r = load(car, MY_FIXED, 1, 0, DRIVEN), load(car, MY_FIXED + R, 1, 0, READ)
        dt, n, table = car[DT], int(car[SUBSTEPS]), car[TABLE:]
        c = later(car, LATER, 1, 0, command_of((first, last), driven.actuator))
        x, w = load(car, X, 1, 0, STATE), load(car, W, 1, 0, PHASORS)
        t = time.start + time.elapsed * dt
        x, w, kink, next = drive(x, w, c, driven, int(time.kink), time.next, t, dt, n, table)
        elapsed = time.elapsed + 1.0
        now = look(x, w, c, driven, kink, time.start + elapsed * dt, table)
        costs, out, measured = judge(now, load(car, REMEMBERED, 1, 0, BEFORE), driven, r)
        late = elapsed >= time.last and not out
        penalty = -r.penalty if out else 0.0
        done = 1.0 if out or late else 0.0
        clock = Clock(
            elapsed, time.last, done, time.start, time.phase, float(kink), next, time.noise
        )
        save(car, X, 1, 0, x)
        save(car, W, 1, 0, w)
        save(car, REMEMBERED, 1, 0, measured)
        save(car, MY_CLOCK, 1, 0, clock)
        save(car, HELD, 1, 0, c)
        raw = read(now, driven)
        entries = read_by_sensors(car, 1, 0, raw, time.noise, elapsed, dt, r, False)
        for i in range(K):
            seen[i] = entry(entries[i])
        save(push, 0, 1, 0, forces_of(now))
        return outcome(FINE, negative_sum(costs) + penalty, out, late, costs, penalty)

    # A fleet ----------------------------------------------------------------------------------

    @compiled
    def begin_car(fleet, drawn, i, given, draw, seen):
        """Begin an episode of car `i`, from numbers that are drawn now or were kept."""
        block, j, k = i // LANES, i % LANES, drawn.chosen[i]
        count, first, last = drawn.counts[k]
        uniforms = drawn.uniforms[i, :count]
        if draw:
            for each in range(count):
                uniforms[each] = uniform(drawn.streams, i)
        own = fleet.blocks[block]
        clock = fleet.clocks[block]
        start_car(
            fleet.slabs[block],
            clock,
            fleet.fixed[own[OWN_FIXED]],
            LANES,
            j,
            uniforms,
            given,
            drawn.nominals[k],
            drawn.row,
            drawn.draws[k],
            drawn.targets[first:last],
            fleet.tables[fleet.bounds[i, 0] : fleet.bounds[i, 1]],
            fleet.dt,
            fleet.substeps,
            seen,
        )
        own[QUIET] = min(own[QUIET], quiet_of(clock, j, fleet.dt))

    @kernel(allocates=exact)
    def begin(fleet, drawn, which, given, draw, seen):
        """Begin episodes of the cars in `which`; `given` has a row for each, or one for all."""
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        for row in range(which.shape[0]):
            i = which[row]
            begin_car(fleet, drawn, i, given[min(row, given.shape[0] - 1)], draw, seen[i])

    @kernel(allocates=False)
    def show(fleet, seen):
        """Write the observations of all cars."""
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        for i in range(seen.shape[0]):
            block, j = i // LANES, i % LANES
            z, p = fleet.slabs[block], fleet.fixed[fleet.blocks[block, OWN_FIXED]]
            driven, r = load_wide(p, 0, LANES, j, DRIVEN), load_wide(p, R, LANES, j, READ)
            time = load(fleet.clocks[block], 0, LANES, j, CLOCK)
            now = look(
                load_wide(z, X, LANES, j, STATE),
                load_wide(z, W, LANES, j, PHASORS),
                load_wide(z, HELD, LANES, j, COMMAND),
                driven,
                int(time.kink),
                time.start + time.elapsed * fleet.dt,
                fleet.tables[fleet.bounds[i, 0] : fleet.bounds[i, 1]],
            )
            entries = show_again(z, LANES, j, read(now, driven), r)
            for k in range(K):
                seen[i, k] = entry(entries[k])

    @compiled
    def note(now, before, b, j, driven, r):
        """Pass on what has been read of one car, and remember what the reward's terms have read."""
        costs, out, measured = judge(now, before, driven, r)
        late = (b.clock[ELAPSED * LANES + j] >= b.clock[LAST * LANES + j]) & (not out)
        penalty = -r.penalty * out
        set_out(b, j, read(now, driven), r)
        save(b.s, U, LANES, j, forces_of(now))
        save(b.s, REWARD, LANES, j, (negative_sum(costs) + penalty, negative(costs), penalty))
        save(b.s, END, LANES, j, (out, late))
        save(b.z, REMEMBERED, LANES, j, measured)

    @compiled_apart
    def inspect_one(b, j, before):
        """Read one car by itself."""
        driven, r = load_wide(b.p, 0, LANES, j, DRIVEN), load_wide(b.p, R, LANES, j, READ)
        time = load(b.clock, 0, LANES, j, CLOCK)
        now = look(
            load_wide(b.z, X, LANES, j, STATE),
            load_wide(b.z, W, LANES, j, PHASORS),
            load_wide(b.z, HELD, LANES, j, COMMAND),
            driven,
            int(time.kink),
            time.start + time.elapsed * b.dt,
            b.tables[b.bounds[j, 0] : b.bounds[j, 1]],
        )
        note(now, before, b, j, driven, r)

    @compiled
    def inspect(b):
        """Read all cars of a block."""
        for j in range(b.lanes):
            driven, r = load(b.p, 0, LANES, j, DRIVEN), load(b.p, R, LANES, j, READ)
            x, w = load(b.z, X, LANES, j, STATE), load(b.z, W, LANES, j, PHASORS)
            y, y_dot, input = at_end(b, j, w, driven)
            now = moment(x, w, load(b.z, HELD, LANES, j, COMMAND), driven, y, y_dot, input)
            note(now, load(b.z, REMEMBERED, LANES, j, BEFORE), b, j, driven, r)

    @compiled
    def put_out(b, seen, rewards, push, ends):
        """Write what a block's cars have done, and whether the episode of one is over.

        Arrays of a row for each car are flat, so that the distances in them are constants.
        """
        s, over = b.s, False
        first, last = b.first, b.first + b.lanes
        own_seen, own_push = seen[first * K : last * K], push[first * m : last * m]
        for j in range(b.lanes):
            for k in range(K):
                own_seen[j * K + k] = b.shown[k * LANES + j]
        for j in range(b.lanes):
            for i in range(m):
                own_push[j * m + i] = s[(U + i) * LANES + j]
        for i in range(T + 2):
            row = rewards[i, first:last]
            for j in range(b.lanes):
                row[j] = s[(REWARD + i) * LANES + j]
        for i in range(2):
            which = ends[i, first:last]
            for j in range(b.lanes):
                which[j] = s[(END + i) * LANES + j] > NONE
        for j in range(b.lanes):
            over |= s[END * LANES + j] + s[(END + 1) * LANES + j] + b.clock[DONE * LANES + j] > NONE
        b.own[ENDED] = over

    @kernel(allocates=exact)
    @compiled_apart(allocates=exact)  # for kernels of many intervals, see `held_law`
    def step(
        slabs,
        clocks,
        fixed_slabs,
        blocks,
        tables,
        bounds,
        dt,
        n,
        s,
        stages,
        shown,
        first_block,
        end_block,
        actions,
        seen,
        rewards,
        push,
        ends,
    ):
        """Advance the cars of some blocks.

        Returns 0, `OVER` if an episode is over, now or before, or `NOT_FINITE` if an action is no
        finite number; no car has moved then.
        """
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        widen()
        cars, actions = actions.shape[0], actions.reshape(actions.size)
        seen, push = seen.reshape(seen.size), push.reshape(push.size)
        over, wrong = 0, 0
        given = actions[first_block * LANES * m : min(end_block * LANES, cars) * m]
        for i in range(given.shape[0]):
            wrong |= not abs(given[i]) <= HIGHEST
        if wrong:
            return NOT_FINITE
        for block in range(first_block, end_block):
            first, own = block * LANES, blocks[block]
            last = min(first + LANES, cars)
            z, clock, p, lanes = (
                slabs[block],
                clocks[block],
                fixed_slabs[own[OWN_FIXED]],
                last - first,
            )
            table_bounds = bounds[first:last]
            b = Block(first, own, z, clock, p, s, stages, shown, lanes, tables, table_bounds, dt, n)
            given = actions[first * m : last * m]
            for j in range(lanes):
                action = (real(given[j * m]), real(given[j * m + m - 1]))
                command = command_of(action, load(p, 0, LANES, j, DRIVEN).actuator)
                save(z, HELD, LANES, j, later(z, LATER, LANES, j, command))
            kinks = advance(b)
            if kinks:
                for i in range(REMEMBERED * LANES, LATER * LANES):
                    s[i] = z[i]
            inspect(b)
            if kinks:
                for j in range(lanes):
                    time = load(clock, 0, LANES, j, CLOCK)
                    if time.next <= time.start + time.elapsed * dt:
                        inspect_one(b, j, load_wide(s, REMEMBERED, LANES, j, BEFORE))
            if senses:
                for j in range(lanes):
                    r, time = load_wide(p, R, LANES, j, READ), load(clock, 0, LANES, j, CLOCK)
                    raw = load_wide(s, E, LANES, j, ENTRIES)
                    now = read_by_sensors(z, LANES, j, raw, time.noise, time.elapsed, dt, r, False)
                    save(b.shown, 0, LANES, j, bounded(now, OBSERVATION_LIMIT))
            put_out(b, seen, rewards, push, ends)
            over |= own[ENDED]
        return OVER if over else FINE

    @kernel(allocates=exact)
    def turn_over(fleet, drawn, given, same_step, seen, rewards, push, ends, begun, phases, finals):
        """Mark the cars whose episode has just ended, and quiet those that had ended before.

        The former begin the next one at once if `same_step`, and their last observations are
        `finals`; else the latter begin. Write which cars have `begun`, and the phases of their
        roads; return their number.
        """
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        count = 0
        for block in range(fleet.blocks.shape[0]):
            if not fleet.blocks[block, ENDED]:
                continue
            clock = fleet.clocks[block]
            for i in range(block * LANES, min((block + 1) * LANES, ends.shape[1])):
                j = i - block * LANES
                before, now = clock[DONE * LANES + j] > 0.0, ends[0, i] or ends[1, i]
                if before:
                    push[i] = 0.0
                    rewards[:, i] = 0.0
                    ends[:, i] = False
                elif now:
                    clock[DONE * LANES + j] = 1.0
                if before or (now and same_step):
                    for k in range(K if same_step else 0):
                        finals[count, k] = seen[i, k]
                    begun[count] = i
                    begin_car(fleet, drawn, i, given[0], True, seen[i])
                    phases[i] = load(clock, 0, LANES, j, CLOCK).phase
                    count += 1
            fleet.blocks[block, ENDED] = False  # and not once more
        return count

    return Kernels(
        moving=moving,
        fixed=fixed,
        scratch=passed.size,
        stages=motion.stages,
        step=step,
        turn_over=turn_over,
        begin=begin,
        show=show,
        entries=entries_of,
        step_one=step_one,
        reset_one=reset_one,
        own=Own(clock=MY_CLOCK, dt=DT, table=TABLE),
    )
