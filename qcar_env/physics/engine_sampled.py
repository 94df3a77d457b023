"""Cars whose forces are held over control intervals, compiled: the engine of the environments.

Blocks of cars as in `qcar_env.physics.engine`. What an episode starts with, what is observed and
what it costs are the functions of a task (`qcar_env.envs.task`), which is passed in.

An interval has three passes over a block: actions to forces, the Runge-Kutta steps, and what is
seen of their end. A car that meets a kink of its road within the interval is then integrated once
more by itself, cut at the kink; a car whose episode is over starts the next one.
"""

# pyright: basic, reportArgumentType=false
# numba has no types for what it compiles.

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from qcar_env.physics.closed_loop import Limits
from qcar_env.physics.dynamics import Coefficients
from qcar_env.physics.engine import (
    LANES,
    NEVER,
    address_of,
    align_stack,
    carray,
    compiled,
    compiled_apart,
    fresh,
    is_array,
    kernel,
    let_go,
    load,
    load_passage,
    load_wide,
    load_world,
    nothing,
    pointer_at,
    prefetch,
    put,
    put_rows,
    single_kernel,
    source_stamp,
    store,
    store_passage,
    store_world,
    take_back,
)
from qcar_env.physics.engine_random import uniform
from qcar_env.physics.exact_map import ExactMap, Weights, exact_interval
from qcar_env.physics.forcing import Amplitudes, MiddleAmplitudes, Passage, World
from qcar_env.physics.motion import Plant, angle, four_substeps, interval, substep
from qcar_env.physics.rk4 import Step, step_fractions
from qcar_env.physics.roads import Phasor, RoadPieces, kink_time
from qcar_env.physics.state import State

# Rows of the slab.
PLANT = 0  # State
WORLD = 4  # World: phasors of road and force
CAR = 8  # Coefficients
AMPLITUDES = 17  # Amplitudes
PASSAGE = 20  # Passage
SCALES = 28  # the task's Scales
LIMITS = 38  # Limits: specific forces that action 1 makes [m/s^2]
ELAPSED = 40  # control intervals since the episode began [-]
LAST = 41  # control intervals in the episode [-]
DONE = 42  # 1 when the episode is over [-]
FORCES = 43  # Limits: the same in the actuator's unit [m/s^2] or [N]
PIECES = 45  # RoadPieces
OMEGA = 51  # frequency of the external force [rad/s]
START = 52  # time on the road when the episode began [s]
PHASE = 53  # phase of the road then [rad]
KINK = 54  # index of the road's next kink [-]
NEXT = 55  # time of the road's next kink [s]
ROWS = 56

# What a single car has behind them.
DT = ROWS  # control interval [s]
SUBSTEPS = ROWS + 1  # integration steps in it [-]
HELD = ROWS + 2  # the actions of the last interval, within [-1, 1]
ONE_CAR = ROWS + 4

# Rows of what is passed on within an interval.
FORCE = 0  # u1, u2 held [m/s^2]
ENTRIES = 2  # what is observed: nine rows in single precision
SAVED = 11  # the states before a crossing of kinks
SCRATCH_SIZE = (SAVED + CAR) * LANES

# Where a batch's numbers lie, for `step`: addresses, as numba takes longer to unpack an argument
# than to step a car.
(
    SLABS,  # (blocks, ROWS * LANES)
    QUIET,  # (blocks,) of int64: for how many intervals no car of a block can meet a kink
    WAITING,  # (blocks,) of int64: cars whose episode is over
    STREAMS,  # (n, 4): random numbers
    NOMINALS,  # (k, fields): scenarios
    WHICH,  # (n,) of int64: from which of them each car draws its episodes
    SCRATCHES,  # (workers, SCRATCH_SIZE)
    FINALS,  # (n, size) of float32: last observations of the cars that have begun again
    RESTARTED,  # (n,) of bool: which cars these are, until a step has returned it
    PHASES,  # (n,): of their roads, 0 of the others
    COMMON,  # (SHARED,): what all cars have in common where the exact map advances them
    SETTINGS,  # (6,): dt, substeps and the Step
    CARS,  # the number n
    SCENARIOS,  # the number k
    MAKER,  # two addresses, see `qcar_env.physics.engine.array_makers`
    ARRAY_TYPE,
    GIVEN,  # (n, m) of float32: actions; this and the following are what `prepare` notes
    SEEN,  # (n, size) of float32: observations
    REWARD,  # (n,)
    TERMINATED,  # (n,) of bool
    TRUNCATED,  # (n,) of bool
    PUSH,  # (n, m): forces
    REWARD_X1,  # (n,): the terms of the reward
    REWARD_X2,  # (n,)
    REWARD_TRAVEL,  # (n,)
    HELD_SIZE,
) = range(26)

