"""A message names what is wrong, the value, the range and the remedy."""

import math
import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env import validation

NOT_FINITE = [math.nan, math.inf, -math.inf]
NOT_NUMBERS = ["1", b"1", None, True, 1j, [1.0], {1.0}, object()]
NOT_NUMBERS += [np.ones(1), np.ones(2), np.bool_(True), np.complex128(1.0), np.array("1")]


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


@pytest.mark.parametrize("check", [validation.finite, validation.positive, validation.non_negative])
@pytest.mark.parametrize("value", [7, np.int64(7), np.float32(7.0), np.array(7), np.array(7.0)])
def test_a_number_of_numpy_passes_as_a_float(check, value):
    assert check("h", value, "m") == 7.0
    assert type(check("h", value, "m")) is float


@pytest.mark.parametrize("check", [validation.finite, validation.positive, validation.non_negative])
@pytest.mark.parametrize("value", [10**400, -(10**400), pytest.param(10**5000, id="5001 digits")])
def test_an_int_beyond_all_floats_is_refused_in_a_short_message(check, value):
    with pytest.raises(ValueError, match=r"^h must be finite, got .* m; give a finite") as caught:
        check("h", value, "m")
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("value", [1, 7, 7.0, np.int64(7), np.float64(7.0), np.array(7), 10**400])
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


def test_a_whole_number_above_the_most_is_refused():
    assert validation.whole("count", 9, most=9) == 9
    with pytest.raises(ValueError, match=r"^count must be at most 9, got 10; give 1 to 9$"):
        validation.whole("count", 10, most=9)
    with pytest.raises(ValueError, match=r"^count must be at most 9, got a number of more digits"):
        validation.whole("count", 10**5000, most=9)


@pytest.mark.parametrize("value", [(1.0, 2.0), [1.0, 2.0], np.array([1.0, 2.0])])
def test_entries_of_a_sequence_are_a_tuple_of_plain_numbers(value):
    assert validation.entries(value) == (1.0, 2.0)
    assert [type(each) for each in validation.entries(value)] == [float, float]


@pytest.mark.parametrize("value", [1.0, None, "12", {1.0, 2.0}, np.array(1.0), np.eye(2)])
def test_what_is_no_sequence_has_no_entries(value):
    assert validation.entries(value) == ()


@pytest.mark.parametrize("value", [1, 0.5, [1, 2], np.eye(2), np.float32(1.0), ()])
def test_finite_numbers_of_any_shape_pass_as_an_array(value):
    found = validation.finite_array("t", value, "s")
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, value)


@pytest.mark.parametrize(
    "value", [*NOT_FINITE, None, "1", True, 10**400, [0.0, math.nan], [1, [2]], np.ma.masked]
)
def test_an_array_that_is_not_of_finite_numbers_is_refused(value):
    with pytest.raises(ValueError, match=r"^t must be finite \[s\], got .*; give a finite number"):
        validation.finite_array("t", value, "s")


@pytest.mark.parametrize("value", [1, True, [0.5, math.nan], [Fraction(1, 2), 2**70], ((),)])
def test_numbers_of_any_kind_pass_as_an_array(value):
    found = validation.numbers("x", value)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, np.array(value, np.float64))


@pytest.mark.parametrize(
    "value", ["1", b"1", 1j, [1, "1"], [1, b"1"], [1, 1j], [1, [2]], [10**400], np.ma.masked]
)
def test_what_is_not_made_of_numbers_is_refused(value):
    with pytest.raises(ValueError, match=r"^x must be numbers, got .*; give a list or an array of"):
        validation.numbers("x", value)


@pytest.mark.parametrize("name", ["cnvc", np.str_("cnvc")])
def test_a_known_name_passes_as_a_plain_string(name):
    found = validation.known("law", name, ("lnvc", "cnvc"))
    assert found == "cnvc"
    assert type(found) is str


@pytest.mark.parametrize("name", ["cnv", "CNVC", "cnvcc"])
def test_an_unknown_name_gets_the_nearest_and_the_whole_list(name):
    message = rf"^unknown law '{name}'; did you mean 'cnvc'\? Known: cnvc, lnvc$"
    with pytest.raises(ValueError, match=message):
        validation.known("law", name, ("lnvc", "cnvc"))


@pytest.mark.parametrize("name", ["zzzz", None, 3, 10**400, ["cnvc"], np.array(["cnvc", "lnvc"])])
def test_a_name_that_is_near_none_gets_the_list_alone(name):
    message = rf"^unknown law {re.escape(repr(name)[:200])}.*Known: cnvc, lnvc$"
    with pytest.raises(ValueError, match=message):
        validation.known("law", name, ("lnvc", "cnvc"))


def test_where_nothing_is_known_the_message_says_so():
    with pytest.raises(ValueError, match=r"^unknown render mode 'human'\. Known: none$"):
        validation.known("render mode", "human", ())
