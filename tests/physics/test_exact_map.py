"""The exact map of an interval is the matrices of `linear`, and the limit of RK4."""

import dataclasses

import numpy as np
import pytest

from qcar_env import SCENARIOS
from qcar_env.physics.exact_map import ExactMap, Weights, exact_interval
from qcar_env.physics.forcing import World
from qcar_env.physics.linear import exact_transition
from qcar_env.physics.motion import angle, interval, plant, world_at
from qcar_env.physics.roads import Phasor
from qcar_env.physics.state import State

PAPER = SCENARIOS["paper"]


def map_of(scenario):
    made = exact_transition(scenario.car, scenario.road, scenario.force, scenario.dt)
    rows = np.hstack([made.A, made.B, made.road, made.force])
    by = World(angle(scenario.road.omega * scenario.dt), angle(scenario.force.Omega * scenario.dt))
    return ExactMap(*(Weights(*row) for row in rows), by), made


def test_it_is_the_product_with_the_matrices():
    exact, made = map_of(PAPER)
    rng = np.random.default_rng(0)
    x, u, road, force = (rng.normal(size=(k, 5)) for k in (4, 2, 2, 2))
    end, world = exact_interval(State(*x), World(Phasor(*road), Phasor(*force)), u[0], u[1], exact)
    expected = made.A @ x + made.B @ u + made.road @ road + made.force @ force
    # ten products in another order, each rounded by 1e-16 of the largest
    np.testing.assert_allclose(np.array(end), expected, rtol=0, atol=1e-14 * abs(expected).max())
    np.testing.assert_allclose(np.hypot(*world.road), np.hypot(*road), rtol=1e-14)


@pytest.mark.parametrize("substeps", [4, 8, 16])
def test_rk4_approaches_it_with_the_fourth_power_of_the_step(substeps):
    exact, _ = map_of(PAPER)
    start, world = State(0.1, -0.2, 3.0, 2.0), world_at(0.3, PAPER.road, PAPER.force)
    truth, _ = exact_interval(start, world, 20.0, -10.0, exact)

    def error(substeps):
        one = plant(PAPER.car, PAPER.road, PAPER.force, PAPER.dt / substeps)
        end, _, _ = interval(start, world, 0, 0.0, PAPER.dt, substeps, 20.0, -10.0, one)
        return np.abs(np.array(end) - truth).max()

    assert error(2 * substeps) < error(substeps) / 14.0  # 16, less what the fifth order adds


def test_floats_and_arrays_agree_bit_for_bit():
    exact, _ = map_of(dataclasses.replace(PAPER, dt=0.01))
    rng = np.random.default_rng(1)
    x, w, u = (rng.normal(size=(k, 3)) for k in (4, 4, 2))
    together, _ = exact_interval(State(*x), World(Phasor(*w[:2]), Phasor(*w[2:])), *u, exact)
    for i in range(3):
        a, b, c = (part[:, i].tolist() for part in (x, w, u))
        alone, _ = exact_interval(State(*a), World(Phasor(*b[:2]), Phasor(*b[2:])), *c, exact)
        assert alone == tuple(each[i] for each in together)