HIGHEST = np.finfo(np.float32).max  # an action beyond is not a finite number
MANY = 32  # [blocks] that do not fit the second-level cache of 1 MB: fetched ahead from there on
DRAWS = 12  # uniform numbers that the start of an episode takes
RESEED = 64  # [intervals] after which phasors in single precision are computed anew
RESEED_EXACT = 512  # the same where an interval turns them once, instead of in each half step

# What all cars share where the exact map advances them, behind the rows of one of them.
MAP = ROWS  # ExactMap
SHARED = ROWS + 44

NOTHING_GIVEN = (math.nan,) * 5

DISABLED, NEXT_STEP, SAME_STEP = range(3)  # what becomes of a car whose episode is over


class One(NamedTuple):
    """A single number of a slab."""

    value: Any


class Two(NamedTuple):
    """Two numbers of an array."""

    first: Any
    last: Any


class Seen(NamedTuple):
    """The nine entries that can be observed."""

    x1: Any
    x2: Any
    v1: Any
    v2: Any
    y: Any
    y_dot: Any
    F: Any
    F_dot: Any
    limit: Any


class Kernels(NamedTuple):
    """The compiled functions of a task."""

    step: Any
    prepare: Any
    step_blocks: Any
    restarts: Any
    reset: Any
    step_one: Any
    reset_one: Any


@compiled_apart
def place(z: Any, stride: Any, lane: Any, episode: Any, phase: Any, last: Any) -> None:
    """Write a car at the start of an episode into a slab."""
    plant = episode.plant
    store(z, stride, PLANT, lane, episode.x)
    store_world(z, stride, WORLD, lane, episode.world)
    store(z, stride, CAR, lane, plant.car)
    store(z, stride, AMPLITUDES, lane, plant.amplitudes)
    store_passage(z, stride, PASSAGE, lane, plant.passage)
    store(z, stride, SCALES, lane, episode.scales)
    store(z, stride, LIMITS, lane, episode.limits)
    store(z, stride, FORCES, lane, episode.forces)
    store(z, stride, PIECES, lane, plant.road)
    kink = kink_time(episode.kink, plant.road)
    store(z, stride, ELAPSED, lane, (0.0, last, 0.0))
    store(z, stride, OMEGA, lane, (plant.Omega, episode.start, phase, episode.kink, kink))


@compiled_apart
def start_car(
    z: Any,
    stride: Any,
    lane: Any,
    draws: Any,
    given: Any,
    nominal: Any,
    draw_factors: Any,
    draw_motion: Any,
    begin: Any,
) -> None:
    """Begin an episode of one car, in the state and phase of `given` where these are numbers."""
    x, phase = draw_motion(draws, nominal)
    if not math.isnan(given[0]):
        x = State(given[0], given[1], given[2], given[3])
    if not math.isnan(given[4]):
        phase = given[4]
    episode = begin(x, phase, draw_factors(draws, nominal), nominal)
    place(z, stride, lane, episode, phase, nominal.steps)


@compiled
def draw_all(states: Any, i: Any) -> Any:
    """Return the uniform numbers that the start of an episode takes, from stream `i`."""
    return (
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
        uniform(states, i),
    )


@compiled
def cross(z: Any, stride: Any, lane: Any, t: Any, dt: Any, substeps: Any, u1: Any, u2: Any) -> None:
    """Advance one car over an interval that may hold kinks of its road."""
    road = load_wide(z, stride, PIECES, lane, RoadPieces)
    passage = Passage(
        World(
            load_wide(z, stride, PASSAGE, lane, Phasor),
            load_wide(z, stride, PASSAGE + 2, lane, Phasor),
        ),
        load_wide(z, stride, PASSAGE + 4, lane, MiddleAmplitudes),
    )
    plant = Plant(
        load_wide(z, stride, CAR, lane, Coefficients),
        load_wide(z, stride, AMPLITUDES, lane, Amplitudes),
        road,
        load_wide(z, stride, OMEGA, lane, One).value,
        passage,
        step_fractions(dt / substeps),
    )
    x, world, kink = interval(
        load_wide(z, stride, PLANT, lane, State),
        World(
            load_wide(z, stride, WORLD, lane, Phasor),
            load_wide(z, stride, WORLD + 2, lane, Phasor),
        ),
        int(load_wide(z, stride, KINK, lane, One).value),
        t,
        dt,
        substeps,
        u1,
        u2,
        plant,
    )
    store(z, stride, PLANT, lane, x)
    store_world(z, stride, WORLD, lane, world)
    store(z, stride, KINK, lane, (kink, kink_time(kink, road)))


