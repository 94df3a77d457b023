"""Profiles: their shape, their rate, and their kinks to the last bit."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics import roads
from qcar_env.physics.roads import Phasor, Road, kink_time, turn

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
    assert road.height(way / (V / 3.6)) == pytest.approx(0.1 * math.sin(math.pi * share), abs=2e-16)
    assert road.duration == pytest.approx(L / (V / 3.6), rel=1e-15)


def test_only_speed_over_length_counts():
    slow, fast = roads.hump(h=0.1, V=10.0, L=3.0), roads.hump(h=0.1, V=30.0, L=9.0)
    assert slow.omega == pytest.approx(fast.omega, rel=1e-15)


def test_the_papers_frequency_of_a_hump():
    """Section 2: omega = pi V / (3.6 L); 36 km/h is 10 m/s, so 10 m take one second."""
    assert roads.hump_frequency(36.0, 10.0) == pytest.approx(math.pi, rel=1e-15)


@given(road=st.one_of(hump, train))
def test_the_end_of_the_last_hump_is_flat_to_the_last_bit(road):
    assert road.height(road.end) == 0.0
    assert road.rate(road.end) == 0.0
    before = math.nextafter(road.end, -math.inf)
    # cos = -1 to second order of the last bit of a time, times 100 rad/s: (100 * 2e-15)^2
    assert road.rate(before) == pytest.approx(-road.h * road.omega, rel=1e-12)


@given(road=st.one_of(hump, train))
def test_a_hump_begins_at_its_foot_rising_and_ends_in_a_flat_road(road):
    kinks = [kink_time(index, road.pieces) for index in range(2 * road.count)]
    for begin, end in zip(kinks[::2], kinks[1::2], strict=True):
        assert road.height(begin) == 0.0
        assert road.rate(begin) == road.h * road.omega
        assert road.rate(math.nextafter(begin, -math.inf)) == 0.0
        assert road.height(end) == 0.0
        assert road.rate(end) == 0.0
        middle = 0.5 * (begin + end)
        assert road.height(middle) == pytest.approx(road.h, rel=1e-12)  # the top, flat there
        # a length is the difference of two times of up to 20 s, each rounded to 4e-15
        assert end - begin == pytest.approx(road.duration, abs=1e-14)


@given(road=train)
def test_the_humps_of_a_train_are_a_gap_apart(road):
    begins = [kink_time(index, road.pieces) for index in range(0, 2 * road.count, 2)]
    assert begins[0] == road.start
    pitch = (1.0 + road.gap) * road.duration
    assert np.diff(begins) == pytest.approx(np.full(road.count - 1, pitch), abs=1e-13)
    assert kink_time(2 * road.count, road.pieces) == math.inf


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


@given(...)
def test_a_road_does_not_end_or_ends_flat(road: Road):
    if road.profile in ("harmonic", "step"):
        assert road.end == math.inf
    else:
        assert np.all(road.height(road.end + np.linspace(0.0, 5.0, 50)) == 0.0)


@given(road=st.from_type(Road), t=time)
def test_the_rate_is_the_derivative_of_the_height(road, t):
    d = 1e-5 / max(road.omega, 1.0)
    if road.kinks(t - 2 * d, t + 2 * d):
        return  # there is no derivative
    slope = (road.height(t + d) - road.height(t - d)) / (2 * d)
    # truncation (1e-5)^2 / 6; rounding of times up to 20 s: 4e-15 s / 1e-5 s times omega^2
    assert slope == pytest.approx(float(road.rate(t)), abs=1e-6 * abs(road.h) * (1 + road.omega))


@given(road=st.from_type(Road), t=time, after=st.floats(0.0, 1.0))
def test_a_turned_phasor_is_the_phasor_of_a_later_time_on_the_same_piece(road, t, after):
    if road.kinks(t, t + after) or road.kinks(math.nextafter(t, -math.inf), t + after + 1e-9):
        return
    by = Phasor(math.sin(road.omega * after), math.cos(road.omega * after))
    turned, later = turn(road.phasor(t), by), road.phasor(t + after)
    # angles up to 2200 rad are rounded to 4.5e-13, differently on both sides
    assert turned.s == pytest.approx(float(later.s), abs=2e-12)
    assert turned.c == pytest.approx(float(later.c), abs=2e-12)


@given(a=angle, b=angle)
def test_turning_adds_angles(a, b):
    found = turn(Phasor(math.sin(a), math.cos(a)), Phasor(math.sin(b), math.cos(b)))
    assert found == pytest.approx((math.sin(a + b), math.cos(a + b)), abs=1e-14)  # angles to 20


@given(b=angle)
def test_a_phasor_at_rest_stays_at_rest(b):
    assert turn(Phasor(0.0, 0.0), Phasor(math.sin(b), math.cos(b))) == (0.0, 0.0)


@given(road=st.from_type(Road), t=time)
def test_the_next_kink_is_the_first_one_later(road, t):
    index = road.next_kink(t)
    assert kink_time(index, road.pieces) > t
    assert index == 0 or kink_time(index - 1, road.pieces) <= t


@given(road=st.from_type(Road), a=time, b=time)
def test_kinks_lie_inside_the_interval_in_order(road, a, b):
    found = road.kinks(a, b)
    assert all(a < kink < b for kink in found)
    pieces = road.pieces
    everything = [kink_time(index, pieces) for index in range(2 * int(pieces.count))]
    assert found == [kink for kink in everything if a < kink < b]


@given(...)
def test_the_phasor_keeps_the_shape_of_the_times(road: Road):
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
    with pytest.raises(ValueError, match="hump height h must be finite, got nan m; give a finite"):
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


@pytest.mark.parametrize("count", [0, -1, 1.5])
def test_a_train_has_a_whole_number_of_humps(count):
    with pytest.raises(ValueError, match=f"count must be .*, got {count}; give 1 or more"):
        roads.train(h=0.1, omega=5.0, count=count, gap=1.0)


@pytest.mark.parametrize("count", [1_000_001, 10**9, 10**30])
def test_a_train_does_not_have_more_humps_than_can_be_listed(count):
    with pytest.raises(ValueError, match=f"count must be at most 1000000, got {count}; give 1 to"):
        roads.train(h=0.1, omega=5.0, count=count, gap=1.0)


def test_a_train_whose_count_is_a_float_is_the_one_whose_count_is_an_int():
    given_, expected = (roads.train(h=0.1, omega=5.0, count=n, gap=1.0) for n in (5.0, 5))
    assert (given_, hash(given_), repr(given_)) == (expected, hash(expected), repr(expected))
    assert given_.height([0.0, 1.0]).tolist() == expected.height([0.0, 1.0]).tolist()


def test_a_road_of_numpys_numbers_is_the_one_of_plain_numbers():
    numbers = {"h": 0.5, "omega": 5.0, "start": 1.0, "gap": 2.0, "count": 3}
    road = Road(profile="train", **numbers)
    for kind in (np.array, np.float64, np.float32):
        other = Road(profile=np.str_("train"), **{k: kind(v) for k, v in numbers.items()})
        assert (other, hash(other), repr(other)) == (road, hash(road), repr(road))


@pytest.mark.parametrize("numbers", [{"gap": 1e308}, {"gap": 1.0, "omega": 1e-320}])
def test_a_train_ends_at_a_finite_time(numbers):
    with pytest.raises(ValueError, match=r"last hump must end at a finite time, got omega=.* gap="):
        roads.train(**{"h": 0.1, "count": 9, "omega": 1.0, **numbers})


@pytest.mark.parametrize("t", [None, math.nan, math.inf, -math.inf, "now"])
@pytest.mark.parametrize("method", ["height", "rate", "phasor", "next_kink"])
def test_a_time_is_finite(method, t):
    road = roads.train(h=0.1, omega=5.0, count=2, gap=1.0)
    for each in [road, roads.harmonic(h=0.1, omega=5.0), roads.step(h=0.1)]:
        with pytest.raises(ValueError, match=rf"^t must be .*, got {t!r}.*; give a finite number"):
            getattr(each, method)(t)


@pytest.mark.parametrize("times", [(math.nan, 1.0), (0.0, None), (0.0, math.inf)])
def test_kinks_are_listed_between_finite_times(times):
    with pytest.raises(ValueError, match=r"t_(start|end) must be .*, got .*; give a finite number"):
        roads.hump(h=0.1, omega=5.0).kinks(*times)


def test_a_gap_must_not_be_negative():
    with pytest.raises(ValueError, match=r"gap must not be negative, got -0\.5; give 0 or more"):
        roads.train(h=0.1, omega=5.0, count=2, gap=-0.5)


def test_a_profile_must_be_known():
    with pytest.raises(ValueError, match="unknown road profile 'hum'; did you mean 'hump'"):
        Road(profile="hum", h=0.1, omega=5.0)


def test_a_step_has_no_frequency():
    with pytest.raises(ValueError, match=r"a step has no frequency, got omega=5\.0 rad/s; give 0"):
        Road(profile="step", h=0.1, omega=5.0, count=1)


@pytest.mark.parametrize(
    ("profile", "omega", "count"),
    [("hump", 5.0, 0), ("hump", 5.0, 2), ("train", 5.0, 0), ("step", 0.0, 2), ("harmonic", 5.0, 1)],
)
def test_a_road_made_by_hand_has_the_humps_of_its_profile(profile, omega, count):
    with pytest.raises(ValueError, match=rf"count .* got {count}; .*"):
        Road(profile=profile, h=0.1, omega=omega, count=count)
