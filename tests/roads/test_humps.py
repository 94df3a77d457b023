"""Humps that are planted are found, and nothing else is."""

import inspect
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from qcar_env.roads import find_humps, shapes
from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop
from qcar_env.roads.humps import LEAST_SCORE
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.profile import Shape
from qcar_env.roads.shapes import OneMinusCosine
from qcar_env.roads.train import Train

SPACING = 0.05
S = np.arange(0.0, 120.0, SPACING)

PLANTED = {
    "HalfSine": lambda h, L, start: shapes.HalfSine.of_length(h=h, L=L, start=start),
    "OneMinusCosine": lambda h, L, start: OneMinusCosine(h=h, L=L, start=start),
    "CircularArc": lambda h, L, start: shapes.CircularArc(h=h, L=L, start=start),
    "Parabola": lambda h, L, start: shapes.Parabola(h=h, L=L, start=start),
    "Quartic": lambda h, L, start: shapes.Quartic(h=h, L=L, start=start),
    "Sextic": lambda h, L, start: shapes.Sextic(h=h, L=L, start=start),
    "SquareBar": lambda h, L, start: shapes.SquareBar(h=h, L=L, start=start),
    "FlatTop": lambda h, L, start: FlatTop(h=h, ramp=0.12 * L, top=0.76 * L, start=start),
    "SmoothFlatTop": lambda h, L, start: SmoothFlatTop(
        h=h, ramp=0.12 * L, top=0.76 * L, start=start
    ),
}
# class: largest error of the middle [m] and of the length, in lengths; those that are stated at
# find_humps and a quarter more, for humps that were not drawn there
LARGEST = {"A": (0.1, 0.18), "B": (0.2, 0.22), "C": (0.75, 0.45)}


def test_every_shape_is_planted():
    """Those of `shapes` and `flat_tops`: whatever has a beginning, an end and one height."""
    kinds = [
        each for each in [*vars(shapes).values(), FlatTop, SmoothFlatTop] if inspect.isclass(each)
    ]
    humps = {each.__name__ for each in kinds if issubclass(each, Shape)} - {"Shape", "Hump"}
    assert humps == PLANTED.keys()


@settings(max_examples=6)
@pytest.mark.parametrize("road_class", LARGEST)
@pytest.mark.parametrize("name", PLANTED)
@given(
    h=st.floats(0.08, 0.15),
    L=st.floats(1.5, 8.0),
    start=st.floats(20.0, 90.0),
    gradient=st.floats(-0.06, 0.06),
    seed=st.integers(0, 10**6),
)
def test_a_hump_on_a_rough_road_is_found(name, road_class, h, L, start, gradient, seed):
    rough = ISO8608.of_class(road_class, L=120.0, seed=seed).heights(S)
    profile = PLANTED[name](h, L, start).heights(S) + rough + gradient * S
    (found,) = find_humps(profile, spacing=SPACING)
    middle, length = LARGEST[road_class]
    assert abs(found.middle - (start + 0.5 * L)) < middle
    assert abs(found.length - L) < length * L + SPACING
    # a height by least squares scatters by 1 / score of it
    assert found.score > LEAST_SCORE
    assert abs(found.height - h) < 5.0 / found.score * h


@pytest.mark.parametrize("name", PLANTED)
@given(
    h=st.floats(0.03, 0.3),
    L=st.floats(0.5, 10.0),
    start=st.floats(15.0, 90.0),
    gradient=st.floats(-0.2, 0.2),
    at=st.floats(-1e3, 1e3),
)
@settings(max_examples=6)
def test_a_hump_on_a_smooth_road_is_found_as_it_is(name, h, L, start, gradient, at):
    assume(h < 0.2 * L)  # steeper ones, which no car survives, are told less well: 6 % of a height
    profile = PLANTED[name](h, L, start).heights(S) + gradient * S
    (found,) = find_humps(profile, spacing=SPACING, start=at, least_height=0.02)
    # nobody knows where a jump is between two samples; the arc is taken for a parabola
    assert found.middle == pytest.approx(at + start + 0.5 * L, abs=SPACING)
    assert found.length == pytest.approx(L, abs=2.0 * SPACING)
    assert found.height == pytest.approx(h, rel=0.05)


