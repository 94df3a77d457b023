"""Cars, humps, actuators and sensors by name: sources, reference values, and that they drive."""

import csv
import dataclasses
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from qcar_env.analysis.simulate import simulate
from qcar_env.control import Passive
from qcar_env.parts.damper import LinearDamper
from qcar_env.physics import linear
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads.enveloping import moving_average
from qcar_env.roads.excitation import Excitation
from qcar_env.scenarios import files, presets, scenario
from qcar_env.scenarios.presets.cars import GRAVITY

# Peak acceleration, least tyre load and travel of cars without stops that lift off, on roads that
# are averaged over 0.25 m: computed by another program, from matrix exponentials.
REFERENCE = Path(__file__).parents[1] / "data" / "city" / "passive.csv"
ROWS = list(csv.DictReader(REFERENCE.read_text(encoding="utf-8").splitlines()))


def passive(row):
    """Return peak acceleration [g], least tyre load [-] and travel [m] of a crossing."""
    car = presets.car(row["car"], stops=False)
    speed = float(row["kmh"]) / 3.6
    shape = presets.hump(row["hump"], start=0.5 * speed + 0.125)
    on = Excitation(road=moving_average(shape, contact=0.25), speed=speed)
    duration = round((0.5 * speed + shape.extent + 0.25) / speed + 3.0, 3)
    r = simulate(car, on, ExternalForce(), Passive(), duration=duration, step=1e-3)
    travel, static = r.x2 - r.x1, (car.m1 + car.m2) * GRAVITY
    a = -(car.spring.k * travel + car.damper.c * (r.v2 - r.v1)) / car.m2
    load = np.maximum(0.0, static + car.tyre.k * (on.height(r.t) - r.x1)) / static
    return np.abs(a).max() / GRAVITY, load.min(), np.abs(travel).max()


@pytest.mark.slow
@pytest.mark.parametrize("hump", sorted({row["hump"] for row in ROWS}))
def test_cars_do_on_humps_what_another_program_says(hump):
    rows = [row for row in ROWS if row["hump"] == hump]
    assert len(rows) == 30
    for row in rows:
        peak, load, travel = passive(row)
        case = f"{row['car']} at {row['kmh']} km/h"
        assert peak == pytest.approx(float(row["peak_g"]), rel=0.02), case
        assert travel == pytest.approx(float(row["travel_m"]), rel=0.02), case
        assert load == pytest.approx(float(row["minload"]), abs=0.015), case


@pytest.mark.parametrize(
    ("name", "body_hz", "zeta", "hop_hz"),
    [  # frequencies as printed with two and three digits, damping with two
        ("escort", 1.27, 0.27, 12.8),
        ("bmw-320i", 1.52, 0.35, 12.0),
        ("vanagon", 1.55, 0.35, 12.4),
        ("megane", 1.54, 0.25, 12.7),
        ("hub-motor", 1.27, 0.27, 9.2),
        ("heavy-axle", 1.43, 0.21, 9.0),
    ],
)
def test_cars_have_their_modes(name, body_hz, zeta, hop_hz):
    """Of undamped masses on springs one by one: body on both springs in series, wheel on both."""
    car = presets.car(name)
    series = car.spring.k * car.tyre.k / (car.spring.k + car.tyre.k)
    turn = 2.0 * np.pi
    # the heavy axle's table counts the suspension's spring alone
    assert np.sqrt(series / car.m2) / turn == pytest.approx(body_hz, rel=0.09)
    ratio = car.damper.c / (2.0 * np.sqrt(car.spring.k * car.m2))
    assert ratio == pytest.approx(zeta, abs=0.04)
    assert np.sqrt((car.spring.k + car.tyre.k) / car.m1) / turn == pytest.approx(hop_hz, rel=0.02)


def test_the_escorts_static_load_and_sag_are_as_derived():
    car = presets.car("escort")
    load = (car.m1 + car.m2) * GRAVITY
    assert load == pytest.approx(3_708.0, abs=1.0)
    assert load / car.tyre.k == pytest.approx(19.5e-3, abs=0.1e-3)


@pytest.mark.parametrize("name", list(presets.CARS))
def test_a_car_without_stops_and_lift_off_is_linear_where_its_damper_is(name):
    car = presets.car(name, stops=False, lift_off=False)
    assert car.linear == isinstance(car.damper, LinearDamper)
    if car.linear:
        assert np.all(linear.poles(car).real < 0.0)
    assert presets.car(name, load="laden").m2 > car.m2
    assert not presets.car(name).linear


