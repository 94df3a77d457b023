"""A car over a hump, from presets."""

from __future__ import annotations

import dataclasses
import math

from qcar_env.parts.actuator import LaggedSemiActiveDamper
from qcar_env.parts.damper import LinearDamper
from qcar_env.roads.enveloping import moving_average
from qcar_env.roads.profile import Road
from qcar_env.scenarios.presets import cars, equipment, humps
from qcar_env.scenarios.scenario import Scenario
from qcar_env.validation import known, non_negative, positive

CONTACT = 0.25  # [m] over which a tyre averages the road, as in the International Roughness Index
RUN_UP = 0.5  # [s] before the hump
AFTER = 3.0  # [s] after it: four of the slowest car's periods
DT = 0.005  # [s]


def over_hump(
    car: str,
    hump: str,
    *,
    speed: float | None = None,
    actuator: str = "em",
    sensors: str = "ideal",
    load: str = "empty",
    contact: float = CONTACT,
    stops: bool = True,
    lift_off: bool = True,
) -> Scenario:
    """Return a scenario of a car that drives over a hump.

    Parameters
    ----------
    car, hump, actuator, sensors : str
        Names of presets. A semi-active damper takes the place of the car's own.
    speed : float, optional
        Speed [m/s]; without it the one that the hump is made for.
    load : str
        ``"empty"`` or ``"laden"``.
    contact : float
        Length over which the tyre averages the road [m]; 0 for a point.
    stops, lift_off : bool
        Whether travel ends at stops, and the tyre can lift off; a car with neither is linear.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of range.

    Notes
    -----
    A quarter car overstates a car's peaks on a hump, as it does not pitch: a sinusoidal hump of
    4.8 m x 120 mm gave 0.5 g at the driver at 30 km/h (Belgian Road Research Centre), quarter cars
    give 0.8 to 1.0 g. Not validated against a measured crossing.
    """
    made = cars.car(car, load=load, stops=stops, lift_off=lift_off)
    preset = humps.HUMPS[known("hump", hump, humps.HUMPS)]
    v = preset.speed if speed is None else positive("speed", speed, "m/s")
    half = 0.5 * non_negative("contact", contact, "m")
    start = RUN_UP * v + half
    shape = humps.hump(hump, start=start)
    road: Road = moving_average(shape, contact=contact) if contact > 0.0 else shape
    damping = getattr(made.damper, "c", 1_500.0)
    pushes = equipment.actuator(actuator, damping=damping)
    if isinstance(pushes, LaggedSemiActiveDamper):
        made = dataclasses.replace(made, damper=LinearDamper(c=0.0))
    end = (start + shape.extent + half) / v + AFTER
    return Scenario(
        name=f"{car}-{hump}",
        title=f"{cars.CARS[car].title}, over: {preset.title}, at {3.6 * v:.3g} km/h",
        source=f"{cars.CARS[car].source}. {preset.source}",
        car=made,
        road=road,
        speed=v,
        actuator=pushes,
        sensors=equipment.sensors(sensors),
        dt=DT,
        duration=DT * math.ceil(end / DT),
    )
