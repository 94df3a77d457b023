"""Rides: measures of a drive, at every instant, against another program and laws of mechanics."""

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from qcar_env.evaluation import comfort
from qcar_env.evaluation.comfort_speed import comfort_speed
from qcar_env.evaluation.fine import fine
from qcar_env.evaluation.ride import MEASURES, RIDE_SIGNALS, Ride, ride
from qcar_env.evaluation.rollouts import Rollout, rollout, rollouts
from qcar_env.evaluation.tracks import Episode
from qcar_env.parts.actuator import SemiActiveDamper, SuspensionActuator
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.shapes import HalfSine, Sine
from qcar_env.scenarios import Scenario, presets, scenario
from qcar_env.scenarios.reference import Scales

# Vibration dose, MTVV and tyre of passive crossings, by another program (matrix exponentials at
# 1 kHz, weighted in the frequency domain): cars without stops, tyres that lift off.
ROWS = list(
    csv.DictReader(
        (Path(__file__).parents[1] / "data" / "city" / "passive.csv")
        .read_text(encoding="utf-8")
        .splitlines()
    )
)


class Pushes:
    """A policy that draws an action for every `hold` intervals."""

    def __init__(self, hold=1, scale=1.0):
        self.hold, self.scale = hold, scale

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        k = 0 if state is None else state[0]
        drawn = np.random.default_rng([7, k // self.hold]).uniform(-self.scale, self.scale)
        return np.full((len(observation), 1), drawn), (k + 1,)


FREE = Pushes(scale=0.0)


def record(x2, v2, a2, before, car, *, dt=0.005, actuator=None, force=0.0):
    """Return a rollout of a body that moves as it is told over a wheel at rest."""
    k = len(x2)
    nothing = np.zeros(k)
    made = Scenario(
        car=car,
        road=HalfSine(h=0.0, wavenumber=1.0),
        speed=1.0,
        actuator=actuator or SuspensionActuator(limit=100.0),
        dt=dt,
        duration=k * dt,
        substeps=16,
    )
    return Rollout(
        t=dt * np.arange(1, k + 1), x1=nothing, x2=x2, v1=nothing, v2=v2,
        force=np.full((k, 1), force), reward=nothing, terminated=False, scenario=made,
        before=before, signals={"body_acceleration": a2},
    )  # fmt: skip


def swinging(car, amplitude=0.1, omega=2.0 * np.pi, seconds=4.0, **given):
    t = 0.005 * np.arange(round(seconds / 0.005) + 1)
    x, v = amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t)
    a = -omega * omega * x
    return record(x[1:], v[1:], a[1:], (0.0, x[0], 0.0, v[0]), car, **given)


CAR = QuarterCar.from_physical(40.0, 300.0, 200e3, 20e3, 0.0, 1_500.0)


def test_measures_have_names_units_and_titles():
    assert list(MEASURES) == [each.name for each in dataclasses.fields(Ride)]
    found = ride(swinging(CAR))
    assert found.measures == {name: getattr(found, name) for name in MEASURES}
    assert found.words == comfort.words(found.weighted_rms)


def test_a_swinging_body_is_measured_in_closed_form():
    omega, stops = 2.0 * np.pi, presets.car("escort").stops
    stopped = dataclasses.replace(CAR, stops=dataclasses.replace(stops, bump=0.06, rebound=0.08))
    found = ride(swinging(stopped, force=50.0))
    assert found.peak_acceleration == pytest.approx(0.1 * omega**2, rel=1e-5)
    assert found.rms_acceleration == pytest.approx(0.1 * omega**2 / math.sqrt(2.0), rel=1e-5)
    # the mean over an interval beside the zero: (omega dt)^2 / 6 less
    assert found.peak_jerk == pytest.approx(0.1 * omega**3, rel=2e-4)
    assert found.peak_travel == pytest.approx(0.1, rel=1e-5)
    assert found.rms_travel == pytest.approx(0.1 / math.sqrt(2.0), rel=1e-5)
    assert (found.stop_hits, found.stop_depth) == (8, pytest.approx(0.04, rel=1e-5))
    assert found.rms_load == pytest.approx(0.0, abs=1e-12)
    assert (found.least_load, found.largest_load, found.lost_contact) == (1.0, 1.0, 0.0)
    # a force of 50 N over a way of 0.4 m in each of four turns, forth and back
    assert (found.rms_force, found.peak_force, found.saturation) == (50.0, 50.0, 0.0)
    assert found.shaft_energy == pytest.approx(50.0 * 1.6, rel=1e-4)
    assert found.net_energy == pytest.approx(0.0, abs=1e-6)
    assert found.peak_power == pytest.approx(50.0 * 0.1 * omega, rel=1e-4)
    assert ride(swinging(CAR, force=100.0)).saturation == 1.0
    assert ride(swinging(CAR)).stop_hits == 0


def test_wk_of_a_swinging_body_is_the_filters_gain():
    found = ride(swinging(CAR, seconds=20.0, omega=4.0 * np.pi))
    own = ride(swinging(CAR, seconds=20.0, omega=4.0 * np.pi), weighting="Wb")
    assert found.weighted_rms / found.rms_acceleration == pytest.approx(0.531, rel=0.02)  # at 2 Hz
    assert own.weighted_rms != pytest.approx(found.weighted_rms, rel=0.01)
    assert found.crossings == comfort.crossings(found.vdv)


@pytest.mark.slow
@pytest.mark.parametrize("hump", sorted({row["hump"] for row in ROWS}))
def test_passive_crossings_are_those_of_another_program(hump):
    rows = [row for row in ROWS if row["hump"] == hump]
    assert len(rows) == 30
    for row in rows:
        case = f"{row['car']} at {row['kmh']} km/h"
        over = presets.over_hump(
            row["car"],
            hump,
            speed=float(row["kmh"]) / 3.6,
            actuator="ideal",
            stops=False,
        )
        found = ride(rollout(FREE, over, signals=RIDE_SIGNALS))
        assert found.vdv == pytest.approx(float(row["vdv"]), rel=0.02), case
        assert found.mtvv == pytest.approx(float(row["mtvv"]), rel=0.02), case
        assert found.peak_acceleration / 9.81 == pytest.approx(float(row["peak_g"]), rel=0.02), case
        assert found.least_load == pytest.approx(float(row["minload"]), abs=0.015), case
        assert found.largest_load == pytest.approx(float(row["maxload"]), rel=0.01), case
        assert found.lost_contact == pytest.approx(float(row["liftoff_s"]), abs=4e-3), case
        assert found.peak_travel == pytest.approx(float(row["travel_m"]), rel=0.02), case


@pytest.mark.parametrize(
    ("hump", "km_h"), [("egypt-bump", 20.0), ("bar", 50.0), ("italy-50", 50.0)]
)
@pytest.mark.parametrize("actuator", ["ideal", "em", "mr"])
def test_what_lies_between_the_control_instants_is_seen(hump, km_h, actuator):
    """The same forces, kept at 200 Hz and at 4 kHz: the shortest humps, a force that jumps."""
    over = presets.over_hump("escort", hump, speed=km_h / 3.6, actuator=actuator)
    at_once = dataclasses.replace(over.actuator, delay=0.0)
    over = dataclasses.replace(over, actuator=at_once, substeps=20, duration=1.5)
    finer = dataclasses.replace(over, dt=over.dt / 20, substeps=1)
    found = ride(rollout(Pushes(), over, signals=RIDE_SIGNALS))
    kept = rollout(Pushes(hold=20), finer, signals=RIDE_SIGNALS)
    truth = ride(kept)
    a = np.abs(kept.signals["body_acceleration"])
    # kept at the ends of intervals, the last of them 0.25 ms before the force jumps
    assert a.max() <= truth.peak_acceleration * (1.0 + 1e-6)
    assert truth.peak_acceleration == pytest.approx(a.max(), rel=0.02)
    for name in ("peak_acceleration", "weighted_rms", "vdv", "mtvv", "peak_travel", "rms_travel"):
        assert getattr(found, name) == pytest.approx(getattr(truth, name), rel=3e-3), name
    for name in ("rms_load", "least_load", "largest_load"):
        assert getattr(found, name) == pytest.approx(getattr(truth, name), abs=0.01), name
    assert found.lost_contact == pytest.approx(truth.lost_contact, abs=1e-3)
    for name in ("rms_force", "shaft_energy"):
        assert getattr(found, name) == pytest.approx(getattr(truth, name), rel=0.03), name


def test_energy_that_is_fed_in_is_in_the_car():
    """Without dampers, on a road of a nanometre, from rest: in motion and springs."""
    car = QuarterCar.from_physical(40.0, 300.0, 200e3, 20e3, 0.0, 0.0)
    flat = Scenario(
        car=car,
        road=HalfSine(h=1e-9, wavenumber=1.0),
        speed=10.0,
        actuator=SuspensionActuator(limit=500.0),
        duration=1.0,
        substeps=16,
        scales=Scales(A1=10.0, A2=10.0, omega1=10.0, omega2=10.0),
    )
    r = rollout(Pushes(), flat, signals=RIDE_SIGNALS)
    x1, x2, v1, v2 = r.x1[-1], r.x2[-1], r.v1[-1], r.v2[-1]
    energy = 0.5 * (40.0 * v1**2 + 300.0 * v2**2 + 200e3 * x1**2 + 20e3 * (x2 - x1) ** 2)
    found = ride(r)
    assert found.net_energy == pytest.approx(energy, rel=2e-3)
    assert found.shaft_energy > abs(found.net_energy)
    assert found.force_rate <= 2.0 * 500.0 / 0.005


def test_a_semi_active_damper_only_takes_energy_out():
    over = presets.over_hump("megane", "watts", actuator="mr")
    at_once = SemiActiveDamper(c_min=900.0, c_max=4_300.0)
    for each in (over, dataclasses.replace(over, actuator=at_once)):
        found = ride(rollout(Pushes(), each, signals=RIDE_SIGNALS))
        assert found.net_energy == pytest.approx(-found.shaft_energy, rel=0.01)
        assert found.net_energy < 0.0
        assert math.isnan(found.saturation)


def test_a_free_drive_has_no_force_and_a_short_stop_is_hit():
    found = ride(rollout(FREE, presets.over_hump("escort", "watts"), signals=RIDE_SIGNALS))
    assert (found.rms_force, found.peak_force, found.force_rate, found.saturation) == (0, 0, 0, 0)
    assert (found.shaft_energy, found.net_energy, found.peak_power) == (0, 0, 0)
    assert found.stop_hits >= 1
    assert 0.0 < found.stop_depth < 0.05
    assert comfort.crossings(found.vdv) == found.crossings < 400.0


def test_many_drives_are_measured_one_by_one_and_a_phase_is_known():
    """The load between the instants ends where the kept one is, on an endless road as well."""
    rough = Scenario(
        car=CAR,
        road=Sine(h=0.01, wavenumber=1.0),
        speed=20.0,
        actuator=SuspensionActuator(limit=100.0),
        duration=0.5,
        substeps=8,
    )
    cases = [
        Episode(nominal=rough, force_scale=1.0, uniforms=(), state=(0.0,) * 4, phase=phase)
        for phase in (0.0, 1.0)
    ]
    found = rollouts(FREE, cases, signals=(*RIDE_SIGNALS, "tyre_load"))
    for drive in found:
        kept = drive.signals["tyre_load"]
        assert fine(drive).load[:, -1] == pytest.approx(kept, rel=1e-6)
    alone = rollout(FREE, rough, phase=1.0, signals=RIDE_SIGNALS)
    assert ride(found[1]) == ride(alone)
    assert ride(found[0]) != ride(alone)


def test_what_has_no_ride_is_refused():
    with pytest.raises(ValueError, match=r"roll out with signals=\('body_acceleration',\)"):
        ride(rollout(FREE, presets.over_hump("escort", "watts"), duration=0.1))
    paper = scenario("paper")
    pushes = rollout(Twice(), paper, duration=0.1, signals=RIDE_SIGNALS)
    with pytest.raises(ValueError, match="car must have masses and an actuator in newtons"):
        ride(pushes)


class Twice:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 2)), None


