"""The paper's roads in time: their shape, their rate, their kinks, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics.motion import Phasor, turn
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.shapes import Step

time = st.floats(-2.0, 20.0)
angle = st.floats(-10.0, 10.0)
omega = st.floats(1.0, 100.0)
start = st.floats(-1.0, 1.0)
hump = st.builds(roads.hump, h=st.floats(0.01, 0.2), omega=omega, start=start)
train = st.builds(
    roads.train,
    h=st.floats(0.01, 0.2),
    omega=omega,
    start=start,
    count=st.integers(1, 5),
    gap=st.floats(0.01, 3.0),
)


@given(h=st.floats(-0.2, 0.2), omega=omega, t=time)
def test_the_papers_road_is_a_sine(h, omega, t):
    road = roads.harmonic(h=h, omega=omega)
    # one product each; the sine of the same angle
    assert road.height(t) == pytest.approx(h * math.sin(omega * t), rel=1e-15, abs=1e-17)
    assert road.rate(t) == pytest.approx(omega * h * math.cos(omega * t), rel=1e-14, abs=1e-15)


@given(V=st.floats(1.0, 150.0), L=st.floats(0.1, 20.0), share=st.floats(0.0, 0.999))
def test_a_hump_of_length_L_is_half_a_sine_of_the_way_driven(V, L, share):
    road = roads.hump(h=0.1, V=V, L=L)
    way = share * L  # [m] since the hump's foot, at V / 3.6 metres a second
    # the angle is rounded three times, so that a height of 0.1 m is known to 1e-16 m
    assert road.height(way / (V / 3.6)) == pytest.approx(0.1 * math.sin(math.pi * share), abs=4e-16)
    assert road.end == pytest.approx(L / (V / 3.6), rel=1e-14)


def test_only_speed_over_length_counts():
    slow, fast = roads.hump(h=0.1, V=10.0, L=3.0), roads.hump(h=0.1, V=30.0, L=9.0)
    assert slow.omega == pytest.approx(fast.omega, rel=1e-15)


def test_the_papers_frequency_of_a_hump():
    """Section 2: omega = pi V / (3.6 L); 36 km/h is 10 m/s, so 10 m take one second."""
    assert roads.hump_frequency(36.0, 10.0) == pytest.approx(math.pi, rel=1e-15)


@given(h=st.floats(0.01, 0.2), omega=omega, share=st.floats(0.0, 4.999))
def test_humps_without_a_gap_are_a_rectified_sine(h, omega, share):
    road = roads.train(h=h, omega=omega, count=5, gap=0.0)
    y = road.height(share * math.pi / omega)
    # the angle, up to 16 rad, is rounded to 4e-15
    assert y == pytest.approx(h * abs(math.sin(math.pi * share)), abs=1e-14 * h)


@given(h=st.floats(-0.2, 0.2), start=start)
def test_a_step_rises_at_once_and_stays(h, start):
    road = roads.step(h=h, start=start)
    t = np.array([start - 1.0, math.nextafter(start, -math.inf), start, start + 1.0, 1e6])
    assert road.height(t).tolist() == [0.0, 0.0, h, h, h]
    assert road.rate(t).tolist() == [0.0] * 5
    assert road.kinks(start - 1.0, 1e6) == [start]


@given(road=st.from_type(Excitation), t=time)
def test_the_rate_is_the_derivative_of_the_height(road, t):
    d = 1e-5 / max(road.omega, 1.0)
    if road.kinks(t - 2 * d, t + 2 * d):
        return  # there is no derivative
    slope = (road.height(t + d) - road.height(t - d)) / (2 * d)
    # truncation (1e-5)^2 / 6; rounding of times up to 20 s: 4e-15 s / 1e-5 s times omega^2
    assert slope == pytest.approx(float(road.rate(t)), abs=1e-6 * abs(road.h) * (1 + road.omega))


@given(a=angle, b=angle)
def test_turning_adds_angles(a, b):
    found = turn(Phasor(math.sin(a), math.cos(a)), Phasor(math.sin(b), math.cos(b)))
    assert found == pytest.approx((math.sin(a + b), math.cos(a + b)), abs=1e-14)  # angles to 20


@given(b=angle)
def test_a_phasor_at_rest_stays_at_rest(b):
    assert turn(Phasor(0.0, 0.0), Phasor(math.sin(b), math.cos(b))) == (0.0, 0.0)


@given(...)
def test_a_road_keeps_the_shape_of_the_times(road: Excitation):
    t = np.linspace(-1.0, 3.0, 12)
    for of in (road.height, road.rate):
        assert of(t.reshape(3, 4)).shape == (3, 4)
        assert of(t.reshape(3, 4)).ravel().tolist() == [float(of(each)) for each in t]


# What is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda h: roads.harmonic(h=h, omega=55.0),
        lambda h: roads.hump(h=h, V=10.0, L=3.0),
        lambda h: roads.train(h=h, omega=5.0, count=2, gap=1.0),
        lambda h: roads.step(h=h),
    ],
)
def test_a_height_that_is_not_a_number_is_refused(make):
    with pytest.raises(
        ValueError, match=r"(height|amplitude) h must be finite, got nan m; give a finite"
    ):
        make(math.nan)


@pytest.mark.parametrize("L", [0.0, -0.5])
def test_a_hump_must_have_a_length(L):
    message = f"hump length L must be positive, got {L:g} m; give a value above 0 m"
    with pytest.raises(ValueError, match=message):
        roads.hump(h=0.1, V=10.0, L=L)


def test_a_car_must_drive():
    with pytest.raises(ValueError, match="speed V must be positive, got 0 km/h"):
        roads.harmonic(h=0.1, V=0.0, L=3.0)


def test_a_frequency_must_be_positive():
    with pytest.raises(ValueError, match="omega must be positive, got -1 rad/s"):
        roads.harmonic(h=0.1, omega=-1.0)


@pytest.mark.parametrize(
    "given_", [{}, {"V": 10.0}, {"L": 3.0}, {"omega": 1.0, "V": 1.0, "L": 1.0}]
)
def test_the_speed_is_given_in_one_way(given_):
    with pytest.raises(ValueError, match=r"give either omega \[rad/s\] or both V .* and L"):
        roads.hump(h=0.1, **given_)


@pytest.mark.parametrize("t", [None, math.nan, math.inf, -math.inf, "now"])
@pytest.mark.parametrize("method", ["height", "rate"])
def test_a_time_is_finite(method, t):
    road = roads.train(h=0.1, omega=5.0, count=2, gap=1.0)
    for each in [road, roads.harmonic(h=0.1, omega=5.0), roads.step(h=0.1)]:
        with pytest.raises(ValueError, match=rf"^t must be .*, got {t!r}.*; give a finite number"):
            getattr(each, method)(t)


@pytest.mark.parametrize("times", [(math.nan, 1.0), (0.0, None), (0.0, math.inf)])
def test_kinks_are_listed_between_finite_times(times):
    with pytest.raises(ValueError, match=r"t_(start|end) must be .*, got .*; give a finite number"):
        roads.hump(h=0.1, omega=5.0).kinks(*times)


# Roads and speeds ------------------------------------------------------------------------------


@given(road=st.from_type(Excitation), factor=st.floats(0.1, 10.0))
def test_a_road_driven_over_faster_is_the_same_road_sooner(road, factor):
    fast = Excitation(road=road.road, speed=road.speed * factor)
    t = np.linspace(0.1, 2.0, 7)
    if any(abs(t - kink).min() < 1e-9 for kink in road.kinks(0.0, 3.0)):
        return
    # a distance is rounded twice
    atol = 1e-13 * (1.0 + road.omega) * abs(road.h)
    np.testing.assert_allclose(fast.height(t / factor), road.height(t), rtol=1e-12, atol=atol)
    np.testing.assert_allclose(
        fast.rate(t / factor), factor * road.rate(t), rtol=1e-11, atol=atol * factor * road.omega
    )


def test_a_varied_road_has_another_height_or_frequency():
    for road in (
        roads.harmonic(h=0.1, omega=5.0),
        roads.hump(h=0.1, V=20.0, L=3.0),
        roads.train(h=0.1, V=20.0, L=3.0, count=3, gap=0.5),
    ):
        assert road.varied(h=0.2).h == 0.2
        assert road.varied(h=0.2).omega == road.omega
        assert road.varied(omega=7.0).omega == pytest.approx(7.0, rel=1e-15)
        assert road.varied(omega=7.0).speed == road.speed


def wavy(s):
    return math.sin(s)


def test_a_road_that_is_read_has_no_frequency():
    read = Excitation(road=FunctionRoad(profile=wavy), speed=2.0)
    assert not read.turning
    assert not read.harmonic
    with pytest.raises(ValueError, match="the road must be made of sines, got FunctionRoad"):
        assert read.omega


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_a_speed_is_positive(speed):
    with pytest.raises(ValueError, match="speed must be"):
        Excitation(road=Step(h=0.1), speed=speed)
