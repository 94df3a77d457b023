"""Largest Lyapunov exponents and Poincare sections of systems where they are known."""

from dataclasses import dataclass

import numpy as np
import pytest

from qcar_env.analysis.chaos import largest_lyapunov_exponent, poincare_section
from qcar_env.analysis.paper.forced_car import stack
from qcar_env.physics import linear


@dataclass(frozen=True)
class Lorenz:
    """sigma = 10, rho = 28, beta = 8/3: exponent 0.9056 (Sprott, Chaos and Time-Series, 2003)."""

    dimension = 3
    omega = np.array([2.0 * np.pi])  # a "period" of 1 s, the system has no forcing
    scale = np.full((3, 1), 10.0)

    def rate(self, state, phase):
        x, y, z = state
        return np.array([10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z])


@dataclass(frozen=True)
class TwoFrequencies:
    """An undamped oscillator forced off its own frequency: quasi-periodic motion."""

    dimension = 2
    omega = np.array([1.0])
    scale = np.ones((2, 1))

    def rate(self, state, phase):
        x, v = state
        return np.array([v, -2.0 * x + np.cos(phase)])


@pytest.mark.slow
def test_the_exponent_of_the_lorenz_system():
    """300 s: the running mean has settled to 0.05."""
    found = largest_lyapunov_exponent(
        Lorenz(), np.array([[1.0], [1.0], [20.0]]), np.random.default_rng(0), periods=300,
        settle=20, steps=200,
    )  # fmt: skip
    assert found.exponent[0] == pytest.approx(0.9056, abs=0.06)
    assert not found.diverged[0]


def test_the_exponent_of_the_uncontrolled_car_is_its_slowest_pole(paper):
    """A linear plant cannot be chaotic, whatever the paper's section 5 calls it."""
    found = largest_lyapunov_exponent(
        stack([paper]), np.full((4, 1), 0.1), np.random.default_rng(0), periods=60, settle=20,
        steps=64,
    )  # fmt: skip
    slowest = linear.poles(paper.car).real.max()
    # RK4 with 64 steps a period damps the slow mode by 1e-3 of its rate
    assert found.exponent[0] == pytest.approx(slowest, rel=5e-3)
    assert found.history.shape == (60, 1)


def test_the_same_seed_gives_the_same_estimate(paper):
    runs = [
        largest_lyapunov_exponent(
            stack([paper]), np.full((4, 1), 0.1), np.random.default_rng(seed), periods=3,
            settle=0, steps=32,
        ).exponent[0]
        for seed in (5, 5, 6)
    ]  # fmt: skip
    assert runs[0] == runs[1] != runs[2]


def test_a_periodic_motion_is_one_point_of_the_section(paper):
    exact = linear.steady_state(paper.car, paper.road, paper.force).state(0.0)
    section = poincare_section(stack([paper]), exact[:, None], periods=5, settle=0, steps=256)
    assert section.shape == (4, 1, 5)
    np.testing.assert_allclose(section[:, 0, :], np.tile(exact[:, None], 5), rtol=1e-4)


def test_a_quasi_periodic_motion_is_a_closed_curve():
    """Points never repeat, and lie on one ellipse about the forced motion x = cos(t)."""
    section = poincare_section(TwoFrequencies(), np.zeros((2, 1)), periods=60, settle=0, steps=128)
    x, v = section[:, 0]
    radius = 2.0 * (x - 1.0) ** 2 + v * v  # energy of the free part is kept
    np.testing.assert_allclose(radius, radius[0], rtol=1e-4)
    assert np.unique(np.round(x, 6)).size > 50


def test_a_motion_that_leaves_all_bounds_is_marked(paper):
    car = paper.vary("E3", 60_000.0)
    found = largest_lyapunov_exponent(
        stack([car]), np.full((4, 1), 1e300), np.random.default_rng(0), periods=40, settle=0,
        steps=16,
    )  # fmt: skip
    assert found.diverged[0]
    assert np.isnan(found.exponent[0])
