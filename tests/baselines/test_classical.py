"""What every controller of real cars must do, by name."""

import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest

import qcar_env  # noqa: F401 - registers the environments
from qcar_env.baselines import classical
from qcar_env.parts.actuator import LaggedSuspensionActuator
from qcar_env.parts.sensor import Sensor
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.shapes import Sine
from qcar_env.scenarios import Uniform, Vary, scenario as find

NAMES = pytest.mark.parametrize("name", list(classical.CLASSICAL))


def homes(name, cars):
    """Return the scenarios of both actuators that a controller can enter."""
    both = cars.escort(duration=1.0), cars.megane(duration=1.0)
    return [each for each in both if classical.fits(name, each)]


@NAMES
def test_it_drives_the_environment_as_it_drives_the_fleet_and_stays_finite(name, cars):
    for scenario in homes(name, cars):
        policy = classical.make(name, scenario)
        run = cars.drive(policy, scenario)
        assert np.isfinite(run.x2).all()
        assert not run.terminated
        env = gym.make("QuarterCarHump-v0", scenario=scenario, observe=policy.reads)
        seen, _ = env.reset(seed=0, options={"state": np.zeros(4)})
        memory, start = None, np.array([True])
        for x2 in run.x2:
            action, memory = policy.predict(seen, memory, start)
            seen, *_ = env.step(action)
            start = np.array([False])
            assert env.unwrapped.state.x2 == x2


@NAMES
def test_a_batch_is_its_cars_one_by_one_bit_for_bit(name, cars):
    for scenario in homes(name, cars):
        policy = classical.make(name, scenario)
        rng = np.random.default_rng(0)
        series = rng.normal(scale=0.3, size=(4, 5, len(policy.reads))).astype(np.float32)
        together, memory = [], None
        for seen in series:
            action, memory = policy.predict(seen, memory)
            together.append(action)
        for j in range(5):
            memory = None
            for seen, action in zip(series, together, strict=True):
                alone, memory = policy.predict(seen[j], memory)
                np.testing.assert_array_equal(alone, action[j])


@NAMES
def test_an_episode_that_begins_forgets_the_one_before(name, cars):
    for scenario in homes(name, cars):
        policy = classical.make(name, scenario)
        seen = np.random.default_rng(1).normal(size=(3, len(policy.reads))).astype(np.float32)
        fresh, memory = policy.predict(seen)
        for _ in range(3):
            _, memory = policy.predict(seen, memory)
        again, _ = policy.predict(seen, memory, np.array([True, True, True]))
        np.testing.assert_array_equal(again, fresh)


@pytest.mark.parametrize(
    "name", [name for name, each in classical.CLASSICAL.items() if each.valve is not False]
)
def test_a_damper_only_takes_energy_out(name, cars):
    scenario = cars.megane(duration=1.0)
    run = cars.drive(classical.make(name, scenario), scenario)
    power = run.signals["u2"] * run.signals["travel_rate"]
    assert power.max() <= 1e-6  # of products in single precision


@NAMES
def test_it_enters_only_where_its_actuator_is(name, cars):
    (entry,) = classical.entries([name])
    pickle.dumps(entry)
    assert entry.make(find("paper"), None, 1.0) is None
    for scenario in homes(name, cars):
        assert entry.make(scenario, None, 1.0).name


@NAMES
def test_names_and_gains_that_are_unknown_are_named(name, cars):
    with pytest.raises(ValueError, match=f"unknown gain of {name} 'nothing'"):
        classical.make(name, homes(name, cars)[0], nothing=1.0)
    with pytest.raises(
        ValueError, match=r"needs (one actuator between the masses|a semi-active damper), got Indep"
    ):
        classical.make(name, "paper")


def test_an_unknown_controller_gets_the_nearest_name(cars):
    with pytest.raises(ValueError, match="unknown controller 'skyhok'; did you mean 'skyhook'"):
        classical.make("skyhok", cars.escort())


