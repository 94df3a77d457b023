"""The plant with a control law closed around it in continuous time.

The law acts at every instant, its filter is integrated together with the plant, and the actuators
saturate. A law is a pair of pure functions, see `qcar_env.control.law.Law`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from qcar_env.physics.dynamics import rate
from qcar_env.physics.state import Filter, State, add, add_filter, advance, advance_filter

UNLIMITED = 1e300  # [m/s^2] of an actuator without a limit; finite, so that 0 * UNLIMITED is 0


class ControlledState(NamedTuple):
    """Plant and control filter together."""

    plant: Any  # State
    filter: Any  # Filter


class Limits(NamedTuple):
    """Largest specific forces of the actuators."""

    u1: Any  # wheel [m/s^2]
    u2: Any  # body [m/s^2]


REST = Filter(0.0, 0.0, 0.0, 0.0)  # control filter at rest


def saturate(u: Any, limit: Any) -> Any:
    """Return `u` held within ``[-limit, limit]``, without a branch.

    Parameters
    ----------
    u, limit : float or array (n,)
        Value, and its limit: positive and finite (see `UNLIMITED`).
    """
    return u * (abs(u) <= limit) + limit * (u > limit) - limit * (u < -limit)


def controlled_rate(
    state: Any, forcing: Any, command: Any, filter_rate: Any, gains: Any, car: Any
) -> ControlledState:
    """Return the time derivative of plant and filter under a law that acts at every instant.

    Parameters
    ----------
    state : ControlledState
        Plant and filter, entries float or array (n,).
    forcing : Forcing
        Road and external force at the same instant.
    command, filter_rate : callable
        The law's functions.
    gains : NamedTuple
        The law's gains.
    car : Coefficients or QuarterCar
        The plant.
    """
    u1, u2 = command(state.plant, state.filter, gains)
    return ControlledState(
        rate(state.plant, forcing, u1, u2, car),
        filter_rate(state.plant, state.filter, gains),
    )


def memoryless_rate(x: Any, forcing: Any, command: Any, gains: Any, car: Any) -> State:
    """Return the time derivative of the plant under a law without memory."""
    u1, u2 = command(x, REST, gains)
    return rate(x, forcing, u1, u2, car)


def unlimited_rate(
    state: Any, forcing: Any, command: Any, filter_rate: Any, gains: Any, limits: Any, car: Any
) -> ControlledState:
    """Return the same; `limits` are not looked at."""
    return controlled_rate(state, forcing, command, filter_rate, gains, car)


def saturated_rate(
    state: Any, forcing: Any, command: Any, filter_rate: Any, gains: Any, limits: Any, car: Any
) -> ControlledState:
    """Return the same with actuators that saturate at `limits` (a `Limits`)."""
    u1, u2 = command(state.plant, state.filter, gains)
    return ControlledState(
        rate(state.plant, forcing, saturate(u1, limits.u1), saturate(u2, limits.u2), car),
        filter_rate(state.plant, state.filter, gains),
    )


def held_rate(
    state: Any, forcing: Any, command: Any, filter_rate: Any, gains: Any, forces: Any, car: Any
) -> ControlledState:
    """Return the same under held `forces` (a `Limits`), while the law's filter goes on."""
    return ControlledState(
        rate(state.plant, forcing, forces.u1, forces.u2, car),
        filter_rate(state.plant, state.filter, gains),
    )


def no_filter(x: Any, eta: Any, gains: Any) -> Filter:
    """Return the rate of the filter of a law without memory: none."""
    return REST


def advance_controlled(state: Any, step: Any, rate: Any) -> ControlledState:
    """Move plant and filter along a rate: ``state + step * rate``."""
    return ControlledState(
        advance(state.plant, step, rate.plant),
        advance_filter(state.filter, step, rate.filter),
    )


def add_controlled(a: Any, b: Any) -> ControlledState:
    """Return the sum of two rates of plant and filter."""
    return ControlledState(add(a.plant, b.plant), add_filter(a.filter, b.filter))
