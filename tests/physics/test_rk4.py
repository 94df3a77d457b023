"""The step against the method's own theory: quadrature, stability polynomial, order."""

import cmath
import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics import rk4


class Point(NamedTuple):
    """A state of one entry."""

    x: float


def step_of(rate, x, size, w, t=0.0):
    inputs = (w(t), w(t + size / 2), w(t + size))
    return rk4.rk4_step(rate, Point(x), rk4.step_fractions(size), *inputs).x


@given(
    p=st.lists(st.floats(-10.0, 10.0), min_size=4, max_size=4),
    t=st.floats(-2.0, 2.0),
    size=st.floats(0.01, 2.0),
)
def test_an_input_alone_is_integrated_by_simpsons_rule_exact_for_cubics(p, t, size):
    cubic = np.polynomial.Polynomial(p)
    found = step_of(lambda x, w: Point(w), 0.0, size, cubic, t)
    whole = cubic.integ()
    # values of a cubic within |t| <= 4 reach 850, an interval is at most 2, roundings a dozen
    assert found == pytest.approx(whole(t + size) - whole(t), abs=1e-12)


@given(r=st.floats(0.0, 3.0), phi=st.floats(0.0, math.pi))
def test_a_linear_mode_is_multiplied_by_the_stability_polynomial(r, phi):
    z = cmath.rect(r, phi)
    found = step_of(lambda x, w: Point(z * x.x), 1.0, 1.0, lambda t: None)
    # Hairer and Wanner II, (IV.2.12): the exponential's series to the fourth power
    assert found == pytest.approx(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, rel=1e-13, abs=1e-13)


def growth(z):
    return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)


def test_below_the_stability_limit_no_decaying_mode_grows():
    """The half disc |z| <= limit, Re z <= 0 lies in the region where the polynomial is below 1."""
    r, phi = np.meshgrid(np.linspace(0.0, rk4.STABILITY_LIMIT, 400), np.linspace(0.5, 1.0, 400))
    assert np.max(growth(r * np.exp(1j * math.pi * phi))) <= 1.0 + 1e-15  # 1 at 0, to rounding


def test_the_limit_is_the_least_extent_of_the_region_with_a_small_margin():
    zeta = 0.53
    direction = complex(-zeta, math.sqrt(1.0 - zeta**2))
    assert growth(2.615 * direction) < 1.0 < growth(2.617 * direction)
    assert 2.5 < rk4.STABILITY_LIMIT < 2.616


def test_the_regions_extent_on_its_axes():
    assert growth(-2.785) < 1.0 < growth(-2.786)
    assert growth(2.828j) < 1.0 < growth(2.829j)


def test_the_accuracy_limit_is_the_local_error_that_its_comment_says():
    z = 1j * rk4.ACCURACY_LIMIT
    error = abs(np.exp(z) - (1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24))
    assert error == pytest.approx(rk4.ACCURACY_LIMIT**5 / 120, rel=0.1)  # next term: 0.5 / 6


def test_the_error_falls_with_the_fourth_power_of_the_step():
    """On x' = -x^3 + cos(t) x, x(0) = 1, which is Bernoulli's equation with a known solution."""
    t_end = 2.0

    def rate(x, w):
        return Point(w * x.x - x.x * x.x * x.x)

    # u = x^-2 solves u' = 2 - 2 cos(t) u; its integral by Gauss's rule to rounding
    nodes, weights = np.polynomial.legendre.leggauss(50)
    s = t_end / 2 * (nodes + 1)
    integral = t_end / 2 * np.sum(weights * 2 * np.exp(2 * np.sin(s)))
    exact = 1.0 / math.sqrt(math.exp(-2 * math.sin(t_end)) * (1.0 + integral))
    errors = []
    for count in (20, 40, 80, 160):
        x, size = 1.0, t_end / count
        for k in range(count):
            x = step_of(rate, x, size, math.cos, k * size)
        errors.append(abs(x - exact))
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert ratios == pytest.approx(16.0, rel=0.15)  # 2^4; the next order is a step of 0.1 away
    assert ratios[-1] == pytest.approx(16.0, rel=0.03)


def test_a_step_has_its_fractions():
    step = rk4.step_fractions(0.6)
    assert step == (0.6, 0.6 / 2, 0.6 / 3, 0.6 / 6)


def test_the_rate_is_asked_at_the_stages_and_its_arguments_are_passed_on():
    asked = []

    def rate(x, w, *args):
        asked.append((w, args))
        return Point(0.0)

    step = rk4.step_fractions(1.0)
    rk4.rk4_step(rate, Point(1.0), step, "a", "b", "c", 7, 8)
    assert asked == [("a", (7, 8)), ("b", (7, 8)), ("b", (7, 8)), ("c", (7, 8))]
