"""Presets, reference amplitudes, randomisation, and the checks of numbers against each other."""

import dataclasses
import math
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import qcar_env
from qcar_env import SCENARIOS, Scenario, scenario
from qcar_env.physics import linear, motion, roads
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.rk4 import STABILITY_LIMIT
from qcar_env.physics.state import State
from qcar_env.scenarios import Actuator, Randomisation, check_step, draw, vary

PAPER = scenario("paper")
HUMP = scenario("mathworks-hump")
factor = st.floats(0.5, 2.0)


# Presets ----------------------------------------------------------------------------------------


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
    car, force = PAPER.car, PAPER.force
    assert car.coefficients == (55.0, 55.0, 8.7, 0.71, 0.5, 3.4, 0.5, 2510.0, 16.0)
    assert (PAPER.road.h, PAPER.road.omega, force.f, force.Omega) == (0.1, 55.0, 24.8, 55.0)
    assert PAPER.actuator.limit == (280.0, 33.0)


def test_every_real_car_has_its_body_far_below_its_wheel():
    """Every printed car has omega1 / omega2 between 7.5 and 17 (users.md)."""
    for each in SCENARIOS.values():
        if each.car.m1 is not None:
            assert 7.0 < each.car.omega1 / each.car.omega2 < 17.0


# Reference amplitudes and frequency -------------------------------------------------------------


def peaks(found: Scenario, duration: float) -> np.ndarray:
    """Return max |x1|, |x2| of a crossing from rest without control, by RK4."""
    dt = 1e-3
    plant = motion.plant(found.car, found.road, found.force, dt)
    x, world = State(0.0, 0.0, 0.0, 0.0), motion.world_at(0.0, found.road, found.force)
    kink, most = found.road.next_kink(-1e-12), np.zeros(2)
    for k in range(round(duration / dt)):
        x, world, kink = motion.interval(x, world, kink, k * dt, dt, 1, 0.0, 0.0, plant)
        most = np.maximum(most, np.abs(x[:2]))
    return most


@pytest.mark.parametrize("name", ["mathworks-hump", "mathworks-train"])
def test_reference_amplitudes_of_a_hump_are_the_peaks_of_a_crossing_from_rest(name):
    found = SCENARIOS[name]
    # peaks between samples are missed by (58 rad/s * 1 ms)^2 / 8 = 4e-4 at most
    expected = peaks(found, found.road.end + 3.0)
    assert found.reference_amplitudes == pytest.approx(tuple(expected), rel=1e-3)


def test_reference_amplitudes_of_a_step_are_the_overshoot():
    found = dataclasses.replace(HUMP, road=roads.step(h=0.1, start=0.2))
    assert found.reference_amplitudes == pytest.approx(tuple(peaks(found, 3.0)), rel=1e-3)
    assert min(found.reference_amplitudes) > 0.1  # an underdamped car overshoots


def test_reference_amplitudes_of_a_harmonic_road_are_the_steady_ones():
    expected = linear.steady_state(PAPER.car, PAPER.road, PAPER.force).amplitudes
    assert PAPER.reference_amplitudes == expected


def test_under_an_external_force_a_crossing_is_measured_by_the_steady_answer_at_least():
    for name in ("paper-hump", "paper-step"):
        found = SCENARIOS[name]
        alone = dataclasses.replace(found, road=roads.harmonic(h=0.0, omega=1.0))
        assert np.all(np.array(found.reference_amplitudes) >= alone.reference_amplitudes)


@pytest.mark.parametrize("gap", [0.0, 1e-12, 0.5])
def test_humps_may_touch(gap):
    """Without a gap the end of a hump and the beginning of the next fall on one instant."""
    for omega in (3.0, 7.0, 11.0, 17.5):
        road = roads.train(h=0.1, omega=omega, count=4, gap=gap, start=0.3)
        found = dataclasses.replace(HUMP, road=road)
        assert min(found.reference_amplitudes) > 0.0


def test_a_car_that_does_not_move_is_refused():
    still = dataclasses.replace(PAPER, road=roads.harmonic(h=0.0, omega=1.0), force=ExternalForce())
    with pytest.raises(
        ValueError, match=r"uncontrolled car must move, got amplitudes \(0.0, 0.0\)"
    ):
        _ = still.reference_amplitudes


