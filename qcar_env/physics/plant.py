"""The plant: a car with its actuators, whatever both are made of.

`qcar_env.physics.car` has the cars, `qcar_env.parts.actuator` the actuators. Their functions are
put together here once for each pair of classes, so that compiled code sees one function.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from qcar_env.physics.car import CarFunctions


class PlantState(NamedTuple):
    """State of car and actuators."""

    car: Any  # State of the car
    memory: Any  # of the actuators, `qcar_env.parts.part.Nothing` if they have none


class PlantFunctions(NamedTuple):
    """Pure functions of a plant."""

    rate: Any  # rate(x, input, command, p) -> PlantState
    forces: Any  # forces(x, command, p) -> (u1, u2) in the actuators' unit
    specific: Any  # specific(x, command, p) -> (u1, u2) [m/s^2]
    by_mass: Any  # what turns the actuators' forces into specific ones
    memory_rate: Any  # of the actuators


@cache
def plant_functions(car: CarFunctions, actuator: type) -> PlantFunctions:
    """Put a car and a class of actuators together; `p` has their numbers as `car`, `actuator`."""
    kind: Any = actuator
    force, travel_rate, car_rate = kind.force, car.travel_rate, car.rate
    by_mass = car.by_mass if kind.unit == "N" else _as_it_is
    nothing = kind.State

    def no_memory(memory: Any, command: Any, travel_rate: Any, p: Any) -> Any:
        return nothing()

    memory_rate = kind.rate if kind.State._fields else no_memory

    def forces(x: Any, command: Any, p: Any) -> Any:
        return force(x.memory, command, travel_rate(x.car), p.actuator)

    def specific(x: Any, command: Any, p: Any) -> Any:
        u1, u2 = forces(x, command, p)
        return by_mass(u1, u2, p.car)

    def rate(x: Any, input: Any, command: Any, p: Any) -> PlantState:
        u1, u2 = specific(x, command, p)
        return PlantState(
            car_rate(x.car, input, u1, u2, p.car),
            memory_rate(x.memory, command, travel_rate(x.car), p.actuator),
        )

    return PlantFunctions(rate, forces, specific, by_mass, memory_rate)


def _as_it_is(u1: Any, u2: Any, c: Any) -> tuple[Any, Any]:
    return u1, u2
