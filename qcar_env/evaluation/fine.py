"""The motion between the control instants, from what is kept at them.

A rollout keeps states and acceleration at the end of each control interval. In between, the body's
acceleration is taken as the parabola that ends with the kept one and moves the body as far, and
makes it as fast, as the states say: three conditions, and no assumption of how the interval begins,
as an actuator's force may jump there. The displacements are the cubics through both ends (Hermite);
the road is the scenario's own, at every instant; the tyre's load follows from both.

What that is worth: see `qcar_env.evaluation.ride`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.evaluation.rollouts import Rollout
from qcar_env.parts.part import Nothing
from qcar_env.physics.car import GRAVITY, QuarterCar

Array = NDArray[np.float64]

PARTS = 8  # of a control interval, chosen here: 1600 Hz at 200 Hz
FINE_SIGNALS = ("body_acceleration",)  # that a rollout must keep


@dataclass(frozen=True, kw_only=True)
class Fine:
    """A motion at both ends of each control interval and in the middle of its equal parts.

    Arrays have a row for each interval and `PARTS` + 2 columns; what jumps at a control instant has
    there the value before in the last column, and the value after in the first one of the next row.
    """

    dt: float  # length of a part [s]
    t: Array  # time since the start [s]
    acceleration: Array  # of the body [m/s^2]
    x1: Array  # [m]
    travel: Array  # x2 - x1 [m]
    travel_rate: Array  # [m/s]
    y: Array  # height of the road [m]
    load: Array  # force between tyre and road [N]
    static: float  # the same at rest [N]
    force: Array  # of the actuator on the body, and against the wheel [N]


def middles(values: Array) -> Array:
    """Return values in the middle of the parts, evenly spaced, (k * PARTS,) of (k, PARTS + 2)."""
    return values[:, 1:-1].ravel()


def fine(rollout: Rollout) -> Fine:
    """Return the motion between the control instants.

    Parameters
    ----------
    rollout : Rollout
        With the signal `body_acceleration`, of a `QuarterCar` whose actuator pushes between the
        masses.

    Raises
    ------
    ValueError
        If the signal was not kept, the car has no masses or the actuator pushes against the ground.
    """
    car = measurable(rollout, FINE_SIGNALS)
    scenario = rollout.scenario
    h = scenario.dt
    x1, x2, v1, v2 = (
        np.concatenate([[before], each])
        for before, each in zip(
            rollout.before, (rollout.x1, rollout.x2, rollout.v1, rollout.v2), strict=True
        )
    )
    s = np.concatenate([[0.0], (np.arange(PARTS) + 0.5) / PARTS, [1.0]])  # of an interval
    last = np.asarray(rollout.signals["body_acceleration"], dtype=np.float64)
    mean = np.diff(v2) / h - last
    moment = (np.diff(x2) / h - v2[:-1]) / h - 0.5 * last
    # a = last + b (1 - s) + c (1 - s)^2 with the integrals b / 2 + c / 3 and b / 3 + c / 4
    b, c = 18.0 * mean - 24.0 * moment, 36.0 * moment - 24.0 * mean
    left = 1.0 - s
    wheel, wheel_rate = cubic(x1, v1, h, s)
    travel, travel_rate = cubic(x2 - x1, v2 - v1, h, s)
    t = rollout.t[:, np.newaxis] - h * left
    on = scenario.excitation
    when = t + (rollout.phase / on.omega if on.harmonic else 0.0)
    y, y_dot = on.height(when.ravel()).reshape(t.shape), on.rate(when.ravel()).reshape(t.shape)
    tyre, static = car.tyre, (car.m1 + car.m2) * GRAVITY
    kind: Any = type(tyre)
    load = static + kind.force(y - wheel, y_dot - wheel_rate, static, tyre.numbers)
    return Fine(
        dt=h / PARTS,
        t=t,
        acceleration=last[:, np.newaxis] + np.outer(b, left) + np.outer(c, left * left),
        x1=wheel,
        travel=travel,
        travel_rate=travel_rate,
        y=y,
        load=load,
        static=static,
        force=_force(rollout, s),
    )


def measurable(rollout: Rollout, signals: Sequence[str]) -> Any:
    """Return the car of a rollout that kept signals, if it is a `QuarterCar`.

    Raises
    ------
    ValueError
        If a signal was not kept, the car has no masses or the actuator pushes against the ground.
    """
    car, actuator = rollout.scenario.car, rollout.scenario.actuator
    if not isinstance(car, QuarterCar) or actuator.unit != "N":
        raise ValueError(
            f"the car must have masses and an actuator in newtons, got {type(car).__name__} with "
            f"{type(actuator).__name__}; give a QuarterCar with a SuspensionActuator"
        )
    if any(name not in rollout.signals for name in signals):
        raise ValueError(
            f"the rollout must keep {', '.join(signals)}, got "
            f"{', '.join(rollout.signals) or 'none'}; roll out with signals={tuple(signals)}"
        )
    return car


def _force(rollout: Rollout, s: Array) -> Array:
    """Return the force in an interval: held, or on the line between those at its ends."""
    actuator, end = rollout.scenario.actuator, rollout.force[:, -1:]
    if actuator.linear and actuator.State is Nothing:
        return np.repeat(end, len(s), axis=1)
    begin = np.concatenate([end[:1], end[:-1]])
    return begin + (end - begin) * s


def cubic(x: Array, v: Array, h: float, s: Array) -> tuple[Array, Array]:
    """Return values and rates (k, len(s)) of the cubics through ends (k + 1,) at shares `s`."""
    x0, a, b = x[:-1, np.newaxis], h * v[:-1, np.newaxis], h * v[1:, np.newaxis]
    rise = x[1:, np.newaxis] - x0
    c2, c3 = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    return x0 + s * (a + s * (c2 + s * c3)), (a + s * (2.0 * c2 + 3.0 * s * c3)) / h
