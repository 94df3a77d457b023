"""Motion over a time without a kink: Runge-Kutta steps of a plant while the road passes under it.

A road reaches the plant in one of two ways. One whose pieces are sines turns a phasor: what a step
needs of it, at its ends and in its middle, is a weighted sum of the phasor's entries, and no sine
is evaluated. Any other is asked for height and slope at the stage times. The external force on the
body always turns a phasor. A phasor turned by a constant angle a thousand times is off by 4e-13.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from qcar_env.physics.rk4 import rk4_step
from qcar_env.physics.tree import combine


class Phasor(NamedTuple):
    """Sine and cosine of an angle that turns at a constant rate; ``(0, 0)`` is a road at rest."""

    s: Any  # sine [-]
    c: Any  # cosine [-]


class Phasors(NamedTuple):
    """Of the road's piece, (0, 0) where it is flat, and of the external force."""

    road: Any
    force: Any


class Input(NamedTuple):
    """What the outside does to a car at one instant."""

    road: Any  # what the car takes of the road, see `qcar_env.physics.car.CarFunctions`
    F: Any  # external specific force on the body [m/s^2]


class Turning(NamedTuple):
    """What phasors are multiplied with, and turned by, in a step of constant length."""

    road_s: Any  # road's part of the input at the phasor's own instant
    road_c: Any
    F: Any
    middle_s: Any  # the same half a step later
    middle_c: Any
    F_s: Any
    F_c: Any
    by: Phasors  # sines and cosines of the angles turned in the step


def angle(radians: float) -> Phasor:
    """Return the phasor at `radians`."""
    return Phasor(math.sin(radians), math.cos(radians))


def turn(phasor: Any, by: Any) -> Phasor:
    """Return `phasor` turned by the angle whose sine and cosine are `by`."""
    return Phasor(
        phasor.s * by.c + phasor.c * by.s,
        phasor.c * by.c - phasor.s * by.s,
    )


def turn_both(phasors: Any, by: Any) -> Phasors:
    """Return the phasors of road and force, each turned by its own angle."""
    return Phasors(turn(phasors.road, by.road), turn(phasors.force, by.force))


def turning(road_s: Any, road_c: Any, f: Any, omega: Any, Omega: Any, step: Any) -> Turning:
    """Prepare the steps of length `step` [s].

    Parameters
    ----------
    road_s, road_c : tuple
        What the car takes of a road of height h, and of one of rate h omega.
    f : float
        Amplitude of the external force [m/s^2].
    omega, Omega : float
        Frequencies of road and force [rad/s].
    step : float
        Step [s].
    """
    half = Phasors(angle(omega * (step / 2)), angle(Omega * (step / 2)))
    road, force = half
    return Turning(
        road_s,
        road_c,
        f,
        combine(road_s, road.c, road_c, -road.s),
        combine(road_s, road.s, road_c, road.c),
        -f * force.s,
        f * force.c,
        turn_both(half, half),
    )


def turning_step(
    rate: Any, x: Any, phasors: Any, turning: Any, step: Any, *args: Any
) -> tuple[Any, Phasors]:
    """Advance ``x' = rate(x, input, *args)`` and the phasors by one RK4 step.

    Parameters
    ----------
    rate : callable
        Right-hand side.
    x : tuple
        State at the beginning of the step.
    phasors : Phasors
        Of road and force then.
    turning : Turning
        What becomes of them in the step.
    step : Step
        Step size and fractions [s].
    *args
        Passed on to `rate`.

    Returns
    -------
    tuple
        State and phasors at the end of the step.
    """
    end = turn_both(phasors, turning.by)
    start_input = input_of(phasors, turning)
    middle_input = Input(
        combine(turning.middle_s, phasors.road.s, turning.middle_c, phasors.road.c),
        middle_force(phasors.force, turning),
    )
    end_input = input_of(end, turning)
    return rk4_step(rate, x, step, start_input, middle_input, end_input, *args), end


def given_step(
    rate: Any,
    x: Any,
    phasors: Any,
    turning: Any,
    step: Any,
    road_start: Any,
    road_middle: Any,
    road_end: Any,
    *args: Any,
) -> tuple[Any, Phasors]:
    """Advance by one RK4 step where the road's part of the input is known at the stage times."""
    force = turn(phasors.force, turning.by.force)
    start = Input(road_start, turning.F * phasors.force.c)
    middle = Input(road_middle, middle_force(phasors.force, turning))
    end = Input(road_end, turning.F * force.c)
    x = rk4_step(rate, x, step, start, middle, end, *args)
    return x, Phasors(phasors.road, force)


def middle_force(force: Any, turning: Any) -> Any:
    """Return the external force half a step after the instant of its phasor."""
    return turning.F_s * force.s + turning.F_c * force.c


def input_of(phasors: Any, turning: Any) -> Input:
    """Return the input at the instant of `phasors`."""
    return Input(
        combine(turning.road_s, phasors.road.s, turning.road_c, phasors.road.c),
        turning.F * phasors.force.c,
    )
