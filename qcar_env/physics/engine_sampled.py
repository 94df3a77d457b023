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
    carray,
    compiled,
    compiled_apart,
    data_of,
    fresh,
    is_row,
    kernel,
    load,
    load_wide,
    load_world,
    pointer_at,
    prefetch,
    single_kernel,
    source_stamp,
    store,
    store_world,
)
from qcar_env.physics.engine_random import uniform
from qcar_env.physics.exact_map import ExactMap, Weights, exact_interval
from qcar_env.physics.forcing import Amplitudes, World
from qcar_env.physics.motion import Plant, angle, interval, substep
from qcar_env.physics.rk4 import Step, step_fractions
from qcar_env.physics.roads import Phasor, RoadPieces, kink_time
from qcar_env.physics.state import State

# Rows of the slab.
PLANT = 0  # State
WORLD = 4  # World: phasors of road and force
CAR = 8  # Coefficients
AMPLITUDES = 17  # Amplitudes
BY = 20  # World: angles turned in half a step
SCALES = 24  # the task's Scales
LIMITS = 34  # Limits: specific forces that action 1 makes [m/s^2]
ELAPSED = 36  # control intervals since the episode began [-]
LAST = 37  # control intervals in the episode [-]
DONE = 38  # 1 when the episode is over [-]
FORCES = 39  # Limits: the same in the actuator's unit [m/s^2] or [N]
PIECES = 41  # RoadPieces
OMEGA = 47  # frequency of the external force [rad/s]
START = 48  # time on the road when the episode began [s]
PHASE = 49  # phase of the road then [rad]
KINK = 50  # index of the road's next kink [-]
NEXT = 51  # time of the road's next kink [s]
ROWS = 52

# What a single car has behind them.
DT = ROWS  # control interval [s]
SUBSTEPS = ROWS + 1  # integration steps in it [-]
HELD = ROWS + 2  # the actions of the last interval, within [-1, 1]
ONE_CAR = ROWS + 4

# Rows of what is passed on within an interval.
FORCE = 0  # u1, u2 held [m/s^2]
ACTION = 2  # the two actions within [-1, 1]
ENTRIES = 4  # what is observed
NUMBERS = 13  # reward, its terms x1, x2, travel
ENDS = 17  # terminated, truncated
SCRATCH = 19
SCRATCH_SIZE = (SCRATCH + CAR) * LANES  # and behind them the states before a crossing of kinks

# What `numbers` has a row for; the forces follow.
REWARD, REWARD_X1, REWARD_X2, REWARD_TRAVEL, FIRST_FORCE = range(5)