@compiled
def show(
    z: Any,
    stride: Any,
    lane: Any,
    observation: Any,
    observe: Any,
    bounded: Any,
    Scales: Any,
    entries: Any,
    with_limit: Any,
    limit: Any,
) -> None:
    """Write the observation of one car."""
    x = load(z, stride, PLANT, lane, State)
    world = load_world(z, stride, WORLD, lane)
    seen = observe(x, world, load(z, stride, SCALES, lane, Scales))
    for i in range(8):
        if i < entries:
            observation[i] = bounded(seen[i], limit)
    if with_limit:
        observation[entries] = bounded(seen[8], limit)


@compiled
def time_of(z: Any, stride: Any, lane: Any, dt: Any) -> Any:
    """Return the time on the road of a car [s]."""
    start = load_wide(z, stride, START, lane, One).value
    return start + load_wide(z, stride, ELAPSED, lane, One).value * dt


@compiled
def quiet_of(z: Any, lane: Any, dt: Any) -> Any:
    """Return how many control intervals will pass before a car can meet a kink."""
    ahead = (load_wide(z, LANES, NEXT, lane, One).value - time_of(z, LANES, lane, dt)) / dt
    return max(0, int(ahead) - 2) if ahead < 1e12 else NEVER


@compiled_apart
def quiet_intervals(z: Any, lanes: Any, dt: Any) -> Any:
    """Return the same for the first car of the block to meet one."""
    least = NEVER
    for j in range(lanes):
        least = min(least, quiet_of(z, j, dt))
    return least


@compiled_apart
def reseed(z: Any, lanes: Any, dt: Any) -> None:
    """Set the phasors of the force and of endless roads to their exact values."""
    for j in range(lanes):
        t = time_of(z, LANES, j, dt)
        road = load_wide(z, LANES, PIECES, j, RoadPieces)
        store(z, LANES, WORLD + 2, j, angle(load_wide(z, LANES, OMEGA, j, One).value * t))
        if road.count == 0.0:
            store(z, LANES, WORLD, j, angle(road.omega * t))


@compiled
def load_map(shared: Any) -> Any:
    """Return the ExactMap that cars share."""
    return ExactMap(
        load(shared, 1, MAP, 0, Weights),
        load(shared, 1, MAP + 10, 0, Weights),
        load(shared, 1, MAP + 20, 0, Weights),
        load(shared, 1, MAP + 30, 0, Weights),
        load_world(shared, 1, MAP + 40, 0),
    )


