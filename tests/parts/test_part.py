"""What a part is: checked numbers, nested numbers, and forms without a branch."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.control.law import Law
from qcar_env.envs.reward import Term
from qcar_env.parts.actuator import Actuator, LaggedSuspensionActuator
from qcar_env.parts.damper import Damper
from qcar_env.parts.part import Part, clamp, least, most, number, positive_part, text, units
from qcar_env.parts.spring import Spring, TravelStops
from qcar_env.parts.tyre import Tyre
from qcar_env.roads.profile import Road
from qcar_env.validation import positive

FINITE = st.floats(-1e150, 1e150)


@dataclass(frozen=True, kw_only=True)
class Inner(Part):
    k: float = number("stiffness", "N/m", positive)


@dataclass(frozen=True, kw_only=True)
class Outer(Part):
    name: str = text("none")
    inner: Inner
    m: float = number("mass", "kg", positive, 2.0)


def test_numbers_are_floats_in_the_order_of_the_fields_and_nest():
    part = Outer(inner=Inner(k=np.int64(3)))
    assert part.numbers == ((3.0,), 2.0)
    assert part.numbers._fields == ("inner", "m")
    assert type(part.numbers.inner.k) is float
    assert units(Inner) == {"k": "N/m"}


def test_a_number_that_is_refused_is_named_with_value_and_remedy():
    with pytest.raises(ValueError, match="stiffness k must be positive, got -1 N/m; give a value"):
        Inner(k=-1.0)


@given(a=FINITE, b=FINITE, c=FINITE)
def test_forms_without_a_branch_are_those_with_one(a: float, b: float, c: float):
    assert least(a, b) == min(a, b)
    assert most(a, b) == max(a, b)
    assert positive_part(a) == max(a, 0.0)
    low, high = min(b, c), max(b, c)
    assert low < high or clamp(a, low, high) in (low, 2.0 * low)
    assert low == high or clamp(a, low, high) == min(max(a, low), high)


@pytest.mark.parametrize(
    ("base", "name"),
    [
        (Spring, "force"),
        (TravelStops, "force"),
        (Damper, "force"),
        (Tyre, "force"),
        (Actuator, "command"),
        (Road, "height"),
        (Law, "command"),
        (Term, "cost"),
    ],
)
def test_a_function_that_was_forgotten_is_named_with_its_class_and_remedy(base, name):
    @dataclass(frozen=True, kw_only=True)
    class Own(base):
        limit: float = 1.0

    said = rf"Own must define {name}, as {base.__name__} describes it; add it as a static method"
    with pytest.raises(TypeError, match=said):
        Own()


def test_a_memory_without_a_rate_is_named():
    @dataclass(frozen=True, kw_only=True)
    class Own(LaggedSuspensionActuator):
        rate = property()  # hides the inherited one: an AttributeError when it is looked up

    with pytest.raises(TypeError, match="Own has a memory Force and must define rate"):
        Own(limit=1.0, lag=0.1)
