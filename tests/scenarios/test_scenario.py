"""Presets, and the checks of a scenario's numbers, alone and against each other."""

import dataclasses
import math
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st

import qcar_env
from qcar_env import SCENARIOS, scenario
from qcar_env.parts.actuator import (
    IndependentActuators,
    LaggedSuspensionActuator,
    SuspensionActuator,
)
from qcar_env.parts.sensor import Sensor
from qcar_env.physics import linear
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.rk4 import STABILITY_LIMIT
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.shapes import Sine
from qcar_env.scenarios import Scales, Scenario, Uniform, Vary

PAPER, HUMP = scenario("paper"), scenario("mathworks-hump")


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_a_preset_knows_its_name_and_source_and_warns_of_nothing(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = dataclasses.replace(SCENARIOS[name])  # checks once more
    assert found.name == name
    assert found.title
    assert found.source
    assert scenario(name) is SCENARIOS[name]
    assert scenario(found) is found


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
    """Preset `paper` of equations.md."""
    assert tuple(PAPER.car.numbers) == (55.0, 55.0, 8.7, 0.71, 0.5, 3.4, 0.5, 2510.0, 16.0)
    road, force = PAPER.excitation, PAPER.force
    assert (road.h, road.omega, force.f, force.Omega) == (0.1, 55.0, 24.8, 55.0)
    assert PAPER.actuator.limit == (280.0, 33.0)


def test_every_real_car_has_its_body_far_below_its_wheel():
    """Every printed car has omega1 / omega2 between 7.5 and 17."""
    for each in SCENARIOS.values():
        if each.car.has_masses:
            body, wheel = linear.modes(each.car)
            assert 7.0 < wheel.frequency / body.frequency < 17.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 0.0}, "dt must be positive, got 0 s"),
        ({"dt": math.nan}, "dt must be finite, got nan s"),
        ({"substeps": 0}, "substeps must be at least 1, got 0"),
        ({"substeps": 2.5}, "substeps must be a whole number, got 2.5"),
        ({"substeps": 10**9}, "substeps must be at most 1000000, got 1000000000"),
        ({"duration": -1.0}, "duration must be positive, got -1 s"),
        ({"duration": 0.001}, "duration must hold a control interval, got 0.001 s .* give 0.005 s"),
        ({"duration": 1e300}, r"duration must be at most 9.0e\+15 control intervals, got 1e\+300"),
        ({"dt": 1e-320}, r"duration must be at most 9.0e\+15 control intervals, got 5 s"),
        ({"travel_limit": 0.0}, "travel_limit must be positive, got 0"),
        ({"speed": -1.0}, "speed must be positive, got -1 m/s"),
        ({"speed": 0.0}, "speed must be positive, got 0 m/s"),
        ({"car": None}, "car must be a PaperCar or a QuarterCar, got None; give such an object"),
        ({"road": "hump"}, "road must be of class Road, got 'hump'; give such an object"),
        ({"force": 24.8}, "force must be of class ExternalForce, got 24.8"),
        ({"actuator": (280.0, 33.0)}, r"actuator must be of class Actuator, got \(280.0, 33.0\)"),
        ({"scales": 1.0}, "scales must be of class Scales, got 1.0"),
        ({"randomisation": ("road.h",)}, "randomisation must be of class Vary, got 'road.h'"),
        ({"dt": np.ones(2)}, r"dt must be a number in s, got array\(\[1., 1.\]\); give a finite"),
        (
            {"actuator": SuspensionActuator(limit=(1000.0,))},
            "an actuator rated in newtons needs a car with masses, got a PaperCar; make the car",
        ),
        ({"sensors": ("x1",)}, "sensor must be of class Sensor"),
        ({"sensors": (Sensor(signal="x1"), Sensor(signal="x1"))}, "different signals"),
        ({"sensors": (Sensor(signal="x1", delay=0.0072),)}, "whole number of control intervals"),
        ({"actuator": IndependentActuators(limit=(1.0, 1.0), delay=0.004)}, "control intervals"),
        (
            {"randomisation": Vary(by=Uniform(low=1.0, high=2.0), numbers="actuator.delay")},
            "the same in all episodes",
        ),
        (
            {"randomisation": Vary(by=Uniform(low=1, high=2), numbers=("road.hight",))},
            r"unknown number of the scenario 'road.hight'; did you mean 'road.h",
        ),
    ],
)
def test_the_numbers_of_a_scenario_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(PAPER, **changes)


@pytest.mark.parametrize(("duration", "steps"), [(5.0, 1000), (0.005, 1), (0.3, 60), (0.7, 140)])
def test_an_episode_holds_the_intervals_that_its_duration_says(duration, steps):
    """0.3 / 0.005 is 59.99... in floating point."""
    assert dataclasses.replace(PAPER, duration=duration).steps == steps


