"""What every controller of real cars must do, by name."""

import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest

import qcar_env  # noqa: F401 - registers the environments
from baselines import classical
from qcar_env.parts.actuator import LaggedSuspensionActuator
from qcar_env.physics.car import QuarterCar
from qcar_env.scenarios import scenario as find

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


@NAMES
def test_a_damper_only_takes_energy_out(name, cars):
    scenario = cars.megane(duration=1.0)
    if not classical.fits(name, scenario):
        pytest.skip("an active controller")
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
