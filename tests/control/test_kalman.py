import numpy as np
import pytest

from qcar_env.control.kalman import kalman, lqg, road_intensity
from qcar_env.control.preview import regulator
from qcar_env.control.suspension import STATES, suspension
from qcar_env.physics.car import QuarterCar
from qcar_env.roads.excitation import Excitation
from qcar_env.roads.iso8608 import CLASSES, HIGHEST, ISO8608, LOWEST

ESCORT = {"m1": 32.84, "m2": 345.1, "k1": 189_785.6, "k2": 21_898.0, "c1": 0.0, "c2": 1_459.4}
PLANT = suspension(QuarterCar.from_physical(**ESCORT), 0.005)
READ = ("body_acceleration", "travel")
NOISE = np.array([0.03, 0.5e-3])
W = road_intensity(CLASSES["C"], 20.0)
FILTER = kalman(PLANT, READ, NOISE, W)


def test_the_intensity_is_that_of_the_roads_rate():
    # The road's waves lie between LOWEST and HIGHEST: the variance of its rate is W, both sides of
    # the spectrum, times the width of that band.
    road = Excitation(road=ISO8608.of_class("C", L=4000.0, seed=3), speed=20.0)
    rate = road.rate(np.linspace(10.0, 190.0, 40_000))
    band = 2.0 * 20.0 * (HIGHEST - LOWEST)
    # 20 ms of the shortest waves: 10 000 independent values, 1.4 % each, and the spline's 0.3 %.
    assert np.var(rate) == pytest.approx(W * band, rel=0.05)


def process():
    """Return the covariance of an interval's road noise by adding up thin slices."""
    n = 2000
    thin = PLANT.A * PLANT.dt / n
    step = np.eye(4) + thin + thin @ thin / 2
    g, total = PLANT.G + thin @ PLANT.G / 2, np.zeros((4, 4))  # the middle of the first slice
    for _ in range(n):
        total += np.outer(g, g) * W * PLANT.dt / n
        g = step @ g
    return total


def test_the_gain_is_where_the_recursion_ends():
    Q, P = process(), np.zeros((4, 4))
    for _ in range(40_000):  # ten time constants of the slowest pole, 0.99975
        S = FILTER.C @ P @ FILTER.C.T + np.diag(NOISE**2)
        L = np.linalg.solve(S, FILTER.C @ P).T
        P = PLANT.Ad @ (P - L @ FILTER.C @ P) @ PLANT.Ad.T + Q
    np.testing.assert_allclose(FILTER.covariance, P, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(FILTER.L, L, rtol=1e-5, atol=1e-9)


def test_the_errors_are_as_large_as_the_filter_says():
    rng, n = np.random.default_rng(0), 400
    root = np.linalg.cholesky(process() + 1e-18 * np.eye(4))
    # Begun with errors as they are in the long run, which the slowest pole takes 20 s to reach.
    xi = rng.multivariate_normal(np.zeros(4), FILTER.covariance, n)
    guess, f, errors = np.zeros((n, 4)), np.zeros(n), []
    for _ in range(200):
        r = xi @ FILTER.C.T + f[:, np.newaxis] * FILTER.d + rng.normal(size=(n, 2)) * NOISE
        errors.append(xi - guess)
        guess = guess + (r - guess @ FILTER.C.T - f[:, np.newaxis] * FILTER.d) @ FILTER.L.T
        f = rng.normal(scale=500.0, size=n)  # whatever it is, the filter is told
        guess = guess @ PLANT.Ad.T + f[:, np.newaxis] * PLANT.Bd
        xi = xi @ PLANT.Ad.T + f[:, np.newaxis] * PLANT.Bd + rng.normal(size=(n, 4)) @ root.T
    found = np.std(np.concatenate(errors), axis=0)
    # 400 cars: 4 %, and the samples of one car help a little.
    np.testing.assert_allclose(found, np.sqrt(np.diag(FILTER.covariance)), rtol=0.08)


def test_the_poles_are_those_of_regulator_and_filter():
    found = regulator(PLANT)
    c = lqg(found, FILTER)
    # Plant and controller, the force given in full.
    A = np.zeros((9, 9))
    own = np.hstack([np.outer(c.D, np.ones(1)).T @ FILTER.C, [c.C]]).ravel()
    own[8] += c.D @ FILTER.d  # the reading has the force before in it, which is the last memory
    A[:4, :4] = PLANT.Ad
    A[:4] += np.outer(PLANT.Bd, own)
    A[4:, :4] = c.B @ FILTER.C
    A[4:, 4:] = c.A
    A[4:, 8] += c.B @ FILTER.d
    A[4:] += np.outer(c.E, own)
    expected = [
        *np.linalg.eigvals(found.closed),
        *np.linalg.eigvals(PLANT.Ad @ (np.eye(4) - FILTER.L @ FILTER.C)),
        0.0,  # the force that is remembered
    ]
    found_poles = np.linalg.eigvals(A)
    for pole in expected:
        assert np.min(np.abs(found_poles - pole)) < 1e-5


def test_with_every_state_read_it_is_lqr():
    found = regulator(PLANT)
    sharp = lqg(found, kalman(PLANT, STATES, np.full(4, 1e-7), W))
    rng, xi, z = np.random.default_rng(0), np.zeros(4), np.zeros((1, 5))
    for _ in range(500):
        F = sharp.asked(z, xi[np.newaxis])
        assert F[0] == pytest.approx(-found.K @ xi, abs=1e-3)  # of some 100 N
        z = sharp.following(z, xi[np.newaxis], F)
        xi = PLANT.Ad @ xi + PLANT.Bd * F[0] + PLANT.Gd * rng.normal(scale=0.1)


def test_what_cannot_be_filtered_is_refused():
    with pytest.raises(ValueError, match="a filter must read something"):
        kalman(PLANT, (), np.zeros(0), W)
    with pytest.raises(ValueError, match="noise must be positive, one number for each"):
        kalman(PLANT, READ, np.array([0.1, 0.0]), W)
    with pytest.raises(ValueError, match="noise must be positive, one number for each"):
        kalman(PLANT, READ, np.array([0.1]), W)
    damped = suspension(QuarterCar.from_physical(**{**ESCORT, "c1": 100.0}), 0.005)
    with pytest.raises(ValueError, match=r"no signal may jump .* wheel_acceleration of a car"):
        kalman(damped, ("wheel_acceleration",), np.array([0.3]), W)
    with pytest.raises(ValueError, match="spectrum G must be positive"):
        road_intensity(0.0, 20.0)
