"""The compiled engine: many cars at once, from the same equations that run in plain Python.

The only file that knows numba. It compiles the functions of this package, and the laws that are
passed in, as they stand; none is written a second time.

Cars lie in blocks of `LANES`. A block is one flat row of memory, a slab: quantity `row` of car
`lane` stands at ``row * LANES + lane``. With constant distances between quantities, cars innermost
and no branch on a car, the compiler turns the loop over cars into vector instructions. What
happens to few cars at a time (a kink of the road) is done for those cars one by one.

No fast-math: a car gets the same bits as in plain Python, whatever its neighbours.
"""

# pyright: basic, reportArgumentType=false
# numba has no types for what it compiles.

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic, register_jitable
from numpy.typing import NDArray

from qcar_env.physics import dynamics, forcing, motion, state
from qcar_env.physics.closed_loop import (
    REST,
    ControlledState,
    Limits,
    advance_controlled,
    controlled_rate,
    no_filter,
    saturate,
    saturated_rate,
    unlimited_rate,
)
from qcar_env.physics.dynamics import Coefficients
from qcar_env.physics.forcing import Amplitudes, World, turn_world
from qcar_env.physics.motion import half_step_angles, piece_phasor
from qcar_env.physics.rk4 import rk4_step, step_fractions
from qcar_env.physics.roads import Phasor, RoadPieces, kink_time, turn
from qcar_env.physics.state import Filter, State

Array = NDArray[np.float64]

LANES = 64  # cars in a block: a slab of 50 quantities fits the first-level cache of 32 KB
RESEED = 1024  # [steps] after which turned phasors are computed anew: they stay within 1e-12
THREADED_WORK = 1_000_000  # [car steps] 10 ms on one core: below, a thread costs what it saves
NEVER = 2**62  # [steps] a step that does not come


# Compiled code --------------------------------------------------------------------------------


def compiled(function: Any) -> Any:
    """Let compiled code call `function`, which stays plain Python; return it."""
    if function not in _COMPILED:
        _COMPILED.add(function)
        register_jitable(forceinline=True)(function)
    return function


_COMPILED: set[Any] = set()

for _each in (
    state.advance,
    state.advance_filter,
    state.squared_amplitudes,
    dynamics.accelerations,
    dynamics.rate,
    forcing.forcing,
    turn_world,
    turn,
    kink_time,
    rk4_step,
    step_fractions,
    motion.angle,
    half_step_angles,
    piece_phasor,
    saturate,
    controlled_rate,
    saturated_rate,
    unlimited_rate,
    no_filter,
    advance_controlled,
):
    compiled(_each)


def source_stamp(*functions: Callable[..., Any]) -> str:
    """Return a hash of every source file that enters compiled code with `functions`.

    numba's cache on disk looks at the file that holds a kernel and at nothing else: it would go
    on using the machine code of a law that has been edited since. Kernels close over this stamp,
    so that it becomes part of the cache's key.

    The files are those of the modules of `functions` and of whatever modules of the same
    packages they refer to, and so on.
    """
    todo = [function.__module__ for function in functions] + [__name__]
    found: set[str] = set()
    while todo:
        name = todo.pop()
        if name in found or name not in sys.modules:
            continue
        found.add(name)
        package = name.partition(".")[0]
        for value in vars(sys.modules[name]).values():
            other = value.__name__ if isinstance(value, ModuleType) else None
            other = other or getattr(value, "__module__", None)
            if isinstance(other, str) and other.partition(".")[0] == package:
                todo.append(other)
    stamp = hashlib.sha256()
    for name in sorted(found):
        path = getattr(sys.modules[name], "__file__", None)
        if path is not None and os.path.exists(path):
            with open(path, "rb") as file:
                stamp.update(file.read())
    return stamp.hexdigest()


def kernel(function: Any) -> Any:
    """Compile `function` for calls from Python: cached on disk, free of the interpreter's lock."""
    return numba.njit(cache=True, nogil=True, boundscheck=False, error_model="numpy")(function)


