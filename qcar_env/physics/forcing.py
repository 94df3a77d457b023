"""Road and external force together, as phasors that turn with time.

The state of the outside world is two phasors. `forcing` reads the road's height, its rate and the
force off them. The integrators never evaluate a sine: a phasor turned by a constant angle a
thousand times is off by 4e-13.
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
    """What the phasors are multiplied with."""

    y: Any  # h [m]
    y_dot: Any  # h omega [m/s]
    F: Any  # f [m/s^2]


def forcing(world: Any, amplitudes: Any) -> Forcing:
    """Return road height, road rate and external force at the instant of `world`.

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
    return Forcing(
        amplitudes.y * world.road.s,
        amplitudes.y_dot * world.road.c,
        amplitudes.F * world.force.c,
    )


def turn_world(world: Any, by: Any) -> World:
    """Return `world` with each phasor turned by its own angle.

    Parameters
    ----------
    world, by : World
        Phasors, and the sines and cosines of the angles that they turn by.
    """
    return World(turn(world.road, by.road), turn(world.force, by.force))
