"""Closed loops that are timed in one compiled call, beside the processor's peak."""

from __future__ import annotations

from typing import Any

import numpy as np

from qcar_env.control import CNVC, Passive
from qcar_env.evaluation.throughput.timing import Candidate, shared_out
from qcar_env.physics import engine, engine_continuous
from qcar_env.physics.motion import plant, world_at
from qcar_env.physics.rk4 import step_fractions
from qcar_env.scenarios import scenario as find_scenario

LENGTHS = (250, 500, 1000, 2000, 4000)  # [intervals] of closed loops
OPERATIONS = 144  # of an RK4 step of the plant, see `count_operations` in the tests


def _rollout(
    name: str,
    law: Any,
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
    one = plant(scenario.car, scenario.road, scenario.force, step)
    world = world_at(0.0, scenario.road, scenario.force)
    column = [0.0] * 8 + [*world.road, *world.force, *one.passage.by.road]
    column += [*one.passage.by.force, *one.passage.middle, *one.car]
    column += [*one.amplitudes, *scenario.actuator.limit, *one.road, 0.0, one.Omega]
    rows = np.zeros((engine_continuous.ROWS, cars))
    rows[: engine_continuous.WINDOW] = np.array(column)[:, np.newaxis]
    rows[engine_continuous.WINDOW] = engine.NEVER
    gains = np.array(law.gains)[:, np.newaxis]
    rows[engine_continuous.GAINS : engine_continuous.GAINS + len(gains)] = gains
    slabs, record = engine.slabs(rows), np.empty((0, 6, cars))
    kernel = engine_continuous.closed_loop_kernel(
        law.command, law.filter_rate, type(law.gains), False, held, fused
    )
    fractions = step_fractions(step)
    edges = [slabs.shape[0] * i // threads for i in range(threads + 1)]

    def part(i: int) -> None:
        kernel(slabs, edges[i], edges[i + 1], cars, fractions, steps, scenario.substeps, 0, record)

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
    cores = engine.cores()
    found = [
        _rollout("rollout, held", CNVC(), held=True),
        _rollout("rollout, held, fused", CNVC(), held=True, fused=True),
        _rollout("rollout, in every stage", CNVC(), held=False),
        _rollout("rollout, in every stage, fused", CNVC(), held=False, fused=True),
        _rollout("rollout, no control", Passive(), held=False),
    ]
    if cores > 1:
        name = f"rollout, held, fused, {cores} threads"
        found.append(_rollout(name, CNVC(), held=True, fused=True, threads=cores))
    # what a control interval would take if the processor did nothing but multiply and add
    repeats = 10_000  # some milliseconds: a call of a tenth of one spends 8 % on its array
    flops = 2 * engine.PEAK_LENGTH * engine.PEAK_WIDTH * repeats
    steps = max(1, flops // (OPERATIONS * scenario.substeps))

    def peak(calls: int) -> None:
        for _ in range(calls):
            engine.multiply_add(repeats)

    found.append(Candidate(name="multiply-add peak", run=peak, steps=steps))
    if cores > 1:
        found.append(
            shared_out(
                f"multiply-add peak, {cores} threads",
                lambda _: engine.multiply_add(repeats),
                cores,
                steps=cores * steps,
            )
        )
    return found
