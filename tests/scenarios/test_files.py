"""Scenarios as TOML and JSON: to and fro without a change, and errors that say where."""

import dataclasses
import json
from dataclasses import dataclass

import pytest
from hypothesis import given, strategies as st

from qcar_env import SCENARIOS, scenario
from qcar_env.parts.actuator import LaggedSuspensionActuator, SemiActiveDamper, SuspensionActuator
from qcar_env.parts.damper import BilinearDamper, LinearDamper
from qcar_env.parts.part import number
from qcar_env.parts.sensor import Sensor
from qcar_env.parts.spring import CubicSpring, LinearSpring, NoStops, Stops
from qcar_env.parts.tyre import LiftOffTyre, LinearTyre
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads import shapes
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.measured import SampledRoad
from qcar_env.roads.train import Train
from qcar_env.scenarios import Choice, LogUniform, Normal, Scales, Scenario, Uniform, Vary, files
from qcar_env.validation import positive

PAPER, HUMP = scenario("paper"), scenario("mathworks-hump")
WRITERS = {"json": files.to_json, "toml": files.to_toml}


def between(low, high):
    return st.floats(low, high, allow_subnormal=False)


CARS = st.builds(
    QuarterCar,
    m1=between(30.0, 60.0),
    m2=between(200.0, 600.0),
    spring=st.builds(LinearSpring, k=between(1e4, 5e4))
    | st.builds(CubicSpring, k=between(1e4, 5e4), k3=between(-1e5, 1e6)),
    damper=st.builds(LinearDamper, c=between(0.0, 3e3))
    | st.builds(
        BilinearDamper,
        c_compression=between(1.0, 2e3),
        c_rebound=between(1.0, 2e3),
        knee=between(0.1, 0.5),
        fast=between(0.0, 2.0),
    ),
    tyre=st.builds(LinearTyre, k=between(1e5, 3e5)) | st.builds(LiftOffTyre, k=between(1e5, 3e5)),
    stops=st.builds(NoStops)
    | st.builds(Stops, bump=between(0.05, 0.1), rebound=between(0.05, 0.1), k=between(0.0, 1e5)),
)
HALF_SINES = st.builds(shapes.HalfSine, h=between(-0.2, 0.2), wavenumber=between(0.1, 9.0))
ROADS = st.one_of(
    HALF_SINES,
    st.builds(shapes.Sine, h=between(-0.2, 0.2), wavenumber=between(0.1, 9.0)),
    st.builds(shapes.OneMinusCosine, h=between(-0.2, 0.2), L=between(0.5, 9.0)),
    st.builds(Train, shape=HALF_SINES, count=st.integers(1, 9), gap=between(0.0, 9.0)),
    st.builds(ISO8608, G=between(1e-6, 1e-4), L=between(91.0, 200.0), seed=st.integers(0, 99)),
    st.builds(
        SampledRoad,
        distances=st.just((0.0, 1.0, 2.0, 3.0)),
        samples=st.tuples(*[between(-0.1, 0.1)] * 4),
    ),
)
ACTUATORS = st.one_of(
    st.builds(SuspensionActuator, limit=st.tuples(between(1.0, 1e4))),
    st.builds(
        LaggedSuspensionActuator, limit=st.tuples(between(1e3, 1e4)), lag=between(0.005, 0.1)
    ),
    st.builds(SemiActiveDamper, c_min=between(0.0, 100.0), c_max=between(200.0, 5e3)),
)
DISTRIBUTIONS = st.one_of(
    st.builds(Uniform, low=between(0.5, 1.0), high=between(1.0, 2.0)),
    st.builds(LogUniform, low=between(0.5, 1.0), high=between(1.0, 2.0)),
    st.builds(Normal, mean=between(0.9, 1.1), sd=between(0.0, 0.01)),
    st.builds(Choice, values=st.lists(between(0.5, 2.0), min_size=1, max_size=4).map(tuple)),
)
VARIED = st.dictionaries(
    st.sampled_from(["car.m1", "car.m2", "speed", "force.f"]),
    st.sampled_from([0.0, 1.0, -0.5]),
    min_size=1,
)
STATED = st.none() | st.builds(
    Scales,
    A1=between(0.1, 1.0),
    A2=between(0.1, 1.0),
    omega1=between(1.0, 9.0),
    omega2=between(1.0, 9.0),
    others=st.dictionaries(st.sampled_from(["y", "F"]), between(0.0, 1.0)),
)
ANY = st.builds(
    Scenario,
    name=st.text(st.characters(codec="utf-8", exclude_categories=["Cs"])),
    car=CARS,
    road=ROADS,
    speed=between(1.0, 40.0),
    force=st.builds(ExternalForce, f=between(-9.0, 9.0), Omega=between(0.0, 99.0)),
    actuator=ACTUATORS,
    randomisation=st.lists(st.builds(Vary, by=DISTRIBUTIONS, numbers=VARIED), max_size=2),
    sensors=st.just(())
    | st.builds(Sensor, signal=st.just("x1"), noise=between(0.0, 1.0), delay=st.just(0.004)).map(
        lambda each: (each,)
    ),
    duration=between(1.0, 9.0),
    dt=st.just(0.002),
    scales=STATED,
)


