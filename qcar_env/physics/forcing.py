"""Road and external force together, as phasors that turn with time.

The state of the outside world is two phasors. What a Runge-Kutta step needs of it, at its ends and
in its middle, is a weighted sum of their entries: the integrators never evaluate a sine. A phasor
turned by a constant angle a thousand times is off by 4e-13.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from qcar_env.physics.dynamics import Forcing
from qcar_env.physics.roads import turn


class World(NamedTuple):
    """Phasors of the road and of the external force."""

    road: Any  # Phasor of the road's piece; (0, 0) where it is flat
    force: Any  # Phasor of the external force


class Amplitudes(NamedTuple):
    """What the phasors are multiplied with to give the forcing of their own instant."""

    road_s: Any  # mu1 h [m/s^2]
    road_c: Any  # mu2 h omega [m/s^2]
    F: Any  # f [m/s^2]


class MiddleAmplitudes(NamedTuple):
    """What the phasors are multiplied with to give the forcing half a step later."""

    road_s: Any  # mu1 h cos - mu2 h omega sin [m/s^2], sine and cosine of the angle turned
    road_c: Any  # mu1 h sin + mu2 h omega cos [m/s^2]
    force_s: Any  # -f sin [m/s^2]
    force_c: Any  # f cos [m/s^2]


class Passage(NamedTuple):
    """What becomes of phasors in a step of constant length."""

    by: World  # sines and cosines of the angles turned in the step
    middle: MiddleAmplitudes


def amplitudes_of(h: Any, omega: Any, f: Any, car: Any) -> Amplitudes:
    """Return the amplitudes of the forcing.

    Parameters
    ----------
    h, omega : float
        Height of the road [m] and frequency of its pieces [rad/s].
    f : float
        External specific force [m/s^2].
    car : Coefficients or QuarterCar
        Coefficients of the plant.
    """
    return Amplitudes(car.mu1 * h, car.mu2 * (h * omega), f)


def passage_of(half: Any, amplitudes: Any) -> Passage:
    """Return what becomes of phasors in a step.

    Parameters
    ----------
    half : World
        Sines and cosines of the angles turned in half the step.
    amplitudes : Amplitudes
        Amplitudes of the forcing.
    """
    road, force = half.road, half.force
    return Passage(
        turn_world(half, half),
        MiddleAmplitudes(
            amplitudes.road_s * road.c - amplitudes.road_c * road.s,
            amplitudes.road_s * road.s + amplitudes.road_c * road.c,
            -amplitudes.F * force.s,
            amplitudes.F * force.c,
        ),
    )


def forcing(world: Any, amplitudes: Any) -> Forcing:
    """Return what road and external force do at the instant of `world`.

    Parameters
    ----------
    world : World
        Phasors, entries float or array (n,).
    amplitudes : Amplitudes
        Amplitudes, entries float or array (n,).

    Returns
    -------
    Forcing
    """
    road = amplitudes.road_s * world.road.s + amplitudes.road_c * world.road.c
    return Forcing(road, amplitudes.F * world.force.c)


def forcing_in_the_middle(world: Any, middle: Any) -> Forcing:
    """Return the forcing half a step later, `middle` being the step's `MiddleAmplitudes`."""
    road = middle.road_s * world.road.s + middle.road_c * world.road.c
    force = middle.force_s * world.force.s + middle.force_c * world.force.c
    return Forcing(road, force)


def turn_world(world: Any, by: Any) -> World:
    """Return `world` with each phasor turned by its own angle.

    Parameters
    ----------
    world, by : World
        Phasors, and the sines and cosines of the angles that they turn by.
    """
    return World(turn(world.road, by.road), turn(world.force, by.force))