def test_presets_are_titled_and_sourced_and_plausible():
    assert len(presets.CARS) >= 10
    for each in (*presets.CARS.values(), *presets.HUMPS.values()):
        assert each.title
        assert each.source
    for each in presets.CARS.values():
        assert 0.05 < each.car.m1 / each.car.m2 < 0.35
    for each in presets.HUMPS.values():
        assert 0.0 < each.shape.h <= 0.15
        assert 1.0 < 3.6 * each.speed <= 50.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: presets.car("escrt"), "unknown car 'escrt'; did you mean 'escort'"),
        (lambda: presets.car("escort", load="full"), "unknown load of escort 'full'"),
        (lambda: presets.hump("wats"), "unknown hump 'wats'; did you mean 'watts'"),
        (lambda: presets.hump("watts", start=np.nan), "start must be finite, got nan m"),
        (lambda: presets.actuator("emm"), "unknown actuator 'emm'; did you mean 'em'"),
        (lambda: presets.actuator("mr", damping=0.0), "damping must be positive, got 0 N s/m"),
        (lambda: presets.sensors("best"), "unknown set of sensors 'best'"),
        (lambda: presets.over_hump("escort", "watts", speed=0.0), "speed must be positive, got 0"),
        (lambda: presets.over_hump("escort", "watts", contact=-1.0), "contact must not be negati"),
    ],
)
def test_what_there_is_not_is_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def drives(made, steps=40):
    """Step an environment with forces to and fro, and a batch beside it; return observations."""
    one = gym.make("QuarterCarHump-v0", scenario=made, disable_env_checker=True)
    many = gym.make_vec("QuarterCarHump-v0", num_envs=2, scenario=made)
    seen, _ = one.reset(seed=5)
    both, _ = many.reset(seed=5)
    rows = [(seen, both[0])]
    rng = np.random.default_rng(0)
    for _ in range(steps):
        push = rng.uniform(-1.0, 1.0, 1).astype(np.float32)
        seen, reward, terminated, *_ = one.step(push)
        both, *_ = many.step(np.array([push, push]))
        rows.append((seen, both[0]))
        assert np.isfinite(reward)
        if terminated:
            break
    a, b = (np.array(each) for each in zip(*rows, strict=True))
    assert np.all(np.isfinite(a))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("car", list(presets.CARS))
def test_every_car_drives_over_a_hump(car):
    drives(presets.over_hump(car, "watts"))


@pytest.mark.parametrize("hump", list(presets.HUMPS))
def test_every_hump_is_driven_over(hump):
    drives(presets.over_hump("escort", hump, load="laden"))


@pytest.mark.parametrize("actuator", list(presets.ACTUATORS))
def test_every_actuator_acts(actuator):
    made = presets.over_hump("megane", "belgium", actuator=actuator)
    drives(made)
    if actuator in ("mr", "cdc"):  # in place of the car's own damper
        assert made.car.damper.c == 0.0
        assert (made.actuator.c_min, made.actuator.c_max) == pytest.approx((900.0, 4_300.0))


def test_production_sensors_read_with_noise():
    made = presets.over_hump("bmw-320i", "watts", sensors="production")
    drives(made)
    observe = ("body_acceleration", "wheel_acceleration", "travel")
    env = gym.make("QuarterCarHump-v0", scenario=made, observe=observe)
    seen, _ = env.reset(seed=0, options={"state": np.zeros(4)})
    assert np.all(seen != 0.0)  # a car at rest on the flat: noise alone
    assert np.all(np.abs(seen) < 0.2)


def test_a_scenario_of_presets_passes_both_checkers_and_the_way_through_a_file():
    checks = pytest.importorskip("stable_baselines3.common.env_checker")
    made = presets.over_hump("escort", "watts", speed=20.0 / 3.6)
    env = gym.make("QuarterCarHump-v0", scenario=made)
    check_env(env.unwrapped, skip_render_check=True)
    checks.check_env(env.unwrapped)
    assert files.from_text(files.to_toml(made)) == made
    assert files.from_text(files.to_json(made)) == made


def test_averaging_over_no_contact_is_the_hump_itself():
    made = presets.over_hump("escort", "watts", contact=0.0)
    assert type(made.road) is type(presets.hump("watts"))
    assert dataclasses.replace(made.road, start=0.0) == presets.hump("watts")
    assert scenario(made) == made
