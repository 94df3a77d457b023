"""Harmonic balance against closed forms, shooting and simulation."""

import dataclasses

import numpy as np
import pytest

from qcar_env.analysis.harmonic_balance import HarmonicBalance, balance
from qcar_env.analysis.newton import newton
from qcar_env.analysis.paper.fixed_points import balanced_start
from qcar_env.analysis.paper.forced_car import stack, sweep
from qcar_env.analysis.periodic_orbit import flow_map, periodic_orbits
from qcar_env.analysis.simulate import simulate
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.physics import linear

LAWS = [Passive(), CNVC(), LNVC(), PD(), PPF(), NDF()]


def cars_under(paper, law, count=5):
    car = dataclasses.replace(paper, law=law)
    return stack(list(sweep(car, "sigma1", np.linspace(-10.0, 10.0, count))))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_the_jacobian_is_the_derivative(paper, law):
    cars = cars_under(paper, law, 3)
    equations = HarmonicBalance(system=cars, harmonics=2)
    size = cars.dimension * equations.coefficients
    z = 0.1 * np.random.default_rng(0).standard_normal((size, 3))
    exact = equations.jacobian(z)
    direction = np.random.default_rng(1).standard_normal((size, 3))
    step = 1e-6
    slope = (
        equations.residual(z + step * direction) - equations.residual(z - step * direction)
    ) / (2 * step)
    # the cubic law's slope on the wheel is about 1e3 in these units
    np.testing.assert_allclose(
        np.einsum("nij,jn->in", exact, direction), slope, rtol=1e-5, atol=1e-4
    )


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_the_motion_obeys_the_equations(paper, law):
    """Carried over a period by RK4 (error 3e-8) it comes back."""
    cars = cars_under(paper, law)
    motion = balance(cars, harmonics=15, start=balanced_start(cars))
    assert motion.converged.all()
    begin = motion.states(np.zeros(1))
    end = flow_map(cars, begin, steps=512)
    scale = np.abs(motion.peaks)[:, :, None]
    assert np.max(np.abs(end - begin) / scale) < 1e-6


def test_it_is_the_orbit_of_the_shooting_method(paper):
    cars = cars_under(paper, CNVC(), 21)
    motion = balance(cars, harmonics=15, start=balanced_start(cars))
    orbit = periodic_orbits(cars, motion.states(np.zeros(1))[:, :, 0], steps=512)
    assert orbit.converged.all()
    begin = motion.states(np.zeros(1))[:, :, 0]
    assert np.max(np.abs(orbit.state - begin) / motion.peaks) < 1e-5
    np.testing.assert_allclose(orbit.peaks, motion.peaks, rtol=2e-5)


def test_the_engine_and_the_vectorised_rate_are_the_same_equations(paper):
    """`simulate` from the orbit's state stays on the orbit."""
    cars = cars_under(paper, CNVC(), 3)
    motion = balance(cars, harmonics=15, start=balanced_start(cars))
    car = dataclasses.replace(paper, law=CNVC())
    from qcar_env.physics.state import State

    start = State(*motion.states(np.zeros(1))[:, 1, 0])
    period = 2.0 * np.pi / car.omega
    history = simulate(
        car.car, car.road, car.force, car.law, duration=period, step=period / 400, start=start
    )
    expected = motion.states(car.omega * history.t)[:, 1]
    np.testing.assert_allclose(history.x1, expected[0], atol=1e-6)
    np.testing.assert_allclose(history.v2, expected[3], atol=1e-4)


def test_without_control_one_harmonic_is_exact(paper):
    found = balance(stack([paper]), harmonics=1)
    exact = linear.steady_state(paper.car, paper.road, paper.force)
    np.testing.assert_allclose(found.amplitude()[:, 0], exact.road + exact.force, rtol=1e-8)
    np.testing.assert_allclose(found.peaks[:2, 0], exact.amplitudes, rtol=1e-5)


def test_harmonics_converge(paper):
    """Each pair of harmonics brings the worst-case peak nearer; even ones stay zero."""
    cars = cars_under(paper, CNVC(), 1)
    reference = balance(cars, harmonics=21, start=balanced_start(cars))
    errors = [
        np.abs(
            balance(cars, harmonics=h, start=balanced_start(cars)).peaks / reference.peaks - 1
        ).max()
        for h in (1, 3, 5, 9)
    ]
    assert errors[0] > errors[1] > errors[2] > errors[3]
    assert errors[3] < 1e-5
    assert np.abs(reference.amplitude(2)[:2]).max() < 1e-12
    third = np.abs(reference.amplitude(3)[:2] / reference.amplitude(1)[:2])
    assert 0.005 < third.max() < 0.05  # why averaging is 2 % off at resonance


def test_newton_marks_columns_that_have_no_root():
    """z^2 = 2 converges, z^2 = -2 does not and says so; nothing raises."""
    right = np.array([2.0, -2.0])
    found = newton(
        lambda z: z * z - right,
        lambda z: (2.0 * z).T[:, :, None],
        np.array([[1.0, 1.0]]),
    )
    assert found.converged.tolist() == [True, False]
    assert found.z[0, 0] == pytest.approx(np.sqrt(2.0), rel=1e-12)
    assert found.residual[1] >= 2.0


def test_bad_input(paper):
    cars = stack([paper])
    with pytest.raises(ValueError, match="harmonics must be at least 1, got 0"):
        HarmonicBalance(system=cars, harmonics=0)
    with pytest.raises(ValueError, match="samples must be at least 8, got 4"):
        HarmonicBalance(system=cars, harmonics=3, samples=4)
