"""Cars: what the road and the actuators do to wheel and body.

Two kinds behind one protocol. `PaperCar` keeps the nine coefficients of the paper's equations,

(3)  x1'' + omega1^2 x1 + b1 x1' - E2 x2' - E1 x2 = mu1 y + mu2 y' + u1
(4)  x2'' + omega2^2 x2 - b2 (x1' - x2') - E3 x1  = F + u2

`QuarterCar` is made of parts,

    m1 x1'' = tyre(y - x1, y' - v1) + S + m1 u1
    m2 x2'' = -S + m2 (F + u2),    S = spring(x2 - x1) + damper(v2 - v1) + stops(x2 - x1)

u1, u2 are specific forces [m/s^2]. Signs: see `qcar_env.physics.state`.

Source of (3)-(4): Alluhydan et al., Mathematics 2024, 12(19), 3046, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol

from qcar_env.parts.damper import LinearDamper
from qcar_env.parts.part import Part, number
from qcar_env.parts.spring import LinearSpring, NoStops
from qcar_env.parts.tyre import LinearTyre
from qcar_env.physics.state import State
from qcar_env.validation import finite, instance, non_negative, positive

GRAVITY = 9.81  # [m/s^2]
REST = State(0.0, 0.0, 0.0, 0.0)


class CarFunctions(NamedTuple):
    """Pure functions of a class of cars; `c` are the numbers that `prepare` makes."""

    prepare: Callable[..., Any]  # prepare(p) -> c, once an episode: p are the car's own numbers
    road_input: Callable[..., Any]  # road_input(y, y_dot, c) -> tuple, linear in both
    rate: Callable[..., Any]  # rate(x, input, u1, u2, c) -> State, u specific forces [m/s^2]
    kick: Callable[..., Any]  # kick(x, jump, c) -> State after a jump of the road's height [m]
    by_mass: Callable[..., Any]  # by_mass(U1, U2, c) -> (u1, u2), of forces in newtons
    travel_rate: Callable[..., Any]  # travel_rate(x) -> v2 - v1 [m/s]
    tyre_load: Callable[..., Any]  # tyre_load(x, input, c) -> force between tyre and road [N]


class Car(Protocol):
    """What the rest of the library knows of a car."""

    @property
    def numbers(self) -> Any:
        """Its numbers, as `CarFunctions.prepare` takes them."""
        ...

    @property
    def functions(self) -> CarFunctions:
        """Its functions; two cars of equal functions run in one compiled batch."""
        ...

    @property
    def linear(self) -> bool:
        """Whether `CarFunctions.rate` is linear in state, input and forces."""
        ...

    @property
    def has_masses(self) -> bool:
        """Whether it has masses [kg], which actuators in newtons need."""
        ...


class RoadForce(NamedTuple):
    """What a `PaperCar` takes of the road."""

    specific: Any  # mu1 y + mu2 y' [m/s^2]


class RoadMotion(NamedTuple):
    """What a `QuarterCar` takes of the road."""

    y: Any  # height [m]
    y_dot: Any  # its rate [m/s]


def _frequency(name: str, value: Any, unit: str) -> float:
    found = positive(name, value, unit)
    finite(f"{name}^2", found * found, "1/s^2")
    return found


# The paper's car -------------------------------------------------------------------------------


def paper_prepare(p: Any) -> Any:
    """Return the coefficients as they are."""
    return p


def paper_road_input(y: Any, y_dot: Any, c: Any) -> RoadForce:
    """Return the specific force of the road on the wheel."""
    return RoadForce(c.mu1 * y + c.mu2 * y_dot)


def paper_rate(x: Any, input: Any, u1: Any, u2: Any, c: Any) -> State:
    """Return the time derivative of the state, equations (3)-(4)."""
    spring1 = c.omega1 * c.omega1 * x.x1 - c.E1 * x.x2
    damper1 = c.b1 * x.v1 - c.E2 * x.v2
    spring2 = c.omega2 * c.omega2 * x.x2 - c.E3 * x.x1
    damper2 = c.b2 * (x.v2 - x.v1)
    dv1 = input.road.specific + u1 - spring1 - damper1  # (3)
    dv2 = input.F + u2 - spring2 - damper2  # (4)
    return State(x.v1, x.v2, dv1, dv2)


def paper_kick(x: Any, jump: Any, c: Any) -> State:
    """Return the state after the road has jumped: the damped tyre throws the wheel."""
    return State(x.x1, x.x2, x.v1 + c.mu2 * jump, x.v2)


def paper_by_mass(U1: Any, U2: Any, c: Any) -> tuple[Any, Any]:
    """Return forces as they are: a car without masses takes specific ones."""
    return U1, U2


def travel_rate(x: Any) -> Any:
    """Return the rate of the suspension travel, ``v2 - v1`` [m/s]."""
    return x.v2 - x.v1


def paper_tyre_load(x: Any, input: Any, c: Any) -> Any:
    """Return 0: a car without masses has no load in newtons."""
    return x.x1 * 0.0  # a number of the state's own kind


PAPER_FUNCTIONS = CarFunctions(
    paper_prepare,
    paper_road_input,
    paper_rate,
    paper_kick,
    paper_by_mass,
    travel_rate,
    paper_tyre_load,
)


@dataclass(frozen=True, kw_only=True)
class PaperCar(Part):
    """The nine coefficients of equations (3)-(4).

    Parameters
    ----------
    omega1, omega2 : float
        Natural frequency of wheel and body with the other mass held [rad/s]; positive.
    b1, b2 : float
        Damping of wheel and body [1/s]; not negative.
    E1, E3 : float
        Coupling of the masses through the spring, on wheel and body [1/s^2]; not negative.
    E2 : float
        Coupling through the damper, on the wheel [1/s]; not negative. On the body it is `b2`.
    mu1, mu2 : float
        Stiffness [1/s^2] and damping [1/s] of the tyre per wheel mass; not negative.

    Raises
    ------
    ValueError
        If a coefficient is not finite or has the wrong sign.

    Notes
    -----
    The coefficients are independent, as in the paper, whose worst case
    ``omega1 = omega2 = omega = Omega`` with ``m1 < m2`` is not a car with a passive tyre (it would
    need k1 < 0). `QuarterCar` is made of masses and parts, and `from_physical` turns these into
    coefficients.
    """

    omega1: float = number("", "rad/s", _frequency)
    omega2: float = number("", "rad/s", _frequency)
    b1: float = number("", "1/s", non_negative)
    b2: float = number("", "1/s", non_negative)
    E1: float = number("", "1/s^2", non_negative)
    E2: float = number("", "1/s", non_negative)
    E3: float = number("", "1/s^2", non_negative)
    mu1: float = number("", "1/s^2", non_negative)
    mu2: float = number("", "1/s", non_negative)

    @classmethod
    def from_physical(
        cls,
        m1: float,
        m2: float,
        k1: float,
        k2: float,
        c1: float,
        c2: float,
        *,
        reciprocal: bool = True,
    ) -> PaperCar:
        """Make the coefficients from masses, springs and dampers.

        omega1^2 = (k1 + k2) / m1, omega2^2 = k2 / m2, b1 = (c1 + c2) / m1, b2 = c2 / m2,
        E1 = k2 / m1, E2 = c2 / m1, E3 = k2 / m2, mu1 = k1 / m1, mu2 = c1 / m1.

        Parameters
        ----------
        m1, m2 : float
            Mass of wheel and body [kg]; positive.
        k1, k2 : float
            Stiffness of tyre and suspension [N/m]; positive.
        c1, c2 : float
            Damping of tyre and suspension [N s/m]; not negative.
        reciprocal : bool, optional
            ``True`` (default): ``E3 = k2 / m2``, so that the suspension pulls on both masses
            with opposite and equal forces (Newton's third law). ``False``: ``E3 = k1 / m2``,
            as equation (2) of the paper is printed; such a car rests at ``x1 = (k1 / k2) h`` on a
            road of height h.

        Raises
        ------
        ValueError
            If a value is not finite or has the wrong sign.
        """
        m1, m2 = positive("m1", m1, "kg"), positive("m2", m2, "kg")
        k1, k2 = positive("k1", k1, "N/m"), positive("k2", k2, "N/m")
        c1, c2 = non_negative("c1", c1, "N s/m"), non_negative("c2", c2, "N s/m")
        return cls(
            omega1=math.sqrt((k1 + k2) / m1),
            omega2=math.sqrt(k2 / m2),
            b1=(c1 + c2) / m1,
            b2=c2 / m2,
            E1=k2 / m1,
            E2=c2 / m1,
            E3=(k2 if reciprocal else k1) / m2,
            mu1=k1 / m1,
            mu2=c1 / m1,
        )

    @property
    def functions(self) -> CarFunctions:
        """The functions above."""
        return PAPER_FUNCTIONS

    @property
    def linear(self) -> bool:
        """True."""
        return True

    @property
    def has_masses(self) -> bool:
        """False: forces on it are specific ones."""
        return False

    @property
    def damping_ratios(self) -> tuple[float, float]:
        """Damping ratio of wheel and body, each with the other mass held, ``b / (2 omega)``."""
        return self.b1 / (2.0 * self.omega1), self.b2 / (2.0 * self.omega2)


# Cars made of parts ----------------------------------------------------------------------------


class Prepared(NamedTuple):
    """Numbers of a `QuarterCar` as its functions take them."""

    inverse_m1: Any  # [1/kg]
    inverse_m2: Any  # [1/kg]
    load: Any  # static tyre load (m1 + m2) g [N]
    spring: Any
    damper: Any
    tyre: Any
    stops: Any


@cache
def _functions(spring: type, damper: type, tyre: type, stops: type) -> CarFunctions:
    parts: Any = (spring, damper, tyre, stops)
    spring_force, damper_force, tyre_force, stops_force = (each.force for each in parts)
    tyre_kick = parts[2].kick

    def prepare(p: Any) -> Prepared:
        return Prepared(
            1.0 / p.m1, 1.0 / p.m2, (p.m1 + p.m2) * GRAVITY, p.spring, p.damper, p.tyre, p.stops
        )

    def road_input(y: Any, y_dot: Any, c: Any) -> RoadMotion:
        return RoadMotion(y, y_dot)

    def on_wheel(x: Any, input: Any, c: Any) -> Any:
        return tyre_force(input.road.y - x.x1, input.road.y_dot - x.v1, c.load, c.tyre)

    def rate(x: Any, input: Any, u1: Any, u2: Any, c: Any) -> State:
        travel = x.x2 - x.x1
        suspension = (
            spring_force(travel, c.spring)
            + damper_force(x.v2 - x.v1, c.damper)
            + stops_force(travel, c.stops)
        )
        dv1 = (on_wheel(x, input, c) + suspension) * c.inverse_m1 + u1
        dv2 = input.F + u2 - suspension * c.inverse_m2
        return State(x.v1, x.v2, dv1, dv2)

    def kick(x: Any, jump: Any, c: Any) -> State:
        return State(x.x1, x.x2, x.v1 + tyre_kick(jump, c.tyre) * c.inverse_m1, x.v2)

    def by_mass(U1: Any, U2: Any, c: Any) -> tuple[Any, Any]:
        return U1 * c.inverse_m1, U2 * c.inverse_m2

    def tyre_load(x: Any, input: Any, c: Any) -> Any:
        return c.load + on_wheel(x, input, c)

    return CarFunctions(prepare, road_input, rate, kick, by_mass, travel_rate, tyre_load)


@dataclass(frozen=True, kw_only=True)
class QuarterCar(Part):
    """A wheel on its tyre and a body on its suspension, made of parts.

    Parameters
    ----------
    m1, m2 : float
        Mass of wheel and body [kg]; positive.
    spring, damper, tyre, stops : Part
        Of `qcar_env.parts`; a class of one's own with the same functions serves as well. Without
        stops the travel is not limited.

    Raises
    ------
    ValueError
        If a mass is not positive.

    Notes
    -----
    A quarter car has no pitch and no roll, and overstates what one hump does to a whole car.
    """

    m1: float = number("mass of the wheel", "kg", positive)
    m2: float = number("mass of the body", "kg", positive)
    spring: Part
    damper: Part
    tyre: Part
    stops: Part = NoStops()

    def __post_init__(self) -> None:
        """Check masses and parts."""
        super().__post_init__()
        for name in ("spring", "damper", "tyre", "stops"):
            instance(name, getattr(self, name), Part)

    @classmethod
    def from_physical(
        cls, m1: float, m2: float, k1: float, k2: float, c1: float, c2: float
    ) -> QuarterCar:
        """Make the linear car.

        Parameters
        ----------
        m1, m2 : float
            Mass of wheel and body [kg].
        k1, k2 : float
            Stiffness of tyre and suspension [N/m].
        c1, c2 : float
            Damping of tyre and suspension [N s/m].
        """
        return cls(
            m1=m1,
            m2=m2,
            spring=LinearSpring(k=k2),
            damper=LinearDamper(c=c2),
            tyre=LinearTyre(k=k1, c=c1),
        )

    @property
    def functions(self) -> CarFunctions:
        """Functions of this combination of parts."""
        return _functions(*(type(each) for each in self._parts))

    @property
    def linear(self) -> bool:
        """Whether all parts are linear."""
        return all(getattr(each, "linear", False) for each in self._parts)

    @property
    def has_masses(self) -> bool:
        """True."""
        return True

    @property
    def _parts(self) -> tuple[Part, ...]:
        return self.spring, self.damper, self.tyre, self.stops