def _load(typingctx: Any, slab: Any, row: Any, lane: Any, kind: Any) -> Any:
    """Return quantities `row`, `row` + 1, ... of car `lane` as a `kind`, a NamedTuple class."""
    cls = kind.instance_class
    size = len(cls._fields)
    made = types.NamedUniTuple(slab.dtype, size, cls)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = _address(context, builder, signature, args)
        values = [
            builder.load(builder.gep(first, [context.get_constant(types.intp, i * LANES)]))
            for i in range(size)
        ]
        return context.make_tuple(builder, signature.return_type, values)

    return made(slab, row, lane, kind), codegen


def _store(typingctx: Any, slab: Any, row: Any, lane: Any, values: Any) -> Any:
    """Write a tuple into quantities `row`, `row` + 1, ... of car `lane`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = _address(context, builder, signature, args)
        for i in range(len(values)):
            value = context.cast(
                builder, builder.extract_value(args[3], i), values.types[i], slab.dtype
            )
            builder.store(value, builder.gep(first, [context.get_constant(types.intp, i * LANES)]))
        return context.get_dummy_value()

    return types.void(slab, row, lane, values), codegen


def _address(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Return the pointer to quantity `row` of car `lane`, without a check of the bounds."""
    slab, row, lane = (
        context.make_array(signature.args[0])(context, builder, args[0]),
        context.cast(builder, args[1], signature.args[1], types.intp),
        context.cast(builder, args[2], signature.args[2], types.intp),
    )
    offset = builder.mul(row, context.get_constant(types.intp, LANES))
    return builder.gep(builder.gep(slab.data, [lane]), [offset])


load: Any = intrinsic(prefer_literal=True)(_load)
store: Any = intrinsic(prefer_literal=True)(_store)


