"""Closed loops that are timed in one compiled call, beside the processor's peak."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from qcar_env.control import CNVC, Passive
from qcar_env.control.law import Law
from qcar_env.engine.closed_loop import cores, drive, slabs
from qcar_env.engine.compile import aligned, widen
from qcar_env.engine.course import road_functions
from qcar_env.engine.loop_kernels import Composition, compose, loop_road
from qcar_env.engine.starts import Force
from qcar_env.evaluation.throughput.timing import Candidate, shared_out
from qcar_env.physics.car import REST
from qcar_env.physics.closed_loop import ControlledState, Limits
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.tree import flat
from qcar_env.scenarios import scenario as find_scenario

LENGTHS = (250, 500, 1000, 2000, 4000)  # [intervals] of closed loops
PEAK_WIDTH = 512  # numbers that `multiply_add` works on, in the first-level cache
PEAK_LENGTH = 16  # multiply-adds of each number in one pass, unrolled
REPEATS = 10_000  # passes of a call, some milliseconds: one of a tenth spends 8 % on its array
OPERATIONS = 138  # of an RK4 step of the plant, see `count_operations` in the tests


def _rollout(
    name: str,
    law: Law,
    *,
    held: bool,
    fused: bool = False,
    threads: int = 1,
    intervals: int = 1000,
    cars: int = 1024,
) -> Candidate:
    """Close the loops of many cars in one compiled call."""
    scenario = find_scenario("paper")
    steps, step = intervals * scenario.substeps, scenario.dt / scenario.substeps
    car, force = scenario.car, Force(scenario.force.f, scenario.force.Omega)
    road = road_functions(type(scenario.road))
    numbers = car.numbers, scenario.road.numbers, scenario.speed, force
    driven = drive(car.functions, road, numbers, scenario.road.table, step)
    limits = Limits(*scenario.actuator.limit)
    like = driven.under(law.numbers, limits)
    what = Composition(car.functions, loop_road(road), law.functions, like)
    layout, kernel = compose(what, held, fused)
    state = ControlledState(REST, law.at_rest)
    column = (*flat(state), *driven.rows, *flat(law.numbers), *limits)
    rows = np.zeros((layout.size, cars))
    rows[: len(column)] = np.array(column)[:, np.newaxis]
    blocks, record = slabs(rows), np.empty((0, 6, cars))
    hold = scenario.substeps if held else 1
    table, bounds = np.zeros(0), np.zeros((cars, 2), np.int64)
    fractions = step_fractions(step)
    edges = [blocks.shape[0] * i // threads for i in range(threads + 1)]

    def part(i: int) -> None:
        begin, end = edges[i], edges[i + 1]
        kernel(blocks, begin, end, cars, fractions, steps, hold, 0, table, bounds, record)

    return shared_out(name, part, threads, steps=cars * intervals)


def lengths() -> list[Candidate]:
    """Cost against the length of a closed loop, with everything else as it is."""
    return [
        _rollout(f"rollout of {k} intervals", CNVC(), held=True, intervals=k, cars=64)
        for k in LENGTHS
    ]


def rollouts() -> list[Candidate]:
    """Close loops in one compiled call; beside them the processor's peak."""
    scenario = find_scenario("paper")
    many = cores()
    found = [
        _rollout("rollout, held", CNVC(), held=True),
        _rollout("rollout, held, fused", CNVC(), held=True, fused=True),
        _rollout("rollout, in every stage", CNVC(), held=False),
        _rollout("rollout, in every stage, fused", CNVC(), held=False, fused=True),
        _rollout("rollout, no control", Passive(), held=False),
    ]
    if many > 1:
        name = f"rollout, held, fused, {many} threads"
        found.append(_rollout(name, CNVC(), held=True, fused=True, threads=many))
    found.append(peak("multiply-add peak", scenario.substeps))
    if many > 1:
        name = f"multiply-add peak, {many} threads"
        steps = many * found[-1].steps
        found.append(shared_out(name, lambda _: multiply_add(REPEATS), many, steps=steps))
    return found


def peak(name: str, substeps: int, *, single: bool = False) -> Candidate:
    """Return what a control interval takes if the processor does nothing but multiply and add.

    The operations are those of the plant's Runge-Kutta steps alone: observation, reward, ends and
    new episodes come on top, and what they take is not the peak's.
    """
    flops = 2 * PEAK_LENGTH * PEAK_WIDTH * REPEATS

    def run(calls: int) -> None:
        for _ in range(calls):
            multiply_add(REPEATS, single=single)

    return Candidate(name=name, run=run, steps=max(1, flops // (OPERATIONS * substeps)))


def multiply_add(repeats: int, *, single: bool = False) -> float:
    """Multiply and add, and do nothing else: the yardstick of the other kernels.

    Each of the `repeats` passes has ``PEAK_WIDTH * PEAK_LENGTH`` fused multiply-adds in double
    or single precision. Nobody needs the number that is returned; without it the work would be
    left out.
    """
    real = np.float32 if single else np.float64
    return _multiply_add(aligned((PEAK_WIDTH,), real), real(0.999999), real(1e-6), repeats)


@numba.njit(cache=True, nogil=True, boundscheck=False, fastmath={"contract"})
def _multiply_add(x: Any, a: Any, b: Any, repeats: Any) -> Any:
    widen()
    for _ in range(repeats):
        for j in range(PEAK_WIDTH):
            y = x[j]
            for _ in range(PEAK_LENGTH):
                y = y * a + b
            x[j] = y
    return x[0]
