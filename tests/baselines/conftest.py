"""Real cars and roads on which the controllers are compared."""

import numpy as np
import pytest

from qcar_env.evaluation.rollouts import rollout
from qcar_env.parts.actuator import SemiActiveDamper, SuspensionActuator
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.shapes import CircularArc
from qcar_env.scenarios import Scenario

# Ford Escort, front corner: CommonRoad vehicle models 3.0.2, parameters_vehicle1.yaml.
ESCORT = {"m1": 32.84, "m2": 345.1, "k1": 189_785.6, "k2": 21_898.0, "c1": 0.0, "c2": 1_459.4}
# Renault Megane, as the semi-active literature of Grenoble and Milano has it; damper 900 to 4300.
MEGANE = {"m1": 37.5, "m2": 315.0, "k1": 210_000.0, "k2": 29_500.0, "c1": 0.0, "c2": 0.0}
WATTS = CircularArc(h=0.1, L=3.7, start=2.0)  # LR 597


def escort(road=WATTS, speed=30.0 / 3.6, limit=2_000.0, duration=3.0, **changes):
    """Return the Escort with one actuator between the masses, by default on a Watts hump."""
    car = QuarterCar.from_physical(**ESCORT)
    given = {"actuator": SuspensionActuator(limit=limit), **changes}
    return Scenario(name="escort", car=car, road=road, speed=speed, duration=duration, **given)


def megane(road=WATTS, speed=30.0 / 3.6, c_min=900.0, c_max=4_300.0, duration=3.0, **changes):
    """Return the Megane with a semi-active damper and no other."""
    car = QuarterCar.from_physical(**MEGANE)
    given = {"actuator": SemiActiveDamper(c_min=c_min, c_max=c_max), **changes}
    return Scenario(name="megane", car=car, road=road, speed=speed, duration=duration, **given)


def rough(letter="C", seconds=10.0, speed=20.0, seed=1):
    """Return a random road of ISO 8608 long enough for so many seconds."""
    return ISO8608.of_class(letter, L=max(seconds * speed, 100.0), seed=seed)


def drive(policy, scenario, duration=None):
    """Return an episode from rest with what comfort and safety are read off."""
    kept = ("body_acceleration", "travel", "travel_rate", "tyre_load", "u2")
    return rollout(policy, scenario, duration=duration, observe=policy.reads, signals=kept)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


class Held:
    """The same action always: a passive damper."""

    reads = ("travel_rate",)

    def __init__(self, action):
        self.action = action

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), self.action, dtype=np.float32), None


@pytest.fixture
def cars():
    """What the tests of this folder drive."""

    class Cars:
        pass

    for each in (escort, megane, rough, drive, rms, Held):
        setattr(Cars, each.__name__, staticmethod(each))
    return Cars