def slabs(rows: Array) -> Array:
    """Lay quantities of cars out for kernels.

    Parameters
    ----------
    rows : ndarray (rows, n)
        One quantity a row.

    Returns
    -------
    ndarray (blocks, rows * LANES)
        The last block is filled up with zeros.
    """
    count, n = rows.shape
    blocks = -(-n // LANES)
    whole = np.zeros((count, blocks * LANES))
    whole[:, :n] = rows
    parts = whole.reshape(count, blocks, LANES).transpose(1, 0, 2)
    return np.ascontiguousarray(parts).reshape(blocks, count * LANES)


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


# Closed loop in continuous time ---------------------------------------------------------------

PLANT = 0  # State
FILTER = 4  # Filter
ROAD = 8  # Phasor
FORCE = 10  # Phasor
BY_ROAD = 12  # Phasor of the angle turned in half a step
BY_FORCE = 14  # Phasor of the angle turned in half a step
CAR = 16  # Coefficients
AMPLITUDES = 25  # Amplitudes
LIMITS = 28  # Limits
PIECES = 30  # RoadPieces
KINK = 36  # index of the road's next kink [-]
OMEGA = 37  # frequency of the external force [rad/s]
WINDOW = 38  # first step that is measured [-]
PEAKS = 39  # largest |x1|, |x2|, |u1|, |u2| measured
SQUARES = 43  # sum of u1^2 and u2^2 measured
COMMAND = 45  # u1, u2 at the last step that was measured or recorded
GAINS = 47  # gains of the law, at most MOST_GAINS
MOST_GAINS = 8
ROWS = GAINS + MOST_GAINS


def forced_step(
    rate: Any, advance: Any, x: Any, world: Any, by: Any, amplitudes: Any, step: Any, *args: Any
) -> tuple[Any, World]:
    """Advance ``x' = rate(x, forcing, *args)`` and the world by one RK4 step.

    Parameters
    ----------
    rate, advance : callable
        As in `qcar_env.physics.rk4.rk4_step`.
    x : tuple
        State at the beginning of the step.
    world : World
        Phasors of road and force then.
    by : World
        Sines and cosines of the angles turned in half a step.
    amplitudes : Amplitudes
        Amplitudes of road and force.
    step : Step
        Step size and fractions [s].
    *args
        Passed on to `rate`.

    Returns
    -------
    tuple
        State and world at the end of the step.
    """
    middle = turn_world(world, by)
    end = turn_world(middle, by)
    w_start = forcing.forcing(world, amplitudes)
    w_middle = forcing.forcing(middle, amplitudes)
    w_end = forcing.forcing(end, amplitudes)
    return rk4_step(rate, advance, x, step, w_start, w_middle, w_end, *args), end


def forced_step_over_kinks(
    rate: Any,
    advance: Any,
    x: Any,
    world: Any,
    kink: Any,
    t: Any,
    t_end: Any,
    road: Any,
    Omega: Any,
    amplitudes: Any,
    *args: Any,
) -> tuple[Any, World, Any]:
    """Advance one car from `t` to `t_end` [s], cut at the kinks of its road (see `forced_step`).

    Parameters
    ----------
    kink : int
        Index of the road's next kink.
    road : RoadPieces
        The road.
    Omega : float
        Frequency of the external force [rad/s].

    Returns
    -------
    tuple
        State, world and index of the next kink at `t_end`; a kink then is left to the next step.
    """
    while t < t_end:
        time = kink_time(kink, road)
        stop = min(time, t_end)
        if stop > t:
            size = stop - t
            by = half_step_angles(road.omega, Omega, size)
            x, world = forced_step(
                rate, advance, x, world, by, amplitudes, step_fractions(size), *args
            )
        if time < t_end:
            world = World(piece_phasor(kink, road), world.force)
            kink += 1
        t = stop
    return x, world, kink


compiled(forced_step)
compiled(forced_step_over_kinks)


@cache
def closed_loop_kernel(
    command: Any, filter_rate: Any, kind: type, saturated: bool
) -> Callable[..., None]:
    """Return the compiled closed loop of one law.

    Parameters
    ----------
    command, filter_rate : callable
        The law's functions; `filter_rate` is None for a law without memory.
    kind : type
        NamedTuple class of its gains.
    saturated : bool
        Whether the actuators have limits.

    Returns
    -------
    callable
        ``run(slabs, begin, end, n, step, steps, every, record)`` integrates the blocks from
        `begin` to `end` of `slabs`, in place, over `steps` steps. `n` is the number of cars in
        all blocks, `step` a `Step`. Where `every` is positive it writes
        ``(x1, x2, v1, v2, u1, u2)`` at each `every`-th step into `record` (records, 6, n).
    """
    sources = source_stamp(command, *([] if filter_rate is None else [filter_rate]))
    remembers = filter_rate is not None
    compiled(command)
    filtering = compiled(filter_rate) if remembers else no_filter
    closing = saturated_rate if saturated else unlimited_rate

    @kernel
    def run(
        slabs: Any, begin: Any, end: Any, n: Any, step: Any, steps: Any, every: Any, record: Any
    ) -> None:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        saved = np.empty((ROAD + 4, LANES))
        for block in range(begin, end):
            z = slabs[block]
            first = block * LANES
            lanes = min(LANES, n - first)
            measured = NEVER
            for j in range(lanes):
                measured = min(measured, np.int64(z[WINDOW * LANES + j]))
            event = _next_kink_step(z, lanes, step.full)
            for k in range(steps + 1):
                recorded = every > 0 and k % every == 0
                if recorded or k >= measured:
                    for j in range(lanes):
                        plant = load(z, PLANT, j, State)
                        eta = load(z, FILTER, j, Filter)
                        u1, u2 = command(plant, eta, load(z, GAINS, j, kind))
                        if saturated:
                            limits = load(z, LIMITS, j, Limits)
                            u1, u2 = saturate(u1, limits.u1), saturate(u2, limits.u2)
                        store(z, COMMAND, j, (u1, u2))
                    for j in range(lanes):
                        now = np.float64(k >= z[WINDOW * LANES + j])
                        x1, x2, _, _ = load(z, PLANT, j, State)
                        u1, u2 = load(z, COMMAND, j, Limits)
                        p1, p2, q1, q2 = load(z, PEAKS, j, State)
                        store(
                            z,
                            PEAKS,
                            j,
                            (
                                max(p1, abs(now * x1)),
                                max(p2, abs(now * x2)),
                                max(q1, abs(now * u1)),
                                max(q2, abs(now * u2)),
                            ),
                        )
                        s1, s2 = load(z, SQUARES, j, Limits)
                        store(z, SQUARES, j, (s1 + now * u1 * u1, s2 + now * u2 * u2))
                if recorded:
                    for i in range(6):
                        row = (PLANT + i if i < 4 else COMMAND + i - 4) * LANES
                        for j in range(lanes):
                            record[k // every, i, first + j] = z[row + j]
                if k == steps:
                    break
                if k % RESEED == 0:
                    _reseed(z, lanes, k * step.full)
                if k == event:
                    for i in range(ROAD + 4):
                        for j in range(lanes):
                            saved[i, j] = z[i * LANES + j]
                for j in range(lanes):
                    plant = load(z, PLANT, j, State)
                    eta = load(z, FILTER, j, Filter) if remembers else REST
                    world = World(load(z, ROAD, j, Phasor), load(z, FORCE, j, Phasor))
                    by = World(load(z, BY_ROAD, j, Phasor), load(z, BY_FORCE, j, Phasor))
                    amplitudes = load(z, AMPLITUDES, j, Amplitudes)
                    gains = load(z, GAINS, j, kind)
                    car = load(z, CAR, j, Coefficients)
                    x, world = forced_step(
                        closing,
                        advance_controlled,
                        ControlledState(plant, eta),
                        world,
                        by,
                        amplitudes,
                        step,
                        command,
                        filtering,
                        gains,
                        load(z, LIMITS, j, Limits),
                        car,
                    )
                    store(z, PLANT, j, x.plant)
                    if remembers:
                        store(z, FILTER, j, x.filter)
                    store(z, ROAD, j, world.road)
                    store(z, FORCE, j, world.force)
                if k == event:
                    for j in range(lanes):
                        road = load(z, PIECES, j, RoadPieces)
                        kink = np.int64(z[KINK * LANES + j])
                        if _kink_step(kink, road, step.full) != k:
                            continue
                        for i in range(ROAD + 4):
                            z[i * LANES + j] = saved[i, j]
                        plant = load(z, PLANT, j, State)
                        eta = load(z, FILTER, j, Filter) if remembers else REST
                        x, world, kink = forced_step_over_kinks(
                            closing,
                            advance_controlled,
                            ControlledState(plant, eta),
                            World(load(z, ROAD, j, Phasor), load(z, FORCE, j, Phasor)),
                            kink,
                            k * step.full,
                            (k + 1) * step.full,
                            road,
                            z[OMEGA * LANES + j],
                            load(z, AMPLITUDES, j, Amplitudes),
                            command,
                            filtering,
                            load(z, GAINS, j, kind),
                            load(z, LIMITS, j, Limits),
                            load(z, CAR, j, Coefficients),
                        )
                        store(z, PLANT, j, x.plant)
                        store(z, FILTER, j, x.filter)
                        store(z, ROAD, j, world.road)
                        store(z, FORCE, j, world.force)
                        z[KINK * LANES + j] = kink
                    event = _next_kink_step(z, lanes, step.full)

    return run


def _kink_step(kink: int, road: Any, step: float) -> int:
    """Return the number of the step that holds a kink: ``k step <= time < (k + 1) step``."""
    time = kink_time(kink, road)
    if not time < 1e15 * step:
        return NEVER
    k = int(time / step)
    while k * step > time:
        k -= 1
    while (k + 1) * step <= time:
        k += 1
    return k


@register_jitable
def _next_kink_step(z: Any, lanes: int, step: float) -> int:
    """Return the number of the next step in which some car of the block meets a kink."""
    event = NEVER
    for j in range(lanes):
        kink = np.int64(z[KINK * LANES + j])
        event = min(event, _kink_step(kink, load(z, PIECES, j, RoadPieces), step))
    return event


@register_jitable
def _reseed(z: Any, lanes: int, t: float) -> None:
    """Set the phasors of the force and of endless roads to their values at `t` [s]."""
    for j in range(lanes):
        road = load(z, PIECES, j, RoadPieces)
        store(z, FORCE, j, motion.angle(z[OMEGA * LANES + j] * t))
        if road.count == 0.0:
            store(z, ROAD, j, motion.angle(road.omega * t))


compiled(_kink_step)
