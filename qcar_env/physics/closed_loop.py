"""A car with a control law closed around it in continuous time.

The law acts at every instant and its filter is integrated together with the car. It asks for
specific forces on wheel and body; these act as they are, or within limits, or as well as one
actuator between the masses can give both: ``F = m2 u2 - m1 u1``.

`qcar_env.physics.car` has the cars, `qcar_env.control.law` says what a law is. Their functions are
put together here once for each pair of classes, so that compiled code sees one function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from qcar_env.parts.part import UNLIMITED, Nothing, clamp
from qcar_env.physics.car import CarFunctions


class ControlledState(NamedTuple):
    """State of a car and of its law."""

    plant: Any  # State of the car
    filter: Any  # of the law, `qcar_env.parts.part.Nothing` if it has no memory


class Limits(NamedTuple):
    """Largest specific forces of the actuators."""

    u1: Any = UNLIMITED  # wheel [m/s^2]
    u2: Any = UNLIMITED  # body [m/s^2]


class LawFunctions(NamedTuple):
    """Pure functions of a class of laws (see `qcar_env.control.law.Law`)."""

    command: Callable[..., Any]  # command(x, eta, p) -> (u1, u2) [m/s^2]
    filter_rate: Callable[..., Any] | None  # filter_rate(x, eta, p) -> State of the law
    State: type  # NamedTuple class of its memory


class LoopNumbers(NamedTuple):
    """Numbers of a closed loop; any tuple that has them serves."""

    car: Any  # as the car's functions take them
    law: Any
    limits: Any = Nothing()  # `Limits`, or the numbers of an actuator between the masses


class LoopFunctions(NamedTuple):
    """Pure functions of a closed loop."""

    rate: Callable[..., Any]  # rate(x, input, held, p) -> ControlledState
    forces: Callable[..., Any]  # forces(x, p) -> (u1, u2) [m/s^2] that act


@cache
def loop_functions(
    car: CarFunctions,
    law: LawFunctions,
    *,
    limited: bool = False,
    actuator: type | None = None,
    held: bool = False,
) -> LoopFunctions:
    """Close a class of laws around a class of cars.

    Parameters
    ----------
    car, law
        Their functions.
    limited : bool
        Whether the forces have limits.
    actuator : type, optional
        Class of an actuator between the masses, whose limit is the only one.
    held : bool
        Whether the forces are those in `held`, instead of the law's at every instant.
    """
    command, car_rate = law.command, car.rate
    filter_rate = law.filter_rate or _no_memory(law.State)
    if actuator is not None:
        forces = _between(car, command, actuator)
    elif limited:

        def forces(x: Any, p: Any) -> tuple[Any, Any]:
            u1, u2 = command(x.plant, x.filter, p.law)
            limit1, limit2 = p.limits.u1, p.limits.u2
            return clamp(u1, -limit1, limit1), clamp(u2, -limit2, limit2)

    else:

        def forces(x: Any, p: Any) -> tuple[Any, Any]:
            return command(x.plant, x.filter, p.law)

    if held:

        def rate(x: Any, input: Any, held: Any, p: Any) -> ControlledState:
            return ControlledState(
                car_rate(x.plant, input, held[0], held[1], p.car),
                filter_rate(x.plant, x.filter, p.law),
            )

    else:

        def rate(x: Any, input: Any, held: Any, p: Any) -> ControlledState:
            u1, u2 = forces(x, p)
            return ControlledState(
                car_rate(x.plant, input, u1, u2, p.car),
                filter_rate(x.plant, x.filter, p.law),
            )

    return LoopFunctions(rate, forces)


def _no_memory(nothing: type) -> Callable[..., Any]:
    def filter_rate(x: Any, eta: Any, p: Any) -> Any:
        return nothing()

    return filter_rate


def _between(car: CarFunctions, command: Callable[..., Any], actuator: Any) -> Callable[..., Any]:
    by_mass, travel_rate = car.by_mass, car.travel_rate
    asked, force, nothing = actuator.command, actuator.force, actuator.State

    def forces(x: Any, p: Any) -> tuple[Any, Any]:
        u1, u2 = command(x.plant, x.filter, p.law)
        inverse_m1, inverse_m2 = by_mass(1.0, 1.0, p.car)
        F = u2 / inverse_m2 - u1 / inverse_m1  # what both masses ask for
        action = (F / p.limits.limit[0],)
        U1, U2 = force(nothing(), asked(action, p.limits), travel_rate(x.plant), p.limits)
        return by_mass(U1, U2, p.car)

    return forces
