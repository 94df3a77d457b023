import numpy as np
import pytest

from qcar_env.control import lqr, mpc
from qcar_env.control.lqr import Weights
from qcar_env.scenarios import scenario

PAPER = scenario("paper")
A = np.array(PAPER.reference_amplitudes)
PLANT = lqr.sampled_plant(
    PAPER.car, np.concatenate([A, 55.0 * A]), np.diag(PAPER.actuator.limit), PAPER.dt
)
TURN = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
WORLD = np.array([[0.0, 0.0], [0.001, 0.0], [0.02, -0.01], [0.0, 0.03]])


def test_the_program_is_the_cost_of_the_rolled_out_forces():
    rng = np.random.default_rng(0)
    weights, n = Weights(q1=2.0, q2=3.0, r1=0.1, r2=0.2), 5
    program = mpc.tracking_program(PLANT, WORLD, TURN, weights, n)
    x0, w0 = rng.normal(size=4), rng.normal(size=2)
    plan_x, plan_u = rng.normal(size=(n, 4)), rng.normal(size=(n, 2))

    def cost(u):
        x, w, total = x0, w0, 0.0
        q = np.diag([2.0, 3.0, 2.0, 3.0])
        for k in range(n):
            x = PLANT.A @ x + PLANT.B @ u[k] + WORLD @ w
            w = TURN @ w
            last = lqr.cost_to_go(PLANT, weights) if k == n - 1 else q
            e, d = x - plan_x[k], u[k] - plan_u[k]
            total += e @ last @ e + d @ np.diag([0.1, 0.2]) @ d
        return total

    g = (
        program.from_state @ x0
        + program.from_world @ w0
        - program.from_plan @ plan_x.ravel()
        - program.from_forces @ plan_u.ravel()
    )
    for _ in range(5):
        u, v = rng.normal(size=(n, 2)), rng.normal(size=(n, 2))
        quadratic = [0.5 * f.ravel() @ program.H @ f.ravel() + g @ f.ravel() for f in (u, v)]
        # Twice the program is the cost, up to what does not depend on the forces.
        assert np.isclose(2.0 * (quadratic[0] - quadratic[1]), cost(u) - cost(v), rtol=1e-9)


def test_without_limits_world_and_plan_it_is_the_regulator():
    program = mpc.tracking_program(PLANT, WORLD, TURN, Weights(), 8)
    best = -np.linalg.solve(program.H, program.from_state)
    np.testing.assert_allclose(best[:2], -lqr.regulator(PLANT, Weights()), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("horizon", [0, 1.5, None, 10**9])
def test_a_horizon_is_a_whole_number_of_intervals(horizon):
    with pytest.raises(ValueError, match=f"horizon must be .*, got {horizon}; give 1 "):
        mpc.tracking_program(PLANT, WORLD, TURN, Weights(), horizon)
