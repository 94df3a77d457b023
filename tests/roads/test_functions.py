"""Roads from plain functions."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.roads.functions import FunctionRoad


def waves(s):
    return 0.01 * math.sin(20.0 * s)


def wedge(s):
    if s < 1.0 or s >= 2.0:
        return 0.0
    return 0.3 * (s - 1.0) * (s - 1.0) + 0.1 * s


def forgetful(s):
    return waves(s)  # a plain function, which numba does not know


def words(s):
    return str(s)


@given(s=st.floats(-100.0, 100.0))
def test_a_missing_slope_is_within_what_is_stated(s):
    """A sine of 1 cm and 0.3 m length: 1e-9 at its steepest, where y''' = 80 1/m^2."""
    road = FunctionRoad(profile=waves)
    # 1e-10 / 6 * 80, and heights rounded to 1e-16 of an angle of 2000 rad over 1e-5 m
    assert road.slopes(s) == pytest.approx(0.2 * math.cos(20.0 * s), abs=2e-9 + 2e-9)


def test_both_sides_of_a_kink():
    road = FunctionRoad(profile=wedge, kinks_at=(1.0, 2.0))
    kind, p, table = type(road), road.numbers, road.table
    assert road.kinks(0.0, 9.0) == [1.0, 2.0]
    assert road.jumps(0.0, 9.0) == [pytest.approx(0.1), pytest.approx(-0.5)]
    # a parabola: its difference is exact but for rounding, 1e-17 / 1e-5 m
    ends = [(0, 1.0, 0.0), (1, 1.0, 0.1), (1, 2.0, 0.7), (2, 2.0, 0.0)]
    for piece, s, slope in ends:
        assert kind.slope(s, piece, p, table) == pytest.approx(slope, abs=1e-10)
    assert kind.height(2.0, 1, p, table) == pytest.approx(0.5, abs=1e-15)
    assert kind.height(2.0 + 1e-9, 1, p, table) == pytest.approx(0.5, abs=1e-15)


def test_a_kink_without_a_jump_has_none_at_all():
    road = FunctionRoad(profile=abs_sine, kinks_at=(math.pi,))
    assert road.jumps(0.0, 9.0) == [0.0]


def abs_sine(s):
    return abs(math.sin(s))


def test_a_function_that_is_compiled_already_will_do():
    numba = pytest.importorskip("numba")
    inner = numba.njit(waves)

    def doubled(s):
        return 2.0 * inner(s)

    assert FunctionRoad(profile=inner).heights(0.3) == waves(0.3)
    assert FunctionRoad(profile=doubled).heights(0.3) == 2.0 * waves(0.3)


def test_roads_of_one_function_are_of_one_class():
    a, b = FunctionRoad(profile=waves), FunctionRoad(profile=waves, kinks_at=(1.0,))
    assert type(a) is type(b)
    assert type(a) is not type(FunctionRoad(profile=wedge))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FunctionRoad(profile=forgetful), "numba compiles, got <function forgetful"),
        (lambda: FunctionRoad(profile=forgetful), "sample it: SampledRoad.from_function"),
        (lambda: FunctionRoad(profile=words), "profile must be a function of floats"),
        (lambda: FunctionRoad(profile=np.ones(3)), "profile must be a function of s, got array("),
        (lambda: FunctionRoad(profile=waves, gradient=words), "gradient must be a function of"),
        (
            lambda: FunctionRoad(profile=waves, kinks_at=(2.0, 1.0)),
            "kinks_at must rise by at least 0.001 m, got (2.0, 1.0); give them in order",
        ),
        (lambda: FunctionRoad(profile=waves, kinks_at=(math.nan,)), "kinks_at must be finite"),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(make, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        make()
    assert message in str(error.value)
