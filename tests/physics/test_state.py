"""Signs and readings of a state."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics import state
from qcar_env.physics.state import State

angle = st.floats(0.0, 2.0 * math.pi)


@given(x=st.from_type(State), by=st.floats(-1.0, 1.0))
def test_lifting_car_and_road_together_changes_no_deflection(x: State, by: float):
    lifted = x._replace(x1=x.x1 + by, x2=x.x2 + by)
    # two additions of numbers up to 2, each rounded to 2.2e-16
    assert state.suspension_travel(lifted) == pytest.approx(state.suspension_travel(x), abs=1e-15)
    assert state.tyre_deflection(lifted, by) == pytest.approx(
        state.tyre_deflection(x, 0.0), abs=1e-15
    )


def test_a_lifted_body_stretches_the_suspension_and_a_bump_presses_the_tyre():
    assert state.suspension_travel(State(0.0, 0.1, 0.0, 0.0)) > 0.0
    assert state.tyre_deflection(State(0.0, 0.0, 0.0, 0.0), 0.1) < 0.0


@given(a1=st.floats(0.0, 2.0), a2=st.floats(0.0, 2.0), psi1=angle, psi2=angle)
def test_the_envelope_amplitude_is_that_of_a_pure_oscillation_at_any_instant(a1, a2, psi1, psi2):
    omega = 55.0
    x = State(  # (5)-(8)
        a1 * math.cos(psi1),
        a2 * math.cos(psi2),
        -omega * a1 * math.sin(psi1),
        -omega * a2 * math.sin(psi2),
    )
    found = state.squared_amplitudes(x, 1.0 / omega)
    assert found == pytest.approx((a1 * a1, a2 * a2), rel=1e-14)  # a few roundings


def test_floats_arrays_and_tensors_give_the_same_bits(same_bits):
    rng = np.random.default_rng(1)
    x, step = State(*rng.normal(size=(4, 64))), rng.random(64)
    same_bits(state.squared_amplitudes, x, step)
    same_bits(state.suspension_travel, x)
    same_bits(state.tyre_deflection, x, step)
