"""A message names what is wrong, the value, the range and the remedy."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics import validation

NOT_FINITE = [math.nan, math.inf, -math.inf]
NOT_NUMBERS = ["1", None, True, 1j, [1.0], object()]


@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_a_finite_number_passes_unchanged(value: float):
    assert validation.finite("h", value, "m") == value


@given(value=st.floats(min_value=0.0, exclude_min=True, allow_infinity=False))
def test_a_positive_number_passes_unchanged(value: float):
    assert validation.positive("m1", value, "kg") == value
    assert validation.non_negative("m1", value, "kg") == value


@given(value=st.floats(max_value=-1e-300, allow_infinity=False))
def test_a_negative_number_is_named_with_value_range_and_remedy(value: float):
    with pytest.raises(ValueError, match=r"m1 must be positive, got -.* kg; give a value above 0"):
        validation.positive("m1", value, "kg")
    with pytest.raises(ValueError, match=r"m1 must not be negative, got -.* kg; give 0 kg or more"):
        validation.non_negative("m1", value, "kg")


def test_a_number_without_a_unit_is_named_without_one():
    with pytest.raises(ValueError, match=r"^gap must not be negative, got -1; give 0 or more$"):
        validation.non_negative("gap", -1.0)
    with pytest.raises(ValueError, match=r"^zeta must be positive, got 0; give a value above 0$"):
        validation.positive("zeta", 0.0)
    with pytest.raises(ValueError, match=r"^gap must be a number, got None; give a finite number$"):
        validation.finite("gap", None)


def test_zero_is_not_positive_and_not_negative():
    with pytest.raises(ValueError, match="L must be positive, got 0 m; give a value above 0 m"):
        validation.positive("L", 0.0, "m")
    assert validation.non_negative("L", 0.0, "m") == 0.0


@pytest.mark.parametrize("check", [validation.finite, validation.positive, validation.non_negative])
@pytest.mark.parametrize("value", NOT_FINITE)
def test_what_is_not_finite_is_refused(check, value):
    with pytest.raises(ValueError, match=f"h must be finite, got {value} m; give a finite number"):
        check("h", value, "m")


@pytest.mark.parametrize("check", [validation.finite, validation.positive, validation.non_negative])
@pytest.mark.parametrize("value", NOT_NUMBERS)
def test_what_is_not_a_number_is_refused(check, value):
    with pytest.raises(ValueError, match=r"h must be a number in m, got .*; give a finite number"):
        check("h", value, "m")


@pytest.mark.parametrize("value", [1, 7, 7.0, np.int64(7), np.float64(7.0)])
def test_a_whole_number_passes_as_an_int(value):
    found = validation.whole("substeps", value)
    assert found == value
    assert type(found) is int


@pytest.mark.parametrize("value", [1.5, *NOT_FINITE, *NOT_NUMBERS, "seven"])
def test_what_is_not_a_whole_number_is_refused(value):
    with pytest.raises(
        ValueError, match=r"substeps must be a whole number, got .*; give 1 or more"
    ):
        validation.whole("substeps", value)


@pytest.mark.parametrize("least", [0, 1, 5])
def test_a_whole_number_below_the_least_is_refused(least):
    assert validation.whole("count", least, least) == least
    message = f"count must be at least {least}, got {least - 1}; give {least} or more"
    with pytest.raises(ValueError, match=message):
        validation.whole("count", least - 1, least)


def test_a_known_name_passes():
    assert validation.known("law", "cnvc", ("lnvc", "cnvc")) == "cnvc"


@pytest.mark.parametrize("name", ["cnv", "CNVC", "cnvcc"])
def test_an_unknown_name_gets_the_nearest_and_the_whole_list(name):
    message = rf"^unknown law '{name}'; did you mean 'cnvc'\? Known: cnvc, lnvc$"
    with pytest.raises(ValueError, match=message):
        validation.known("law", name, ("lnvc", "cnvc"))


@pytest.mark.parametrize("name", ["zzzz", None, 3])
def test_a_name_that_is_near_none_gets_the_list_alone(name):
    with pytest.raises(ValueError, match=rf"^unknown law {name!r}\. Known: cnvc, lnvc$"):
        validation.known("law", name, ("lnvc", "cnvc"))


def test_where_nothing_is_known_the_message_says_so():
    with pytest.raises(ValueError, match=r"^unknown render mode 'human'\. Known: none$"):
        validation.known("render mode", "human", ())
