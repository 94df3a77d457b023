import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

from qcar_env.control.h_infinity import h_infinity
from qcar_env.control.preview import Acceptable
from qcar_env.control.suspension import suspension
from qcar_env.physics.car import QuarterCar

CAR = QuarterCar.from_physical(
    m1=32.84, m2=345.1, k1=189_785.6, k2=21_898.0, c1=0.0, c2=1_459.4
)  # Ford Escort, CommonRoad
PLANT = suspension(CAR, 0.005)
READ = ("body_acceleration", "travel")
NOISE = np.array([0.03, 0.5e-3])
FOUND = h_infinity(PLANT, READ, NOISE, road=0.3)


def loop(found):
    """Return the continuous closed loop from w to z, in force units: A, B, C."""
    g, (N, M, F2) = found.plant, found.observer
    A = np.block([[g.A, g.B2 @ F2], [M @ g.C2, N + g.B2 @ F2]])
    B = np.vstack([g.B1, M @ g.D21])
    C = np.hstack([g.C1, g.D12 @ F2])
    return A, B, C


def norm_at(A, B, C, omega):
    return np.linalg.norm(C @ np.linalg.solve(1j * omega * np.eye(len(A)) - A, B), 2)


def exceeds(A, B, C, gamma):
    """Return whether the norm reaches gamma: the Hamiltonian has imaginary eigenvalues then."""
    hamiltonian = np.block([[A, B @ B.T / gamma**2], [-C.T @ C, -A.T]])
    values = np.linalg.eigvals(hamiltonian)
    return np.min(np.abs(values.real) / np.abs(values)) < 1e-7


def test_the_loop_keeps_the_bound_and_no_more_is_lost_than_allowed():
    A, B, C = loop(FOUND)
    assert np.linalg.eigvals(A).real.max() < 0.0
    peak = max(norm_at(A, B, C, omega) for omega in np.geomspace(1e-2, 1e5, 4000))
    assert FOUND.least * (1.0 - 1e-3) <= peak <= FOUND.gamma
    assert not exceeds(A, B, C, FOUND.gamma)
    assert exceeds(A, B, C, 0.99 * peak)


def test_near_the_least_gamma_the_norm_is_that():
    near = h_infinity(PLANT, READ, NOISE, road=0.3, above=1.001)
    A, B, C = loop(near)
    peak = max(norm_at(A, B, C, omega) for omega in np.geomspace(1e-2, 1e5, 4000))
    assert peak == pytest.approx(near.least, rel=2e-3)


def test_no_controller_is_below_what_the_wheel_makes_of_the_road():
    # At sqrt(k1 / m1) no force between the masses changes the body: x2 = -(m1 / m2) y, so that
    # a2 / y' = (m1 / m2) omega1 (J. K. Hedrick, T. Butsuen, 1990).
    fixed = CAR.m1 / CAR.m2 * np.sqrt(CAR.tyre.k / CAR.m1)
    assert fixed * 0.3 < FOUND.least < 1.1 * fixed * 0.3
    A, B, C = loop(FOUND)
    omega1 = np.sqrt(CAR.tyre.k / CAR.m1)
    row = (C @ np.linalg.solve(1j * omega1 * np.eye(8) - A, B))[0, 0]
    assert abs(row) == pytest.approx(fixed * 0.3, rel=1e-9)


def test_far_from_the_least_gamma_it_is_lqg():
    g = h_infinity(PLANT, READ, NOISE, road=0.3, above=1e4)
    p, (_, M, F2) = g.plant, g.observer
    X = solve_continuous_are(p.A, p.B2, p.C1.T @ p.C1, p.D12.T @ p.D12, s=p.C1.T @ p.D12)
    K = np.linalg.solve(p.D12.T @ p.D12, p.B2.T @ X + p.D12.T @ p.C1)
    np.testing.assert_allclose(F2, -K, rtol=1e-4, atol=1e-6 * np.abs(K).max())
    Y = solve_continuous_are(p.A.T, p.C2.T, p.B1 @ p.B1.T, p.D21 @ p.D21.T)
    np.testing.assert_allclose(M, Y @ p.C2.T, rtol=1e-3, atol=1e-6 * np.abs(M).max())


def test_sampled_it_is_the_continuous_controller_where_the_car_moves():
    # The force freed of its own share in the readings: r - d f, f = F.
    c, (N, M, F2) = FOUND.controller, FOUND.observer
    g, force = FOUND.plant, Acceptable().force
    for hertz in (0.5, 1.5, 5.0):
        s = 2j * np.pi * hertz
        exact = force * F2 @ np.linalg.solve(s * np.eye(4) - N - g.B2 @ F2, M / NOISE)
        z = np.exp(s * 0.005)
        # Without the remembered force: its share was taken off the readings above.
        A = c.A[:4, :4] + np.outer(c.E[:4], c.C[:4])
        B = c.B[:4] + np.outer(c.E[:4], c.D)
        sampled = c.C[:4] @ np.linalg.solve(z * np.eye(4) - A, B) + c.D
        # The force that is held lags by half an interval: 5 % at 3 Hz.
        np.testing.assert_allclose(sampled, exact[0], rtol=0.02 * hertz + 0.02)


def test_the_sampled_loop_is_stable():
    c = FOUND.controller
    C2, d, _ = PLANT.rows(READ)
    A = np.zeros((9, 9))
    own = np.concatenate([c.D @ C2, c.C])
    own[8] += c.D @ d
    A[:4, :4], A[4:, :4], A[4:, 4:] = PLANT.Ad, c.B @ C2, c.A
    A[4:, 8] += c.B @ d
    A[:4] += np.outer(PLANT.Bd, own)
    A[4:] += np.outer(c.E, own)
    assert np.abs(np.linalg.eigvals(A)).max() < 1.0
    np.testing.assert_allclose(PLANT.Ad, expm(PLANT.A * 0.005), rtol=1e-9, atol=1e-12)


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="above must be above 1, got 1"):
        h_infinity(PLANT, READ, NOISE, above=1.0)
    with pytest.raises(ValueError, match="noise must be positive, one number for each"):
        h_infinity(PLANT, READ, np.zeros(2))
    with pytest.raises(ValueError, match="road must be positive"):
        h_infinity(PLANT, READ, NOISE, road=0.0)
