import numpy as np
import pytest
from scipy.optimize import minimize

from qcar_env.control.preview import regulator
from qcar_env.control.suspension import suspension
from qcar_env.control.suspension_mpc import suspension_program
from qcar_env.physics.car import QuarterCar

CAR = QuarterCar.from_physical(
    m1=32.84, m2=345.1, k1=189_785.6, k2=21_898.0, c1=0.0, c2=1_459.4
)  # Ford Escort, CommonRoad
REGULATOR = regulator(suspension(CAR, 0.005))
PLANT = REGULATOR.plant
XI, SLOPES = np.array([0.01, -0.1, 0.002, 0.2]), np.full(30, 0.4)
WIDE = {"limit": 1e5, "rate": 1e9, "stroke": 10.0}


@pytest.mark.parametrize(("horizon", "preview"), [(10, 0), (10, 10), (10, 30), (20, 7)])
def test_without_constraints_it_is_the_regulator_with_preview(horizon, preview):
    p = suspension_program(REGULATOR, horizon=horizon, preview=preview, **WIDE)
    slopes = SLOPES[:preview]
    g, low, high = p.vectors(XI, slopes, 0.0)
    z = np.append(np.linalg.solve(p.H[:-1, :-1], -g[:-1]), 0.0)
    assert np.all((p.M @ z >= low) & (p.M @ z <= high))
    expected = -REGULATOR.K @ XI - REGULATOR.preview_gains(preview) @ slopes
    assert WIDE["limit"] * z[0] == pytest.approx(expected, rel=1e-7)


def test_the_program_is_the_cost_written_out():
    n, limit = 6, 2_000.0
    p = suspension_program(REGULATOR, limit=limit, rate=1e9, stroke=0.08, horizon=n, preview=n)
    rng = np.random.default_rng(0)

    def paid(forces):
        xi, total = XI, 0.0
        for k in range(n):
            F = limit * forces[k]
            total += xi @ REGULATOR.Q @ xi + 2.0 * F * (REGULATOR.N @ xi) + REGULATOR.R * F * F
            xi = PLANT.Ad @ xi + PLANT.Bd * F + PLANT.Gd * SLOPES[k]
        return total + xi @ REGULATOR.P @ xi

    def program(forces):
        z = np.append(forces, 0.0)
        return 0.5 * z @ p.H @ z + g @ z

    g, _, _ = p.vectors(XI, SLOPES[:n], 0.0)
    one, two, three = rng.normal(size=(3, n))
    ratio = (paid(one) - paid(two)) / (program(one) - program(two))
    assert paid(one) - paid(three) == pytest.approx(ratio * (program(one) - program(three)))


def test_its_rows_are_forces_changes_and_travel():
    n, limit, stroke = 5, 2_000.0, 0.08
    p = suspension_program(REGULATOR, limit=limit, rate=40e3, stroke=stroke, horizon=n, preview=3)
    _, low, high = p.vectors(XI, SLOPES[:3], 0.25)
    F = np.random.default_rng(1).uniform(-1.0, 1.0, n)
    rows = p.M @ np.append(F, 0.0)
    np.testing.assert_allclose(rows[:n], F)
    assert p.change == pytest.approx(40e3 * 0.005 / limit)
    np.testing.assert_allclose(rows[n : 2 * n], F - np.append(0.0, F[:-1]))
    assert (low[n] + high[n]) / 2.0 == pytest.approx(0.25)
    xi, travel = XI, []
    for k in range(n):
        slope = SLOPES[k] if k < 3 else 0.0
        xi = PLANT.Ad @ xi + PLANT.Bd * limit * F[k] + PLANT.Gd * slope
        travel.append(xi[0] / stroke)
    np.testing.assert_allclose(rows[2 * n : 3 * n] - low[2 * n : 3 * n], np.array(travel) + 1.0)
    np.testing.assert_allclose(high[3 * n : 4 * n] - rows[3 * n : 4 * n], 1.0 - np.array(travel))


def test_a_constrained_program_is_solved_as_another_solver_solves_it():
    osqp = pytest.importorskip("osqp")
    from scipy.sparse import csc_matrix, triu

    n = 8
    p = suspension_program(REGULATOR, limit=150.0, rate=40e3, stroke=0.012, horizon=n, preview=30)
    g, low, high = p.vectors(XI, SLOPES, 0.1)
    solver = osqp.OSQP()
    settings = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000, "verbose": False}
    solver.setup(P=csc_matrix(triu(p.H)), q=g, A=csc_matrix(p.M), l=low, u=high, **settings)
    found = solver.solve(raise_error=False).x
    rows = [
        {"type": "ineq", "fun": lambda z: (p.M @ z - low)[np.isfinite(low)]},
        {"type": "ineq", "fun": lambda z: (high - p.M @ z)[np.isfinite(high)]},
    ]
    other = minimize(
        lambda z: 0.5 * z @ p.H @ z + g @ z,
        np.zeros(n + 1),
        jac=lambda z: p.H @ z + g,
        constraints=rows,
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    ).x
    np.testing.assert_allclose(found, other, atol=1e-4)
    at_limit = np.isclose(p.M @ found, low, atol=1e-4) | np.isclose(p.M @ found, high, atol=1e-4)
    assert at_limit[:n].any()  # of the force


def test_bad_numbers_are_refused():
    good = {"limit": 2e3, "rate": 4e4, "stroke": 0.08, "horizon": 4, "preview": 4}
    for name, message in (
        ("limit", "force limit must be positive"),
        ("rate", "rate must be positive"),
        ("stroke", "stroke must be positive"),
        ("horizon", "horizon must be at least 1"),
    ):
        with pytest.raises(ValueError, match=message):
            suspension_program(REGULATOR, **{**good, name: 0})
    with pytest.raises(ValueError, match="intervals of preview must be at least 0"):
        suspension_program(REGULATOR, **{**good, "preview": -1})