def test_the_reference_frequency_is_the_roads_else_the_forces_else_the_bodys():
    assert dataclasses.replace(PAPER, force=ExternalForce(f=1, Omega=9)).reference_frequency == 55.0
    assert SCENARIOS["paper-hump"].reference_frequency == PAPER.force.Omega
    assert HUMP.reference_frequency == HUMP.car.omega2
    constant = dataclasses.replace(HUMP, force=ExternalForce(f=1.0, Omega=0.0))
    assert constant.reference_frequency == HUMP.car.omega2


# Actuators --------------------------------------------------------------------------------------


@given(limit=st.floats(1.0, 1e5))
def test_a_suspension_actuator_pushes_both_masses_with_opposite_forces(limit):
    actuator = Actuator(actuation="suspension", limit=(limit,))
    u1, u2 = actuator.specific_limits(HUMP.car)
    assert u1 * HUMP.car.m1 == pytest.approx(-limit, rel=1e-15)
    assert u2 * HUMP.car.m2 == pytest.approx(limit, rel=1e-15)
    assert (actuator.unit, actuator.size) == ("N", 1)


def test_independent_actuators_push_each_mass_up():
    assert PAPER.actuator.specific_limits(PAPER.car) == (280.0, 33.0)
    assert (PAPER.actuator.unit, PAPER.actuator.size) == ("m/s^2", 2)


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
    ("actuation", "limit", "message"),
    [
        ("independent", (280.0,), r"'independent' takes 2 force limit\(s\), got 1: \(280.0,\)"),
        ("suspension", (1.0, 2.0), r"'suspension' takes 1 force limit\(s\), got 2"),
        ("suspension", (0.0,), "force limit must be positive, got 0 N"),
        ("independent", (1.0, -1.0), r"force limit must be positive, got -1 m/s\^2"),
        (
            "independent",
            {1.0, 2.0},
            r"takes 2 force limit\(s\), got 0: \{1.0, 2.0\}; give a tuple of 2",
        ),
        ("suspension", 5, r"takes 1 force limit\(s\), got 0: 5; give a tuple of 1"),
        (
            "suspension",
            (10**400,),
            "force limit must be finite, got 1000.* N; give a finite number",
        ),
        (
            "suspension",
            (None,),
            "force limit must be a number in N, got None; give a finite number",
        ),
        ("suspention", (1.0,), r"unknown actuation 'suspention'; did you mean 'suspension'\?"),
    ],
)
def test_an_actuator_is_checked(actuation, limit, message):
    with pytest.raises(ValueError, match=message):
        Actuator(actuation=actuation, limit=limit)


def test_an_actuator_in_newtons_needs_masses():
    with pytest.raises(
        ValueError, match="suspension actuator needs a car with masses, got m1=None"
    ):
        dataclasses.replace(PAPER, actuator=Actuator(actuation="suspension", limit=(1_000.0,)))


# Steps ------------------------------------------------------------------------------------------


@given(car=st.from_type(QuarterCar), over=st.floats(1.01, 10.0))
def test_a_step_at_which_rk4_diverges_is_refused_with_the_largest_that_does_not(car, over):
    limit = STABILITY_LIMIT / float(np.max(np.abs(linear.poles(car))))
    message = (
        rf"step must be below {limit:.3g} s for this car, got {over * limit:.3g} s .* smaller dt"
    )
    with pytest.raises(ValueError, match=message):
        check_step(car, over * limit)
    with pytest.warns(UserWarning, match="is coarse for this car"):
        check_step(car, 0.99 * limit)
    check_step(car, 0.18 * limit)  # 0.47 of the allowed 2.6


@pytest.mark.parametrize("step", [math.nan, -2.5, None])
def test_a_step_must_be_positive(step):
    with pytest.raises(ValueError, match=f"integration step must be .*, got {step}"):
        check_step(PAPER.car, step)


def test_a_refused_step_does_diverge_and_the_limit_does_not():
    """The mode of damping ratio 0.53 is where RK4's region is smallest."""
    zeta = 0.53
    car = dataclasses.replace(PAPER.car, b1=2 * zeta * 55.0, b2=2 * zeta * 55.0, E1=0.0, E2=0.0)
    flat = roads.harmonic(h=0.0, omega=1.0)
    for product, grows in ((2.7, True), (2.6, False)):
        m = linear.rk4_transition(car, flat, ExternalForce(), product / 55.0, 1)
        assert (np.max(np.abs(np.linalg.eigvals(m.A))) > 1.0) == grows


