"""A sensor reads what it is told to, within its range, in its steps, as blurred as it says."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.parts.sensor import Sensor

VALUE = st.floats(-1e3, 1e3)
DRAW = st.floats(-5.0, 5.0)


def measure(part, value, draw=0.0):
    return part.measure(value, draw, part.numbers)


@given(value=VALUE, draw=DRAW)
def test_a_perfect_sensor_reads_the_value_itself(value: float, draw: float):
    assert measure(Sensor(signal="v2"), value, draw) == value


@given(part=..., value=VALUE, draw=DRAW)
def test_readings_stay_in_range_and_in_steps(part: Sensor, value: float, draw: float):
    reading = measure(part, value, draw)
    step = part.resolution
    assert abs(reading) <= part.range + 0.5000001 * step
    if step:
        assert reading == pytest.approx(step * np.rint(reading / step), rel=1e-12)
    blurred = value + part.bias + part.noise * draw
    held = min(max(blurred, -part.range), part.range)
    assert reading == pytest.approx(held, rel=1e-12, abs=0.5000001 * step)


@given(value=VALUE)
def test_steps_are_those_of_rint(value: float):
    assert measure(Sensor(signal="v2", resolution=1.0), value) == np.rint(value)


def test_noise_and_bias_are_those_that_were_stated():
    rng = np.random.default_rng(0)
    readings = measure(Sensor(signal="v2", noise=0.5, bias=2.0), 1.0, rng.normal(size=100_000))
    # five standard errors of mean and deviation: 5 * 0.5 / sqrt(n), 5 * 0.5 / sqrt(2 n)
    assert readings.mean() == pytest.approx(3.0, abs=5 * 0.5 / math.sqrt(1e5))
    assert readings.std() == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(2e5))


def test_at_its_cutoff_the_filter_lets_through_half_the_power():
    """z' = a (value - z) answers exp(i w t) by a / (a + i w): |.|^2 = 1/2 at w = a."""
    part = Sensor(signal="v2", cutoff=50.0)
    w = 2 * math.pi * 50.0
    z = 1 / (1 + 1j)
    found = part.rate(part.State(z), 1.0, part.numbers).value
    assert found == pytest.approx(1j * w * z)
    assert abs(z) ** 2 == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        ({"noise": -0.1}, "standard deviation of the noise must not be negative, got -0.1; give 0"),
        ({"bias": math.nan}, "bias must be finite, got nan; give a finite number"),
        ({"range": 0.0}, "range must be positive, got 0; give a value above 0"),
        ({"resolution": -1.0}, "resolution must not be negative, got -1; give 0 or more"),
        ({"delay": -1.0}, "delay must not be negative, got -1 s; give 0 s or more"),
        ({"period": -1.0}, "period must not be negative, got -1 s; give 0 s or more"),
        ({"cutoff": -1.0}, "cutoff must not be negative, got -1 Hz; give 0 Hz or more"),
        ({"signal": ""}, "signal must be the name of one, got ''; give a text such as"),
        ({"signal": 3}, "signal must be the name of one, got 3; give a text such as"),
    ],
)
def test_what_is_refused_is_named_with_value_and_remedy(given_, message: str):
    with pytest.raises(ValueError, match=message):
        Sensor(**{"signal": "v2", **given_})
