"""What a control law is, and the plant with a law closed around it in continuous time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from qcar_env.physics.car import QuarterCar
from qcar_env.physics.dynamics import rate
from qcar_env.physics.state import Filter, State, advance, advance_filter

Command = Callable[[Any, Any, Any], tuple[Any, Any]]
FilterRate = Callable[[Any, Any, Any], Filter]


class Law(Protocol):
    """A closed-form control law with the paper's two specific forces `u1`, `u2` [m/s^2].

    A law is a frozen dataclass of its gains. Its formula is a pair of pure functions at module
    level, without branches, powers or library calls (see `qcar_env.physics.dynamics`), so that
    simulation, baselines and compiled rollouts all use that one source.
    """

    @property
    def name(self) -> str:
        """Short name, as in the paper's Table 1."""
        ...

    @property
    def gains(self) -> NamedTuple:
        """The gains as plain floats, as `command` and `filter_rate` take them."""
        ...

    @property
    def command(self) -> Command:
        """``command(x, eta, gains) -> (u1, u2)``: specific forces [m/s^2]."""
        ...

    @property
    def filter_rate(self) -> FilterRate | None:
        """``filter_rate(x, eta, gains) -> Filter``; None for a law without memory."""
        ...

    def check(self, car: QuarterCar) -> None:
        """Raise ValueError where the law is known to destabilise `car`."""
        ...


class ControlledState(NamedTuple):
    """Plant and control filter together."""

    plant: Any  # State
    filter: Any  # Filter


REST = Filter(0.0, 0.0, 0.0, 0.0)  # control filter at rest


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
        The law's functions, see `Law`.
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
    """Return the time derivative of the plant under a law without memory (see `controlled_rate`)."""
    u1, u2 = command(x, REST, gains)
    return rate(x, forcing, u1, u2, car)


def advance_controlled(state: Any, step: Any, rate: Any) -> ControlledState:
    """Move plant and filter along a rate: ``state + step * rate``."""
    return ControlledState(
        advance(state.plant, step, rate.plant),
        advance_filter(state.filter, step, rate.filter),
    )
