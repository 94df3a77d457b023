"""Scenarios as TOML and JSON, to and fro."""

import dataclasses

import pytest
from hypothesis import given, strategies as st

from qcar_env import SCENARIOS, scenario
from qcar_env.parts.actuator import LaggedSuspensionActuator
from qcar_env.parts.damper import BilinearDamper
from qcar_env.parts.sensor import Sensor
from qcar_env.parts.spring import CubicSpring, Stops, TableSpring
from qcar_env.parts.tyre import LiftOffTyre
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.measured import SampledRoad
from qcar_env.scenarios import Choice, Vary
from qcar_env.scenarios.files import from_record, from_text, to_json, to_toml, write

MADE = dataclasses.replace(
    SCENARIOS["mathworks-hump"],
    name="made",
    car=QuarterCar(
        m1=40.0,
        m2=300.0,
        spring=CubicSpring(k=2e4, k3=1e6),
        damper=BilinearDamper(c_compression=1e3, c_rebound=1.5e3, knee=0.3, fast=0.5),
        tyre=LiftOffTyre(k=2e5, c=50.0),
        stops=Stops(bump=0.08, rebound=0.08, k=4e4),
    ),
    road=SampledRoad(distances=(0.0, 1.0, 2.0, 3.0, 4.0), samples=(0.0, 0.01, 0.0, 0.02, 0.0)),
    actuator=LaggedSuspensionActuator(limit=(2e3,), lag=0.01, rate_limit=4e4),
    sensors=(Sensor(signal="body_acceleration", noise=0.1, delay=0.01),),
    randomisation=(Vary(by=Choice(values=(0.8, 1.0, 1.2)), numbers={"car.m2": 1.0}),),
)


@pytest.mark.parametrize("given_scenario", [*SCENARIOS.values(), MADE], ids=lambda each: each.name)
@pytest.mark.parametrize("to_text", [to_json, to_toml])
def test_a_scenario_comes_back_as_it_was(given_scenario, to_text):
    assert from_text(to_text(given_scenario)) == given_scenario


@given(st.floats(1e-3, 1e3), st.floats(0.1, 100.0), st.floats(1e3, 1e6))
def test_every_number_comes_back_to_the_last_bit(h, speed, k):
    changed = SCENARIOS["mathworks-hump"].replaced({"road.h": h, "car.spring.k": k})
    changed = dataclasses.replace(changed, speed=speed)
    assert from_text(to_toml(changed)) == changed
    assert from_text(to_json(changed)) == changed


def test_a_file_is_a_scenario(tmp_path):
    for name in ("own.toml", "own.json"):
        write(MADE, tmp_path / name)
        assert scenario(tmp_path / name) == MADE
        assert scenario(str(tmp_path / name)) == MADE


def test_a_class_of_ones_own_is_named_by_its_module():
    text = to_json(MADE).replace('"CubicSpring"', '"qcar_env.parts.spring:CubicSpring"')
    assert from_text(text) == MADE


def test_a_table_comes_back():
    car = dataclasses.replace(
        MADE.car, spring=TableSpring(travels=(-0.1, 0.0, 0.1), forces=(-3e3, 0.0, 2e3))
    )
    assert from_text(to_toml(dataclasses.replace(MADE, car=car))).car == car


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "no scenario can be read"),
        ("car = \n", "no scenario can be read"),
        ('{"carr": {}}', "unknown entry of scenario 'carr'; did you mean 'car'"),
        ('{"name": "x"}', "scenario lacks car, road, speed, actuator"),
        ('{"car": {"kind": "QuarterCarr"}}', "unknown kind of scenario.car"),
        ('{"car": {"kind": "nowhere:Car"}}', "which is not there"),
        ('{"car": {"kind": "math:sin"}}', "which is no part"),
    ],
)
def test_what_cannot_be_read_says_where(text, message):
    with pytest.raises(ValueError, match=message):
        from_text(text)


def test_a_record_of_another_kind_is_refused():
    with pytest.raises(ValueError, match="must be a table"):
        from_record([1, 2])


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.toml"):
        scenario(tmp_path / "none.toml")
