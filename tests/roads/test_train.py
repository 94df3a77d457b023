"""Trains: their humps are the shape's, a pitch apart."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop
from qcar_env.roads.shapes import HalfSine, Parabola, Sine, SquareBar
from qcar_env.roads.train import Train

shape = st.one_of(
    st.builds(HalfSine, h=st.floats(0.01, 0.2), wavenumber=st.floats(0.2, 30.0)),
    st.builds(Parabola, h=st.floats(-0.2, 0.2), L=st.floats(0.1, 5.0), start=st.floats(-3.0, 3.0)),
    st.builds(SquareBar, h=st.floats(0.01, 0.2), L=st.floats(0.1, 5.0), start=st.floats(-3.0, 3.0)),
    st.builds(FlatTop, h=st.floats(0.01, 0.2), ramp=st.floats(0.2, 2.0), top=st.floats(0.1, 7.0)),
)
train = st.builds(
    Train,
    shape=shape,
    count=st.integers(1, 6),
    gap=st.one_of(st.just(0.0), st.floats(0.01, 30.0)),
)


@given(train=train, share=st.floats(0.001, 0.999), which=st.integers(0, 5))
def test_every_hump_is_the_first_one(train, share, which):
    x = train.shape.start + share * train.pitch
    s = x + min(which, int(train.count) - 1) * train.pitch
    near = [abs(x - each) < 1e-9 for each in train.shape.kinks(-99.0, 99.0)]
    if not any(near):  # where the height may jump
        # distances of up to 250 m are rounded to 3e-14 m, slopes are at most 6
        assert train.heights(s) == pytest.approx(train.shape.heights(x), abs=1e-12)
        assert train.slopes(s) == pytest.approx(train.shape.slopes(x), abs=1e-11)


@given(train=train)
def test_the_kinks_of_a_train(train):
    kinks = train.kinks(-1e4, 1e4)
    each = train.shape.kink_count
    assert len(kinks) == each * train.count
    assert kinks == sorted(kinks)
    assert np.diff(kinks[::each]) == pytest.approx(train.pitch, abs=1e-12)
    assert train.length == kinks[-1]
    assert train.heights(train.length + 1.0) == 0.0
    if train.gap == 0.0:
        assert kinks[each::each] == kinks[each - 1 : -1 : each]


@given(train=train)
def test_a_pitch_is_a_gap(train):
    other = Train.of_pitch(shape=train.shape, count=int(train.count), pitch=train.pitch)
    assert other.pitch == pytest.approx(train.pitch, rel=1e-14)


def test_trains_of_one_shape_share_their_functions_and_of_another_do_not():
    one = Train(shape=Parabola(h=0.1, L=1.0), count=2, gap=1.0)
    longer = dataclasses.replace(one, shape=Parabola(h=0.2, L=2.0), count=3)
    other = dataclasses.replace(one, shape=SmoothFlatTop(h=0.1, ramp=1.0, top=1.0))
    assert type(longer) is type(one)
    assert type(other) is not type(one)
    assert other.heights(1.5) == 0.1
    assert Train(shape=HalfSine(h=0.1, wavenumber=1.0), count=2, gap=1.0).turning
    assert not one.turning
    assert all(isinstance(each, Train) for each in (one, longer, other))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Train.of_pitch(shape=Parabola(h=0.1, L=3.0), count=2, pitch=2.0),
            "pitch of a train must be at least its hump's length of 3 m, got 2 m; give a larger",
        ),
        (
            lambda: Train(shape=Parabola(h=0.1, L=3.0), count=0, gap=1.0),
            "number of humps count must be at least 1, got 0; give 1 or more",
        ),
        (
            lambda: Train(shape=Parabola(h=0.1, L=3.0), count=1.5, gap=1.0),
            "number of humps count must be a whole number, got 1.5",
        ),
        (
            lambda: Train(shape=Parabola(h=0.1, L=3.0), count=2, gap=-1.0),
            "gap gap must not be negative, got -1 m",
        ),
        (
            lambda: Train(shape=Sine(h=0.1, wavenumber=1.0), count=2, gap=1.0),
            "shape of a train must be of class Shape, got Sine(",
        ),
        (
            lambda: Train(
                shape=Train(shape=Parabola(h=0.1, L=3.0), count=2, gap=1.0), count=2, gap=1.0
            ),
            "shape of a train must be of class Shape, got Train(",
        ),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(make, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        make()
    assert message in str(error.value)
