"""Dampers take energy out at every rate; tables are their points and the lines between."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.parts.damper import BilinearDamper, Damper, LinearDamper, TableDamper

RATE = st.floats(-100.0, 100.0)
MATHWORKS = TableDamper(rates=(-1, -0.5, 0, 0.5, 1), forces=(-5700, -2250, 0, 2250, 6000))


def force(part, rate):
    return part.force(rate, part.numbers)


@given(part=..., rate=RATE)
def test_dampers_are_passive(part: Damper, rate: float):
    assert force(part, rate) * rate >= 0.0


@given(part=..., share=st.floats(0.0, 1.0))
def test_a_table_is_numpys_inside(part: TableDamper, share: float):
    rate = part.rates[0] + share * (part.rates[-1] - part.rates[0])
    # forces differ by up to 1e5 over each of eight lines
    expected = np.interp(rate, part.rates, part.forces)
    assert force(part, rate) == pytest.approx(expected, abs=1e-7)


def test_a_table_reads_as_printed_and_goes_on_straight():
    rates = np.array([-2.0, -1.0, -0.5, 0.0, 0.25, 1.0, 2.0])
    assert force(MATHWORKS, rates) == pytest.approx(
        [-5700 - 6900, -5700, -2250, 0, 1125, 6000, 6000 + 7500]
    )


@given(c=st.floats(0.0, 1e4), knee=st.floats(0.01, 1.0), rate=RATE)
def test_a_bilinear_damper_without_asymmetry_and_knee_is_linear(c: float, knee: float, rate: float):
    part = BilinearDamper(c_compression=c, c_rebound=c, knee=knee, fast=1.0)
    assert force(part, rate) == pytest.approx(force(LinearDamper(c=c), rate), rel=1e-12)


def test_a_bilinear_damper_has_its_slopes_in_rebound_compression_and_beyond_the_knee():
    part = BilinearDamper(c_compression=1000.0, c_rebound=1500.0, knee=0.2, fast=0.4)
    assert force(part, 0.1) == pytest.approx(150.0)
    assert force(part, -0.1) == pytest.approx(-100.0)
    assert force(part, 1.2) == pytest.approx(1500.0 * (0.2 + 0.4))
    assert force(part, -1.2) == pytest.approx(-1000.0 * (0.2 + 0.4))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: LinearDamper(c=-1.0),
            "damping c must not be negative, got -1 N s/m; give 0 N s/m",
        ),
        (
            lambda: BilinearDamper(c_compression=1.0, c_rebound=1.0, knee=0.0, fast=1.0),
            "speed of the knee must be positive, got 0 m/s; give a value above 0 m/s",
        ),
        (
            lambda: TableDamper(rates=(-1.0, 0.0, 1.0), forces=(1.0, 0.0, 1.0)),
            r"damper forces must not fall, got 0 N at \[1\] after 1 N; sort the points or mend",
        ),
        (
            lambda: TableDamper(rates=(-1.0, 0.0, 1.0), forces=(0.0, 1.0, 2.0)),
            r"damper table must hold the point \(0, 0\)",
        ),
    ],
)
def test_what_is_refused_is_named_with_value_and_remedy(make, message: str):
    with pytest.raises(ValueError, match=message):
        make()
