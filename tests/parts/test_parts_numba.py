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


def compiled_loop(function, part, several):
    """Return a loop over cars in compiled code: ``loop(columns (k, n), p, out (m, n))``."""
    if function not in LOOPS:
        arguments, row = [], 0
        for each in arguments_of(function):
            cells = "".join(f"columns[{row + i}, i], " for i in range(size(each, part)))
            row += size(each, part)
            made = {"p": "p", "memory": f"State({cells})", **dict.fromkeys(ONES, f"({cells})")}
            arguments.append(made.get(each, cells.rstrip(", ")))
        found = [f"found[{i}]" for i in range(several)] or ["found"]
        store = "; ".join(f"out[{i}, i] = {each}" for i, each in enumerate(found))
        names = {
            "function": let_compiled_code_call(function),
            "State": getattr(part, "State", None),
        }
        exec(LOOP.format(arguments=", ".join(arguments), store=store), names)
        LOOPS[function] = numba.njit(error_model="numpy")(names["loop"])
    return LOOPS[function]


def arguments_of(function):
    return list(inspect.signature(function).parameters)


def size(argument, part):
    """Return how many drawn numbers an argument holds."""
    if argument == "memory":
        return len(part.State._fields)
    return part.size if argument in ONES else int(argument != "p")


def call(function, part, numbers, p):
    """Call a function with a float, or an array (n,), for each of the drawn numbers."""
    numbers, given = iter(numbers), []
    for each in arguments_of(function):
        held = [next(numbers) for _ in range(size(each, part))]
        if each == "p":
            given.append(p)
        elif each == "memory":
            given.append(part.State(*held))
        else:
            given.append(tuple(held) if each in ONES else held[0])
    return function(*given)


def rows(found):
    return found if isinstance(found, tuple) else (found,)


def bits(found):
    return np.asarray(found, dtype=np.float64).tobytes()


def each_car(p):
    """Return numbers in which every float is an array (n,): each car has its own."""
    if isinstance(p, tuple):
        made = [each_car(each) for each in p]
        return type(p)(*made) if hasattr(p, "_fields") else tuple(made)
    return np.full(CARS, p)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(data=st.data())
def test_floats_arrays_and_compiled_code_give_the_same_bits(kind: type, functions, data):
    part: Part = data.draw(st.from_type(kind))
    p = part.numbers
    for function in functions(kind).values():
        count = sum(size(each, part) for each in arguments_of(function))
        drawn = st.lists(VALUES, min_size=count * CARS, max_size=count * CARS)
        columns = np.reshape(data.draw(drawn), (count, CARS))
        found = [call(function, part, car, p) for car in columns.T.tolist()]
        expected = np.transpose([rows(each) for each in found])
        for numbers in (p, each_car(p)):
            on_arrays = rows(call(function, part, columns, numbers))
            assert bits(expected) == bits([np.broadcast_to(each, CARS) for each in on_arrays])
        out = np.empty_like(expected)
        several = len(found[0]) if isinstance(found[0], tuple) else 0
        compiled_loop(function, part, several)(columns, p, out)
        assert bits(expected) == bits(out), function


@pytest.mark.filterwarnings("ignore:overflow")  # of a power, which then allows no force
def test_forces_are_finite(kind: type, functions):
    @given(part=st.from_type(kind), data=st.data())
    def check(part, data):
        drawn = st.lists(st.sampled_from([0.0, -0.0, 1e-300, -1e80, 1e80]), min_size=9, max_size=9)
        for function in functions(kind).values():
            assert np.isfinite(rows(call(function, part, data.draw(drawn), part.numbers))).all()

    check()


def test_what_rests_feels_no_force_to_the_last_bit(kind: type, functions):
    @given(part=st.from_type(kind))
    def check(part):
        if "force" in functions(kind):
            assert not any(rows(call(kind.force, part, [0.0] * 9, part.numbers)))

    check()


def test_numbers_of_one_class_are_of_one_class(kind: type):
    @given(a=st.from_type(kind), b=st.from_type(kind))
    def check(a, b):
        assert type(a.numbers) is type(b.numbers)
        assert all(isinstance(each, float) for each in floats_of(a.numbers))

    check()


def floats_of(p):
    return [each for entry in p for each in floats_of(entry)] if isinstance(p, tuple) else [p]
