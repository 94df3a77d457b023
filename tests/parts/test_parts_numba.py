"""Every function of every part gives the same bits on floats, on arrays and in compiled code."""

import inspect
from types import FunctionType

import numba
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from qcar_env.parts.part import Part

CARS = 5
ONES = {"action", "command"}  # tuples (m,)
VALUES = st.floats(-1e4, 1e4, allow_subnormal=False)


def let_compiled_code_call(function: FunctionType) -> FunctionType:
    """Register a function with numba, and what it calls of this package, as it stands."""
    if function not in REGISTERED:
        REGISTERED.add(function)
        numba.extending.register_jitable(function)
        for name in function.__code__.co_names:
            called = function.__globals__.get(name)
            if isinstance(called, FunctionType) and called.__module__.startswith("qcar_env."):
                let_compiled_code_call(called)
    return function


REGISTERED: set[FunctionType] = set()
LOOP = """
def loop(columns, p, out):
    for i in range(out.shape[1]):
        found = function({arguments})
        {store}
"""
LOOPS: dict = {}


def compiled_loop(name, function, part, width):
    """Return a loop over cars in compiled code: ``loop(columns (k, n), p, out (width, n))``."""
    if function not in LOOPS:
        arguments, row = [], 0
        for each in inspect.signature(function).parameters:
            count = entries(each, part)
            cells = "".join(f"columns[{row + i}, i], " for i in range(count or 0))
            row += count or 0
            if each == "p":
                arguments.append("p")
            elif each == "memory":
                arguments.append(f"State({cells})")
            else:
                arguments.append(f"({cells})" if each in ONES else cells.rstrip(", "))
        store = "; ".join(
            f"out[{i}, i] = found" + (f"[{i}]" if width != 1 or several(function, part) else "")
            for i in range(width)
        )
        names = {
            "function": let_compiled_code_call(function),
            "State": getattr(part, "State", None),
        }
        exec(LOOP.format(arguments=", ".join(arguments), store=store), names)
        LOOPS[function] = numba.njit(error_model="numpy")(names["loop"])
    return LOOPS[function]


def entries(name, part):
    """Return how many numbers an argument holds; None of `p`, which is not drawn."""
    if name == "p":
        return None
    return len(part.State._fields) if name == "memory" else part.size if name in ONES else 1


def several(function, part):
    return isinstance(call(function, part, np.zeros(20), part.numbers), tuple)


def call(function, part, numbers, p):
    """Call a function with a float, or an array (n,), for each of its numbers."""
    numbers, given = iter(numbers), []
    for each in inspect.signature(function).parameters:
        if each == "p":
            given.append(p)
            continue
        held = [next(numbers) for _ in range(entries(each, part))]
        memory = part.State(*held) if each == "memory" else None
        given.append(memory if each == "memory" else tuple(held) if each in ONES else held[0])
    return function(*given)


def rows(found):
    return found if isinstance(found, tuple) else (found,)


def bits(found):
    return np.asarray(found, dtype=np.float64).tobytes()


def each_car(p, n):
    """Return numbers in which every float is an array (n,)."""
    if isinstance(p, tuple):
        made = [each_car(each, n) for each in p]
        return type(p)(*made) if hasattr(p, "_fields") else tuple(made)
    return np.full(n, p)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(data=st.data())
def test_floats_arrays_and_compiled_code_give_the_same_bits(kind: type, functions, data):
    part: Part = data.draw(st.from_type(kind))
    for name, function in functions(kind).items():
        count = sum(entries(each, part) or 0 for each in inspect.signature(function).parameters)
        drawn = st.lists(VALUES, min_size=count * CARS, max_size=count * CARS)
        columns = np.reshape(data.draw(drawn), (count, CARS))
        one_by_one = np.transpose(
            [rows(call(function, part, car.tolist(), part.numbers)) for car in columns.T]
        )
        for p in (part.numbers, each_car(part.numbers, CARS)):
            on_arrays = rows(call(function, part, columns, p))
            assert bits(one_by_one) == bits([np.broadcast_to(each, CARS) for each in on_arrays])
        out = np.empty((len(on_arrays), CARS))
        compiled_loop(name, function, part, len(on_arrays))(columns, part.numbers, out)
        assert bits(one_by_one) == bits(out), name


def test_parts_of_one_class_have_numbers_of_one_type(kind: type):
    """What is compiled for one fits all of them, tables of one length and shape included."""

    @given(a=st.from_type(kind), b=st.from_type(kind))
    def check(a, b):
        assert type(a.numbers) is type(b.numbers)
        assert type(a.at_rest) is type(b.at_rest) if hasattr(a, "at_rest") else True
        hash(a.numbers)

    check()


@pytest.mark.parametrize("value", [0.0, -0.0])
def test_what_rests_feels_no_force(kind: type, functions, value):
    """No travel, no rate, no action: no force, to the last bit."""

    @given(part=st.from_type(kind))
    def check(part):
        if "force" in functions(kind):
            assert not any(
                rows(call(kind.force, part, [value] * 20, part.numbers))
            )

    check()
