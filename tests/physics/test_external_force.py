"""The force F = f cos(Omega t) of (4)."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics.external_force import ExternalForce

time = st.floats(-20.0, 20.0)


@given(f=st.floats(-50.0, 50.0), Omega=st.floats(0.0, 100.0), t=time)
def test_the_force_is_a_cosine(f, Omega, t):
    force = ExternalForce(f=f, Omega=Omega)
    assert force.value(t) == pytest.approx(f * math.cos(Omega * t), rel=1e-15, abs=1e-14)


@given(force=st.from_type(ExternalForce), t=time)
def test_the_rate_is_its_derivative(force, t):
    d = 1e-5 / max(force.Omega, 1.0)
    slope = (force.value(t + d) - force.value(t - d)) / (2 * d)
    # truncation (1e-5)^2 / 6; rounding of times up to 20 s: 4e-15 s / 1e-5 s times Omega
    scale = abs(force.f) * (1.0 + force.Omega)
    assert slope == pytest.approx(float(force.rate(t)), abs=1e-6 * scale)


@given(f=st.floats(-50.0, 50.0), t=time)
def test_without_a_frequency_it_is_constant(f, t):
    assert ExternalForce(f=f).value(t) == f
    assert ExternalForce(f=f).rate(t) == 0.0


def test_there_is_none_unless_given():
    assert np.all(ExternalForce().value(np.linspace(0.0, 9.0, 7)) == 0.0)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_it_must_be_finite(value):
    with pytest.raises(ValueError, match=f"f must be finite, got {value} m/s\\^2"):
        ExternalForce(f=value, Omega=55.0)
    with pytest.raises(ValueError, match=f"Omega must be finite, got {value} rad/s"):
        ExternalForce(f=1.0, Omega=value)


def test_its_frequency_must_not_be_negative():
    with pytest.raises(ValueError, match="Omega must not be negative, got -1 rad/s; give 0"):
        ExternalForce(f=1.0, Omega=-1.0)


@pytest.mark.parametrize("t", [None, math.nan, math.inf, "now", [0.0, math.nan]])
@pytest.mark.parametrize("method", ["value", "rate", "phasor"])
def test_a_time_must_be_finite(method, t):
    with pytest.raises(ValueError, match=r"^t must be finite \[s\], got .*; give a finite number"):
        getattr(ExternalForce(f=1.0, Omega=55.0), method)(t)


def test_it_holds_plain_floats():
    given_ = ExternalForce(f=np.array(2), Omega=np.float32(55.0))
    assert repr(given_) == "ExternalForce(f=2.0, Omega=55.0)"
    assert hash(given_) == hash(ExternalForce(f=2, Omega=55))
