"""Closed loops, compiled: a law that acts inside the Runge-Kutta stages, or is sampled and held.

Blocks of cars as in `qcar_env.physics.engine`.
"""

# pyright: basic, reportArgumentType=false
# numba has no types for what it compiles.

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from qcar_env.physics.closed_loop import (
    REST,
    ControlledState,
    Limits,
    add_controlled,
    advance_controlled,
    held_rate,
    no_filter,
    saturate,
    saturated_rate,
    unlimited_rate,
)
from qcar_env.physics.dynamics import Coefficients
from qcar_env.physics.engine import (
    LANES,
    NEVER,
    align_stack,
    compiled,
    fused_kernel,
    kernel,
    load,
    load_passage,
    load_world,
    source_stamp,
    store,
    store_world,
)
from qcar_env.physics.forcing import Amplitudes, World, passage_of
from qcar_env.physics.motion import angle, forced_step, half_step_angles, piece_phasor
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.roads import RoadPieces, kink_time
from qcar_env.physics.state import Filter, State

RESEED = 1024  # [steps] after which turned phasors are computed anew: they stay within 1e-12

# Rows of the slab.
PLANT = 0  # State
FILTER = 4  # Filter
ROAD = 8  # World: Phasor of the road
FORCE = 10  # and of the force
PASSAGE = 12  # Passage
CAR = 20  # Coefficients
AMPLITUDES = 29  # Amplitudes
LIMITS = 32  # Limits
PIECES = 34  # RoadPieces
KINK = 40  # index of the road's next kink [-]
OMEGA = 41  # frequency of the external force [rad/s]
WINDOW = 42  # first step that is measured [-]
PEAKS = 43  # largest |x1|, |x2|, |u1|, |u2| measured
SQUARES = 47  # sum of u1^2 and u2^2 measured
COMMAND = 49  # u1, u2 at the last step that was measured or recorded
GAINS = 51  # gains of the law, at most MOST_GAINS
MOST_GAINS = 8
ROWS = GAINS + MOST_GAINS


