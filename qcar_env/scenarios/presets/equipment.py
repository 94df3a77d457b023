"""Actuators and sensors by name, with the sources of their numbers.

Each actuator's command acts 5 ms late, one sample at 200 Hz. Sources give limits and bandwidths;
rates and powers that are not said to be published are chosen here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from qcar_env.parts.actuator import (
    Actuator,
    LaggedSemiActiveDamper,
    LaggedSuspensionActuator,
    SuspensionActuator,
)
from qcar_env.parts.sensor import Sensor
from qcar_env.validation import known, positive

DELAY = 0.005  # [s] of every command, chosen here
# Least and largest damping of the Megane's semi-active damper over its passive one (Poussot-Vassal
# et al.; recalled, not checked).
VALVE = 900.0 / 1_500.0, 4_300.0 / 1_500.0

ACTUATORS: Mapping[str, tuple[str, Callable[[float], Actuator]]] = MappingProxyType(
    {
        "ideal": (
            "2 kN at once: what theory has",
            lambda c: SuspensionActuator(limit=(2_000.0,)),
        ),
        "em": (
            "electromagnetic: 2 kN, 40 kN/s, 5 ms, 2 kW; between the continuous and the peak force "
            "of Gysen et al., IEEE Trans. Vehicular Technology 59(3), 2010 (recalled)",
            lambda c: LaggedSuspensionActuator(
                limit=(2_000.0,), lag=0.005, rate_limit=40e3, power=2e3, delay=DELAY
            ),
        ),
        "abc": (
            "hydraulic of 1999: 5 kN, first order at 5 Hz (Mercedes ABC's bandwidth)",
            lambda c: LaggedSuspensionActuator(limit=(5_000.0,), lag=0.032, delay=DELAY),
        ),
        "eabc": (
            "hydraulic with a motor pump (Mercedes E-ABC): 5 kN, 16 ms",
            lambda c: LaggedSuspensionActuator(limit=(5_000.0,), lag=0.016, delay=DELAY),
        ),
        "electromech": (
            "electromechanical (Audi A8): 1.1 kN m on an arm of 0.35 m, assumed, 30 ms, 6 kW",
            lambda c: LaggedSuspensionActuator(
                limit=(1_100.0 / 0.35,), lag=0.030, power=6e3, delay=DELAY
            ),
        ),
        "mr": (
            "magnetorheological damper: 0.6 to 2.9 times the car's own damping, 8 ms",
            lambda c: LaggedSemiActiveDamper(
                c_min=VALVE[0] * c, c_max=VALVE[1] * c, lag=0.008, delay=DELAY
            ),
        ),
        "cdc": (
            "damper with a valve: the same range, 15 ms",
            lambda c: LaggedSemiActiveDamper(
                c_min=VALVE[0] * c, c_max=VALVE[1] * c, lag=0.015, delay=DELAY
            ),
        ),
    }
)

SENSORS: Mapping[str, tuple[str, tuple[Sensor, ...]]] = MappingProxyType(
    {
        "ideal": ("true values", ()),
        "production": (
            "accelerometers of 0.03 m/s^2 on the body (16 m/s^2, 50 Hz) and 0.3 m/s^2 on the wheel "
            "(120 m/s^2, 200 Hz), a height sensor of 0.5 mm in steps of 0.2 mm; noise after "
            "datasheets of automotive sensors, chosen here within their range",
            (
                Sensor(signal="body_acceleration", noise=0.03, range=16.0, cutoff=50.0),
                Sensor(signal="wheel_acceleration", noise=0.3, range=120.0, cutoff=200.0),
                Sensor(signal="travel", noise=0.5e-3, range=0.1, resolution=0.2e-3),
            ),
        ),
    }
)


def actuator(name: str, *, damping: float = 1_500.0) -> Actuator:
    """Return an actuator by its name.

    Parameters
    ----------
    name : str
        One of `ACTUATORS`.
    damping : float
        Damping of the car's own damper [N s/m]; a semi-active one takes its place and is rated by
        it.

    Raises
    ------
    ValueError
        If there is no such actuator.
    """
    return ACTUATORS[known("actuator", name, ACTUATORS)][1](positive("damping", damping, "N s/m"))


def sensors(name: str) -> tuple[Sensor, ...]:
    """Return a set of sensors by its name, one of `SENSORS`.

    Raises
    ------
    ValueError
        If there is no such set.
    """
    return SENSORS[known("set of sensors", name, SENSORS)][1]