@given(road_class=st.sampled_from("ABC"), seed=st.integers(0, 10**6))
@settings(max_examples=25)
def test_a_rough_road_has_no_humps(road_class, seed):
    assert (
        find_humps(ISO8608.of_class(road_class, L=120.0, seed=seed).heights(S), spacing=SPACING)
        == ()
    )


@pytest.mark.parametrize("gap", [0.0, 1.0, 10.0])
@pytest.mark.parametrize("spacing", [0.01, 0.05, 0.25])
def test_all_humps_of_a_train_are_found_in_order(gap, spacing):
    train = Train(shape=PLANTED["OneMinusCosine"](0.1, 3.7, 5.0), count=4, gap=gap)
    s = np.arange(0.0, 80.0, spacing)
    found = find_humps(train.heights(s), spacing=spacing)
    assert [each.start for each in found] == pytest.approx(
        [5.0 + i * train.pitch for i in range(4)], abs=0.1
    )
    assert [each.length for each in found] == pytest.approx([3.7] * 4, rel=0.03)
    assert [each.height for each in found] == pytest.approx([0.1] * 4, rel=0.01)


def test_what_is_found_is_a_road():
    hump = PLANTED["Parabola"](0.1, 3.7, 30.0)
    (found,) = find_humps(hump.heights(S), spacing=SPACING)
    assert isinstance(found.shape, Shape)
    # it ends the fit within a thousandth of the length, where the slope is 0.1
    assert found.shape.heights(S) == pytest.approx(hump.heights(S), abs=5e-4)
    assert (found.start, found.length, found.height) == pytest.approx((30.0, 3.7, 0.1), rel=1e-3)


NOTHING = {
    "flat": np.zeros_like(S),
    "a kerb": 0.1 * (S > 50.0),
    "a ramp to another level": np.clip(0.1 * (S - 50.0), 0.0, 0.15),
    "a hill of 60 m": OneMinusCosine(h=0.5, L=60.0, start=30.0).heights(S),
    "a hole": -PLANTED["OneMinusCosine"](0.1, 3.7, 50.0).heights(S),
    "a low hump": PLANTED["Parabola"](0.02, 3.7, 50.0).heights(S),
    "two samples": np.array([0.0, 0.1]),
}


@pytest.mark.parametrize("profile", NOTHING.values(), ids=NOTHING)
def test_what_is_no_hump_is_not_found(profile):
    assert find_humps(profile, spacing=SPACING) == ()


def test_a_hole_is_a_hump_upside_down():
    (found,) = find_humps(-NOTHING["a hole"], spacing=SPACING)
    assert (found.start, found.length, found.height) == pytest.approx((50.0, 3.7, 0.1), rel=1e-2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(heights=np.zeros((9, 2))), "heights must be two or more in a row, got shape (9, 2);"),
        (dict(heights=[0.0, math.nan]), "heights must be finite [m], got"),
        (dict(spacing=0.0), "spacing must be positive, got 0 m"),
        (dict(start=math.inf), "start must be finite, got inf m"),
        (dict(least_height=0.0), "least_height must be positive, got 0 m"),
        (dict(shortest=-1.0), "shortest must be positive, got -1 m"),
        (dict(longest=0.1), "longest must be at least 0.3 m, the shortest hump or four samples"),
        (
            dict(spacing=5.0),
            "longest must be at least 20 m, the shortest hump or four samples, got",
        ),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(changes, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        find_humps(**({"heights": np.zeros(99), "spacing": 0.05} | changes))
    assert message in str(error.value)
