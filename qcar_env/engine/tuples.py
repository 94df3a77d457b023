"""Named tuples in compiled code, and where their numbers lie in a slab.

A function here has two forms: plain Python, and what compiled code takes, made from the types of
its arguments. So have those of `qcar_env.physics.tree` and `qcar_env.parts.part`.
"""

# pyright: basic, reportArgumentType=false, reportAttributeAccessIssue=false
# numba has no types for what it compiles.

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from qcar_env.engine.compile import has_form
from qcar_env.parts import part
from qcar_env.physics import tree


def _entrywise(kind: Any, leaf: Callable[[str], str]) -> tuple[str, dict[str, Any]]:
    """Return an expression that makes a tuple like `kind` of ``leaf("[i][j]")``, and its names."""
    names: dict[str, Any] = {}

    def build(part: Any, index: str) -> str:
        if not isinstance(part, types.BaseTuple):
            return leaf(index)
        inside = "".join(build(each, f"{index}[{i}]") + ", " for i, each in enumerate(part.types))
        if not isinstance(part, types.BaseNamedTuple):
            return f"({inside})"
        names[name := f"K{len(names)}"] = part.instance_class
        return f"{name}({inside})"

    return build(kind, ""), names


def _indices(values: Any) -> list[str]:
    """Return ``"[i][j]"`` of each number in a tuple of numbers or of tuples."""
    found: list[str] = []
    _entrywise(values, lambda index: found.append(index) or "")
    return found


def _implementation(arguments: str, body: str, names: dict[str, Any]) -> Any:
    exec(f"def made({arguments}):\n    return {body}", names)
    return names["made"]


@has_form(tree.advance)
def _advance(x: Any, step: Any, rate: Any) -> Any:
    body, names = _entrywise(x, lambda i: f"x{i} + step * rate{i}")
    return _implementation("x, step, rate", body, names)


@has_form(tree.add)
def _add(a: Any, b: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} + b{i}")
    return _implementation("a, b", body, names)


@has_form(tree.combine)
def _combine(a: Any, s: Any, b: Any, c: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} * s + b{i} * c")
    return _implementation("a, s, b, c", body, names)


@has_form(tree.times)
def _times(a: Any, b: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"a{i} * b{i}")
    return _implementation("a, b", body, names)


@has_form(tree.bounded)
def _bounded(a: Any, limit: Any) -> Any:
    body, names = _entrywise(a, lambda i: f"min(max(a{i}, -limit), limit)")
    return _implementation("a, limit", body, names)


# What parts choose with: a product with a truth value is slow in vectors, and a choice has the same
# bits, as no zero is negative. A first argument that is no number stays none.


def _zero(kind: Any) -> Any:
    return (np.float32 if kind == types.float32 else np.float64)(0.0)


@has_form(part.least)
def _least(a: Any, b: Any) -> Any:
    zero = _zero(a)
    return lambda a, b: (b if b < a else a) + zero


@has_form(part.most)
def _most(a: Any, b: Any) -> Any:
    zero = _zero(a)
    return lambda a, b: (b if b > a else a) + zero


@has_form(part.positive_part)
def _positive_part(value: Any) -> Any:
    zero = _zero(value)
    return lambda value: zero if zero >= value else value


@has_form(part.clamp)
def _clamp(value: Any, low: Any, high: Any) -> Any:
    return lambda value, low, high: part.least(part.most(value, low), high)


def negative_sum(costs: Any) -> Any:
    """Return ``-costs[0] - costs[1] - ...``, in this order."""
    total = -costs[0]
    for each in costs[1:]:
        total = total - each
    return total


@has_form(negative_sum)
def _negative_sum(costs: Any) -> Any:
    body = "".join(f" - costs[{i}]" for i in range(len(costs))).strip()
    return _implementation("costs", body.replace("- ", "-", 1) or "0.0", {})


def negative(costs: Any) -> Any:
    """Return ``(-costs[0], -costs[1], ...)``."""
    return tuple(-each for each in costs)


@has_form(negative)
def _negative(costs: Any) -> Any:
    body, names = _entrywise(costs, lambda i: f"-costs{i}")
    return _implementation("costs", body, names)


def outcome(code: Any, reward: Any, out: Any, late: Any, costs: Any, penalty: Any) -> Any:
    """Return ``(code, reward, out, late, -costs[0], -costs[1], ..., penalty)``."""
    return code, reward, out, late, *(-each for each in costs), penalty