def test_a_scenario_with_a_step_that_diverges_is_refused():
    with pytest.raises(ValueError, match=r"integration step must be below .* more substeps"):
        dataclasses.replace(HUMP, dt=0.05, substeps=1)
    with pytest.warns(UserWarning, match=r"integration step 0\.02 s is coarse"):
        dataclasses.replace(HUMP, dt=0.02, substeps=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 0.0}, "dt must be positive, got 0 s"),
        ({"dt": math.nan}, "dt must be finite, got nan s"),
        ({"substeps": 0}, "substeps must be at least 1, got 0"),
        ({"substeps": 2.5}, "substeps must be a whole number, got 2.5"),
        ({"duration": -1.0}, "duration must be positive, got -1 s"),
        ({"duration": 0.001}, "duration must hold a control interval, got 0.001 s .* give 0.005 s"),
        ({"travel_limit": 0.0}, "travel_limit must be positive, got 0"),
        (
            {"duration": 1e300},
            r"duration must be at most 9.0e\+15 control intervals, got 1e\+300 s",
        ),
        ({"dt": 1e-320}, r"duration must be at most 9.0e\+15 control intervals, got 5 s"),
        (
            {"substeps": 10**9},
            "substeps must be at most 1000000, got 1000000000; give 1 to 1000000",
        ),
        ({"car": None}, "car must be of class QuarterCar, got None; give such an object"),
        ({"road": "hump"}, "road must be of class Road, got 'hump'"),
        ({"force": 24.8}, "force must be of class ExternalForce, got 24.8"),
        ({"actuator": (280.0, 33.0)}, r"actuator must be of class Actuator, got \(280.0, 33.0\)"),
        ({"randomisation": {}}, r"randomisation must be of class Randomisation, got \{\}"),
        ({"dt": np.ones(2)}, r"dt must be a number in s, got array\(\[1., 1.\]\); give a finite"),
    ],
)
def test_the_numbers_of_a_scenario_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(PAPER, **changes)


@pytest.mark.parametrize(("duration", "steps"), [(5.0, 1000), (0.005, 1), (0.3, 60), (0.7, 140)])
def test_an_episode_holds_the_intervals_that_its_duration_says(duration, steps):
    """0.3 / 0.005 is 59.99... in floating point."""
    assert dataclasses.replace(PAPER, duration=duration).steps == steps


# Variation --------------------------------------------------------------------------------------


def test_without_factors_nothing_varies():
    for each in SCENARIOS.values():
        assert vary(each) == dataclasses.replace(each, randomisation=None)


@given(load=factor, wheel=factor)
def test_other_masses_make_the_car_that_its_springs_and_dampers_say(load, wheel):
    parts = dict(m1=60.0, m2=300.0, k1=190e3, k2=16e3, c1=50.0, c2=1e3)
    nominal = dataclasses.replace(HUMP, car=QuarterCar.from_physical(**parts))
    found = vary(nominal, load=load, wheel_mass=wheel)
    expected = QuarterCar.from_physical(**parts | {"m1": 60.0 * wheel, "m2": 300.0 * load})
    for name in ("omega1", "omega2", "b1", "b2", "E1", "E2", "E3", "mu1", "mu2", "m1", "m2"):
        assert getattr(found.car, name) == pytest.approx(getattr(expected, name), rel=1e-15)
    assert found.actuator == nominal.actuator  # newtons stay newtons


@given(load=factor, wheel=factor, force=factor, limit=factor)
def test_forces_keep_their_newtons_when_masses_vary(load, wheel, force, limit):
    found = vary(PAPER, load=load, wheel_mass=wheel, force=force, limit=limit)
    # times the mass, in nominal masses
    assert found.force.f * load == pytest.approx(PAPER.force.f * force, rel=1e-15)
    limits = (found.actuator.limit[0] * wheel, found.actuator.limit[1] * load)
    assert limits == pytest.approx((280.0 * limit, 33.0 * limit), rel=1e-15)


@given(height=factor, frequency=factor)
def test_height_and_speed_vary_the_road_alone(height, frequency):
    found = vary(PAPER, height=height, frequency=frequency)
    assert found.car == PAPER.car
    assert found.road == roads.harmonic(h=0.1 * height, omega=55.0 * frequency)
    assert found.force == ExternalForce(f=PAPER.force.f, Omega=55.0 * frequency)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_draws_stay_in_their_ranges_and_do_not_compound(seed):
    nominal, rng = SCENARIOS["paper-randomised"], np.random.default_rng(seed)
    ranges = nominal.randomisation
    for _ in range(20):
        found = draw(nominal, rng)
        assert found.randomisation is None
        drawn = {
            "height": found.road.h / nominal.road.h,
            "frequency": found.road.omega / nominal.road.omega,
            "load": nominal.car.b2 / found.car.b2,
            "wheel_mass": nominal.car.b1 / found.car.b1,
        }
        for name, value in drawn.items():
            low, high = getattr(ranges, name)
            assert low * (1 - 1e-15) <= value <= high * (1 + 1e-15), name


