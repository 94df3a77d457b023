import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import qcar_env  # noqa: F401 - registers the environments
from qcar_env.baselines.semi_active_policy import SemiActivePolicy
from qcar_env.control.semi_active import SEMI_ACTIVE_LAWS, LinearHybrid
from qcar_env.parts.actuator import LaggedSemiActiveDamper, SuspensionActuator

KINDS = pytest.mark.parametrize("kind", SEMI_ACTIVE_LAWS.values(), ids=SEMI_ACTIVE_LAWS)


@KINDS
def test_it_drives_the_environment_and_only_takes_energy_out(kind, cars):
    scenario = cars.megane()
    policy = SemiActivePolicy(kind(), scenario)
    run = cars.drive(policy, scenario)
    assert np.isfinite(run.x2).all()
    assert not run.terminated
    assert np.all(run.signals["u2"] * run.signals["travel_rate"] <= 1e-6)

    env = gym.make("QuarterCarHump-v0", scenario=scenario, observe=policy.reads)
    seen, _ = env.reset(seed=0, options={"state": np.zeros(4)})
    for x2 in run.x2:
        seen, _, over, cut, _ = env.step(policy.predict(seen)[0])
        assert env.unwrapped.state.x2 == x2
        if over or cut:
            break


@KINDS
def test_a_damper_without_a_range_is_passive(kind, cars):
    scenario = cars.megane(c_min=1500.0, c_max=1500.0)
    run = cars.drive(SemiActivePolicy(kind(), scenario), scenario)
    held = cars.drive(cars.Held(0.0), scenario)
    np.testing.assert_array_equal(run.x2, held.x2)


@KINDS
def test_a_batch_is_its_cars_one_by_one_bit_for_bit(kind, cars):
    policy = SemiActivePolicy(kind(), cars.megane())
    seen = np.random.default_rng(0).normal(size=(33, len(policy.reads))).astype(np.float32)
    together, _ = policy.predict(seen)
    assert together.dtype == np.float32
    np.testing.assert_array_equal(together, np.stack([policy.predict(each)[0] for each in seen]))


def left(cars, run):
    """Return what is left of acceleration and rate of the body, rate of the wheel, tyre load."""
    car = run.scenario.car
    load = run.signals["tyre_load"] - 9.81 * (car.m1 + car.m2)
    rows = run.signals["body_acceleration"], run.v2, run.v1, load
    return np.array([cars.rms(each) for each in rows])


def test_each_is_better_at_what_it_is_made_for_than_any_passive_damper(cars):
    road = cars.megane(road=cars.rough("C"), speed=20.0, duration=10.0)
    held = np.linspace(-1.0, 1.0, 9)
    best = np.min([left(cars, cars.drive(cars.Held(each), road)) for each in held], axis=0)
    soft = left(cars, cars.drive(cars.Held(-1.0), road))

    def found(name, **numbers):
        law = SEMI_ACTIVE_LAWS[name](**numbers)
        return left(cars, cars.drive(SemiActivePolicy(law, road), road))

    comfort = {name: found(name)[0] for name in ("add", "sh-add", "mix-1", "hybrid-linear")}
    assert max(comfort.values()) < best[0]
    assert comfort["sh-add"] < comfort["add"]  # Savaresi and Spelta 2007
    assert found("hybrid-linear", share=1.0)[0] < best[0]
    assert found("hybrid-linear")[3] < soft[3]  # what its groundhook is for
    assert found("skyhook-on-off")[1] < 0.75 * best[1]
    # Of the load no law of these is better than the best passive damper: the wheel's rate only.
    assert found("groundhook-on-off")[2] < best[2]
    assert found("groundhook-on-off")[3] > best[3]


def test_it_needs_a_semi_active_damper(cars):
    ideal = dataclasses.replace(cars.megane(), actuator=SuspensionActuator(limit=1000.0))
    with pytest.raises(ValueError, match="ADD needs a semi-active damper, got SuspensionActuator"):
        SemiActivePolicy(SEMI_ACTIVE_LAWS["add"](), ideal)
    with pytest.raises(ValueError, match="law must be of class SemiActiveLaw, got 'add'"):
        SemiActivePolicy("add", cars.megane())
    lagged = LaggedSemiActiveDamper(c_min=900.0, c_max=4300.0, lag=0.008)
    policy = SemiActivePolicy(LinearHybrid(), dataclasses.replace(cars.megane(), actuator=lagged))
    with pytest.raises(ValueError, match=r"observe=\('v1', 'v2', 'travel_rate'\)"):
        policy.predict(np.zeros(2))