@has_form(outcome)
def _outcome(code: Any, reward: Any, out: Any, late: Any, costs: Any, penalty: Any) -> Any:
    terms = "".join(f"-costs[{i}], " for i in range(len(costs)))
    body = f"(code, reward, out, late, {terms}penalty)"
    return _implementation("code, reward, out, late, costs, penalty", body, {})


def load(z: Any, row: int, stride: int, lane: int, like: Any) -> Any:
    """Return the numbers of car `lane` from `row` of slab `z` on, as a tuple of the kind of `like`.

    Parameters
    ----------
    z : ndarray (rows * stride,)
        The slab.
    row, stride, lane : int
        First row, cars in the slab, and the car.
    like : tuple
        A named tuple of numbers or of named tuples; its own numbers do not matter.
    """
    rows = np.asarray(z).reshape(-1, stride)[row:, lane]
    return tree.unflat(like, rows[: len(tree.flat(like))].tolist())


@has_form(load)
def _load(z: Any, row: Any, stride: Any, lane: Any, like: Any) -> Any:
    rows = iter(range(10**6))
    body, names = _entrywise(like, lambda _: f"z[(row + {next(rows)}) * stride + lane]")
    return _implementation("z, row, stride, lane, like", body, names)


def load_wide(z: Any, row: int, stride: int, lane: int, like: Any) -> Any:
    """Return the same in double precision, whatever the slab's."""
    return load(z, row, stride, lane, like)


@has_form(load_wide)
def _load_wide(z: Any, row: Any, stride: Any, lane: Any, like: Any) -> Any:
    rows = iter(range(10**6))
    entry = lambda _: f"float64(z[(row + {next(rows)}) * stride + lane])"  # noqa: E731
    body, names = _entrywise(like, entry)
    return _implementation("z, row, stride, lane, like", body, {**names, "float64": np.float64})


def save(z: Any, row: int, stride: int, lane: int, values: Any) -> None:
    """Write `values`, a tuple of numbers or of tuples, into the rows from `row` on (see `load`)."""
    flat = tree.flat(values)
    np.asarray(z).reshape(-1, stride)[row : row + len(flat), lane] = flat


@has_form(save)
def _save(z: Any, row: Any, stride: Any, lane: Any, values: Any) -> Any:
    lines = [
        f"    z[(row + {k}) * stride + lane] = values{i}" for k, i in enumerate(_indices(values))
    ]
    names: dict[str, Any] = {}
    exec("def made(z, row, stride, lane, values):\n" + "\n".join(lines or ["    pass"]), names)
    return names["made"]


def holds(z: Any, row: int, stride: int, lane: int, values: Any) -> bool:
    """Return whether `save` of the same would change nothing."""
    flat = tree.flat(values)
    rows = np.asarray(z).reshape(-1, stride)[row : row + len(flat), lane]
    return bool(np.all(rows == np.array(flat).astype(rows.dtype)))


@has_form(holds)
def _holds(z: Any, row: Any, stride: Any, lane: Any, values: Any) -> Any:
    each = (
        f"(z[(row + {k}) * stride + lane] == real(values{i}))"
        for k, i in enumerate(_indices(values))
    )
    names = {"real": np.float32 if z.dtype == types.float32 else np.float64}
    return _implementation("z, row, stride, lane, values", " & ".join(each) or "True", names)


def weighted(z: Any, row: int, stride: int, lane: int, values: Any, like: Any) -> Any:
    """Return a matrix times a vector, as a tuple of the kind of `like`.

    Parameters
    ----------
    z, row, stride, lane
        Where the matrix lies, row by row (see `load`).
    values : tuple
        The vector: a tuple of numbers or of tuples.
    like : tuple
        Has as many numbers as the matrix has rows.
    """
    vector = np.array(tree.flat(values))
    size = len(tree.flat(like)) * len(vector)
    matrix = np.asarray(z).reshape(-1, stride)[row : row + size, lane].reshape(-1, len(vector))
    return tree.unflat(like, (matrix @ vector).tolist())


@has_form(weighted)
def _weighted(z: Any, row: Any, stride: Any, lane: Any, values: Any, like: Any) -> Any:
    places, rows = _indices(values), iter(range(10**6))

    def entry(_: str) -> str:
        first = next(rows) * len(places)
        terms = (
            f"z[(row + {first + k}) * stride + lane] * values{i}" for k, i in enumerate(places)
        )
        return " + ".join(terms)

    body, names = _entrywise(like, entry)
    return _implementation("z, row, stride, lane, values, like", body, names)