HIGHEST = 1e38  # an action above is not a finite float32
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
    store_world(z, stride, BY, lane, plant.by)
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
    by = World(load_wide(z, stride, BY, lane, Phasor), load_wide(z, stride, BY + 2, lane, Phasor))
    plant = Plant(
        load_wide(z, stride, CAR, lane, Coefficients),
        load_wide(z, stride, AMPLITUDES, lane, Amplitudes),
        road,
        load_wide(z, stride, OMEGA, lane, One).value,
        by,
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


@compiled_apart
def quiet_intervals(z: Any, lanes: Any, dt: Any) -> Any:
    """Return how many control intervals will pass before a car of the block can meet a kink."""
    least = NEVER
    for j in range(lanes):
        ahead = (load_wide(z, LANES, NEXT, j, One).value - time_of(z, LANES, j, dt)) / dt
        if ahead < 1e12:
            least = min(least, max(0, int(ahead) - 2))
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
    ``step(worker, first_block, end_block, held, settings, actions, observations, numbers, ends)``
    advances the cars of some blocks by one control interval:

    - held: addresses in memory, as numba takes longer to unpack an argument than to step a car:
      slabs (blocks, ROWS * LANES); quiet (blocks,) of int64, for how many intervals no car of a
      block can meet a kink; streams (n, 4), random numbers; nominals (k, fields) and which (n,) of
      int64, scenarios, and which one each car draws its episodes from; scratch (workers,
      SCRATCH_SIZE); finals (n, size) of float32 and restarted (n,) of bool, the last observations
      of the cars that were over and begun again within this step, and which cars have begun again
      (never cleared here); phases (n,), of the roads of those; the number k; and at last
      shared (SHARED,), what all cars have in common if `exact`;
    - settings: dt, substeps, mode (`DISABLED`, `NEXT_STEP` or `SAME_STEP`), and the `Step`;
    - actions (n, m) of float32; observations (n, size) of float32, numbers (4 + m, n) and ends
      (2, n) of bool, which are written: reward, its terms, the forces; terminated, truncated.

    It returns ``(code, finished, begun)``: 0, -1 if an action is not a finite number or -2 if the
    episode of a car is over and the mode is `DISABLED` (no car has moved then, unless the blocks
    are shared out to several workers), and the numbers of cars that have finished and begun.

    ``reset(slabs, quiet, streams, nominals, which, mask, given, dt, observations)`` begins
    episodes of the cars in `mask` (n,) and writes all observations; given (n, 5) has states and
    phases, drawn where they are not a number. ``reset_one(car, makers, draws, given,
    nominal)`` does the same for one car, a slab (ONE_CAR,) by itself, and returns its observation;
    `makers` are those of `qcar_env.physics.engine.array_makers`. ``step_one(place, action)`` steps
    it; at the address `place` are that of the car and `makers`. It returns ``(code, observation,
    reward, terminated, truncated, forces, reward terms x1, x2, travel)``, with the code -3 for an
    action that is not an array (m,) of float32.
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
    UNIT, ONE, NONE, BOUND = real(1.0), real(1.0), real(0.0), real(limit)
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
    LINES = (DONE + 1) * LANES // LINE
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
        seen = fresh(makers, np.float32(0), size)
        shown = carray(data_of(seen, np.float32(0)), (size,))
        show(car, 1, 0, shown, observe, bounded, Scales, entries, with_limit, limit)
        return seen

    @single_kernel
    def step_one(place: Any, action: Any) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        held = carray(pointer_at(place, np.int64(0)), (3,))
        car = carray(pointer_at(held[0], 0.0), (ONE_CAR,))
        makers = held[1], held[2]
        seen, push = fresh(makers, np.float32(0), size), fresh(makers, 0.0, actions)
        if not is_row(makers, action, actions):
            return -3, seen, 0.0, False, False, push, 0.0, 0.0, 0.0
        if car[DONE] > 0.0:
            return -2, seen, 0.0, False, False, push, 0.0, 0.0, 0.0
        given = carray(data_of(action, np.float32(0)), (actions,))
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
        shown = carray(data_of(seen, np.float32(0)), (size,))
        show(car, 1, 0, shown, observe, bounded, Scales, entries, with_limit, limit)
        store(car, 1, HELD, 0, (first, last))
        forces = load(car, 1, FORCES, 0, Limits)
        pushed = carray(data_of(push, 0.0), (actions,))
        pushed[0] = first * forces.u1
        if actions == 2:
            pushed[1] = last * forces.u2
        return 0, seen, reward, terminated, truncated, push, -cost1, -cost2, penalty

    @kernel
    def reset(
        slabs: Any,
        quiet: Any,
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

    @kernel
    def step(
        worker: Any,
        first_block: Any,
        end_block: Any,
        held: Any,
        settings: Any,
        acts: Any,
        observations: Any,
        numbers: Any,
        ends: Any,
    ) -> Any:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        n = observations.shape[0]
        slabs = carray(pointer_at(held[0], real(0)), (end_block, ROWS * LANES))
        quiet = carray(pointer_at(held[1], np.int64(0)), (end_block,))
        streams = carray(pointer_at(held[2], np.uint64(0)), (n, 4))
        nominals = carray(pointer_at(held[3], 0.0), (held[9], NOMINAL))
        phases = carray(pointer_at(held[8], 0.0), (n,))
        which = carray(pointer_at(held[4], np.int64(0)), (n,))
        s = carray(pointer_at(held[5], real(0)), (worker + 1, SCRATCH_SIZE))[worker]
        finals = carray(pointer_at(held[6], np.float32(0)), (n, size))
        restarted = carray(pointer_at(held[7], np.bool_(0)), (n,))
        dt = settings[0]
        substeps, mode = np.int64(settings[1]), np.int64(settings[2])
        fractions = Step(real(settings[3]), real(settings[4]), real(settings[5]), real(settings[6]))
        shared = carray(pointer_at(held[10], real(0)), (SHARED,))
        the_map = load_map(shared)
        the_limits = load(shared, 1, LIMITS, 0, Limits)
        the_scales, the_last = load(shared, 1, SCALES, 0, Scales), shared[LAST]
        saved = s[SCRATCH * LANES :]
        seen_flat = observations.reshape(observations.size)
        acts_flat = acts.reshape(acts.size)
        wrong = 0
        for i in range(first_block * LANES * actions, min(n, end_block * LANES) * actions):
            wrong += np.int64(not abs(acts_flat[i]) <= HIGHEST)
        if wrong > 0:
            return -1, 0, 0
        finished = 0
        begun = 0
        many = end_block - first_block >= MANY
        for block in range(first_block, end_block):
            z = slabs[block]
            base = block * LANES
            lanes = min(LANES, n - base)
            waiting = 0
            if mode != SAME_STEP:
                for j in range(lanes):
                    waiting += np.int64(z[DONE * LANES + j] > 0)
                if waiting > 0 and mode == DISABLED:
                    return -2, 0, 0
            for j in range(lanes):
                given = load(acts_flat, 1, (base + j) * actions, 0, Given)
                a1, a2 = bounded(real(given[0]), UNIT), bounded(real(given[-1]), UNIT)
                if exact:
                    limits = the_limits
                else:
                    limits = load(z, LANES, LIMITS, j, Limits)
                store(s, LANES, FORCE, j, (limits.u1 * a1, limits.u2 * a2, a1, a2))
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
                        saved[i] = z[i]
                else:
                    quiet[block] = quiet_intervals(z, lanes, dt)
            if single and int(z[ELAPSED * LANES]) % EVERY == 0:
                reseed(z, lanes, dt)
            # The next block comes from a slower cache while this one is worked on.
            ahead = slabs[min(block + 1, end_block - 1)]
            asked = 0 if many else LINES
            share = 1 + LINES // substeps
            if exact:
                for line in range(CAR * LANES // LINE):
                    prefetch(ahead, line * LINE)
                for line in range(ELAPSED * LANES // LINE, (DONE + 1) * LANES // LINE):
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
            for _ in range(0 if exact else substeps):
                for line in range(asked, min(asked + share, LINES)):
                    prefetch(ahead, line * LINE)
                asked += share
                for j in range(lanes):
                    u = load(s, LANES, FORCE, j, Limits)
                    x, world = substep(
                        load(z, LANES, PLANT, j, State),
                        load_world(z, LANES, WORLD, j),
                        load_world(z, LANES, BY, j),
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
                            z[i * LANES + j] = saved[i * LANES + j]
                        u = load_wide(s, LANES, FORCE, j, Limits)
                        cross(z, LANES, j, t, dt, substeps, u.u1, u.u2)
            over = 0
            for j in range(lanes):
                elapsed = z[ELAPSED * LANES + j] + ONE
                z[ELAPSED * LANES + j] = elapsed
                x = load(z, LANES, PLANT, j, State)
                if exact:
                    scales, last = the_scales, the_last
                else:
                    scales, last = load(z, LANES, SCALES, j, Scales), z[LAST * LANES + j]
                cost1, cost2 = costs(x, scales)
                out = out_of_travel(x, scales)
                late = (elapsed >= last) & (not out)
                penalty = -fine(scales) if out else NONE
                seen = observe(x, load_world(z, LANES, WORLD, j), scales)
                reward = -cost1 - cost2 + penalty
                store(s, LANES, NUMBERS, j, (reward, -cost1, -cost2, penalty, out, late))
                store(
                    s,
                    LANES,
                    ENTRIES,
                    j,
                    (
                        bounded(seen[0], BOUND),
                        bounded(seen[1], BOUND),
                        bounded(seen[2], BOUND),
                        bounded(seen[3], BOUND),
                        bounded(seen[4], BOUND),
                        bounded(seen[5], BOUND),
                        bounded(seen[6], BOUND),
                        bounded(seen[7], BOUND),
                        bounded(seen[8], BOUND),
                    ),
                )
                over += np.int64(out | late)
            for k in range(4):
                for j in range(lanes):
                    numbers[k, base + j] = s[(NUMBERS + k) * LANES + j]
            for k in range(actions):
                if exact:
                    unit = shared[UNITS + k]
                    for j in range(lanes):
                        numbers[FIRST_FORCE + k, base + j] = s[(ACTION + k) * LANES + j] * unit
                else:
                    for j in range(lanes):
                        numbers[FIRST_FORCE + k, base + j] = (
                            s[(ACTION + k) * LANES + j] * z[(UNITS + k) * LANES + j]
                        )
            for k in range(2):
                for j in range(lanes):
                    ends[k, base + j] = s[(ENDS + k) * LANES + j] != 0
            for j in range(lanes):
                seen = load(s, LANES, ENTRIES, j, Seen)
                if with_limit:
                    store(seen_flat, 1, (base + j) * size, 0, seen[:entries] + seen[8:])
                else:
                    store(seen_flat, 1, (base + j) * size, 0, seen[:entries])
            if waiting > 0 or over > 0:
                for j in range(lanes):
                    i = base + j
                    again = z[DONE * LANES + j] > 0
                    ended = (ends[0, i] or ends[1, i]) and not again
                    if ended:
                        finished += 1
                        z[DONE * LANES + j] = 1
                    if again:
                        for k in range(FIRST_FORCE + actions):
                            numbers[k, i] = 0.0
                        ends[0, i] = False
                        ends[1, i] = False
                    elif ended and mode == SAME_STEP:
                        for k in range(size):
                            finals[i, k] = observations[i, k]
                    else:
                        continue
                    begun += 1
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
                quiet[block] = quiet_intervals(z, lanes, dt)
        return 0, finished, begun

    return Kernels(step=step, reset=reset, step_one=step_one, reset_one=reset_one)
