"""Springs and stops give back what they take; tables are their points and the lines between."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.parts.spring import (
    CubicSpring,
    LinearSpring,
    NoStops,
    Spring,
    Stops,
    TableSpring,
    TableStops,
    TravelStops,
)

TRAVEL = st.floats(-0.3, 0.3)
POINTS = {"travels": (-0.1, 0.0, 0.05, 0.1), "forces": (-3e3, 0.0, 1e3, 4e3)}
STOPS = {"bump": 0.1, "rebound": 0.08}
FEDA = {"depths": (0.0, 0.01, 0.02, 0.06), "forces": (0.0, 1e3, 2.5e3, 125e3)}


def force(part, travel):
    return part.force(travel, part.numbers)


def work(part, start, end):
    """Gauss's rule between travels and all kinks: exact for lines and cubics."""
    kinks = [*getattr(part, "travels", ())]
    if not isinstance(part, NoStops) and isinstance(part, TravelStops):
        depths = getattr(part, "depths", (0.0,))
        kinks = [part.rebound + d for d in depths] + [-part.bump - d for d in depths]
    low, high = sorted((start, end))
    edges = np.array([low, *sorted(each for each in kinks if low < each < high), high])
    middle, half = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / 2
    gauss = math.sqrt(1 / 3)
    found = sum(half * force(part, middle + sign * gauss * half) for sign in (-1, 1)).sum()
    return float(found) if start < end else -float(found)


@given(part=st.from_type(Spring) | st.from_type(TravelStops), a=TRAVEL, b=TRAVEL, c=TRAVEL)
def test_the_work_of_a_round_trip_is_zero(part, a: float, b: float, c: float):
    trips = [work(part, a, b), work(part, b, c), work(part, c, a)]
    # a dozen roundings of numbers as large as the greatest trip; its halves may cancel
    scale = max(abs(force(part, each)) for each in (a, b, c)) * 0.6
    assert sum(trips) == pytest.approx(0.0, abs=1e-11 * max(scale, *map(abs, trips), 1e-6))


@given(part=st.from_type(TravelStops), travel=st.floats(-3.0, 3.0))
def test_stops_push_back_into_the_range_and_are_silent_inside(part, travel: float):
    assert force(part, travel) * travel >= 0.0
    inside = isinstance(part, NoStops) or -part.bump <= travel <= part.rebound
    assert not inside or force(part, travel) == 0.0


@given(part=..., share=st.floats(0.0, 1.0))
def test_a_table_is_numpys_inside_and_goes_on_straight_outside(part: TableSpring, share: float):
    x, y = part.travels, part.forces
    travel = x[0] + share * (x[-1] - x[0])
    scale = 1e-13 * (max(map(abs, y)) + 1e5 * 50.0)  # forces differ by up to 1e5 over a line
    assert force(part, travel) == pytest.approx(np.interp(travel, x, y), abs=scale)
    beyond = x[-1] + share
    slope = (y[-1] - y[-2]) / (x[-1] - x[-2])
    assert force(part, beyond) == pytest.approx(y[-1] + slope * share, rel=1e-12, abs=10 * scale)
    assert [force(part, each) for each in x] == pytest.approx(y, abs=scale)


def test_a_table_that_ends_at_zero_goes_on_with_its_slope_there():
    part = TableSpring(travels=(0.0, 0.1, 0.2), forces=(0.0, 2e3, 6e3))
    assert force(part, -0.05) == pytest.approx(-1e3)
    part = TableSpring(travels=(-0.2, -0.1, 0.0), forces=(-6e3, -2e3, 0.0))
    assert force(part, 0.05) == pytest.approx(1e3)


def test_a_line_is_the_same_from_each_class():
    linear = LinearSpring(k=2e4)
    table = TableSpring(travels=(-1.0, 0.0, 1.0), forces=(-2e4, 0.0, 2e4))
    for travel in (-2.0, -0.1, 0.0, 0.3, 5.0):
        assert force(CubicSpring(k=2e4), travel) == force(linear, travel) == force(table, travel)
    assert linear.linear
    assert NoStops().linear
    assert not table.linear


def test_stops_meet_their_table_and_their_cubic():
    table = TableStops(**STOPS, **FEDA)
    assert force(table, 0.1) == pytest.approx(2.5e3)
    assert force(table, -0.11) == pytest.approx(-1e3)
    cubic = Stops(**STOPS, k=1e4, k3=1e7)
    assert force(cubic, 0.1) == pytest.approx(1e4 * 0.02 + 1e7 * 0.02**3)
    assert force(cubic, -0.11) == pytest.approx(-1e4 * 0.01 - 1e7 * 0.01**3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: LinearSpring(k=0.0),
            "stiffness k must be positive, got 0 N/m; give a value above",
        ),
        (
            lambda: CubicSpring(k=1.0, k3=math.inf),
            "stiffness k3 must be finite, got inf N/m.3; giv",
        ),
        (lambda: Stops(bump=-1.0, rebound=0.0, k=1.0), "bump clearance bump must not be negative"),
        (
            lambda: TableSpring(travels=(0.0, 1.0), forces=(0.0, 1.0, 2.0)),
            "spring table must have as many .* got 2 and 3; give two tuples of one length",
        ),
        (
            lambda: TableSpring(travels=(0.0, 1.0, 1.0), forces=(0.0, 1.0, 2.0)),
            r"spring travels must rise, got 1 m at \[2\] after 1 m; sort the points",
        ),
        (
            lambda: TableSpring(travels=(0.0,), forces=(0.0, 1.0)),
            r"spring travels must be two numbers or more, got \(0.0,\); give a tuple",
        ),
        (
            lambda: TableSpring(travels=(0.0, 1.0), forces=(0.0, math.nan)),
            r"spring forces\[1\] must be finite, got nan N; give a finite number",
        ),
        (
            lambda: TableSpring(travels=(-1.0, 1.0), forces=(-1.0, 1.0)),
            r"spring table must hold the point \(0, 0\), got .*; measure both from rest",
        ),
        (
            lambda: TableSpring(travels=(0.0, 5e-324), forces=(0.0, 1.0)),
            "slope of spring table from 0 must be finite, got inf",
        ),
        (
            lambda: TableStops(**STOPS, depths=(0.01, 0.02), forces=(1.0, 2.0)),
            r"stop table must begin with the point \(0, 0\), got \(0.01, 1\); put 0 first",
        ),
        (
            lambda: TableStops(**STOPS, depths=(0.0, 0.01, 0.02), forces=(0.0, 2.0, 1.0)),
            r"stop forces must not fall, got 1 N at \[2\] after 2 N; sort the points or mend",
        ),
    ],
)
def test_what_is_refused_is_named_with_value_and_remedy(make, message: str):
    with pytest.raises(ValueError, match=message):
        make()


def test_points_come_as_lists_and_arrays_too():
    made = TableSpring(travels=list(POINTS["travels"]), forces=np.array(POINTS["forces"]))
    assert made == TableSpring(**POINTS)
    assert hash(made) == hash(TableSpring(**POINTS))
