"""Actuators: from an action in [-1, 1] to the forces on wheel and body.

    command(action, p)                          what is asked for, held over a control interval
    rate(memory, command, travel_rate, p)       of an actuator with a memory, [per s]
    force(memory, command, travel_rate, p)      (u1, u2) on wheel and body, upward, in `unit`

The travel rate is ``v2 - v1`` [m/s]. An actuator between the masses gives ``(-F, F)``: what it does
to the one it does to the other, and it feeds in the power ``F travel_rate``.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from qcar_env.parts.part import UNLIMITED, Nothing, Part, clamp, most, number
from qcar_env.validation import entries, non_negative, positive, shown


class Force(NamedTuple):
    """Memory of an actuator whose force lags behind."""

    F: Any  # [N]


class Damping(NamedTuple):
    """Memory of a damper whose valve lags behind."""

    c: Any  # from the middle of its range [N s/m]


@dataclass(frozen=True, kw_only=True)
class Actuator(Part):
    """What a scenario takes as its actuator.

    Subclasses give `command`, `force`, where there is a memory `State` and `rate`, and ``limit``, a
    tuple (m,): the force that action 1 asks for, or the largest damping.

    Parameters
    ----------
    delay : float
        How much later the command acts [s]; not negative. Whoever steps the car holds it back.
    """

    delay: float = number("delay of the command", "s", non_negative, 0.0)

    if TYPE_CHECKING:  # a field of some subclasses, a property of others

        @property
        def limit(self) -> tuple[float, ...]:
            """Force that action 1 asks for, or the largest damping, shape (m,)."""
            ...

    def __post_init__(self) -> None:
        """Check every number, and that a memory has a rate."""
        super().__post_init__()
        if self.State._fields and not hasattr(self, "rate"):
            raise TypeError(
                f"{type(self).__name__} has a memory {self.State.__name__} and must define rate, "
                "its derivative; add it as a static method rate(memory, command, travel_rate, p)"
            )

    size = 1  # number of actions m
    unit = "N"  # of the forces
    linear = False  # in action, memory and travel rate, while the action is within [-1, 1]
    State = Nothing

    def scaled(self, scale: float) -> Any:
        """Return the same actuator with `scale` [-] times its limits."""
        return replace(self, limit=tuple(scale * each for each in self.limit))

    @property
    def at_rest(self) -> Any:
        """The memory at rest: zeros."""
        return self.State(*(0.0 for _ in self.State._fields))

    @staticmethod
    def largest(p: Any) -> Any:
        """Return the first entry of `limit`."""
        return p.limit[0]

    @staticmethod
    @abstractmethod
    def command(action: Any, p: Any) -> Any:
        """Return a tuple (m,) for an action (m,)."""

    @staticmethod
    @abstractmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> Any:
        """Return the forces on wheel and body."""


def _limits(count: int) -> Any:
    def check(name: str, value: Any, unit: str) -> tuple[float, ...]:
        given = entries(value)
        if count == 1 and not given:
            given = (value,)
        if len(given) != count:
            raise ValueError(f"{name} must be a tuple of {count}, got {shown(value)}; give {count}")
        return tuple(positive(name, each, unit) for each in given)

    return check


@dataclass(frozen=True, kw_only=True)
class IndependentActuators(Actuator):
    """Two actuators against the ground, one on each mass, as the paper's `u1` and `u2`.

    Parameters
    ----------
    limit : tuple of float
        Largest specific forces on wheel and body [m/s^2]; positive.
    delay : float
        How much later the command acts [s].

    Notes
    -----
    The last terms of (3) and (4), ``u = limit clip(action, -1, 1)``. Ideal: no lag, any power. No
    car has such actuators; they are the paper's.
    """

    limit: tuple[float, ...] = number("force", "m/s^2", _limits(2))  # pyright: ignore[reportIncompatibleMethodOverride]

    size = 2
    unit = "m/s^2"
    linear = True

    @staticmethod
    def command(action: Any, p: Any) -> Any:
        """Return the specific forces [m/s^2] that an action asks for."""
        return p.limit[0] * clamp(action[0], -1.0, 1.0), p.limit[1] * clamp(action[1], -1.0, 1.0)

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
        """Return the specific forces [m/s^2] on wheel and body."""
        return command[0], command[1]


@dataclass(frozen=True, kw_only=True)
class SuspensionActuator(Actuator):
    """An ideal actuator between wheel and body, ``F = limit clip(action, -1, 1)``.

    Parameters
    ----------
    limit : tuple of float
        Largest force [N], a tuple of one or the number; positive.
    delay : float
        How much later the command acts [s].

    Notes
    -----
    Not validated: it makes its force at once and at any speed; a real one has a lag and a power
    (`LaggedSuspensionActuator`).
    """

    limit: tuple[float, ...] = number("force", "N", _limits(1))  # pyright: ignore[reportIncompatibleMethodOverride]

    linear = True

    @staticmethod
    def command(action: Any, p: Any) -> Any:
        """Return the force [N] that an action asks for."""
        return (p.limit[0] * clamp(action[0], -1.0, 1.0),)

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
        """Return the forces [N] on wheel and body."""
        return -command[0], command[0]


@dataclass(frozen=True, kw_only=True)
class LaggedSuspensionActuator(Actuator):
    """An actuator between wheel and body with lag and limits of rate, power and small commands.

        F' = clamp((F0 - F) / lag, -rate_limit, rate_limit)
        F0 = limit a - clamp(limit a, -dead_zone, dead_zone),   a = clip(action, -1, 1)
        force on the body = F min(1, power / |F travel_rate|)

    Parameters
    ----------
    limit : tuple of float
        Largest force [N], a tuple of one or the number; positive.
    lag : float
        Time constant of the force [s]; positive.
    rate_limit : float
        Largest change of the force [N/s]; positive. By default there is none.
    power : float
        Largest mechanical power [W], in and out; positive. By default there is none.
    dead_zone : float
        Force [N] that a command must exceed, and by which it is diminished; not negative and below
        the limit.
    delay : float
        How much later the command acts [s].

    Raises
    ------
    ValueError
        If a number is outside its range.

    Notes
    -----
    The usual first model of electromagnetic and hydraulic actuators, e.g. 2 kN, 5 ms, 40 kN/s, 2 kW
    for an electromagnetic one and 5 kN, 32 ms (5 Hz) for Mercedes ABC. An explicit Runge-Kutta step
    must stay below 2.7 lags. Not validated: heat, inertia of the gear, leakage, pressure.
    """

    limit: tuple[float, ...] = number("force", "N", _limits(1))  # pyright: ignore[reportIncompatibleMethodOverride]
    lag: float = number("time constant", "s", positive)
    rate_limit: float = number("", "N/s", positive, UNLIMITED)
    power: float = number("largest", "W", positive, UNLIMITED)
    dead_zone: float = number("", "N", non_negative, 0.0)

    State = Force

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        if self.dead_zone >= self.limit[0]:
            raise ValueError(
                f"dead_zone must be below the limit of {self.limit[0]:g} N, "
                f"got {self.dead_zone:g} N; give a smaller one"
            )

    @property
    def linear(self) -> bool:
        """Whether there is a lag alone."""
        return min(self.rate_limit, self.power) >= UNLIMITED and self.dead_zone == 0.0

    @staticmethod
    def command(action: Any, p: Any) -> Any:
        """Return the force [N] that an action asks for, less the dead zone."""
        asked = p.limit[0] * clamp(action[0], -1.0, 1.0)
        return (asked - clamp(asked, -p.dead_zone, p.dead_zone),)

    @staticmethod
    def rate(memory: Any, command: Any, travel_rate: Any, p: Any) -> Force:
        """Return the rate of the force [N/s]."""
        inverse = 1.0 / p.lag  # the same at all stages of a step, and taken once
        return Force(clamp((command[0] - memory.F) * inverse, -p.rate_limit, p.rate_limit))

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
        """Return the forces [N] on wheel and body."""
        F = memory.F * (p.power / most(p.power, abs(memory.F * travel_rate)))
        return -F, F


def _damping(c: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
    """Return the forces [N] of a damping `c` [N s/m] from the middle of its range."""
    half = 0.5 * (p.c_max - p.c_min)
    F = -(0.5 * (p.c_max + p.c_min) + clamp(c, -half, half)) * travel_rate
    return -F, F


@dataclass(frozen=True, kw_only=True)
class _Valve(Actuator):
    """What both semi-active dampers have in common."""

    c_min: float = number("least damping", "N s/m", non_negative)
    c_max: float = number("largest damping", "N s/m", positive)

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        if self.c_max < self.c_min:
            raise ValueError(
                f"largest damping c_max must be at least c_min of {self.c_min:g} N s/m, "
                f"got {self.c_max:g} N s/m; exchange them"
            )

    def scaled(self, scale: float) -> Any:
        """Return the damper with `scale` [-] times the range of its damping above the least."""
        return replace(self, c_max=self.c_min + scale * (self.c_max - self.c_min))

    @property
    def limit(self) -> tuple[float, ...]:
        """The largest damping [N s/m]."""
        return (self.c_max,)

    @staticmethod
    def largest(p: Any) -> Any:
        """Return the largest damping [N s/m]."""
        return p.c_max

    @staticmethod
    def command(action: Any, p: Any) -> Any:
        """Return the damping [N s/m] that an action asks for, from the middle of its range."""
        return (0.5 * (p.c_max - p.c_min) * clamp(action[0], -1.0, 1.0),)


@dataclass(frozen=True, kw_only=True)
class SemiActiveDamper(_Valve):
    """A damper whose damping is set at once; it only takes energy out.

    ``F = -c travel_rate`` on the body, `c` from `c_min` at action -1 to `c_max` at 1.

    Parameters
    ----------
    c_min, c_max : float
        Least and largest damping [N s/m]; not negative.
    delay : float
        How much later the command acts [s].

    Raises
    ------
    ValueError
        If a number is outside its range.

    Notes
    -----
    The semi-active damper of D. Karnopp, M. J. Crosby, R. A. Harwood (1974). It stands beside the
    car's own damper; a car that has no other has a `LinearDamper` of 0. Not validated: a real one
    is not linear in speed and has a lag (`LaggedSemiActiveDamper`).
    """

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
        """Return the forces [N] on wheel and body."""
        return _damping(command[0], travel_rate, p)


@dataclass(frozen=True, kw_only=True)
class LaggedSemiActiveDamper(_Valve):
    """A damper whose damping follows with a lag, ``c' = (c0 - c) / lag``; it takes energy out.

    ``F = -c travel_rate`` on the body, `c0` from `c_min` at action -1 to `c_max` at 1; at rest the
    damping is in the middle.

    Parameters
    ----------
    c_min, c_max : float
        Least and largest damping [N s/m]; not negative.
    lag : float
        Time constant of the valve [s]; positive. Typical: 8 ms (magnetorheological), 15 ms (valve).
    delay : float
        How much later the command acts [s].

    Raises
    ------
    ValueError
        If a number is outside its range.

    Notes
    -----
    As `SemiActiveDamper`, with the first-order lag of its valve or coil. An explicit Runge-Kutta
    step must stay below 2.7 lags. Not validated: hysteresis and yield of a magnetorheological one.
    """

    lag: float = number("time constant", "s", positive)

    State = Damping

    @staticmethod
    def rate(memory: Any, command: Any, travel_rate: Any, p: Any) -> Damping:
        """Return the rate of the damping [N/m]."""
        inverse = 1.0 / p.lag  # the same at all stages of a step, and taken once
        return Damping((command[0] - memory.c) * inverse)

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> tuple[Any, Any]:
        """Return the forces [N] on wheel and body."""
        return _damping(memory.c, travel_rate, p)
