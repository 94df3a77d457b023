"""How an episode begins: what is drawn, and the numbers that stay the same until its end.

Plain Python, compiled where `qcar_env.engine.stepping` calls it.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from typing import Any, NamedTuple

from qcar_env.engine.random import standard

FIRST_DRAWS = 6  # uniform numbers before those of the motion, at least: as in version 0.1.0
MOTION_DRAWS = 6  # uniform numbers that state and phase at the start take
NOISE_DRAWS = 1  # of sensors, where there are any; before those of the motion

REST_SHARE = 0.25  # [-] share of the episodes that start from rest
START_RANGE = (0.01, 1.5)  # [-] of start amplitudes over the uncontrolled ones, log-uniform
LOG_START = math.log(START_RANGE[0])
LOG_RANGE = math.log(START_RANGE[1]) - math.log(START_RANGE[0])
CIRCLE = 2.0 * math.pi  # [rad]
FARTHEST = 4.0  # [standard deviations] of a normal number: 6e-5 of all lie beyond, and end there

OBSERVATION_LIMIT = 10.0  # [-] bound of every entry; travel ends an episode long before

UNIFORM, LOG_UNIFORM, NORMAL, CHOICE = range(4)  # kinds of distribution


class Force(NamedTuple):
    """External force on the body."""

    f: Any  # amplitude [m/s^2]
    Omega: Any  # angular frequency [rad/s]


class Numbers(NamedTuple):
    """The numbers of a scenario, any of which may vary from episode to episode."""

    car: Any
    road: Any
    speed: Any  # of the car [m/s]
    force: Any  # Force
    actuator: Any
    sensors: Any  # a tuple


class Reference(NamedTuple):
    """The uncontrolled motion, which scales starts and ends."""

    A1: Any  # amplitude of the wheel from which starts are drawn [m]
    A2: Any  # and of the body
    omega1: Any  # largest velocity of the wheel over A1 [1/s]
    omega2: Any  # and of the body over A2
    X1: Any  # largest displacement of the wheel [m]
    X2: Any  # and of the body
    travel: Any  # displacement that ends an episode over these [-]
    penalty: Any  # what that costs [-]


class Nominal(NamedTuple):
    """What a car draws its episodes from."""

    numbers: Any  # Numbers
    reference: Any  # Reference
    steps: Any  # control intervals in an episode [-]
    endless: Any  # 1 where the phase of the road is drawn [-]
    scales: Any  # what the entries of the observation are multiplied by
    terms: Any  # numbers of the reward's terms
    term_scales: Any  # what each term's readings are multiplied by


class Driven(NamedTuple):
    """What stays the same during an episode and moves the car: what signals read."""

    car: Any  # numbers as the car's functions take them
    road: Any  # the same of the road
    speed: Any  # [m/s]
    omega: Any  # frequency of a turning road, 0 of one that is read [rad/s]
    force: Any  # Force
    turning: Any  # Turning, of whole steps
    actuator: Any


class Read(NamedTuple):
    """What stays the same during an episode and says how the car is read and judged."""

    sensors: Any  # a tuple
    scales: Any  # see `Nominal`
    terms: Any
    term_scales: Any
    inverse_X1: Any  # [1/m]
    inverse_X2: Any
    travel: Any  # largest displacement over A [-]
    penalty: Any  # of leaving it [-]


class Clock(NamedTuple):
    """Where an episode is."""

    elapsed: Any  # control intervals since it began [-]
    last: Any  # control intervals in it [-]
    done: Any  # 1 when it is over [-]
    start: Any  # time on the road when it began [s]
    phase: Any  # phase of the road then [rad]
    kink: Any  # number of the road's next kink [-]
    next: Any  # its time [s]
    noise: Any  # number that the episode's sensor noise is made from [-]


def drawn(u: Any, how: Any) -> Any:
    """Return what a distribution makes of a number `u` from [0, 1).

    Parameters
    ----------
    u : float
        Uniform number.
    how : ndarray (k,)
        ``(UNIFORM, low, high)``, ``(LOG_UNIFORM, log low, log high)``, ``(NORMAL, mean, standard
        deviation)`` or ``(CHOICE, count, values...)``. What is normal ends at `FARTHEST`.
    """
    if how[0] == UNIFORM:
        return how[1] + (how[2] - how[1]) * u
    if how[0] == LOG_UNIFORM:
        return math.exp(how[1] + (how[2] - how[1]) * u)
    if how[0] == NORMAL:
        return how[1] + how[2] * min(max(standard(u), -FARTHEST), FARTHEST)
    return how[2 + min(int(u * how[1]), int(how[1]) - 1)]


def vary(row: Any, uniforms: Any, draws: Any, targets: Any) -> None:
    """Change the numbers in `row`, in place, by what is drawn.

    Parameters
    ----------
    row : ndarray (k,)
        Numbers of a scenario.
    uniforms : ndarray
        The first of these are drawn from.
    draws : ndarray (d, k)
        Distributions, see `drawn`.
    targets : ndarray (t, 3)
        Which draw, which number of the row, and how: 0 replaces it, any other power of what is
        drawn multiplies it.
    """
    for i in range(targets.shape[0]):
        which, index, power = int(targets[i, 0]), int(targets[i, 1]), targets[i, 2]
        value = drawn(uniforms[which], draws[which])
        if power == 0.0:
            row[index] = value
        elif power == 1.0:
            row[index] = row[index] * value
        elif power == -1.0:
            row[index] = row[index] / value
        elif power == -0.5:
            row[index] = row[index] / math.sqrt(value)
        else:
            row[index] = row[index] * value**power


def drawn_motion(uniforms: Any, first: Any, reference: Any) -> tuple[Any, Any, Any, Any]:
    """Return ``(x1, x2, v1, v2)`` at the start, from six uniform numbers from `first` on.

    A share `REST_SHARE` starts from rest; the others on each mass's own circle in the phase plane,
    its amplitude log-uniform in `START_RANGE` times the uncontrolled one.
    """
    moves = 1.0 if uniforms[first + 4] >= REST_SHARE else 0.0
    a1 = moves * math.exp(LOG_START + LOG_RANGE * uniforms[first]) * reference.A1
    a2 = moves * math.exp(LOG_START + LOG_RANGE * uniforms[first + 1]) * reference.A2
    psi1 = CIRCLE * uniforms[first + 2]
    psi2 = CIRCLE * uniforms[first + 3]
    return (
        a1 * math.cos(psi1),
        a2 * math.cos(psi2),
        -reference.omega1 * a1 * math.sin(psi1),
        -reference.omega2 * a2 * math.sin(psi2),
    )
