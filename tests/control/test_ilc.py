import numpy as np
import pytest

from qcar_env.control.ilc import learner
from qcar_env.control.preview import WEIGHTED, Acceptable, regulator
from qcar_env.control.suspension import suspension
from qcar_env.physics.car import QuarterCar

ESCORT = {"m1": 32.84, "m2": 345.1, "k1": 189_785.6, "k2": 21_898.0, "c1": 0.0, "c2": 1_459.4}
LIMITS = Acceptable()
SIZE = np.array([[LIMITS.acceleration], [LIMITS.travel], [LIMITS.tyre]])
N = 200
SLOPES = np.diff(0.1 * np.sin(np.pi * np.clip((np.arange(N + 1) - 20) / 60, 0, 1)) ** 2) / 0.005


def plant_and_regulator(**changes):
    plant = suspension(QuarterCar.from_physical(**{**ESCORT, **changes}), 0.005)
    return plant, regulator(plant, LIMITS)


def crossing(plant, K, plan):
    """Return the outputs (3, n) of a crossing, written out."""
    c, d, _ = plant.rows(WEIGHTED)
    xi, outputs = np.zeros(4), []
    for u, slope in zip(plan, SLOPES, strict=True):
        F = u - K @ xi
        xi = plant.Ad @ xi + plant.Bd * F + plant.Gd * slope
        outputs.append(c @ xi + d * F)
    return np.array(outputs).T


def cost(outputs, plan):
    return float(np.sum((outputs / SIZE) ** 2) + np.sum((plan / LIMITS.force) ** 2))


def test_it_learns_the_least_squares_plan_of_a_hump_that_it_does_not_know():
    plant, found = plant_and_regulator()
    teach, plan = learner(found, LIMITS, N), np.zeros(N)
    for _ in range(30):
        plan = teach.improved(plan, crossing(plant, found.K, plan))
    free = crossing(plant, found.K, np.zeros(N))
    rows = [crossing(plant, found.K, unit) - free for unit in np.eye(N)]
    matrix = np.vstack([np.stack([(r / SIZE).ravel() for r in rows], 1), np.eye(N) / LIMITS.force])
    wanted = -np.append((free / SIZE).ravel(), np.zeros(N))
    best, *_ = np.linalg.lstsq(matrix, wanted, rcond=None)
    np.testing.assert_allclose(plan, best, atol=1e-4 * np.abs(best).max())


def test_each_crossing_costs_less_and_caution_slows_it():
    plant, found = plant_and_regulator()
    fallen = []
    for caution in (0.0, 1.0, 100.0):
        teach, plan, costs = learner(found, LIMITS, N, caution=caution), np.zeros(N), []
        for _ in range(6):
            outputs = crossing(plant, found.K, plan)
            costs.append(cost(outputs, plan))
            plan = teach.improved(plan, outputs)
        assert np.all(np.diff(costs) <= 1e-6 * costs[0])
        fallen.append(costs[1])
    assert fallen == sorted(fallen)


def test_it_learns_with_a_body_that_is_heavier_than_it_believes():
    plant, _ = plant_and_regulator(m2=1.1 * ESCORT["m2"])
    _, found = plant_and_regulator()
    teach, plan, costs = learner(found, LIMITS, N, caution=10.0), np.zeros(N), []
    for _ in range(5):
        outputs = crossing(plant, found.K, plan)
        costs.append(cost(outputs, plan))
        plan = teach.improved(plan, outputs)
    assert costs[-1] < 0.6 * costs[0]


def test_what_does_not_fit_is_refused():
    _, found = plant_and_regulator()
    teach = learner(found, LIMITS, 10)
    with pytest.raises(ValueError, match=r"plan and outputs must be of 10 intervals, got shapes"):
        teach.improved(np.zeros(9), np.zeros((3, 10)))
    with pytest.raises(ValueError, match="outputs must be finite"):
        teach.improved(np.zeros(10), np.full((3, 10), np.nan))
    with pytest.raises(ValueError, match="intervals must be at least 1"):
        learner(found, LIMITS, 0)
    with pytest.raises(ValueError, match="caution must not be negative"):
        learner(found, LIMITS, 10, caution=-1.0)
