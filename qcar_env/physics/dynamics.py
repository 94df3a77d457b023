"""Equations of motion of the quarter car, written once.

(3)  x1'' + omega1^2 x1 + b1 x1' - E2 x2' - E1 x2 = mu1 y + mu2 y' + u1
(4)  x2'' + omega2^2 x2 - b2 (x1' - x2') - E3 x1  = F + u2

after Alluhydan et al., Mathematics 2024, 12(19), 3046, with ``y = h sin(omega t)`` on the
paper's road and ``F = f cos(Omega t)``. Signs: see `qcar_env.physics.state`.

The functions are branch-free arithmetic on named tuples: the same source runs on floats, numpy
arrays ``(n,)``, torch tensors and inside numba, and gives the same bits on all of them. For that
reason they contain no power operator, no library call and no literal.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from qcar_env.physics.state import State


class Forcing(NamedTuple):
    """What the world does to the car at one instant."""

    road: Any  # specific force of the road on the wheel, ``mu1 y + mu2 y'`` [m/s^2]
    F: Any  # external specific force on the body [m/s^2]


class Coefficients(NamedTuple):
    """The nine coefficients of (3)-(4), as plain entries for compiled code.

    A `qcar_env.physics.car.QuarterCar` has the same attributes and serves as well.
    """

    omega1: Any  # natural frequency of the wheel [rad/s]
    omega2: Any  # natural frequency of the body [rad/s]
    b1: Any  # damping of the wheel [1/s]
    b2: Any  # damping of the body [1/s]
    E1: Any  # spring coupling on the wheel [1/s^2]
    E2: Any  # damper coupling on the wheel [1/s]
    E3: Any  # spring coupling on the body [1/s^2]
    mu1: Any  # tyre stiffness per wheel mass [1/s^2]
    mu2: Any  # tyre damping per wheel mass [1/s]


def forcing_by(y: Any, y_dot: Any, F: Any, car: Any) -> Forcing:
    """Return the forcing of a car by road and external force.

    Parameters
    ----------
    y : float or array (n,)
        Road height under the tyre [m].
    y_dot : float or array (n,)
        Its rate as the car moves over it [m/s].
    F : float or array (n,)
        External specific force on the body [m/s^2].
    car : Coefficients or QuarterCar
        Coefficients of the plant.
    """
    return Forcing(car.mu1 * y + car.mu2 * y_dot, F)


def accelerations(x: Any, u1: Any, u2: Any, forcing: Any, car: Any) -> tuple[Any, Any]:
    """Return the accelerations of wheel and body.

    Parameters
    ----------
    x : State
        State of the plant, entries float or array (n,).
    u1, u2 : float or array (n,)
        Specific actuator forces on wheel and body [m/s^2].
    forcing : Forcing
        What road and external force do at the same instant.
    car : Coefficients or QuarterCar
        Coefficients of the plant.

    Returns
    -------
    tuple
        ``(x1'', x2'')`` [m/s^2].
    """
    spring1 = car.omega1 * car.omega1 * x.x1 - car.E1 * x.x2
    damper1 = car.b1 * x.v1 - car.E2 * x.v2
    spring2 = car.omega2 * car.omega2 * x.x2 - car.E3 * x.x1
    damper2 = car.b2 * (x.v2 - x.v1)
    dv1 = forcing.road + u1 - spring1 - damper1  # (3)
    dv2 = forcing.F + u2 - spring2 - damper2  # (4)
    return dv1, dv2


def rate(x: Any, forcing: Any, u1: Any, u2: Any, car: Any) -> State:
    """Return the time derivative of the state under held actuator forces.

    Parameters and errors as `accelerations`.

    Returns
    -------
    State
        ``(v1, v2, x1'', x2'')``.
    """
    dv1, dv2 = accelerations(x, u1, u2, forcing, car)
    return State(x.v1, x.v2, dv1, dv2)