def test_another_spring_and_damper_are_those_of_another_car(cars):
    plain = cars.escort(limit=1e5, duration=1.0)
    given = {"m1": 32.84, "m2": 345.1, "k1": 189_785.6, "c1": 0.0}
    softer = QuarterCar.from_physical(**given, k2=18_000.0, c2=1_200.0)
    # Held over 5 ms the force lags behind the damper's own by half an interval: some percent.
    found = cars.drive(classical.make("passive", plain, stiffness=-3_898.0, damping=-259.4), plain)
    wanted = cars.drive(cars.Held(0.0), dataclasses.replace(plain, car=softer))
    np.testing.assert_allclose(found.x2, wanted.x2, atol=0.03 * np.abs(wanted.x2).max())


def test_skyhook_and_pid_calm_the_body_on_a_hump(cars):
    hump = cars.escort()
    passive = cars.rms(cars.drive(cars.Held(0.0), hump).v2)
    assert cars.rms(cars.drive(classical.make("skyhook", hump), hump).v2) < 0.8 * passive
    assert cars.rms(cars.drive(classical.make("pid", hump), hump).v2) < 0.8 * passive


def test_a_lagged_actuator_is_driven_too(cars):
    lagged = LaggedSuspensionActuator(limit=2_000.0, lag=0.005, rate_limit=40e3, delay=0.005)
    scenario = cars.escort(actuator=lagged)
    run = cars.drive(classical.make("skyhook", scenario), scenario)
    assert np.isfinite(run.x2).all()


def comfort(cars, name, scenario, **gains):
    """Return the RMS acceleration of the body [m/s^2]; of None without control."""
    policy = cars.Held(0.0) if name is None else classical.make(name, scenario, **gains)
    return cars.rms(cars.drive(policy, scenario).signals["body_acceleration"])


def escort_on_both(cars):
    """Return the Escort on a Watts hump at 30 km/h and on a road of class C at 72 km/h."""
    return cars.escort(), cars.escort(road=cars.rough("C"), speed=20.0, duration=10.0)


def test_an_active_car_is_more_comfortable_the_more_it_knows(cars):
    for scenario in escort_on_both(cars):
        found = [comfort(cars, name, scenario) for name in (None, "skyhook", "lqr", "preview")]
        assert found == sorted(found, reverse=True)
        assert found[-1] < 0.5 * found[0]


def test_preview_of_nothing_is_lqr(cars):
    hump = cars.escort()
    blind = cars.drive(classical.make("preview", hump, ahead=0.0), hump)
    np.testing.assert_array_equal(blind.x2, cars.drive(classical.make("lqr", hump), hump).x2)


def test_clipped_lqr_is_more_comfortable_than_any_passive_damper(cars):
    road = cars.megane(road=cars.rough("C"), speed=20.0, duration=10.0)
    held = [cars.drive(cars.Held(each), road) for each in np.linspace(-1.0, 1.0, 9)]
    best = min(cars.rms(run.signals["body_acceleration"]) for run in held)
    assert comfort(cars, "lqr", road) < best
    assert comfort(cars, "preview", road) < comfort(cars, "lqr", road)


def test_preview_needs_one_road_for_all_episodes(cars):
    drawn = Vary(by=Uniform(low=0.5, high=1.5), numbers={"road.h": 1.0})
    varied = cars.escort(randomisation=(drawn,))
    assert not classical.fits("preview", varied)
    with pytest.raises(ValueError, match="preview needs one road that all episodes meet alike"):
        classical.make("preview", varied)
    endless = cars.escort(road=Sine(h=0.01, wavenumber=2.0))
    assert not classical.fits("preview", endless)
    assert classical.fits("lqr", varied)
    assert classical.fits("lqr", endless)


PRODUCTION = (
    Sensor(signal="body_acceleration", noise=0.03, cutoff=50.0),
    Sensor(signal="travel", noise=0.5e-3, resolution=0.2e-3),
)


def test_lqg_does_from_two_sensors_nearly_what_lqr_does_from_the_state(cars):
    for scenario in escort_on_both(cars):
        passive, best = comfort(cars, None, scenario), comfort(cars, "lqr", scenario)
        noisy = dataclasses.replace(scenario, sensors=PRODUCTION)
        assert comfort(cars, "lqg", scenario) < best + 0.2 * (passive - best)
        assert comfort(cars, "lqg", noisy) < best + 0.5 * (passive - best)