def forced_step_over_kinks(
    rate: Any,
    advance: Any,
    add: Any,
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
            passage = passage_of(half_step_angles(road.omega, Omega, size), amplitudes)
            x, world = forced_step(
                rate, advance, add, x, world, passage, amplitudes, step_fractions(size), *args
            )
        if time < t_end:
            world = World(piece_phasor(kink, road), world.force)
            kink += 1
        t = stop
    return x, world, kink


compiled(forced_step_over_kinks)


@cache
def closed_loop_kernel(
    command: Any,
    filter_rate: Any,
    kind: type,
    saturated: bool,
    held: bool = False,
    fused: bool = False,
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
    held : bool
        Whether the forces are held between samples of the law, instead of following it.
    fused : bool
        Whether products and sums may be fused (see `qcar_env.physics.engine.fused_kernel`).

    Returns
    -------
    callable
        ``run(slabs, begin, end, n, step, steps, hold, every, record)`` integrates the blocks from
        `begin` to `end` of `slabs`, in place, over `steps` steps. `n` is the number of cars in
        all blocks, `step` a `Step`, `hold` the number of steps between samples. Where `every` is
        positive it writes ``(x1, x2, v1, v2, u1, u2)`` at each `every`-th step into `record`
        (records, 6, n).
    """
    sources = source_stamp(command, *([] if filter_rate is None else [filter_rate])), fused
    remembers = filter_rate is not None
    compiled(command)
    filtering = compiled(filter_rate) if remembers else no_filter
    follows = saturated_rate if saturated else unlimited_rate
    closing = held_rate if held else follows
    BOUND = COMMAND if held else LIMITS

    @(fused_kernel if fused else kernel)
    def run(
        slabs: Any,
        begin: Any,
        end: Any,
        n: Any,
        step: Any,
        steps: Any,
        hold: Any,
        every: Any,
        record: Any,
    ) -> None:
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        align_stack()
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
                if (held and k % hold == 0) or (not held and (recorded or k >= measured)):
                    for j in range(lanes):
                        plant = load(z, LANES, PLANT, j, State)
                        eta = load(z, LANES, FILTER, j, Filter)
                        u1, u2 = command(plant, eta, load(z, LANES, GAINS, j, kind))
                        if saturated:
                            limits = load(z, LANES, LIMITS, j, Limits)
                            u1, u2 = saturate(u1, limits.u1), saturate(u2, limits.u2)
                        store(z, LANES, COMMAND, j, (u1, u2))
                if recorded or k >= measured:
                    for j in range(lanes):
                        now = np.float64(k >= z[WINDOW * LANES + j])
                        x1, x2, _, _ = load(z, LANES, PLANT, j, State)
                        u1, u2 = load(z, LANES, COMMAND, j, Limits)
                        p1, p2, q1, q2 = load(z, LANES, PEAKS, j, State)
                        store(
                            z,
                            LANES,
                            PEAKS,
                            j,
                            (
                                max(p1, abs(now * x1)),
                                max(p2, abs(now * x2)),
                                max(q1, abs(now * u1)),
                                max(q2, abs(now * u2)),
                            ),
                        )
                        s1, s2 = load(z, LANES, SQUARES, j, Limits)
                        store(z, LANES, SQUARES, j, (s1 + now * u1 * u1, s2 + now * u2 * u2))
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
                    plant = load(z, LANES, PLANT, j, State)
                    eta = load(z, LANES, FILTER, j, Filter) if remembers else REST
                    world = load_world(z, LANES, ROAD, j)
                    passage = load_passage(z, LANES, PASSAGE, j)
                    amplitudes = load(z, LANES, AMPLITUDES, j, Amplitudes)
                    gains = load(z, LANES, GAINS, j, kind)
                    car = load(z, LANES, CAR, j, Coefficients)
                    x, world = forced_step(
                        closing,
                        advance_controlled,
                        add_controlled,
                        ControlledState(plant, eta),
                        world,
                        passage,
                        amplitudes,
                        step,
                        command,
                        filtering,
                        gains,
                        load(z, LANES, BOUND, j, Limits),
                        car,
                    )
                    store(z, LANES, PLANT, j, x.plant)
                    if remembers:
                        store(z, LANES, FILTER, j, x.filter)
                    store_world(z, LANES, ROAD, j, world)
                if k == event:
                    for j in range(lanes):
                        road = load(z, LANES, PIECES, j, RoadPieces)
                        kink = np.int64(z[KINK * LANES + j])
                        if _kink_step(kink, road, step.full) != k:
                            continue
                        for i in range(ROAD + 4):
                            z[i * LANES + j] = saved[i, j]
                        plant = load(z, LANES, PLANT, j, State)
                        eta = load(z, LANES, FILTER, j, Filter) if remembers else REST
                        x, world, kink = forced_step_over_kinks(
                            closing,
                            advance_controlled,
                            add_controlled,
                            ControlledState(plant, eta),
                            load_world(z, LANES, ROAD, j),
                            kink,
                            k * step.full,
                            (k + 1) * step.full,
                            road,
                            z[OMEGA * LANES + j],
                            load(z, LANES, AMPLITUDES, j, Amplitudes),
                            command,
                            filtering,
                            load(z, LANES, GAINS, j, kind),
                            load(z, LANES, BOUND, j, Limits),
                            load(z, LANES, CAR, j, Coefficients),
                        )
                        store(z, LANES, PLANT, j, x.plant)
                        store(z, LANES, FILTER, j, x.filter)
                        store_world(z, LANES, ROAD, j, world)
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


def _next_kink_step(z: Any, lanes: int, step: float) -> int:
    """Return the number of the next step in which some car of the block meets a kink."""
    event = NEVER
    for j in range(lanes):
        kink = np.int64(z[KINK * LANES + j])
        event = min(event, _kink_step(kink, load(z, LANES, PIECES, j, RoadPieces), step))
    return event


def _reseed(z: Any, lanes: int, t: float) -> None:
    """Set the phasors of the force and of endless roads to their values at `t` [s]."""
    for j in range(lanes):
        road = load(z, LANES, PIECES, j, RoadPieces)
        store(z, LANES, FORCE, j, angle(z[OMEGA * LANES + j] * t))
        if road.count == 0.0:
            store(z, LANES, ROAD, j, angle(road.omega * t))


compiled(_kink_step)
compiled(_next_kink_step)
compiled(_reseed)
