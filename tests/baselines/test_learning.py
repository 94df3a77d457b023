import numpy as np
import pytest

from qcar_env.baselines import classical
from qcar_env.baselines.learning import learn
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.shapes import Sine


def test_a_hump_that_is_met_again_is_crossed_better_than_with_preview(cars):
    hump = cars.escort()
    found = learn(hump, crossings=4)
    assert found.costs[1] < 0.5 * found.costs[0]  # the first crossing is the regulator's alone
    assert found.costs[-1] <= found.costs[1] * (1.0 + 1e-6)

    def comfort(policy):
        return cars.rms(cars.drive(policy, hump).signals["body_acceleration"])

    assert comfort(found.policy) < comfort(classical.make("preview", hump))
    assert comfort(found.policy) < 0.5 * comfort(classical.make("lqr", hump))


def test_what_is_learned_with_a_wrong_model_is_never_worse_than_no_plan(cars):
    hump = cars.escort(duration=2.0)
    numbers = {"m1": 32.84, "m2": 276.0, "k1": 150e3, "k2": 21_898.0, "c1": 0.0, "c2": 1_459.4}
    wrong = QuarterCar.from_physical(**numbers)
    found = learn(hump, crossings=8, model=wrong)
    assert max(found.costs) > min(found.costs)
    best = learn(
        hump, crossings=1 + int(np.argmin(found.costs)), model=QuarterCar.from_physical(**numbers)
    )
    np.testing.assert_array_equal(found.policy.plan, best.policy.plan)
    assert min(found.costs) < 0.9 * found.costs[0]


def test_what_cannot_be_learned_is_refused(cars):
    with pytest.raises(ValueError, match="learning needs one road that all episodes meet alike"):
        learn(cars.escort(road=Sine(h=0.01, wavenumber=2.0)))
    with pytest.raises(ValueError, match="learning needs one actuator between the masses"):
        learn("paper")
    with pytest.raises(ValueError, match="crossings must be at least 1, got 0"):
        learn(cars.escort(), crossings=0)