def test_one_generator_draws_one_sequence_and_another_another():
    nominal = SCENARIOS["paper-randomised"]

    def sequence(seed):
        rng = np.random.default_rng(seed)
        return [draw(nominal, rng) for _ in range(3)]

    assert sequence(7) == sequence(7)
    assert sequence(7) != sequence(8)
    assert len(set(map(repr, sequence(7)))) == 3


def test_a_scenario_that_does_not_vary_draws_nothing():
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    assert draw(PAPER, rng) is PAPER
    assert rng.bit_generator.state == before


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Randomisation)])
@pytest.mark.parametrize(
    ("given_range", "message"),
    [
        ((0.0, 1.0), "{name} factor must be positive, got 0"),
        ((1.5, 0.5), r"range of {name} must rise, got \(1.5, 0.5\); swap the two"),
        ((0.5, math.nan), "{name} factor must be finite, got nan"),
        ((0.5, math.inf), "{name} factor must be finite, got inf"),
        ((0.5,), r"range of {name} must be two numbers, got \(0.5,\)"),
        (0.5, r"range of {name} must be two numbers, got 0.5"),
        ({0.5, 1.5}, r"range of {name} must be two numbers, got {{0.5, 1.5}}; give the lowest"),
        ("12", r"range of {name} must be two numbers, got '12'; give the lowest"),
        ((0.5, 10**400), "{name} factor must be finite, got 1000"),
    ],
)
def test_a_range_is_two_positive_numbers_in_rising_order(name, given_range, message):
    with pytest.raises(ValueError, match=message.format(name=name)):
        Randomisation(**{name: given_range})


# Values as they are stored ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", [list, np.array])
@pytest.mark.parametrize("number", [np.array, np.float64, np.float32])
def test_a_scenario_of_lists_and_numpys_numbers_is_the_one_of_plain_ones(kind, number):
    """Equal, as a key, as text and after a round trip through pickle."""
    plain = dataclasses.replace(
        PAPER, randomisation=Randomisation(height=(0.5, 1.5)), duration=5.0, substeps=4
    )
    other = dataclasses.replace(
        plain,
        actuator=Actuator(actuation=np.str_("independent"), limit=kind([280.0, 33.0])),
        randomisation=Randomisation(height=kind([0.5, 1.5])),
        duration=number(5),
        substeps=number(4),
        travel_limit=number(3),
    )
    for each in (other, pickle.loads(pickle.dumps(other)), dataclasses.replace(other)):
        assert (each, hash(each), repr(each)) == (plain, hash(plain), repr(plain))
    assert (type(other.substeps), type(other.duration)) == (int, float)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("load", 0, "load factor must be positive, got 0; give a value above 0"),
        ("load", -1, "load factor must be positive, got -1"),
        ("wheel_mass", 0.0, "wheel_mass factor must be positive, got 0"),
        ("frequency", -1.0, "frequency factor must be positive, got -1"),
        ("limit", 0.0, "limit factor must be positive, got 0"),
        ("height", math.nan, "height factor must be finite, got nan"),
        ("force", None, "force factor must be a number, got None"),
    ],
)
@pytest.mark.parametrize("nominal", [PAPER, HUMP], ids=lambda each: each.name)
def test_the_factors_of_a_variation_are_checked(nominal, name, value, message):
    with pytest.raises(ValueError, match=message):
        vary(nominal, **{name: value})


@pytest.mark.parametrize(
    "road",
    [
        roads.hump(h=0.1, omega=1e-9),
        roads.hump(h=0.1, omega=20.0, start=1e12),
        roads.train(h=0.1, omega=20.0, count=2, gap=1e12),
        roads.train(h=0.1, omega=20.0, count=1_000_000, gap=1.0),
    ],
    ids=["slow", "late", "gap", "many"],
)
def test_a_crossing_too_long_to_be_looked_through_is_refused(road):
    with pytest.raises(ValueError, match=r"a crossing must be over within .* s .*, got .* s with"):
        _ = dataclasses.replace(HUMP, road=road).reference_amplitudes
