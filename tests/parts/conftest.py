"""Random parts: `@given(...)` draws them from a test's annotations, of every class there is.

A new part class whose numbers are declared with a known check needs nothing here.
"""

import dataclasses
import importlib
import inspect
import pkgutil

import pytest
from hypothesis import assume, strategies as st

import qcar_env.parts
from qcar_env import validation
from qcar_env.parts import actuator, damper, part, sensor, spring, table, tyre


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


AHEAD = st.lists(floats(1e-2, 10.0), min_size=0, max_size=4)


@st.composite
def points(draw, behind: bool, falling: bool):
    """Two rising tuples that go through (0, 0); the second may fall where asked for."""
    steps = draw(AHEAD.filter(len)), draw(AHEAD) if behind else []
    x, y = [0.0], [0.0]
    for sign, side in zip((1, -1), steps, strict=True):
        for step in side:
            up = draw(floats(-1e5 if falling else 0.0, 1e5))
            at = -1 if sign > 0 else 0
            x.insert(len(x) if sign > 0 else 0, x[at] + sign * step)
            y.insert(len(y) if sign > 0 else 0, y[at] + sign * up)
    return tuple(x), tuple(y)


LIMIT = floats(1.0, 1e4)
POSITIVE = st.builds(lambda x, power: x * 10.0**power, floats(1.0, 10.0), st.integers(-3, 5))
NUMBERS = {
    validation.finite: POSITIVE | POSITIVE.map(lambda x: -x),
    validation.positive: POSITIVE,
    validation.non_negative: POSITIVE | POSITIVE | st.just(0.0),
}
TUPLES = {table.several, table.rising, table.not_falling}


@st.composite
def parts(draw, kind):
    """A part of a class, its numbers drawn by their checks; at times with its defaults."""
    fields = [each for each in dataclasses.fields(kind) if "check" in each.metadata]
    tables = [each for each in fields if each.metadata["check"] in TUPLES]
    given = {"signal": "v2"} if kind is sensor.Sensor else {}
    if tables:
        first, second = tables
        falling = second.metadata["check"] is table.several
        behind = not issubclass(kind, spring.TravelStops)
        given[first.name], given[second.name] = draw(points(behind, falling))
    for each in fields:
        if each in tables:
            continue
        if each.name == "limit":
            given["limit"] = draw(st.tuples(*[LIMIT] * kind.size))
        elif each.default is dataclasses.MISSING or draw(st.integers(0, 3)):
            given[each.name] = draw(NUMBERS[each.metadata["check"]])
    try:
        return kind(**given)
    except ValueError:  # two numbers that do not fit each other
        assume(False)


def classes(base: type) -> list[type]:
    """Return every class of parts below a base that has no classes below it."""
    for each in pkgutil.iter_modules(qcar_env.parts.__path__, "qcar_env.parts."):
        importlib.import_module(each.name)
    below = [kind for each in base.__subclasses__() for kind in classes(each)]
    own = base.__module__.startswith("qcar_env.parts.") and base is not part.Part
    return below or [base] * own


for base in (
    part.Part,
    spring.Spring,
    spring.TravelStops,
    damper.Damper,
    tyre.Tyre,
    actuator.Actuator,
):
    kinds = classes(base)
    for kind in kinds:
        st.register_type_strategy(kind, parts(kind))
    st.register_type_strategy(base, st.one_of([parts(kind) for kind in kinds]))


@pytest.fixture(params=classes(part.Part), ids=lambda kind: kind.__name__)
def kind(request) -> type:
    return request.param


@pytest.fixture(scope="session")
def functions():
    """Return a function that lists the functions of a class of parts by name."""

    def of(kind: type) -> dict:
        names = [each for each in dir(kind) if not each.startswith("_")]
        found = {each: inspect.getattr_static(kind, each) for each in names}
        return {
            name: each.__func__ for name, each in found.items() if isinstance(each, staticmethod)
        }

    return of
