"""What a tyre makes of a road."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from qcar_env.roads.enveloping import moving_average, rolling_disc
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.measured import SampledRoad
from qcar_env.roads.shapes import CircularArc, HalfSine, Parabola, Sine, SquareBar, Step
from qcar_env.roads.train import Train

R = 0.3  # [m]


@given(slope=st.floats(-0.2, 0.2), contact=st.floats(0.05, 0.5))
@settings(max_examples=10)
def test_the_mean_of_a_straight_line_is_the_line(slope, contact):
    line = SampledRoad(distances=[-50.0, 50.0], samples=[-50.0 * slope, 50.0 * slope])
    road = moving_average(line, contact=contact, start=-10.0, end=10.0)
    s = np.linspace(-10.0, 9.9, 77)
    # the integral over 20 m of heights of up to 2 m is rounded to 1e-14, over a contact of 5 cm
    assert road.heights(s) == pytest.approx(slope * s, abs=1e-12)


@given(h=st.floats(0.01, 0.1), L=st.floats(0.05, 0.2))
@settings(max_examples=10)
def test_the_mean_of_a_bar_is_lower_and_longer(h, L):
    bar = SquareBar(h=h, L=L, start=1.0)
    road = moving_average(bar, contact=0.25)
    s = np.linspace(0.5, 2.0, 500)
    y = road.heights(s)
    assert y.max() == pytest.approx(h * L / 0.25, rel=1e-12)
    assert road.length - road.kinks(0.0, 1.0)[0] == pytest.approx(L + 0.25, abs=1e-12)
    assert road.jumps(0.0, 5.0) == [0.0] * len(road.kinks(0.0, 5.0))
    # a trapezium: ramps as long as the shorter of bar and contact
    front, rear = s - (1.0 - 0.125), (1.0 + L + 0.125) - s
    expected = np.clip(np.minimum(front, rear), 0.0, L) * h / 0.25
    assert y == pytest.approx(expected, abs=1e-13)


def test_the_mean_of_a_sine_is_a_lower_sine():
    k, contact = 5.0, 0.25
    road = moving_average(Sine(h=0.1, wavenumber=k), contact=contact, start=0.0, end=6.0)
    s = np.linspace(0.1, 5.9, 333)  # the spline is coarser at its ends
    lower = math.sin(0.5 * k * contact) / (0.5 * k * contact)
    # the spline's (k d)^4 / 384
    assert road.heights(s) == pytest.approx(0.1 * lower * np.sin(k * s), abs=1e-7)


def test_the_mean_keeps_the_area():
    hump = HalfSine.of_length(h=0.1, L=1.0)
    road = moving_average(hump, contact=0.25)
    s = np.linspace(-0.5, 1.5, 20_001)
    assert road.heights(s).sum() * 1e-4 == pytest.approx(0.2 / math.pi, abs=1e-8)


@given(slope=st.floats(-0.2, 0.2))
@settings(max_examples=10)
def test_a_disc_on_a_straight_line_rolls_along_a_parallel_one(slope):
    line = SampledRoad(distances=[-50.0, 50.0], samples=[-50.0 * slope, 50.0 * slope])
    road = rolling_disc(line, radius=R, start=-1.0, end=1.0)
    s = np.linspace(-1.0, 0.99, 77)
    above = R * (math.sqrt(1.0 + slope * slope) - 1.0)
    # a parabola stands for the circle on 2 mm: (2 mm)^3 / 16 times 3 slope / R^2 at most
    assert road.heights(s) == pytest.approx(slope * s + above, abs=4e-9)


@given(h=st.floats(0.01, 0.15))
@settings(max_examples=10)
def test_a_disc_at_a_step_lies_on_the_circle_around_its_corner(h):
    road = rolling_disc(Step(h=h, start=2.0), radius=R, spacing=0.01)
    meets = 2.0 - math.sqrt(R * R - (R - h) * (R - h))
    s = np.linspace(1.0, 3.0, 2001)
    on_corner = h - R + np.sqrt(np.maximum(R * R - (2.0 - s) * (2.0 - s), 0.0))
    expected = np.where(s >= 2.0, h, np.where(s >= meets, on_corner, 0.0))
    # the spline on 1 cm, where the circle is at its steepest
    assert road.heights(s) == pytest.approx(expected, abs=1e-5)
    assert min(abs(each - meets) for each in road.kinks(1.0, 3.0)) < 1e-5
    assert road.jumps(1.0, 3.0) == [0.0] * len(road.kinks(1.0, 3.0))


def test_a_disc_on_a_bar_makes_it_longer_and_no_higher():
    bar = SquareBar(h=0.03, L=0.1, start=1.0)
    y = rolling_disc(bar, radius=R).heights(np.linspace(0.5, 1.6, 999))
    assert y.max() == pytest.approx(0.03, abs=1e-9)
    assert (y > 1e-6).mean() * 1.1 > 0.1 + 2.0 * 0.1  # 0.13 m before it and after it


def test_a_disc_rolls_over_an_arc_as_its_centre_over_a_larger_one():
    """The centre runs on a circle of the sum of the radii, around the arc's centre."""
    arc = CircularArc(h=0.1, L=3.7)
    radius = (0.25 * 3.7 * 3.7 + 0.01) / 0.2
    s = np.linspace(0.2, 3.5, 333)
    road = rolling_disc(arc, radius=R)
    centre = 0.1 - radius + np.sqrt((radius + R) ** 2 - (s - 1.85) ** 2) - R
    assert road.heights(s) == pytest.approx(centre, abs=1e-8)