@pytest.mark.parametrize("kind", [list, np.array])
@pytest.mark.parametrize("number", [np.array, np.float64, np.float32])
def test_a_scenario_of_lists_and_numpys_numbers_is_the_one_of_plain_ones(kind, number):
    """Equal, as a key, as text and after a round trip through pickle."""
    other = dataclasses.replace(
        PAPER,
        actuator=dataclasses.replace(PAPER.actuator, limit=kind([280.0, 33.0])),
        randomisation=[],
        duration=number(5),
        substeps=number(4),
        travel_limit=number(3),
        speed=number(8),
    )
    for each in (other, pickle.loads(pickle.dumps(other)), dataclasses.replace(other)):
        assert (each, hash(each), repr(each)) == (PAPER, hash(PAPER), repr(PAPER))
    assert (type(other.substeps), type(other.duration)) == (int, float)


# Steps -------------------------------------------------------------------------------------------


@given(car=st.from_type(PaperCar) | st.from_type(QuarterCar), over=st.floats(1.01, 10.0))
def test_a_step_at_which_rk4_diverges_is_refused_with_the_largest_that_does_not(car, over):
    fastest = float(np.max(np.abs(np.linalg.eigvals(linear.jacobian(car)))))
    limit = STABILITY_LIMIT / fastest
    message = rf"step must be below {limit:.3g} s for this car, got {over * limit:.3g} s"

    def made(step):
        return Scenario(
            car=car,
            road=PAPER.road,
            speed=8.0,
            actuator=PAPER.actuator,
            dt=step,
            substeps=1,
            duration=2.0 * step,
        )

    with pytest.raises(ValueError, match=message):
        made(over * limit)
    with pytest.warns(UserWarning, match="is coarse for this car"):
        made(0.99 * limit)
    made(0.18 * limit)  # 0.47 of the allowed 2.6


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


def test_a_step_too_long_for_the_actuators_lag_is_refused():
    slow = LaggedSuspensionActuator(limit=(1000.0,), lag=0.01)
    dataclasses.replace(HUMP, actuator=slow)
    with pytest.raises(ValueError, match=r"integration step must be below 0\.00026 s"):
        dataclasses.replace(HUMP, actuator=dataclasses.replace(slow, lag=1e-4))


# Numbers by their paths --------------------------------------------------------------------------


def test_numbers_are_replaced_by_their_paths():
    found = HUMP.replaced({"car.m2": 400.0, "car.spring.k": 2e4, "actuator.limit.0": 9.0})
    assert (found.car.m2, found.car.spring.k, found.actuator.limit) == (400.0, 2e4, (9.0,))
    assert dataclasses.replace(found, car=HUMP.car, actuator=HUMP.actuator) == HUMP
    assert PAPER.replaced({"speed": 4.0, "force.f": 1.0}).excitation.omega == 27.5


@pytest.mark.parametrize(
    ("path", "nearest"), [("car.m3", "car.m2"), ("road.hh", "road.h"), ("sped", "speed")]
)
def test_an_unknown_path_gets_the_nearest_one(path, nearest):
    with pytest.raises(ValueError, match=f"unknown number of the scenario '{path}'; did you mean"):
        HUMP.replaced({path: 1.0})


def test_a_replaced_number_is_checked():
    with pytest.raises(ValueError, match="mass of the body m2 must be positive, got -1 kg"):
        HUMP.replaced({"car.m2": -1.0})


def test_numbers_that_a_table_was_made_from_cannot_vary():
    """They would be accepted, and change nothing: the table is that of the nominal road."""
    road = ISO8608.of_class("C", L=100.0, seed=1)
    vary = Vary(by=Uniform(low=0.5, high=2.0), numbers=("road.G",))
    with pytest.raises(ValueError, match=r"unknown number of the scenario 'road.G'"):
        dataclasses.replace(HUMP, road=road, randomisation=vary)


@given(scale=st.floats(1e-3, 1e3))
def test_a_force_scale_multiplies_the_limits_and_nothing_else(scale):
    found = PAPER.with_force_scale(scale)
    assert found.actuator.limit == (280.0 * scale, 33.0 * scale)
    assert dataclasses.replace(found, actuator=PAPER.actuator) == PAPER


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan])
def test_a_force_scale_must_be_positive(scale):
    with pytest.raises(ValueError, match=f"force scale must be .*, got {scale:g}"):
        PAPER.with_force_scale(scale)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A1": 0.0}, "scale A1 must be positive, got 0 m"),
        ({"omega2": -1.0}, "scale omega2 must be positive, got -1 rad/s"),
        ({"others": {"y": -0.1}}, "scale of y must not be negative, got -0.1"),
    ],
)
def test_stated_scales_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        Scales(**{"A1": 1.0, "A2": 1.0, "omega1": 1.0, "omega2": 1.0, **changes})


def test_the_road_and_the_speed_make_the_excitation():
    found = dataclasses.replace(PAPER, road=Sine(h=0.02, wavenumber=3.0), speed=5.0).excitation
    assert (found.h, found.omega, found.harmonic) == (0.02, 15.0, True)