@pytest.mark.parametrize("kind", list(WRITERS))
@pytest.mark.parametrize("name", list(SCENARIOS))
def test_presets_go_to_and_fro(name, kind):
    assert files.from_text(WRITERS[kind](SCENARIOS[name])) == SCENARIOS[name]


@given(any_scenario=ANY)
def test_any_scenario_goes_to_and_fro(any_scenario):
    for write in WRITERS.values():
        found = files.from_text(write(any_scenario))
        assert found == any_scenario
        assert hash(found) == hash(any_scenario)
        assert found.numbers == any_scenario.numbers


@pytest.mark.parametrize("suffix", list(WRITERS))
def test_a_file_is_a_scenario(tmp_path, suffix):
    path = tmp_path / f"mine.{suffix}"
    files.write(HUMP, path)
    assert files.read(path) == HUMP
    assert scenario(path) == scenario(str(path)) == HUMP
    assert scenario(path.read_text(encoding="utf-8")) == HUMP


@dataclass(frozen=True, kw_only=True)
class Softer(LinearSpring):
    """A part of a user's own."""

    by: float = number("factor", "-", positive, 0.5)

    @staticmethod
    def force(travel, p):
        return p.by * p.k * travel


def waves(s):
    return 0.02 * s


def test_parts_and_functions_of_ones_own_are_found_again_by_their_place(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    monkeypatch.setattr(Softer, "__module__", "mine")
    monkeypatch.setattr(waves, "__module__", "mine")
    car = dataclasses.replace(HUMP.car, spring=Softer(k=3e4))
    given = dataclasses.replace(HUMP, car=car, road=FunctionRoad(profile=waves))
    record = files.as_record(given)
    assert record["car"]["spring"]["kind"] == "mine:Softer"
    found = files.from_record(json.loads(json.dumps(record)))
    assert found.car == given.car
    assert found.road.profile is waves


def test_what_cannot_be_found_again_is_refused_when_it_is_written():
    given = dataclasses.replace(HUMP, road=FunctionRoad(profile=lambda s: 0.01 * s))
    with pytest.raises(ValueError, match=r"cannot be found again by its name; .*from_function"):
        files.to_json(given)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "scenario lacks car, road, speed, actuator; add it"),
        ("{", "no scenario can be read: .*; give valid TOML or JSON"),
        ("a = = 1\n", "no scenario can be read: .*; give valid TOML or JSON"),
        ("[]\n", "no scenario can be read|must be a table"),
        ("sped = 1.0\n", "unknown entry of scenario 'sped'; did you mean 'speed'"),
        ('car = "fast"\n', "scenario lacks road|car must be"),
        ('[car]\nkind = "QuartrCar"\n', "unknown kind of scenario.car 'QuartrCar'; did you mean"),
        ('[car]\nkind = "os:system"\n', "scenario.car names 'os:system', which is no part"),
        (
            '[car]\nkind = "nowhere:Car"\n',
            "no kind of scenario.car 'nowhere:Car': ModuleNotFo",
        ),
        ('[car]\nkind = "PaperCar"\n', "scenario.car lacks omega1, omega2, b1"),
        (
            '[road]\nkind = "Sine"\nh = "high"\nwavenumber = 1.0\n',
            "amplitude h must be a number in m, got 'high'",
        ),
    ],
)
def test_an_error_says_where_and_what(text, message):
    with pytest.raises(ValueError, match=message):
        files.from_text(text)


def test_a_record_of_another_kind_is_refused():
    with pytest.raises(ValueError, match="scenario must be a table of numbers, got"):
        files.from_record([1, 2])


def test_an_error_in_a_file_names_the_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("sped = 1\n")
    with pytest.raises(ValueError, match=r"mine\.toml: unknown entry of scenario 'sped'"):
        scenario(path)
    with pytest.raises(ValueError, match=r"gone\.json: .*No such file"):
        scenario(tmp_path / "gone.json")


def test_a_papers_car_is_a_record_of_its_coefficients():
    record = files.as_record(PAPER)
    assert record["car"] == {"kind": "PaperCar", **PAPER.car.numbers._asdict()}
    assert files.from_record(record).car == PaperCar(**PAPER.car.numbers._asdict())
