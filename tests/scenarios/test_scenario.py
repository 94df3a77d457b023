"""Presets, and the checks of a scenario's numbers, alone and against each other."""

import dataclasses
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

import qcar_env
from qcar_env import SCENARIOS, scenario
from qcar_env.parts.actuator import IndependentActuators, SuspensionActuator
from qcar_env.parts.sensor import Sensor
from qcar_env.physics import linear
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.rk4 import STABILITY_LIMIT
from qcar_env.roads.shapes import HalfSine, Sine
from qcar_env.scenarios import Scenario, Uniform, Vary

PAPER = scenario("paper")
HUMP = scenario("mathworks-hump")


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_a_preset_knows_its_name_and_source_and_warns_of_nothing(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = dataclasses.replace(SCENARIOS[name])  # checks once more
    assert (found.name, bool(found.title), bool(found.source)) == (name, True, True)
    assert scenario(name) is SCENARIOS[name]
    assert scenario(found) is found
    assert pickle.loads(pickle.dumps(found)) == found


def test_the_presets_cannot_be_changed():
    with pytest.raises(TypeError):
        qcar_env.SCENARIOS["paper"] = PAPER
    with pytest.raises(dataclasses.FrozenInstanceError):
        PAPER.dt = 0.01


@pytest.mark.parametrize("name", ["papr", "Paper", "paperr"])
def test_an_unknown_scenario_gets_the_nearest_name_and_the_list(name):
    message = rf"unknown scenario '{name}'; did you mean 'paper'\? Known: .*mathworks-hump.*paper"
    with pytest.raises(ValueError, match=message):
        scenario(name)


def test_the_papers_preset_is_the_calibrated_one():
    """Preset `paper` of equations.md; the speed is such that omega is 55 rad/s to the last bit."""
    car, road, force = PAPER.car, PAPER.excitation, PAPER.force
    assert tuple(car.numbers) == (55.0, 55.0, 8.7, 0.71, 0.5, 3.4, 0.5, 2510.0, 16.0)
    assert (road.h, road.omega, force.f, force.Omega) == (0.1, 55.0, 24.8, 55.0)
    assert PAPER.actuator.limit == (280.0, 33.0)


@given(st.floats(0.1, 10.0))
def test_a_force_scale_multiplies_the_limits_and_nothing_else(scale):
    scaled = PAPER.with_force_scale(scale)
    assert scaled.actuator.limit == (scale * 280.0, scale * 33.0)
    assert dataclasses.replace(scaled, actuator=PAPER.actuator) == PAPER


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speed": -1.0}, "speed must be positive, got -1"),
        ({"dt": 0.0}, "dt must be positive"),
        ({"substeps": 0}, "substeps must be"),
        ({"duration": 0.001}, "duration must hold a control interval"),
        ({"travel_limit": float("nan")}, "travel_limit"),
        ({"car": 3.0}, "car must be a PaperCar or a QuarterCar"),
        ({"road": "flat"}, "road must be of class Road"),
        ({"actuator": 5.0}, "actuator must be of class Actuator"),
        ({"sensors": ("x1",)}, "sensor must be of class Sensor"),
        ({"sensors": (Sensor(signal="x1"), Sensor(signal="x1"))}, "different signals"),
        ({"sensors": (Sensor(signal="x1", delay=0.0072),)}, "whole number of control intervals"),
        ({"actuator": IndependentActuators(limit=(1.0, 1.0), delay=0.004)}, "control intervals"),
        ({"actuator": SuspensionActuator(limit=(1.0,))}, "needs a car with masses"),
        ({"randomisation": Vary(by=Uniform(low=1.0, high=2.0), numbers="road.hh")}, "road.hh"),
        (
            {"randomisation": Vary(by=Uniform(low=1.0, high=2.0), numbers="actuator.delay")},
            "the same in all episodes",
        ),
    ],
)
def test_the_numbers_of_a_scenario_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(PAPER, **changes)


@given(st.floats(1.01, 3.0))
def test_a_step_at_which_rk4_diverges_is_refused_with_the_largest_that_does_not(over):
    fastest = np.abs(linear.poles(HUMP.car)).max()
    with pytest.raises(ValueError, match="integration step must be below"):
        dataclasses.replace(HUMP, dt=over * STABILITY_LIMIT / fastest, substeps=1)


def test_a_refused_step_does_diverge_and_the_limit_does_not():
    car = PaperCar.from_physical(m1=40.0, m2=300.0, k1=2e5, k2=2e4, c1=0.0, c2=1e3)
    fastest = np.abs(linear.poles(car)).max()

    def growth(factor: float) -> float:
        step = linear.rk4_transition(
            car, HUMP.excitation, ExternalForce(), factor * STABILITY_LIMIT / fastest, 1
        )
        return float(np.abs(np.linalg.eigvals(step.A)).max())

    assert growth(1.0) < 1.0
    assert growth(1.2) > 1.0


@given(st.integers(1, 400))
def test_an_episode_holds_the_intervals_that_its_duration_says(steps):
    assert dataclasses.replace(PAPER, duration=steps * PAPER.dt).steps == steps


def test_any_number_is_replaced_by_its_path():
    found = HUMP.replaced({"car.m2": 350.0, "car.spring.k": 2e4, "road.h": 0.08, "speed": 4.0})
    assert (found.car.m2, found.car.spring.k) == (350.0, 2e4)
    assert (found.road.h, found.speed) == (0.08, 4.0)
    assert found.replaced({"actuator.limit.0": 2e3}).actuator.limit == (2e3,)
    with pytest.raises(ValueError, match=r"unknown number of the scenario 'car\.m3'"):
        HUMP.replaced({"car.m3": 1.0})


def test_an_own_car_needs_no_more_than_its_parts():
    car = QuarterCar.from_physical(m1=32.84, m2=345.1, k1=189785.6, k2=21898.0, c1=0.0, c2=1459.4)
    made = Scenario(
        car=car,
        road=HalfSine.of_length(h=0.1, L=3.7, start=2.0),
        speed=30 / 3.6,
        actuator=SuspensionActuator(limit=(1e3,)),
        duration=1.0,
    )
    assert made.reference.scales["body_acceleration"] > 1.0
    harmonic = dataclasses.replace(made, road=Sine(h=0.01, wavenumber=2.0))
    steady = linear.steady_state(car, harmonic.excitation, ExternalForce()).amplitudes
    assert harmonic.reference_amplitudes == steady