def test_a_disc_does_not_reach_the_bottom_of_a_narrow_hole():
    hole = SquareBar(h=-0.1, L=0.2, start=1.0)
    road = rolling_disc(hole, radius=R)
    # it hangs on both edges: R - sqrt(R^2 - 0.1^2) deep
    assert road.heights(1.1) == pytest.approx(math.sqrt(R * R - 0.01) - R, abs=1e-6)
    assert any(abs(each - 1.1) < 1e-6 for each in road.kinks(1.05, 1.15))  # and changes edges


def test_a_disc_never_sinks_into_a_random_road():
    rough = ISO8608.of_class("D", L=100.0, seed=2)
    s = np.linspace(20.0, 30.0, 5001)
    road = rolling_disc(rough, radius=R, start=19.0, end=31.0)
    assert (road.heights(s) - rough.heights(s)).min() > -2e-5  # between the spline's samples
    assert np.abs(road.heights(s) - rough.heights(s)).max() < 0.01


def test_humps_without_a_gap_are_enveloped_too():
    train = Train(shape=SquareBar(h=0.02, L=0.3, start=1.7), count=3, gap=0.0)
    for road in (moving_average(train, contact=0.25), rolling_disc(train, radius=R)):
        assert road.heights([1.9, 2.3, 2.4]) == pytest.approx(0.02, abs=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: moving_average(Sine(h=0.1, wavenumber=1.0), contact=0.25),
            "start and end must be given for a road without kinks, got None and None; give",
        ),
        (
            lambda: moving_average(Parabola(h=0.1, L=1.0), contact=0.0),
            "contact must be positive, got 0 m",
        ),
        (
            lambda: rolling_disc(Step(h=0.3), radius=0.3),
            "radius must be larger than every jump of the road, got 0.3 m at a jump of 0.3 m",
        ),
        (lambda: rolling_disc(Step(h=0.1), radius=-1.0), "radius must be positive, got -1 m"),
        (lambda: rolling_disc(Step(h=0.1), radius=0.3, spacing=0.0), "spacing must be positive"),
        (
            lambda: moving_average(Step(h=0.1), contact=0.1, start=1.0, end=0.0),
            "end must lie after start, got 1 to 0 m",
        ),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(make, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        make()
    assert message in str(error.value)
