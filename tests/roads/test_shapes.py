"""Shapes: tops, feet, symmetry, areas, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop, cushion
from qcar_env.roads.shapes import (
    CircularArc,
    HalfSine,
    OneMinusCosine,
    Parabola,
    Quartic,
    Sextic,
    Sine,
    SquareBar,
    Step,
    pothole,
)
from qcar_env.roads.sum_of_sines import SumOfSines

h = st.floats(-0.2, 0.2)
length = st.floats(0.8, 20.0)
start = st.floats(-10.0, 50.0)


def of(kind, h, L, start):
    """A hump of any class, of length L."""
    if kind is HalfSine:
        return HalfSine.of_length(h=h, L=L, start=start)
    if issubclass(kind, (FlatTop, SmoothFlatTop)):
        return kind(h=h, ramp=0.2 * L, top=0.6 * L, start=start)
    return kind(h=h, L=L, start=start)


# area under a hump of height 1 and length 1, by integration
AREA = {
    HalfSine: 2.0 / math.pi,
    OneMinusCosine: 0.5,
    Parabola: 2.0 / 3.0,
    Quartic: 16.0 / 30.0,  # 16 B(3, 3)
    Sextic: 64.0 / 140.0,  # 64 B(4, 4)
    FlatTop: 0.8,
    SmoothFlatTop: 0.8,
    SquareBar: 1.0,
}
KINDS = [*AREA, CircularArc]
hump = st.builds(of, st.sampled_from(KINDS), h, length, start)


@given(hump=hump)
def test_a_hump_is_as_high_as_it_says_and_stands_on_the_road(hump):
    p, table, kind = hump.numbers, hump.table, type(hump)
    top = hump.start + 0.5 * hump.extent
    # distances of up to 70 m are rounded to 1e-14 m; slopes are at most 2
    assert hump.heights(top) == pytest.approx(hump.h, abs=1e-13)
    assert hump.slopes(top) == pytest.approx(0.0, abs=1e-12)
    assert hump.heights([hump.start - 1.0, hump.length, hump.length + 1.0]).tolist() == [0.0] * 3
    assert hump.slopes([hump.start - 1.0, hump.length, hump.length + 1.0]).tolist() == [0.0] * 3
    foot = kind.height(hump.start, 1, p, table)
    assert foot == pytest.approx(kind.jump(0, p, table), abs=1e-16)
    assert hump.length == hump.start + hump.extent or hump.start != 0.0


@given(hump=hump, share=st.floats(0.0, 0.499))
def test_a_hump_is_symmetric(hump, share):
    a = hump.start + share * hump.extent
    b = hump.length - share * hump.extent
    if isinstance(hump, SquareBar) and share < 1e-9:  # there it jumps
        return
    y, slope = hump.heights([a, b]), hump.slopes([a, b])
    assert y[0] == pytest.approx(y[1], abs=1e-13)
    if share > 1e-9 and abs(share - 0.2) > 1e-9:  # where the slope jumps
        assert slope[0] == pytest.approx(-slope[1], abs=1e-11)


@given(kind=st.sampled_from(list(AREA)), h=h, L=length, start=start)
def test_the_area_under_a_hump(kind, h, L, start):
    hump = of(kind, h, L, start)
    # the trapezia of a periodic function, or of one with corners: of second order
    s = hump.start + hump.extent * (np.arange(2000) + 0.5) / 2000
    assert hump.heights(s).mean() * hump.extent == pytest.approx(AREA[kind] * h * L, abs=1e-6 * L)


@given(h=st.floats(0.01, 0.3), L=length, share=st.floats(0.0, 1.0))
def test_a_circular_arc_lies_on_its_circle(h, L, share):
    hump = CircularArc(h=h, L=L)
    R = (0.25 * L * L + h * h) / (2.0 * h)  # real_cars.md, 2.2
    x = share * L
    y = hump.heights(x) if x < L else 0.0
    from_centre = math.hypot(x - 0.5 * L, y - (h - R))
    # radii of up to 5 km
    assert from_centre == pytest.approx(R, rel=1e-12, abs=1e-12)


def test_the_arc_of_the_indian_road_congress():
    """IRC:99-1988: 3.7 m, 0.1 m: a radius of 17 m; a parabola differs by less than 0.08 mm."""
    arc, parabola = CircularArc(h=0.1, L=3.7), Parabola(h=0.1, L=3.7)
    R = -1.0 / np.gradient(arc.slopes([1.849, 1.85, 1.851]), 1e-3)[1]
    assert R == pytest.approx(17.16, abs=0.01)
    s = np.linspace(0.0, 3.7, 500)
    assert np.abs(arc.heights(s) - parabola.heights(s)).max() == pytest.approx(73e-6, abs=1e-6)


@given(V=st.floats(5.0, 150.0), L=length, t=st.floats(0.0, 10.0))
def test_the_papers_sine(V, L, t):
    """Section 2: omega = pi V / (3.6 L), V in km/h."""
    road = Sine.of_length(h=0.1, L=L)
    omega = math.pi * V / (3.6 * L)
    # an angle of up to 1600 rad, rounded thrice
    assert road.heights(V / 3.6 * t) == pytest.approx(0.1 * math.sin(omega * t), abs=1e-12)


@pytest.mark.parametrize("kind", [Sine, HalfSine])
def test_what_turns_says_how(kind):
    road = kind(h=0.1, wavenumber=2.0, start=1.0)
    p = road.numbers
    assert kind.turning
    s = 1.3
    piece = len(road.kinks(-9.0, s))
    assert kind.height(s, piece, p, road.table) == p.h * math.sin(p.wavenumber * (s - 1.0))


def test_a_step_stays_up():
    road = Step(h=0.1, start=2.0)
    assert road.heights([1.999, 2.0, 1e9]).tolist() == [0.0, 0.1, 0.1]
    assert (road.kinks(0.0, 9.0), road.jumps(0.0, 9.0)) == ([2.0], [0.1])


def test_a_cushion_rises_one_in_eight():
    road = cushion(h=0.07, L=2.0)
    assert road.extent == pytest.approx(2.0, rel=1e-15)
    assert road.slopes([0.1, 1.0, 1.9]) == pytest.approx([0.125, 0.0, -0.125], rel=1e-14)


def test_a_pothole_is_as_deep_as_it_says():
    assert pothole(depth=0.1, L=0.3).heights(0.15) == pytest.approx(-0.1, rel=1e-15)


@given(
    waves=st.lists(
        st.tuples(st.floats(-0.1, 0.1), st.floats(0.1, 20.0), st.floats(0.0, 7.0)), min_size=1
    )
)
def test_a_sum_of_sines_is_their_sum(waves):
    amplitudes, wavenumbers, phases = zip(*waves, strict=True)
    road = SumOfSines(amplitudes=amplitudes, wavenumbers=wavenumbers, phases=phases)
    s = np.linspace(-1.0, 3.0, 9)
    expected = sum(a * np.sin(k * s + phi) for a, k, phi in waves)
    assert road.heights(s) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Parabola(h=0.1, L=-0.5), "hump length L must be positive, got -0.5 m; give"),
        (lambda: Parabola(h=0.1, L=0.0), "hump length L must be positive, got 0 m; give"),
        (lambda: Parabola(h=math.nan, L=1.0), "height h must be finite, got nan m; give"),
        (lambda: HalfSine.of_length(h=0.1, L=-1.0), "hump length L must be positive, got -1 m"),
        (lambda: HalfSine(h=0.1, wavenumber=0.0), "wavenumber wavenumber must be positive, got 0"),
        (lambda: Sine.of_length(h=0.1, L=0.0), "half wave L must be positive, got 0 m"),
        (lambda: CircularArc(h=0.5, L=1.0), "at most 0.4 L = 0.4 m, got 0.5 m; give a lower"),
        (lambda: FlatTop(h=0.1, ramp=0.0, top=1.0), "ramp length ramp must be positive, got 0 m"),
        (lambda: FlatTop(h=0.1, ramp=1.0, top=-1.0), "must not be negative, got -1 m; give"),
        (
            lambda: FlatTop.of_gradient(h=0.1, L=1.0, gradient=0.1),
            "length L must hold two ramps of 1 m, got 1 m; give a longer one",
        ),
        (lambda: pothole(depth=-0.1, L=1.0), "pothole depth must be positive, got -0.1 m"),
        (lambda: Step(h="high"), "height h must be a number in m, got 'high'"),
        (
            lambda: SumOfSines(amplitudes=(0.1,), wavenumbers=(1.0, 2.0), phases=(0.0,)),
            "must be of one length of at least 1, got shapes",
        ),
        (lambda: SumOfSines(amplitudes=(), wavenumbers=(), phases=()), "at least 1, got shapes"),
        (
            lambda: SumOfSines(amplitudes=(0.1,), wavenumbers=(0.0,), phases=(0.0,)),
            "wavenumbers must be positive, got 0 rad/m",
        ),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(make, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        make()
    assert message in str(error.value)
