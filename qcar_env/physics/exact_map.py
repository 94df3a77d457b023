"""The exact map of a control interval, applied to a car.

The plant is linear. With a held actuator force and on one piece of the road, the state at the end
of an interval is a linear function of state, forces and phasors at its beginning: the matrices of
`qcar_env.physics.linear.exact_transition`, which cars with the same parameters share. Nothing is
integrated step by step and nothing is approximated beyond rounding.

As in `qcar_env.physics.dynamics`, the functions are branch-free arithmetic on named tuples.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from qcar_env.physics.forcing import World, turn_world
from qcar_env.physics.state import State


class Weights(NamedTuple):
    """What one entry of the state is made of at the end of an interval."""

    x1: Any  # the state at the beginning
    x2: Any
    v1: Any
    v2: Any
    u1: Any  # specific actuator forces, held
    u2: Any
    road_s: Any  # phasors at the beginning
    road_c: Any
    force_s: Any
    force_c: Any


class ExactMap(NamedTuple):
    """The map of an interval: weights of each entry of the state, and the turn of the phasors."""

    x1: Weights
    x2: Weights
    v1: Weights
    v2: Weights
    by: World  # sines and cosines of the angles turned in the interval


def exact_interval(x: Any, world: Any, u1: Any, u2: Any, exact: Any) -> tuple[State, World]:
    """Advance plant and world by one control interval under held actuator forces.

    Parameters
    ----------
    x : State
        State of the plant, entries float or array (n,).
    world : World
        Phasors of road and force at the beginning of the interval.
    u1, u2 : float or array (n,)
        Specific actuator forces [m/s^2].
    exact : ExactMap
        The map of the interval.

    Returns
    -------
    tuple
        State and world at the end of the interval.
    """
    end = State(
        weighted(exact.x1, x, world, u1, u2),
        weighted(exact.x2, x, world, u1, u2),
        weighted(exact.v1, x, world, u1, u2),
        weighted(exact.v2, x, world, u1, u2),
    )
    return end, turn_world(world, exact.by)


def weighted(weights: Any, x: Any, world: Any, u1: Any, u2: Any) -> Any:
    """Return one entry of the state at the end of an interval (see `exact_interval`)."""
    plant = weights.x1 * x.x1 + weights.x2 * x.x2 + weights.v1 * x.v1 + weights.v2 * x.v2
    road = weights.road_s * world.road.s + weights.road_c * world.road.c
    force = weights.force_s * world.force.s + weights.force_c * world.force.c
    return plant + (weights.u1 * u1 + weights.u2 * u2) + (road + force)
