"""Motion of one car over an interval: RK4 steps of the plant while road and force turn.

A step never crosses a kink of the road: an interval that holds one is cut there, and each part is
integrated with the same number of steps as a whole interval.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from qcar_env.physics.car import QuarterCar
from qcar_env.physics.dynamics import Coefficients, rate
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.forcing import (
    Amplitudes,
    Passage,
    World,
    amplitudes_of,
    forcing,
    forcing_in_the_middle,
    passage_of,
    turn_world,
)
from qcar_env.physics.rk4 import Step, rk4_step, step_fractions
from qcar_env.physics.roads import Phasor, Road, RoadPieces, kink_time
from qcar_env.physics.state import State, add, advance


class Plant(NamedTuple):
    """What the motion of one car needs, as plain entries for compiled code."""

    car: Coefficients
    amplitudes: Amplitudes
    road: RoadPieces
    Omega: Any  # frequency of the external force [rad/s]
    passage: Passage
    step: Step


def plant(car: QuarterCar, road: Road, force: ExternalForce, step: float) -> Plant:
    """Collect car, road and force for integration with `step` [s]."""
    pieces, Omega = road.pieces, float(force.Omega)
    amplitudes = amplitudes_of(float(road.h), pieces.omega, float(force.f), car.coefficients)
    return Plant(
        car=car.coefficients,
        amplitudes=amplitudes,
        road=pieces,
        Omega=Omega,
        passage=passage_of(half_step_angles(pieces.omega, Omega, step), amplitudes),
        step=step_fractions(step),
    )


def half_step_angles(omega: float, Omega: float, step: float) -> World:
    """Return sines and cosines of what road and force turn in ``step / 2`` [s]."""
    return World(angle(omega * (step / 2)), angle(Omega * (step / 2)))


def angle(radians: float) -> Phasor:
    """Return the phasor at `radians`."""
    return Phasor(math.sin(radians), math.cos(radians))


def world_at(t: float, road: Road, force: ExternalForce) -> World:
    """Return the phasors of road and force at `t` [s]."""
    at_road = road.phasor(t)
    at_force = force.phasor(t)
    return World(
        Phasor(float(at_road.s), float(at_road.c)), Phasor(float(at_force.s), float(at_force.c))
    )


def forced_step(
    rate: Any,
    advance: Any,
    add: Any,
    x: Any,
    world: Any,
    passage: Any,
    amplitudes: Any,
    step: Any,
    *args: Any,
) -> tuple[Any, World]:
    """Advance ``x' = rate(x, forcing, *args)`` and the world by one RK4 step.

    Parameters
    ----------
    rate, advance, add : callable
        As in `qcar_env.physics.rk4.rk4_step`.
    x : tuple
        State at the beginning of the step.
    world : World
        Phasors of road and force then.
    passage : Passage
        What becomes of the phasors in the step.
    amplitudes : Amplitudes
        Amplitudes of the forcing.
    step : Step
        Step size and fractions [s].
    *args
        Passed on to `rate`.

    Returns
    -------
    tuple
        State and world at the end of the step.
    """
    w_start = forcing(world, amplitudes)
    w_middle = forcing_in_the_middle(world, passage.middle)
    end = turn_world(world, passage.by)
    w_end = forcing(end, amplitudes)
    return rk4_step(rate, advance, add, x, step, w_start, w_middle, w_end, *args), end


def substep(
    x: Any, world: Any, passage: Any, amplitudes: Any, step: Any, u1: Any, u2: Any, car: Any
) -> tuple[State, World]:
    """Advance plant and world by one RK4 step under held actuator forces.

    Parameters
    ----------
    x : State
        State of the plant, entries float or array (n,).
    world : World
        Phasors of road and force at the beginning of the step.
    passage : Passage
        What becomes of the phasors in the step.
    amplitudes : Amplitudes
        Amplitudes of the forcing.
    step : Step
        Step size and fractions [s].
    u1, u2 : float or array (n,)
        Specific actuator forces [m/s^2].
    car : Coefficients
        The car.

    Returns
    -------
    tuple
        State and world at the end of the step.
    """
    return forced_step(rate, advance, add, x, world, passage, amplitudes, step, u1, u2, car)


def four_substeps(
    x: Any, world: Any, passage: Any, amplitudes: Any, step: Any, u1: Any, u2: Any, car: Any
) -> tuple[State, World]:
    """Advance plant and world by four RK4 steps (see `substep`), written out.

    A compiler then keeps state and car at hand from one step to the next, and takes the forcing at
    the end of one for that at the beginning of the next.
    """
    x, world = substep(x, world, passage, amplitudes, step, u1, u2, car)
    x, world = substep(x, world, passage, amplitudes, step, u1, u2, car)
    x, world = substep(x, world, passage, amplitudes, step, u1, u2, car)
    return substep(x, world, passage, amplitudes, step, u1, u2, car)


def interval(
    x: Any, world: Any, kink: int, t: float, dt: float, substeps: int, u1: Any, u2: Any, plant: Any
) -> tuple[State, World, int]:
    """Advance one car over the control interval ``[t, t + dt]`` under held forces.

    Parameters
    ----------
    x, world : State, World
        Plant and phasors at `t`.
    kink : int
        Index of the next kink of the road.
    t, dt : float
        Beginning and length of the interval [s].
    substeps : int
        RK4 steps in an interval, and in each part of one that a kink cuts.
    u1, u2 : float
        Specific actuator forces [m/s^2].
    plant : Plant
        Car, road and force; its step is ``dt / substeps``.

    Returns
    -------
    x, world, kink
        The same at ``t + dt``.
    """
    end = t + dt
    time = kink_time(kink, plant.road)
    if time >= end:
        for _ in range(substeps):
            x, world = substep(
                x, world, plant.passage, plant.amplitudes, plant.step, u1, u2, plant.car
            )
        return x, world, kink
    while time < end:
        x, world = part(x, world, time - t, substeps, u1, u2, plant)
        world = World(piece_phasor(kink, plant.road), world.force)
        t = time
        kink += 1
        time = kink_time(kink, plant.road)
    x, world = part(x, world, end - t, substeps, u1, u2, plant)
    return x, world, kink


def piece_phasor(kink: int, road: Any) -> Phasor:
    """Return the phasor with which the piece after kink `kink` begins.

    A hump begins at its foot, rising: (0, 1); a step at its top: (1, 0); a flat road rests.
    """
    if kink % 2 == 1:
        return Phasor(0.0, 0.0)
    if road.omega > 0.0:
        return Phasor(0.0, 1.0)
    return Phasor(1.0, 0.0)


def part(
    x: Any, world: Any, duration: float, substeps: int, u1: Any, u2: Any, plant: Any
) -> tuple[State, World]:
    """Advance one car over a time without a kink, shorter than an interval (see `interval`)."""
    if duration <= 0.0:
        return x, world
    size = duration / substeps
    half = half_step_angles(plant.road.omega, plant.Omega, size)
    passage = passage_of(half, plant.amplitudes)
    step = step_fractions(size)
    for _ in range(substeps):
        x, world = substep(x, world, passage, plant.amplitudes, step, u1, u2, plant.car)
    return x, world