def kernels(
    task: Any, entries: int, with_limit: bool, actions: int, single: bool, exact: bool = False
) -> Kernels:
    """Compile the functions of a task.

    Parameters
    ----------
    task : module
        `qcar_env.envs.task` or another with its functions.
    entries : int
        Entries of the observation, without the limit.
    with_limit : bool
        Whether the force limit is the last entry.
    actions : int
        Number of actions: 2, or 1 for an actuator between the masses.
    single : bool
        Whether slabs have single precision.
    exact : bool
        Whether `step` advances all cars by one exact map, which needs harmonic roads and the same
        parameters for all; Runge-Kutta steps otherwise.

    Returns
    -------
    Kernels

    Notes
    -----
    ``step(place, actions, mode)`` advances all cars by one control interval; `place` is the address
    of the batch's numbers (`SLABS` and the following), `mode` is `DISABLED`, `NEXT_STEP` or
    `SAME_STEP`. It returns ``(code, observations, rewards, terminated, truncated, forces, reward
    terms x1, x2, travel, finished, begun, again, others, phases)``: new arrays, and the numbers of
    cars that have finished and begun. If any have begun, the last three are which have, (n,) of
    bool, which have not, and the phases of the roads of those that have, (n,), 0 elsewhere; None
    otherwise. The code is 0, or -1 if an action is not a finite number, -2 if the episode of a car
    is over and the mode is `DISABLED`, -3 if the actions are no array (n, m) of float32; no car has
    moved then.

    Several workers share a step out. ``prepare(place, actions)`` makes the arrays and notes where
    they lie; it returns what `step` does, with the code 0 or -3. Then ``step_blocks(worker,
    first_block, end_block, mode, place)`` advances the cars of some blocks and returns ``(code,
    finished, begun)``; other workers may have moved theirs if the code is not 0. If any have begun,
    ``restarts(place)`` returns the last three.

    ``reset(slabs, quiet, waiting, streams, nominals, which, mask, given, dt, observations)``
    begins episodes of the cars in `mask` (n,) and writes all observations; given (n, 5) has states
    and phases, drawn where they are not a number. ``reset_one(car, makers, draws, given, nominal)``
    does the same for one car, a slab (ONE_CAR,) by itself, and returns its observation; `makers`
    are those of `qcar_env.physics.engine.array_makers`. ``step_one(place, action)`` steps it; at
    the address `place` are that of the car and `makers`. It returns ``(code, observation, reward,
    terminated, truncated, forces, reward terms x1, x2, travel)``, with the code -3 for an action
    that is not an array (m,) of float32.
    """
    return _kernels(task, entries, with_limit, actions, single, exact)


