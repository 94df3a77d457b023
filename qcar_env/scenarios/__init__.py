"""Scenarios: car, road, speed, external force, actuator and what varies, with their sources."""

from qcar_env.scenarios.files import scenario
from qcar_env.scenarios.presets import (
    PAPER_ACTUATOR,
    PAPER_CAR,
    PAPER_FORCE,
    PAPER_ROAD,
    PAPER_SPEED,
    SCENARIOS,
)
from qcar_env.scenarios.randomise import Choice, LogUniform, Normal, Uniform, Vary
from qcar_env.scenarios.reference import Scales
from qcar_env.scenarios.scenario import Scenario

__all__ = [
    "PAPER_ACTUATOR",
    "PAPER_CAR",
    "PAPER_FORCE",
    "PAPER_ROAD",
    "PAPER_SPEED",
    "SCENARIOS",
    "Choice",
    "LogUniform",
    "Normal",
    "Scales",
    "Scenario",
    "Uniform",
    "Vary",
    "scenario",
]
