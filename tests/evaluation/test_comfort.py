"""Comfort: the standard's measures on signals whose measures are known in closed form."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from qcar_env.evaluation import comfort

DT = 1e-3


def sine(amplitude=1.0, seconds=4.0):
    t = DT * (np.arange(round(seconds / DT)) + 0.5)
    return amplitude * np.sin(2.0 * np.pi * 5.0 * t)


def test_a_sine_has_its_means():
    """Mean of sin^2 is 1/2, of sin^4 3/8."""
    aw = sine(2.0)
    assert comfort.weighted_rms(aw) == pytest.approx(math.sqrt(2.0), rel=1e-9)
    assert comfort.vdv(aw, DT) == pytest.approx(2.0 * (0.375 * 4.0) ** 0.25, rel=1e-9)
    assert comfort.crest_factor(aw) == pytest.approx(math.sqrt(2.0), rel=1e-3)
    assert comfort.mtvv(aw, DT) == pytest.approx(math.sqrt(2.0), rel=1e-6)


def test_the_running_means_of_a_constant_rise_as_a_line_and_an_exponential():
    aw = np.full(3_000, 3.0)
    t = DT * np.arange(1, 3_001)
    line = comfort.running_rms(aw, DT)
    assert line == pytest.approx(3.0 * np.sqrt(np.minimum(t, 1.0)), rel=1e-9)
    fading = comfort.running_rms(aw, DT, "exponential")
    assert fading == pytest.approx(3.0 * np.sqrt(1.0 - np.exp(-t)), rel=1e-9)


def test_a_shock_has_the_same_dose_in_a_longer_record_but_another_mean():
    """VDV is an integral: dividing by the time is a known mistake."""
    short, long = sine(3.0, 1.0), np.concatenate([sine(3.0, 1.0), np.zeros(9_000)])
    assert comfort.vdv(long, DT) == pytest.approx(comfort.vdv(short, DT), rel=1e-12)
    assert comfort.mtvv(long, DT) == pytest.approx(comfort.mtvv(short, DT), rel=1e-12)
    ratio = comfort.weighted_rms(short) / comfort.weighted_rms(long)
    assert ratio == pytest.approx(math.sqrt(10.0), rel=1e-9)


def test_doses_of_repeated_shocks_add_as_fourth_powers():
    one = comfort.vdv(sine(1.0, 1.0), DT)
    assert comfort.vdv(sine(1.0, 16.0), DT) == pytest.approx(2.0 * one, rel=1e-9)
    assert comfort.crossings(2.0 * one, value=one) == pytest.approx(1.0 / 16.0)


@given(seed=st.integers(0, 1_000), scale=st.floats(1e-3, 1e3), count=st.integers(1, 3_000))
@settings(max_examples=30, deadline=None)
def test_measures_scale_and_are_ordered(seed, scale, count):
    a = np.random.default_rng(seed).normal(size=(count, 3))
    rms, dose, largest = comfort.weighted_rms(a), comfort.vdv(a, DT), comfort.mtvv(a, DT)
    assert comfort.weighted_rms(scale * a) == pytest.approx(scale * rms, rel=1e-9)
    assert comfort.vdv(scale * a, DT) == pytest.approx(scale * dose, rel=1e-9)
    assert comfort.mtvv(scale * a, DT) == pytest.approx(scale * largest, rel=1e-6)
    assert comfort.crest_factor(scale * a) == pytest.approx(comfort.crest_factor(a), rel=1e-9)
    T = count * DT
    assert np.all(dose >= rms * T**0.25 * (1.0 - 1e-12))  # means of higher powers are larger
    assert np.all(dose <= np.abs(a).max(axis=0) * T**0.25 * (1.0 + 1e-12))
    assert comfort.vdv(a[:, 1], DT) == pytest.approx(dose[1], rel=1e-12)
    if T > 1.0:  # some second is at least as bad as the mean, less the record's rest
        assert np.all(largest >= rms * math.sqrt(T / math.ceil(T)) * (1.0 - 1e-9))


def test_only_a_shock_needs_more_than_its_mean():
    assert comfort.needs_more(sine(), DT) == {}
    shock = np.zeros(20_000)
    shock[100:120] = 1.0  # crest sqrt(1000), MTVV sqrt(20) means, VDV 1000^(1/4)
    found = comfort.needs_more(shock, DT)
    assert found["crest"] == pytest.approx(math.sqrt(1_000.0))
    assert found["mtvv"] == pytest.approx(math.sqrt(20.0))
    assert found["vdv"] == pytest.approx(1_000.0**0.25)
    assert comfort.needs_more(np.zeros(10), DT) == {}


@pytest.mark.parametrize(
    ("rms", "expected"),
    [
        (0.0, ("not uncomfortable",)),
        (0.31, ("not uncomfortable",)),
        (0.4, ("a little uncomfortable",)),
        (0.55, ("a little uncomfortable", "fairly uncomfortable")),
        (0.9, ("fairly uncomfortable", "uncomfortable")),
        (1.4, ("uncomfortable", "very uncomfortable")),
        (2.2, ("very uncomfortable", "extremely uncomfortable")),
        (9.0, ("extremely uncomfortable",)),
    ],
)
def test_words_are_those_of_annex_c(rms, expected):
    assert comfort.words(rms) == expected


@given(rms=st.floats(0.0, 1e6))
def test_there_is_always_a_word(rms):
    assert 1 <= len(comfort.words(rms)) <= 2


def test_health_values_are_those_of_the_directive():
    assert comfort.ACTION == (0.5, 9.1)
    assert comfort.LIMIT == (1.15, 21.0)
    assert comfort.a8(0.5, 8.0 * 3_600.0) == pytest.approx(0.5)
    assert comfort.a8(1.0, 2.0 * 3_600.0) == pytest.approx(0.5)  # a quarter of the time, doubled
    # a known pair: the Escort on Watts' hump at 30 km/h, and a BMW 320i
    assert comfort.crossings(2.22) == pytest.approx(282.0, abs=1.0)
    assert comfort.crossings(3.13) == pytest.approx(71.0, abs=1.0)
    assert comfort.crossings(0.0) == math.inf
    assert comfort.crossings(1e-300) == math.inf


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: comfort.vdv([1.0], 0.0), "dt must be positive"),
        (lambda: comfort.vdv([], 1.0), "weighted acceleration must have shape"),
        (lambda: comfort.weighted_rms([np.inf]), "weighted acceleration must be finite"),
        (lambda: comfort.mtvv([1.0], 1.0, "square"), "unknown running mean 'square'"),
        (lambda: comfort.words(-1.0), "root mean square must not be negative"),
        (lambda: comfort.crossings(-1.0), "dose must not be negative"),
        (lambda: comfort.a8(1.0, math.nan), "exposure must be finite"),
    ],
)
def test_what_is_no_measure_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
