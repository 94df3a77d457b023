"""Metrics against their definitions."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.evaluation import metrics

amplitude = st.floats(1e-6, 1e3)


@given(a=amplitude, b=amplitude)
def test_the_papers_percentage_error_divides_by_the_controlled_amplitude(a, b):
    error = metrics.percentage_error(a, b)
    assert b * (1.0 + error / 100.0) == pytest.approx(a, rel=1e-9)  # cancels where a << b
    assert (error > 0.0) == (a > b)


def test_2556_percent_is_a_reduction_of_96_percent():
    """Erratum 8: 1 - 1 / (1 + 25.56)."""
    assert metrics.percentage_error(1.57, 1.57 * (1 - 0.96235)) == pytest.approx(2556, abs=1)
    assert metrics.reduction_db(26.56, 1.0) == pytest.approx(28.5, abs=0.05)


@given(a=amplitude, b=amplitude, c=amplitude)
def test_reductions_in_decibel_add_up(a, b, c):
    total = metrics.reduction_db(a, b) + metrics.reduction_db(b, c)
    assert total == pytest.approx(metrics.reduction_db(a, c), abs=1e-11)  # of up to 180 dB
    assert metrics.reduction_db(10.0 * b, b) == pytest.approx(20.0, rel=1e-12)


def test_perfect_control_has_no_finite_measure():
    assert metrics.percentage_error(1.0, 0.0) == math.inf
    assert metrics.reduction_db(1.0, 0.0) == math.inf


def test_control_that_alone_moves_the_mass_has_no_finite_measure_either():
    assert metrics.reduction_db(0.0, 1.0) == -math.inf
    assert metrics.reduction_db(1.0, math.inf) == -math.inf
    assert metrics.percentage_error(0.0, 1.0) == -100.0


@pytest.mark.parametrize("measure", [metrics.reduction_db, metrics.percentage_error])
def test_an_amplitude_is_not_negative(measure):
    with pytest.raises(ValueError, match="uncontrolled amplitude must not be negative, got -1 m"):
        measure(-1.0, 1.0)
    with pytest.raises(ValueError, match=r"^controlled amplitude must not .* got -2 m; give 0 m"):
        measure(1.0, -2.0)
    with pytest.raises(
        ValueError, match=r"^controlled amplitude must be a number .* got None; give"
    ):
        measure(1.0, None)


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (lambda: metrics.last_periods([], 55.0), r"t must be a row of numbers, got shape \(0,\)"),
        (lambda: metrics.last_periods(1.0, 55.0), r"t must be a row of numbers, got shape \(\)"),
        (lambda: metrics.rms([]), r"values must be a row of numbers, got shape \(0,\); give"),
        (
            lambda: metrics.settling_time([], [], 0.0),
            r"t must be a row of numbers, got shape \(0,\)",
        ),
        (lambda: metrics.settling_time([0.0, 1.0], [1.0], 0.0), "envelope must have the 2 samples"),
        (lambda: metrics.settling_time([0.0], [1.0], 1.0, 0.0), "band must be positive, got 0"),
        (lambda: metrics.settling_time([1.0, 0.0], [1.0, 1.0], 0.0), "t must rise, got times"),
        (lambda: metrics.settling_time([0.0], [1.0], math.nan), "what is left must be finite"),
        (lambda: metrics.rms(np.ma.array([1.0, 2.0], mask=[0, 1])), "values must be numbers"),
        (lambda: metrics.rms(["1"]), r"values must be numbers, got \['1'\]; give a list"),
        (
            lambda: metrics.settling_time(np.ma.array([0.0, 1.0], mask=[0, 1]), [1.0, 1.0], 1.0),
            "t must be numbers",
        ),
    ],
)
def test_a_record_must_have_samples(measure, message):
    with pytest.raises(ValueError, match=message):
        measure()


@pytest.mark.parametrize("measure", [metrics.reduction_db, metrics.percentage_error])
@pytest.mark.parametrize("pair", [(math.nan, 1.0), (1.0, math.nan), (np.float64("nan"), 1.0)])
def test_an_amplitude_that_is_no_number_is_refused(measure, pair):
    with pytest.raises(ValueError, match="controlled amplitude must be finite, got nan m"):
        measure(*pair)


@pytest.mark.parametrize(
    ("amplitudes", "free", "message"),
    [
        ((math.nan, 1.0), (1.0, 1.0), "amplitudes must be two, of at least 0 m, with and without"),
        ((-1.0, 1.0), (1.0, 1.0), "amplitudes must be two, of at least 0 m, with and without"),
        ((1.0, 1.0, 1.0), (1.0, 1.0), "amplitudes must be two, of at least 0 m, with and without"),
        ((1.0, 1.0), (0.0, 1.0), "uncontrolled amplitudes must be positive and finite, got"),
        ((1.0, 1.0), (1.0, math.inf), "uncontrolled amplitudes must be positive and finite, got"),
        (("1", "2"), (1.0, 1.0), r"amplitudes must be numbers, got \('1', '2'\)"),
        ((1.0, 1.0), (1.0, 1.0j), "uncontrolled amplitudes must be numbers"),
    ],
)
def test_a_share_of_nothing_or_of_no_number_is_refused(amplitudes, free, message):
    with pytest.raises(ValueError, match=message):
        metrics.rho(amplitudes, free)


@given(a=st.floats(0.0, 10.0), b=st.floats(0.0, 10.0), factor=st.floats(0.1, 10.0))
def test_rho_is_the_larger_share_and_has_no_unit(a, b, factor):
    found = metrics.rho((a, b), (2.0, 4.0))
    assert found == max(a / 2.0, b / 4.0)
    assert metrics.rho((factor * a, factor * b), (2.0 * factor, 4.0 * factor)) == pytest.approx(
        found, rel=1e-14
    )
    assert metrics.rho((math.inf, b), (2.0, 4.0)) == math.inf


@pytest.mark.parametrize("end", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("finite", [0, 5, 9])
def test_what_diverges_never_settles(finite, end):
    envelope = np.r_[np.ones(finite), np.full(10 - finite, end)]
    if end > 0.0 or math.isnan(end):
        assert metrics.settling_time(np.arange(10.0), envelope, 1.0) == math.inf


@given(
    omega=st.floats(1.0, 100.0),
    periods=st.integers(1, 8),
    samples=st.floats(5.0, 500.0),
    start=st.floats(-5.0, 5.0),
)
def test_the_last_periods_hold_at_least_their_length_and_no_sample_more(
    omega, periods, samples, start
):
    dt = 2.0 * math.pi / omega / samples
    t = start + dt * np.arange(math.ceil(periods * samples) + 50)
    found = t[metrics.last_periods(t, omega, periods)]
    assert found[-1] == t[-1]
    length = len(found) * dt  # each sample stands for the interval before it
    assert length >= periods * 2.0 * math.pi / omega * (1.0 - 1e-9)
    assert length < periods * 2.0 * math.pi / omega + dt * (1.0 + 1e-6)


@pytest.mark.parametrize("samples", [1, 2, 90])
def test_a_record_shorter_than_its_periods_is_refused(samples):
    t = 0.005 * np.arange(1, samples + 1)
    with pytest.raises(
        ValueError, match=r"record must hold 5 periods \(0.571 s\), got .*; simulate"
    ):
        metrics.last_periods(t, 55.0)


@pytest.mark.parametrize(
    ("omega", "periods", "message"),
    [(0.0, 5, "omega must be positive, got 0 rad/s"), (55.0, 0, "periods must be at least 1")],
)
def test_periods_must_be_periods(omega, periods, message):
    with pytest.raises(ValueError, match=message):
        metrics.last_periods(np.arange(100.0), omega, periods)


@given(a=st.floats(1e-6, 10.0), b=st.floats(-10.0, 10.0))
def test_rms_of_a_sine_and_of_a_constant(a, b):
    psi = 2.0 * math.pi * np.arange(100) / 100
    assert metrics.rms(a * np.sin(psi)) == pytest.approx(a / math.sqrt(2.0), rel=1e-12)
    assert metrics.rms(np.full(7, b)) == pytest.approx(abs(b), rel=1e-12, abs=1e-150)


@given(tau=st.floats(0.1, 2.0), first=st.floats(0.2, 2.0), left=st.floats(0.0, 1.0))
def test_an_exponential_settles_where_its_formula_says(tau, first, left):
    """first exp(-t / tau) is 5 % of no control at tau ln(20 first)."""
    t = np.linspace(0.0, 30.0 * tau, 30_001)
    envelope = left + first * np.exp(-t / tau)
    expected = tau * math.log(20.0 * first)
    found = [metrics.settling_time(time, envelope, left) for time in (t, t + 5.0)]
    assert found == pytest.approx([expected] * 2, abs=2e-3 * tau)  # a sample


@given(value=st.floats(0.0, 10.0), samples=st.integers(1, 500))
def test_what_does_not_change_has_settled(value, samples):
    t = np.arange(float(samples))
    assert metrics.settling_time(t, np.full(samples, value), value) == 0.0


@given(band=st.floats(0.01, 0.5))
def test_a_wider_band_is_reached_no_later(band):
    t = np.linspace(0.0, 10.0, 2001)
    envelope = np.exp(-t) * (1.5 + np.cos(7.0 * t))
    wide, narrow = (metrics.settling_time(t, envelope, 0.0, each) for each in (band, 0.5 * band))
    assert wide <= narrow
