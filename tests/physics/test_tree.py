"""Named tuples as vectors, on floats, arrays, tensors and in compiled code."""

from typing import NamedTuple

import numba
import numpy as np
import pytest
from hypothesis import given

import qcar_env.engine.tuples  # noqa: F401  has the compiled forms
from qcar_env.parts.part import Nothing
from qcar_env.physics import tree
from qcar_env.physics.closed_loop import ControlledState
from qcar_env.physics.state import Filter, State


class Mixed(NamedTuple):
    """A tuple of everything that a state may hold."""

    a: float
    inside: State
    nothing: Nothing
    b: float


@given(...)
def test_operations_go_entry_by_entry(x: State, eta: Filter, rate: State, eta_rate: Filter):
    one, other = ControlledState(x, eta), ControlledState(rate, eta_rate)
    pairs = list(zip(tree.flat(one), tree.flat(other), strict=True))
    assert tree.flat(tree.advance(one, 0.25, other)) == tuple(a + 0.25 * b for a, b in pairs)
    assert tree.flat(tree.add(one, other)) == tuple(a + b for a, b in pairs)
    assert tree.flat(tree.times(one, other)) == tuple(a * b for a, b in pairs)
    assert tree.flat(tree.combine(one, 2.0, other, 3.0)) == tuple(
        a * 2.0 + b * 3.0 for a, b in pairs
    )
    assert tree.flat(tree.bounded(one, 1.0)) == tuple(min(max(a, -1.0), 1.0) for a, _ in pairs)
    moved = tree.advance(one, 0.0, other)
    assert moved == one
    assert type(moved) is ControlledState
    assert type(moved.filter) is Filter


def test_flat_and_unflat_are_inverse_and_paths_name_the_entries():
    mixed = Mixed(1.0, State(2.0, 3.0, 4.0, 5.0), Nothing(), 6.0)
    assert tree.flat(mixed) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert tree.unflat(mixed, tree.flat(mixed)) == mixed
    assert list(tree.paths(mixed)) == [
        "a", "inside.x1", "inside.x2", "inside.v1", "inside.v2", "b"
    ]  # fmt: skip
    assert tree.paths(mixed)["b"] == 5


@pytest.mark.parametrize("name", ["advance", "add", "combine", "times", "bounded"])
def test_compiled_forms_give_the_same_bits(name):
    rng = np.random.default_rng(3)
    a, b = (
        Mixed(*rng.normal(size=1), State(*rng.normal(size=4)), Nothing(), float(rng.normal()))
        for _ in range(2)
    )
    function = getattr(tree, name)
    given_ = {
        "advance": (a, 0.1, b),
        "combine": (a, 0.1, b, 0.3),
        "bounded": (a, 0.5),
    }.get(name, (a, b))

    @numba.njit
    def compiled(*args):
        return function(*args)

    found = compiled(*given_)
    assert tree.flat(found) == tree.flat(function(*given_))
    assert type(found) is Mixed


def test_floats_arrays_and_tensors_give_the_same_bits(same_bits):
    rng = np.random.default_rng(1)
    x, rate = (
        ControlledState(State(*rng.normal(size=(4, 64))), Filter(*rng.normal(size=(4, 64))))
        for _ in range(2)
    )
    s, c = rng.random((2, 64))
    same_bits(tree.advance, x, s, rate)
    same_bits(tree.add, x, rate)
    same_bits(tree.times, x, rate)
    same_bits(tree.combine, x, s, rate, c)
