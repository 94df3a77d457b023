import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from qcar_env.control.preview import Acceptable, regulator
from qcar_env.control.suspension import suspension
from qcar_env.physics.car import QuarterCar

CAR = QuarterCar.from_physical(
    m1=32.84, m2=345.1, k1=189_785.6, k2=21_898.0, c1=0.0, c2=1_459.4
)  # Ford Escort, CommonRoad
PLANT = suspension(CAR, 0.005)
LIMITS = Acceptable(acceleration=0.8, travel=0.05, tyre=0.01, force=3000.0)


def cost(xi, F):
    """Return the cost of a moment, by Newton's law."""
    travel, v2, tyre, v1 = xi
    a2 = (F - CAR.spring.k * travel - CAR.damper.c * (v2 - v1)) / CAR.m2
    terms = a2 / 0.8, travel / 0.05, tyre / 0.01, F / 3000.0
    return sum(each * each for each in terms)


def total(force, xi, slopes, steps=6000):
    """Return the cost of a law over a road, and the forces."""
    out, forces = 0.0, []
    for k in range(steps):
        F = force(k, xi)
        out += cost(xi, F)
        slope = slopes[k] if k < len(slopes) else 0.0
        xi = PLANT.Ad @ xi + PLANT.Bd * F + PLANT.Gd * slope
        forces.append(F)
    return out, np.array(forces)


def test_the_cost_to_go_is_the_cost():
    found, xi = regulator(PLANT, LIMITS), np.array([0.02, -0.3, 0.01, 0.5])
    paid, _ = total(lambda k, x: -found.K @ x, xi, [])
    assert paid == pytest.approx(xi @ found.P @ xi, rel=1e-9)


def test_no_other_gain_is_cheaper():
    found, rng = regulator(PLANT, LIMITS), np.random.default_rng(0)
    for _ in range(20):
        K, xi = found.K * (1.0 + 0.1 * rng.normal(size=4)), rng.normal(size=4)
        assert total(lambda k, x, K=K: -K @ x, xi, [], 2000)[0] >= xi @ found.P @ xi


def test_the_closed_loop_is_stable_and_its_poles_are_those_of_the_riccati_equation():
    found = regulator(PLANT, LIMITS)
    # The symplectic pencil's stable eigenvalues, with the cross term taken into A and Q.
    A = PLANT.Ad - np.outer(PLANT.Bd, found.N) / found.R
    Q = found.Q - np.outer(found.N, found.N) / found.R
    G = np.outer(PLANT.Bd, PLANT.Bd) / found.R
    inverse = np.linalg.inv(A).T
    symplectic = np.block([[A + G @ inverse @ Q, -G @ inverse], [-inverse @ Q, inverse]])
    stable = np.sort_complex([each for each in np.linalg.eigvals(symplectic) if abs(each) < 1.0])
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(found.closed)), stable, atol=1e-6)


@pytest.mark.parametrize("count", [1, 7, 40])
def test_preview_is_the_regulator_of_the_car_with_a_shift_register(count):
    # State (xi, s_k, ..., s_{k+n-1}): the register moves up, and zero comes in at its end.
    found, n = regulator(PLANT, LIMITS), count
    A = np.zeros((4 + n, 4 + n))
    A[:4, :4], A[:4, 4] = PLANT.Ad, PLANT.Gd
    A[4:-1, 5:] = np.eye(n - 1)
    B = np.append(PLANT.Bd, np.zeros(n))[:, np.newaxis]
    Q = np.zeros((4 + n, 4 + n))
    Q[:4, :4] = found.Q
    N = np.append(found.N, np.zeros(n))[:, np.newaxis]
    P = solve_discrete_are(A, B / 3000.0, Q, np.array([[found.R]]) / 9e6, s=N / 3000.0)
    K = ((B.T @ P @ A + N.T) / (found.R + B.T @ P @ B))[0]
    np.testing.assert_allclose(K[:4], found.K, rtol=1e-6)
    np.testing.assert_allclose(K[4:], found.preview_gains(n), rtol=1e-5, atol=1e-6)


def test_full_preview_is_the_least_squares_optimum():
    # All forces of 0.6 s at once: the outputs are linear in them.
    found, heights = regulator(PLANT, LIMITS), 0.1 * np.sin(np.linspace(0.0, np.pi, 61)) ** 2
    slopes = np.diff(heights) / 0.005
    plan = found.plan(heights, len(slopes))
    paid, _ = total(lambda k, x: -found.K @ x + (plan[k] if k < 60 else 0.0), np.zeros(4), slopes)

    def rows(forces, slopes):
        xi, out = np.zeros(4), []
        for F, s in zip(forces, slopes, strict=True):
            travel, v2, tyre, v1 = xi
            a2 = (F - CAR.spring.k * travel - CAR.damper.c * (v2 - v1)) / CAR.m2
            out += [a2 / 0.8, travel / 0.05, tyre / 0.01, F / 3000.0]
            xi = PLANT.Ad @ xi + PLANT.Bd * F + PLANT.Gd * s
        return np.array(out)

    n = 500  # 2.5 s: what is left after it is below the tolerance
    long = np.append(slopes, np.zeros(n - 60))
    matrix = np.stack([rows(unit, np.zeros(n)) for unit in np.eye(n)], axis=1)
    free = rows(np.zeros(n), long)
    best, *_ = np.linalg.lstsq(matrix, -free, rcond=None)
    least = float(np.sum((matrix @ best + free) ** 2))
    assert paid == pytest.approx(least, rel=1e-4)


def test_more_preview_never_costs_more_and_none_is_the_regulator():
    found, heights = regulator(PLANT, LIMITS), 0.1 * np.sin(np.linspace(0.0, np.pi, 61)) ** 2
    slopes = np.diff(heights) / 0.005
    assert not found.plan(heights, 0).any()
    assert found.preview_gains(0).shape == (0,)
    paid = []
    for count in (0, 5, 20, 60):
        plan = found.plan(heights, count)
        law = lambda k, x, plan=plan: -found.K @ x + (plan[k] if k < 60 else 0.0)  # noqa: E731
        paid.append(total(law, np.zeros(4), slopes)[0])
    assert paid == sorted(paid, reverse=True)


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="acceptable travel must be positive, got 0 m"):
        Acceptable(travel=0.0)
    with pytest.raises(ValueError, match="intervals of preview must be at least 0, got -1"):
        regulator(PLANT).preview_gains(-1)
    with pytest.raises(ValueError, match="heights must be finite"):
        regulator(PLANT).plan(np.array([0.0, np.nan]), 1)
