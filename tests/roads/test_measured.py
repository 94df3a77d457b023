"""Roads from samples."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import PchipInterpolator

from qcar_env.roads.measured import SampledRoad
from qcar_env.roads.shapes import HalfSine, Parabola

heights = st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=30)


@given(y=heights, begin=st.floats(-100.0, 100.0), spacing=st.floats(0.01, 1.0))
def test_it_goes_through_its_samples_and_is_flat_beyond_them(y, begin, spacing):
    s = begin + spacing * np.arange(len(y))
    road = SampledRoad(distances=s, samples=y)
    # rounded distances times slopes of up to 100
    assert road.heights(s) == pytest.approx(y, abs=1e-10)
    assert road.heights([-1e6, 1e6]).tolist() == pytest.approx([y[0], y[-1]], abs=1e-15)
    assert road.slopes([-1e6, 1e6]).tolist() == [0.0, 0.0]
    assert road.kinks(-1e3, 1e3) == [s[0], s[-1]]


@given(y=st.lists(st.floats(-0.2, 0.2), min_size=4, max_size=30))
def test_slope_and_curvature_are_continuous_at_the_samples(y):
    road = SampledRoad(distances=np.arange(len(y)), samples=y)
    inner = np.arange(1.0, len(y) - 1.0)
    before, after = road.slopes(inner - 1e-9), road.slopes(inner + 1e-9)
    assert before == pytest.approx(after, abs=1e-7)
    a, b, c = (road.slopes(inner + d) for d in (-1e-6, 0.0, 1e-6))
    assert c - b == pytest.approx(b - a, abs=1e-11)  # third derivatives of up to 10, squared 1e-6


@given(c=st.lists(st.floats(-0.1, 0.1), min_size=4, max_size=4), share=st.floats(0.0, 0.999))
def test_a_cubic_stays_itself_evenly_sampled_or_not(c, share):
    s = np.array([-1.0, -0.8, 0.1, 0.2, 0.9, 1.5])
    at = -1.0 + 2.5 * share
    for road in (
        SampledRoad(distances=s, samples=np.polyval(c, s), spacing=0.07),
        SampledRoad(
            distances=np.linspace(-1, 1.5, 6), samples=np.polyval(c, np.linspace(-1, 1.5, 6))
        ),
    ):
        assert road.heights(at) == pytest.approx(np.polyval(c, at), abs=1e-13)
        assert road.slopes(at) == pytest.approx(np.polyval(np.polyder(c), at), abs=1e-11)


def test_a_sampled_sine_keeps_its_tops():
    """Eight samples a wave, the top midway: a spline errs by (k d)^4 / 384 = 1e-3 or so."""
    s, between = np.arange(0.0, 80.0), np.linspace(20.0, 60.0, 4001)
    y = np.sin(0.25 * math.pi * (s + 0.5))
    assert SampledRoad(distances=s, samples=y).heights(between).max() == pytest.approx(
        1.0, abs=2e-3
    )
    # two equal samples beside the top: cos(pi / 8)
    assert PchipInterpolator(s, y)(between).max() == pytest.approx(
        math.cos(math.pi / 8.0), abs=1e-12
    )


@pytest.mark.parametrize("hump", [HalfSine(h=0.1, wavenumber=2.0), Parabola(h=0.1, L=1.5)])
def test_a_function_with_kinks_is_sampled_up_to_them(hump):
    road = SampledRoad.from_function(
        lambda s: hump.heights(s).item(),
        start=-1.0,
        end=3.0,
        spacing=0.05,
        kinks_at=hump.kinks(-1.0, 3.0),
    )
    s = np.linspace(-2.0, 4.0, 777)
    # (k d)^4 / 384 of 0.1 m
    assert road.heights(s) == pytest.approx(hump.heights(s), abs=1e-7)
    assert road.kinks(-0.5, 2.5) == hump.kinks(-0.5, 2.5)
    p, table = road.numbers, road.table
    assert road.slope(hump.start, 1, p, table) == pytest.approx(0.0, abs=1e-15)
    expected = hump.slope(0.0, 1, hump.numbers, hump.table)
    assert road.slope(hump.start, 2, p, table) == pytest.approx(expected, abs=1e-4)


def test_a_distance_that_stands_twice_is_a_jump():
    road = SampledRoad(distances=[0.0, 1.0, 1.0, 2.0], samples=[0.0, 0.0, 0.1, 0.1])
    assert road.kinks(-1.0, 3.0) == [0.0, 1.0, 2.0]
    assert road.jumps(-1.0, 3.0) == [0.0, 0.1, 0.0]
    assert road.heights([0.999, 1.0, 3.0]).tolist() == [0.0, 0.1, 0.1]


def test_a_stated_kink_keeps_a_corner():
    s = np.linspace(0.0, 2.0, 21)
    y = 0.1 * np.abs(s - 1.0)
    sharp = SampledRoad(distances=s, samples=y, kinks_at=(1.0,))
    assert sharp.heights([0.95, 1.05]) == pytest.approx([0.005, 0.005], abs=1e-15)
    assert sharp.slopes([0.999, 1.0]) == pytest.approx([-0.1, 0.1], abs=1e-14)
    assert SampledRoad(distances=s, samples=y).heights(1.05) < 0.0049  # the price of no kink


def test_a_lookup_of_what_is_no_number_stays_in_the_table():
    road = SampledRoad(distances=[0.0, 1.0], samples=[0.1, 0.2])
    for s in (math.nan, math.inf, -math.inf, 1e300):
        road.height(s, 1, road.numbers, road.table.tolist())


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        (dict(distances=[0.0], samples=[0.1]), "two or more samples each"),
        (dict(distances=[], samples=[]), "two or more samples each"),
        (dict(distances=[0.0, 1.0], samples=[0.1]), "got shapes (2,) and (1,); give one height"),
        (
            dict(distances=[0.0, 2.0, 1.0], samples=[0.0, 0.0, 0.0]),
            "distances must rise, got 2 m and then 1 m at sample 2; sort",
        ),
        (
            dict(distances=[0.0, 1.0, 1.0, 1.0, 2.0], samples=[0.0] * 5),
            "distances must rise, got 1 m and then 1 m",
        ),
        (dict(distances=[0.0, 0.0, 1.0], samples=[0.0] * 3), "must stand once, got 0 and 1 m"),
        (dict(distances=[0.0, 1.0], samples=[0.0, math.nan]), "samples must be finite [m], got"),
        (dict(distances=[0.0, math.inf], samples=[0.0, 0.0]), "distances must be finite [m]"),
        (
            dict(distances=[0.0, 1.0, 3.0], samples=[0.0] * 3),
            "distances must be even between kinks, got [0.0, 1.0, 3.0] ... of 3 samples",
        ),
        (
            dict(distances=[0.0, 1.0, 2.0], samples=[0.0] * 3, kinks_at=(1.5,)),
            "kinks_at must be among the distances between the first and the last, got 1.5 m",
        ),
        (
            dict(distances=[0.0, 1.0], samples=[0.0] * 2, spacing=0.0),
            "spacing must be positive, got 0 m",
        ),
    ],
)
def test_bad_samples_are_refused_with_name_value_and_remedy(given_, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        SampledRoad(**given_)
    assert message in str(error.value)


def test_a_stretch_that_ends_before_it_begins_is_refused():
    with pytest.raises(ValueError, match="end must lie after start, got 1 to 0 m"):
        SampledRoad.from_function(math.sin, start=1.0, end=0.0, spacing=0.1)