def test_lqg_reads_the_sensors_of_the_scenario(cars):
    assert classical.make("lqg", cars.escort()).reads == ("body_acceleration", "travel")
    three = (*PRODUCTION, Sensor(signal="wheel_acceleration", noise=0.3), Sensor(signal="y"))
    policy = classical.make("lqg", cars.escort(sensors=three))
    assert policy.reads == ("body_acceleration", "travel", "wheel_acceleration")


def test_mpc_keeps_the_travel_within_the_stroke_and_costs_comfort_for_it(cars):
    hump = cars.escort()
    travel = {
        stroke: np.abs(
            cars.drive(classical.make("mpc", hump, stroke=stroke), hump).signals["travel"]
        ).max()
        for stroke in (0.05, 0.06, 0.2)
    }
    assert travel[0.2] > 0.07
    for stroke in (0.05, 0.06):
        assert travel[stroke] < 1.005 * stroke  # between the samples, and the solver's tolerance
    assert comfort(cars, "mpc", hump, stroke=0.05) > comfort(cars, "mpc", hump, stroke=0.2)


def test_mpc_knows_of_limits_what_clipping_does_not(cars):
    weak = cars.escort(limit=1_000.0)
    assert comfort(cars, "mpc", weak, stroke=0.2) < 0.98 * comfort(cars, "preview", weak)
    lagged = LaggedSuspensionActuator(limit=1_000.0, lag=0.0025, rate_limit=20e3)
    slow = cars.escort(actuator=lagged)
    assert comfort(cars, "mpc", slow, stroke=0.2) < 0.95 * comfort(cars, "preview", slow)
    # As quick as 20 kN/s let it be, in limits and intervals.
    asked = np.diff(asked_by(classical.make("mpc", slow), slow, cars))
    assert np.abs(asked).max() <= 20e3 * 0.005 / 1_000.0 * (1.0 + 1e-5)


def test_mpc_with_wide_limits_is_preview(cars):
    strong = cars.escort(limit=5_000.0)
    run = cars.drive(classical.make("mpc", strong, stroke=1.0), strong)
    other = cars.drive(classical.make("preview", strong), strong)
    # The solver stops at 1e-5 of the limit and of the multipliers.
    np.testing.assert_allclose(run.x2, other.x2, atol=5e-3 * np.abs(other.x2).max())


def asked_by(policy, scenario, cars):
    """Return the actions that a policy asks for over an episode."""
    kept = []

    class Asked:
        reads = policy.reads

        def predict(self, *args, **kwargs):
            action, memory = policy.predict(*args, **kwargs)
            kept.append(float(action[0, 0]))
            return action, memory

    cars.drive(Asked(), scenario)
    return np.array(kept)


def test_h_infinity_is_more_comfortable_than_skyhook_and_keeps_the_tyre_on_the_road(cars):
    for scenario in escort_on_both(cars):
        assert comfort(cars, "h-infinity", scenario) < comfort(cars, "skyhook", scenario)
    rough = escort_on_both(cars)[1]
    load = [
        cars.drive(classical.make(name, rough), rough).signals["tyre_load"].min()
        for name in ("h-infinity", "lqg")
    ]
    assert load[0] > load[1] > 0.0


def test_the_tuned_passive_car_is_the_calmest_on_a_random_road(cars):
    _, road = escort_on_both(cars)
    assert comfort(cars, "passive", road) < comfort(cars, None, road)
    best = comfort(cars, "passive", road)
    # The forces of the actuator are held: a few percent of the damping more or less.
    for off in (-600.0, 600.0):
        assert best < comfort(cars, "passive", road, damping=977.2 - 1_459.4 + off)


def test_a_damper_is_no_spring(cars):
    with pytest.raises(ValueError, match="stiffness of a semi-active damper must be 0 N/m, got 5"):
        classical.make("passive", cars.megane(), stiffness=5.0)
