"""Presets with the sources of their numbers: the paper's scenarios, cars, humps, equipment.

scenario = over_hump("escort", "watts", speed=30.0 / 3.6, actuator="em", sensors="production")
"""

from qcar_env.scenarios.presets.cars import CARS, CarPreset, car
from qcar_env.scenarios.presets.city import over_hump
from qcar_env.scenarios.presets.equipment import ACTUATORS, SENSORS, actuator, sensors
from qcar_env.scenarios.presets.humps import HUMPS, HumpPreset, hump
from qcar_env.scenarios.presets.paper import (
    PAPER_ACTUATOR,
    PAPER_CAR,
    PAPER_FORCE,
    PAPER_ROAD,
    PAPER_SPEED,
    SCENARIOS,
)

__all__ = [
    "ACTUATORS",
    "CARS",
    "HUMPS",
    "PAPER_ACTUATOR",
    "PAPER_CAR",
    "PAPER_FORCE",
    "PAPER_ROAD",
    "PAPER_SPEED",
    "SCENARIOS",
    "SENSORS",
    "CarPreset",
    "HumpPreset",
    "actuator",
    "car",
    "hump",
    "over_hump",
    "sensors",
]
