"""Signals: what can be read of a car, by name, with units.

Observation, reward, `info`, histories, metrics and reports choose from this one table. A signal is
a pure function of the moment that is read and of the numbers of the episode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.validation import known


class Moment(NamedTuple):
    """All that is known of a car at one instant."""

    x: Any  # state of the car
    rate: Any  # its time derivative
    y: Any  # height of the road under the tyre [m]
    y_dot: Any  # its rate as the car drives [m/s]
    F: Any  # external specific force on the body [m/s^2]
    F_dot: Any  # its rate [m/s^3]
    u1: Any  # force of the actuators on the wheel, in their unit [m/s^2] or [N]
    u2: Any  # and on the body
    tyre_load: Any  # force between tyre and road [N]; 0 for a car without masses
    limit: Any  # largest force that the first action can ask for, or largest damping


@dataclass(frozen=True)
class Signal:
    """One reading.

    Parameters
    ----------
    name : str
        Name, as in `SIGNALS`.
    unit : str
        Its unit.
    title : str
        What it is, for people.
    reading : callable
        ``reading(m, p)`` of a `Moment` and the episode's numbers.
    scale : float or None
        What the observation divides it by, in its unit; None for the largest value of the
        uncontrolled motion.
    needs_masses : bool
        Whether only a car with masses has it.
    """

    name: str
    unit: str
    title: str
    reading: Callable[[Any, Any], Any]
    scale: float | None = None
    needs_masses: bool = False


def x1(m: Any, p: Any) -> Any:
    """Return the displacement of the wheel [m]."""
    return m.x.x1


def x2(m: Any, p: Any) -> Any:
    """Return the displacement of the body [m]."""
    return m.x.x2


def v1(m: Any, p: Any) -> Any:
    """Return the velocity of the wheel [m/s]."""
    return m.x.v1


def v2(m: Any, p: Any) -> Any:
    """Return the velocity of the body [m/s]."""
    return m.x.v2


def wheel_acceleration(m: Any, p: Any) -> Any:
    """Return the acceleration of the wheel [m/s^2]."""
    return m.rate.v1


def body_acceleration(m: Any, p: Any) -> Any:
    """Return the acceleration of the body [m/s^2]."""
    return m.rate.v2


def travel(m: Any, p: Any) -> Any:
    """Return the suspension travel, positive when it is extended [m]."""
    return m.x.x2 - m.x.x1


def travel_rate(m: Any, p: Any) -> Any:
    """Return the rate of the suspension travel [m/s]."""
    return m.x.v2 - m.x.v1


def tyre_deflection(m: Any, p: Any) -> Any:
    """Return the displacement of the wheel relative to the road [m]."""
    return m.x.x1 - m.y


def tyre_load(m: Any, p: Any) -> Any:
    """Return the force between tyre and road [N]."""
    return m.tyre_load


def y(m: Any, p: Any) -> Any:
    """Return the height of the road under the tyre [m]."""
    return m.y


def y_dot(m: Any, p: Any) -> Any:
    """Return the rate of that height as the car drives [m/s]."""
    return m.y_dot


def F(m: Any, p: Any) -> Any:
    """Return the external specific force on the body [m/s^2]."""
    return m.F


def F_dot(m: Any, p: Any) -> Any:
    """Return the rate of that force [m/s^3]."""
    return m.F_dot


def u1(m: Any, p: Any) -> Any:
    """Return the force of the actuators on the wheel, in their unit."""
    return m.u1


def u2(m: Any, p: Any) -> Any:
    """Return the force of the actuators on the body, in their unit."""
    return m.u2


def limit(m: Any, p: Any) -> Any:
    """Return what action 1 of the first actuator asks for: its largest force, or damping."""
    return m.limit


FORCE = "m/s^2 or N"  # of an actuator: as it is rated

SIGNALS: dict[str, Signal] = {
    each.name: each
    for each in (
        Signal("x1", "m", "wheel displacement", x1),
        Signal("x2", "m", "body displacement", x2),
        Signal("v1", "m/s", "wheel velocity", v1),
        Signal("v2", "m/s", "body velocity", v2),
        Signal("wheel_acceleration", "m/s^2", "wheel acceleration", wheel_acceleration),
        Signal("body_acceleration", "m/s^2", "body acceleration", body_acceleration),
        Signal("travel", "m", "suspension travel", travel),
        Signal("travel_rate", "m/s", "rate of the suspension travel", travel_rate),
        Signal("tyre_deflection", "m", "wheel over road", tyre_deflection),
        Signal("tyre_load", "N", "force between tyre and road", tyre_load, needs_masses=True),
        Signal("y", "m", "road height under the tyre", y),
        Signal("y_dot", "m/s", "its rate", y_dot),
        Signal("F", "m/s^2", "external force", F),
        Signal("F_dot", "m/s^3", "its rate", F_dot),
        Signal("u1", FORCE, "actuator force on the wheel", u1),
        Signal("u2", FORCE, "actuator force on the body", u2),
        Signal("limit", FORCE, "force limit", limit),
    )
}


def signal(name: str | Signal) -> Signal:
    """Return the signal called `name`; a `Signal` of one's own is returned as it is.

    Raises
    ------
    ValueError
        If there is no such signal; the message gives the nearest name and the list.
    """
    return name if isinstance(name, Signal) else SIGNALS[known("signal", name, SIGNALS)]