@cache
def _kernels(
    task: Any, entries: int, with_limit: bool, actions: int, single: bool, exact: bool
) -> Kernels:
    sources = source_stamp(task.begin, uniform)
    size = entries + int(with_limit)
    assert task.DRAWS == DRAWS
    limit = task.OBSERVATION_LIMIT
    real = np.float32 if single else np.float64
    UNIT, ONE, NONE, BOUND = real(1.0), real(1.0), real(0.0), np.float32(limit)
    SIZE = np.dtype(real).itemsize
    Scales, Nominal = task.Scales, task.Nominal
    NOMINAL = len(Nominal._fields)
    assert len(Scales._fields) == LIMITS - SCALES
    for each in (
        task.ratio,
        task.scales_of,
        task.road_pieces,
        task.phasor_at,
        task.vary_car,
        task.observe,
        task.costs,
        task.out_of_travel,
        task.penalty,
        task.bounded,
    ):
        compiled(each)
    LINE = 64 // np.dtype(real).itemsize  # numbers in a cache line
    LINES = (LAST + 1) * LANES // LINE
    EVERY = RESEED_EXACT if exact else RESEED
    UNITS = FORCES if actions == 1 else LIMITS  # two actuators have specific limits
    Given = One if actions == 1 else Two
    observe, costs, out_of_travel = task.observe, task.costs, task.out_of_travel
    fine, bounded = task.penalty, task.bounded
    draw_factors = compiled_apart(task.draw_factors)
    draw_motion = compiled_apart(task.draw_motion)
    begin = compiled_apart(task.begin)

    @single_kernel
    def reset_one(car: Any, makers: Any, draws: Any, given: Any, nominal: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        numbers = load(nominal, 1, 0, 0, Nominal)
        start_car(car, 1, 0, draws, given, numbers, draw_factors, draw_motion, begin)
        store(car, 1, HELD, 0, (0.0, 0.0))
        seen = fresh(makers, np.float32(0), (size,))
        shown = carray(pointer_at(address_of(seen), np.float32(0)), (size,))
        show(car, 1, 0, shown, observe, bounded, Scales, entries, with_limit, limit)
        return seen

    @single_kernel
    def step_one(place: Any, action: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        held = carray(pointer_at(place, np.int64(0)), (3,))
        car = carray(pointer_at(held[0], 0.0), (ONE_CAR,))
        makers = held[1], held[2]
        seen, push = fresh(makers, np.float32(0), (size,)), fresh(makers, 0.0, (actions,))
        if not is_array(makers, action, (actions,)):
            return -3, seen, 0.0, False, False, push, 0.0, 0.0, 0.0
        if car[DONE] > 0.0:
            return -2, seen, 0.0, False, False, push, 0.0, 0.0, 0.0
        given = carray(pointer_at(address_of(action), np.float32(0)), (actions,))
        first, last = np.float64(given[0]), np.float64(given[actions - 1])
        if not (abs(first) <= HIGHEST and abs(last) <= HIGHEST):
            return -1, seen, 0.0, False, False, push, 0.0, 0.0, 0.0
        dt, substeps = car[DT], int(car[SUBSTEPS])
        first, last = bounded(first, 1.0), bounded(last, 1.0)
        limits = load(car, 1, LIMITS, 0, Limits)
        u1, u2 = limits.u1 * first, limits.u2 * last
        cross(car, 1, 0, time_of(car, 1, 0, dt), dt, substeps, u1, u2)
        elapsed = car[ELAPSED] + 1.0
        car[ELAPSED] = elapsed
        x = load(car, 1, PLANT, 0, State)
        scales = load(car, 1, SCALES, 0, Scales)
        cost1, cost2 = costs(x, scales)
        terminated = out_of_travel(x, scales)
        penalty = -fine(scales) if terminated else 0.0
        truncated = elapsed >= car[LAST] and not terminated
        car[DONE] = 1.0 if terminated or truncated else 0.0
        reward = -cost1 - cost2 + penalty
        shown = carray(pointer_at(address_of(seen), np.float32(0)), (size,))
        show(car, 1, 0, shown, observe, bounded, Scales, entries, with_limit, limit)
        store(car, 1, HELD, 0, (first, last))
        forces = load(car, 1, FORCES, 0, Limits)
        pushed = carray(pointer_at(address_of(push), 0.0), (actions,))
        pushed[0] = first * forces.u1
        if actions == 2:
            pushed[1] = last * forces.u2
        return 0, seen, reward, terminated, truncated, push, -cost1, -cost2, penalty

    @kernel
    def reset(
        slabs: Any,
        quiet: Any,
        waiting: Any,
        streams: Any,
        nominals: Any,
        which: Any,
        mask: Any,
        given: Any,
        dt: Any,
        observations: Any,
    ) -> None:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        n = mask.shape[0]
        for block in range(slabs.shape[0]):
            z = slabs[block]
            lanes = min(LANES, n - block * LANES)
            for j in range(lanes):
                i = block * LANES + j
                if mask[i]:
                    numbers = load(nominals[which[i]], 1, 0, 0, Nominal)
                    draws = draw_all(streams, i)
                    start_car(
                        z, LANES, j, draws, given[i], numbers, draw_factors, draw_motion, begin
                    )
                show(
                    z,
                    LANES,
                    j,
                    observations[i],
                    observe,
                    bounded,
                    Scales,
                    entries,
                    with_limit,
                    limit,
                )
            quiet[block] = quiet_intervals(z, lanes, dt)
            waiting[block] = 0
            for j in range(lanes):
                waiting[block] += np.int64(z[DONE * LANES + j] > 0)

    @kernel
    def step_blocks(worker: Any, first_block: Any, end_block: Any, mode: Any, place: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        align_stack()
        held = carray(pointer_at(place, np.int64(0)), (HELD_SIZE,))
        n = held[CARS]
        slabs = carray(pointer_at(held[SLABS], real(0)), (end_block, ROWS * LANES))
        quiet = carray(pointer_at(held[QUIET], np.int64(0)), (end_block,))
        over_before = carray(pointer_at(held[WAITING], np.int64(0)), (end_block,))
        streams = carray(pointer_at(held[STREAMS], np.uint64(0)), (n, 4))
        nominals = carray(pointer_at(held[NOMINALS], 0.0), (held[SCENARIOS], NOMINAL))
        phases = carray(pointer_at(held[PHASES], 0.0), (n,))
        which = carray(pointer_at(held[WHICH], np.int64(0)), (n,))
        scratch = held[SCRATCHES] + worker * SCRATCH_SIZE * SIZE
        s = carray(pointer_at(scratch, real(0)), (SCRATCH_SIZE,))
        entries_of = carray(
            pointer_at(scratch + ENTRIES * LANES * SIZE, np.float32(0)), (9 * LANES,)
        )
        finals = carray(pointer_at(held[FINALS], np.float32(0)), (n, size))
        restarted = carray(pointer_at(held[RESTARTED], np.bool_(0)), (n,))
        settings = carray(pointer_at(held[SETTINGS], 0.0), (6,))
        dt, substeps = settings[0], np.int64(settings[1])
        fractions = Step(real(settings[2]), real(settings[3]), real(settings[4]), real(settings[5]))
        shared = carray(pointer_at(held[COMMON], real(0)), (SHARED,))
        the_map = load_map(shared)
        the_limits = load(shared, 1, LIMITS, 0, Limits)
        the_scales, the_last = load(shared, 1, SCALES, 0, Scales), load(shared, 1, LAST, 0, One)
        the_units = load(shared, 1, UNITS, 0, Limits)
        acts = carray(pointer_at(held[GIVEN], np.float32(0)), (n * actions,))
        observations = carray(pointer_at(held[SEEN], np.float32(0)), (n, size))
        shown, push, reward = held[SEEN], held[PUSH], held[REWARD]
        reward_x1, reward_x2, reward_travel = held[REWARD_X1], held[REWARD_X2], held[REWARD_TRAVEL]
        terminated, truncated = held[TERMINATED], held[TRUNCATED]
        wrong = np.int32(0)
        for i in range(first_block * LANES * actions, min(n, end_block * LANES) * actions):
            wrong |= np.int32(not abs(load(acts, 1, i, 0, One).value) <= HIGHEST)
        if wrong > 0:
            return -1, 0, 0
        finished = 0
        begun = 0
        many = end_block - first_block >= MANY
        width = LINE if many else LANES  # cars of a vector, for which so much is fetched at a time
        for block in range(first_block, end_block):
            z = slabs[block]
            base = block * LANES
            lanes = min(LANES, n - base)
            waiting = over_before[block]
            if waiting > 0 and mode == DISABLED:
                return -2, 0, 0
            for j in range(lanes):
                given = load(acts, 1, (base + j) * actions, 0, Given)
                a1, a2 = bounded(real(given[0]), UNIT), bounded(real(given[-1]), UNIT)
                if exact:
                    limits, units = the_limits, the_units
                else:
                    limits = load(z, LANES, LIMITS, j, Limits)
                    units = load(z, LANES, UNITS, j, Limits)
                store(s, LANES, FORCE, j, (limits.u1 * a1, limits.u2 * a2))
                put(push, 0.0, (base + j) * actions, a1 * units.u1, 1)
                if actions == 2:
                    put(push, 0.0, (base + j) * actions + 1, a2 * units.u2, 1)
            crossing = 0
            if exact:
                pass
            elif quiet[block] > 0:
                quiet[block] -= 1
            else:
                for j in range(lanes):
                    crossing += np.int64(z[NEXT * LANES + j] < time_of(z, LANES, j, dt) + dt)
                if crossing > 0:
                    for i in range(CAR * LANES):
                        s[SAVED * LANES + i] = z[i]
                else:
                    quiet[block] = quiet_intervals(z, lanes, dt)
            if single and int(z[ELAPSED * LANES]) % EVERY == 0:
                reseed(z, lanes, dt)
            # The next block comes from a slower cache while this one is worked on.
            ahead = slabs[min(block + 1, end_block - 1)]
            if exact:
                for line in range(CAR * LANES // LINE):
                    prefetch(ahead, line * LINE)
                for line in range(ELAPSED * LANES // LINE, LINES):
                    prefetch(ahead, line * LINE)
                for j in range(lanes):
                    u = load(s, LANES, FORCE, j, Limits)
                    x, world = exact_interval(
                        load(z, LANES, PLANT, j, State),
                        load_world(z, LANES, WORLD, j),
                        u.u1,
                        u.u2,
                        the_map,
                    )
                    store(z, LANES, PLANT, j, x)
                    store_world(z, LANES, WORLD, j, world)
            for k in range(0 if exact else substeps // 4):
                for strip in range(0, lanes, width):
                    if many and k == 0:
                        line = strip * LINES // LANES
                        for each in range(line, line + width * LINES // LANES):
                            prefetch(ahead, each * LINE)
                    for j in range(strip, min(strip + width, lanes)):
                        u = load(s, LANES, FORCE, j, Limits)
                        x, world = four_substeps(
                            load(z, LANES, PLANT, j, State),
                            load_world(z, LANES, WORLD, j),
                            load_passage(z, LANES, PASSAGE, j),
                            load(z, LANES, AMPLITUDES, j, Amplitudes),
                            fractions,
                            u.u1,
                            u.u2,
                            load(z, LANES, CAR, j, Coefficients),
                        )
                        store(z, LANES, PLANT, j, x)
                        store_world(z, LANES, WORLD, j, world)
            for _ in range(0 if exact else substeps % 4):
                for j in range(lanes):
                    u = load(s, LANES, FORCE, j, Limits)
                    x, world = substep(
                        load(z, LANES, PLANT, j, State),
                        load_world(z, LANES, WORLD, j),
                        load_passage(z, LANES, PASSAGE, j),
                        load(z, LANES, AMPLITUDES, j, Amplitudes),
                        fractions,
                        u.u1,
                        u.u2,
                        load(z, LANES, CAR, j, Coefficients),
                    )
                    store(z, LANES, PLANT, j, x)
                    store_world(z, LANES, WORLD, j, world)
            if crossing > 0:
                for j in range(lanes):
                    t = time_of(z, LANES, j, dt)
                    if z[NEXT * LANES + j] < t + dt:
                        for i in range(CAR):
                            z[i * LANES + j] = s[(SAVED + i) * LANES + j]
                        u = load_wide(s, LANES, FORCE, j, Limits)
                        cross(z, LANES, j, t, dt, substeps, u.u1, u.u2)
            over = 0
            for j in range(lanes):
                elapsed = load(z, LANES, ELAPSED, j, One).value + ONE
                store(z, LANES, ELAPSED, j, (elapsed,))
                x = load(z, LANES, PLANT, j, State)
                if exact:
                    scales, last = the_scales, the_last.value
                else:
                    scales = load(z, LANES, SCALES, j, Scales)
                    last = load(z, LANES, LAST, j, One).value
                cost1, cost2 = costs(x, scales)
                out = out_of_travel(x, scales)
                late = (elapsed >= last) & (not out)
                penalty = -fine(scales) if out else NONE
                put(reward, 0.0, base + j, -cost1 - cost2 + penalty, 2)
                put(reward_x1, 0.0, base + j, -cost1, 3)
                put(reward_x2, 0.0, base + j, -cost2, 4)
                put(reward_travel, 0.0, base + j, penalty, 5)
                put(terminated, np.bool_(0), base + j, out, 6)
                put(truncated, np.bool_(0), base + j, late, 7)
                seen = observe(x, load_world(z, LANES, WORLD, j), scales)
                store(
                    entries_of,
                    LANES,
                    0,
                    j,
                    (
                        bounded(np.float32(seen[0]), BOUND),
                        bounded(np.float32(seen[1]), BOUND),
                        bounded(np.float32(seen[2]), BOUND),
                        bounded(np.float32(seen[3]), BOUND),
                        bounded(np.float32(seen[4]), BOUND),
                        bounded(np.float32(seen[5]), BOUND),
                        bounded(np.float32(seen[6]), BOUND),
                        bounded(np.float32(seen[7]), BOUND),
                    ),
                )
                if with_limit:
                    store(entries_of, LANES, 8, j, (bounded(np.float32(seen[8]), BOUND),))
                over += np.int64(out | late)
            written = 0
            if size == 8 and not with_limit:
                while written + 8 <= lanes:
                    put_rows(entries_of, LANES, written, shown, (base + written) * size)
                    written += 8
            for j in range(written, lanes):
                seen = load(entries_of, LANES, 0, j, Seen)
                for k in range(entries):
                    observations[base + j, k] = seen[k]
                if with_limit:
                    observations[base + j, entries] = seen[8]
            if waiting > 0 or over > 0:
                out_of = carray(pointer_at(terminated, np.bool_(0)), (n,))
                out_at = carray(pointer_at(truncated, np.bool_(0)), (n,))
                for j in range(lanes):
                    i = base + j
                    again = z[DONE * LANES + j] > 0
                    ended = (out_of[i] or out_at[i]) and not again
                    if ended:
                        finished += 1
                        over_before[block] += 1
                        z[DONE * LANES + j] = 1
                    if again:
                        for k in range(actions):
                            put(push, 0.0, i * actions + k, 0.0, 1)
                        put(reward, 0.0, i, 0.0, 2)
                        put(reward_x1, 0.0, i, 0.0, 3)
                        put(reward_x2, 0.0, i, 0.0, 4)
                        put(reward_travel, 0.0, i, 0.0, 5)
                        out_of[i] = False
                        out_at[i] = False
                    elif ended and mode == SAME_STEP:
                        for k in range(size):
                            finals[i, k] = observations[i, k]
                    else:
                        continue
                    begun += 1
                    over_before[block] -= 1
                    restarted[i] = True
                    start_car(
                        z,
                        LANES,
                        j,
                        draw_all(streams, i),
                        NOTHING_GIVEN,
                        load(nominals[which[i]], 1, 0, 0, Nominal),
                        draw_factors,
                        draw_motion,
                        begin,
                    )
                    show(
                        z,
                        LANES,
                        j,
                        observations[i],
                        observe,
                        bounded,
                        Scales,
                        entries,
                        with_limit,
                        limit,
                    )
                    phases[i] = z[PHASE * LANES + j]
                    quiet[block] = min(quiet[block], quiet_of(z, j, dt))
        return 0, finished, begun

    @compiled
    def arrays(place: Any, given: Any) -> Any:
        held = carray(pointer_at(place, np.int64(0)), (HELD_SIZE,))
        makers, n = (held[MAKER], held[ARRAY_TYPE]), held[CARS]
        code = -3
        if is_array(makers, given, (n, actions)):
            code = 0
            held[GIVEN] = address_of(given)
        seen, push = fresh(makers, np.float32(0), (n, size)), fresh(makers, 0.0, (n, actions))
        reward, reward_x1 = fresh(makers, 0.0, (n,)), fresh(makers, 0.0, (n,))
        reward_x2, reward_travel = fresh(makers, 0.0, (n,)), fresh(makers, 0.0, (n,))
        terminated, truncated = fresh(makers, np.bool_(0), (n,)), fresh(makers, np.bool_(0), (n,))
        held[SEEN], held[REWARD], held[PUSH] = (
            address_of(seen),
            address_of(reward),
            address_of(push),
        )
        held[TERMINATED], held[TRUNCATED] = address_of(terminated), address_of(truncated)
        held[REWARD_X1], held[REWARD_X2] = address_of(reward_x1), address_of(reward_x2)
        held[REWARD_TRAVEL] = address_of(reward_travel)
        return code, seen, reward, terminated, truncated, push, reward_x1, reward_x2, reward_travel

    @compiled
    def restarted_cars(place: Any) -> Any:
        held = carray(pointer_at(place, np.int64(0)), (HELD_SIZE,))
        makers, n = (held[MAKER], held[ARRAY_TYPE]), held[CARS]
        marked, phase = fresh(makers, np.bool_(0), (n,)), fresh(makers, 0.0, (n,))
        others = fresh(makers, np.bool_(0), (n,))
        restarted = carray(pointer_at(held[RESTARTED], np.uint8(0)), (n,))
        phases = carray(pointer_at(held[PHASES], 0.0), (n,))
        to_marked, to_others, to_phase = address_of(marked), address_of(others), address_of(phase)
        # One kind of numbers a loop, or it would not become vector instructions.
        for i in range(n):
            again = load(restarted, 1, i, 0, One).value
            put(to_marked, np.uint8(0), i, again, 1)
            put(to_others, np.uint8(0), i, again ^ np.uint8(1), 2)
        for i in range(n):
            put(to_phase, 0.0, i, load(phases, 1, i, 0, One).value, 3)
        restarted[:] = 0
        phases[:] = 0.0
        return marked, others, phase

    @single_kernel
    def restarts(place: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        return restarted_cars(place)

    @single_kernel
    def prepare(place: Any, given: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        made = arrays(place, given)
        return *made, 0, 0, nothing(), nothing(), nothing()

    @single_kernel
    def step(place: Any, given: Any, mode: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        code, seen, reward, terminated, truncated, push, reward_x1, reward_x2, reward_travel = (
            arrays(place, given)
        )
        finished, begun = 0, 0
        if code == 0:
            held = carray(pointer_at(place, np.int64(0)), (HELD_SIZE,))
            blocks = (held[CARS] + LANES - 1) // LANES
            thread = let_go()
            code, finished, begun = step_blocks(0, 0, blocks, mode, place)
            take_back(thread)
        if begun > 0:
            again, others, phase = restarted_cars(place)
        else:
            again, others, phase = nothing(), nothing(), nothing()
        return (
            code,
            seen,
            reward,
            terminated,
            truncated,
            push,
            reward_x1,
            reward_x2,
            reward_travel,
            finished,
            begun,
            again,
            others,
            phase,
        )

    return Kernels(step, prepare, step_blocks, restarts, reset, step_one, reset_one)
