"""The largest displacement between two instants."""

import math

import numpy as np
from hypothesis import given, strategies as st

from qcar_env.physics.peaks import largest_between

number = st.integers(-(10**6), 10**6).map(lambda i: 1e-3 * i)


@given(a=st.floats(1e-3, 10.0), phase=st.floats(0.0, 6.3), angle=st.floats(1e-3, 1.0))
def test_an_oscillation_is_missed_by_its_fourth_power(a, phase, angle):
    x0, x1 = a * math.sin(phase), a * math.sin(phase + angle)
    v0, v1 = a * math.cos(phase), a * math.cos(phase + angle)
    found = float(largest_between(x0, v0, x1, v1, angle))
    true = a * np.abs(np.sin(np.linspace(phase, phase + angle, 2001))).max()
    assert abs(found - true) <= a * (angle**4 / 384.0 + angle**2 / 8.0 / 2000.0**2 + 1e-12)


@given(x0=number, v0=number, x1=number, v1=number)
def test_it_is_the_largest_of_the_cubic_and_never_below_the_ends(x0, v0, x1, v1):
    h = 0.5
    s = np.linspace(0.0, 1.0, 1001)
    a, b, rise = h * v0, h * v1, x1 - x0
    cubic = x0 + s * (a + s * (3.0 * rise - 2.0 * a - b + s * (a + b - 2.0 * rise)))
    found = float(largest_between(x0, v0, x1, v1, h))
    dense = float(np.abs(cubic).max())
    size = max(map(abs, (x0, x1, a, b)))
    assert found >= max(abs(x0), abs(x1))
    assert dense * (1.0 - 1e-12) <= found <= dense + 1e-5 * size


def test_arrays_are_numbers_one_by_one():
    rows = np.random.default_rng(0).normal(size=(4, 50))
    found = largest_between(*rows, 0.3)
    assert found.tolist() == [float(largest_between(*column, 0.3)) for column in rows.T]