# The comfort speed -----------------------------------------------------------------------------

KM_H = np.array([30.0, 10.0, 20.0, 40.0])


def over(speed):
    return presets.over_hump("escort", "watts", speed=speed, stops=False, actuator="ideal")


def test_the_comfort_speed_is_the_fastest_that_will_do():
    """By the table of another program: 0.17, 0.45, 0.79, 0.99 g at 10, 20, 30, 40 km/h."""
    found = comfort_speed(over, lambda each: each.peak_acceleration < 7.0, KM_H / 3.6)
    assert 3.6 * found.speed == pytest.approx(20.0)
    assert [3.6 * speed for speed, _ in found.rides] == pytest.approx([10.0, 20.0, 30.0])
    assert comfort_speed(over, lambda each: False, KM_H / 3.6).speed == 0.0
    every = comfort_speed(over, lambda each: True, KM_H / 3.6)
    assert 3.6 * every.speed == pytest.approx(40.0)
    assert len(every.rides) == 4


def test_a_hump_that_is_skipped_faster_does_not_count():
    held = {10.0: True, 20.0: False, 30.0: True, 40.0: True}
    answers = iter(held.values())
    found = comfort_speed(over, lambda each: next(answers), KM_H / 3.6)
    assert 3.6 * found.speed == pytest.approx(10.0)


def test_a_policy_is_made_for_each_speed():
    seen = []

    def made(scenario):
        seen.append(scenario.speed)
        return Pushes()

    comfort_speed(over, lambda each: True, [5.0, 3.0], policy=made)
    assert seen == [3.0, 5.0]


def test_a_drive_that_leaves_its_limits_does_not_count():
    def soon_over(speed):
        return dataclasses.replace(over(speed), travel_limit=0.5)

    found = comfort_speed(soon_over, lambda each: True, [5.0])
    assert found.speed == 0.0


@pytest.mark.parametrize("speeds", [[], [0.0], [-1.0, 2.0]])
def test_speeds_are_positive(speeds):
    with pytest.raises(ValueError, match="speeds must be positive and at least one"):
        comfort_speed(over, lambda each: True, speeds)
