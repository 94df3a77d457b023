import numpy as np
import pytest

from qcar_env.baselines import classical
from qcar_env.baselines.tune_classical import CLASSICAL_SEARCHES, measure, tune_classical


def test_a_search_finds_the_damper_that_a_fine_grid_finds(cars):
    road = cars.megane(road=cars.rough("C", 5.0), speed=20.0, duration=5.0)

    def of(damping):
        return measure(lambda each: classical.make("passive", each, damping=damping), [road])

    grid = [of(damping) for damping in np.linspace(900.0, 4_300.0, 35)]
    found = tune_classical("passive", [road], population=5, generations=6)
    assert found.measure == pytest.approx(min(grid), rel=2e-3)
    assert found.measure <= found.default
    assert found.evaluations >= 5


def test_a_tuned_controller_is_no_worse_than_a_stated_one_on_what_it_was_tuned_on(cars):
    hump = cars.escort(duration=2.0)
    found = tune_classical("skyhook", [hump], population=5, generations=3)
    assert found.measure <= found.default
    policy = classical.make("skyhook", hump, **found.gains)
    assert measure(policy, [hump]) == pytest.approx(found.measure, rel=1e-12)
    again = tune_classical("skyhook", [hump], population=5, generations=3)
    assert again == found
    assert tune_classical("skyhook", [hump], population=5, generations=3, seed=1) != found


@pytest.mark.parametrize("name", CLASSICAL_SEARCHES)
def test_a_search_names_gains_that_there_are(name):
    assert set(CLASSICAL_SEARCHES[name].names) <= set(classical.CLASSICAL[name].gains)


def test_bad_searches_are_refused(cars):
    with pytest.raises(ValueError, match="unknown controller to tune 'lqr'"):
        tune_classical("lqr", [cars.escort()])
    with pytest.raises(ValueError, match="scenarios must not be empty"):
        tune_classical("skyhook", [])
    with pytest.raises(ValueError, match="population must be at least 5"):
        tune_classical("skyhook", [cars.escort()], population=1)
