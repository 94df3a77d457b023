"""Named tuples as vectors: what integrators do to states, whatever the state is made of.

A state is a named tuple of numbers, or of other named tuples: a car, the memory of its actuator,
a control filter. Entries are floats, arrays ``(n,)`` or torch tensors; compiled code has the same
functions (`qcar_env.engine.tuples`).
"""

from __future__ import annotations

from typing import Any


def advance(x: Any, step: Any, rate: Any) -> Any:
    """Return ``x + step * rate``, entry by entry, of the kind of `x`."""
    if isinstance(x, tuple):
        return _like(x, (advance(a, step, b) for a, b in zip(x, rate, strict=True)))
    return x + step * rate


def add(a: Any, b: Any) -> Any:
    """Return ``a + b``, entry by entry, of the kind of `a`."""
    if isinstance(a, tuple):
        return _like(a, (add(c, d) for c, d in zip(a, b, strict=True)))
    return a + b


def combine(a: Any, s: Any, b: Any, c: Any) -> Any:
    """Return ``a * s + b * c``, entry by entry, of the kind of `a`; `s` and `c` are numbers."""
    if isinstance(a, tuple):
        return _like(a, (combine(d, s, e, c) for d, e in zip(a, b, strict=True)))
    return a * s + b * c


def times(a: Any, b: Any) -> Any:
    """Return ``a * b``, entry by entry, of the kind of `a`."""
    if isinstance(a, tuple):
        return _like(a, (times(c, d) for c, d in zip(a, b, strict=True)))
    return a * b


def bounded(a: Any, limit: Any) -> Any:
    """Return `a` held within ``[-limit, limit]``, entry by entry; `limit` is a number."""
    if isinstance(a, tuple):
        return _like(a, (bounded(each, limit) for each in a))
    return min(max(a, -limit), limit)


def flat(tree: Any) -> tuple[Any, ...]:
    """Return the entries of a named tuple of named tuples, one after the other."""
    if isinstance(tree, tuple):
        return tuple(entry for part in tree for entry in flat(part))  # pyright: ignore[reportUnknownVariableType]
    return (tree,)


def unflat(like: Any, entries: Any) -> Any:
    """Return `entries`, a sequence, in the shape of `like`: the inverse of `flat`."""
    rest = iter(entries)

    def build(part: Any) -> Any:
        return (
            _like(part, (build(each) for each in part)) if isinstance(part, tuple) else next(rest)
        )

    return build(like)


def alike(a: Any, b: Any) -> bool:
    """Return whether two trees are made of the same kinds of tuples, whatever their numbers."""
    if not (isinstance(a, tuple) and isinstance(b, tuple)):
        return not isinstance(a, tuple) and not isinstance(b, tuple)
    same = type(a) is type(b) and len(a) == len(b)  # pyright: ignore[reportUnknownArgumentType]
    return same and all(alike(c, d) for c, d in zip(a, b, strict=True))


def paths(tree: Any, before: str = "") -> dict[str, int]:
    """Return where each entry of a named tuple lies in `flat`, by its dotted path."""
    found: dict[str, int] = {}

    def visit(part: Any, path: str) -> None:
        if not isinstance(part, tuple):
            found[path] = len(found)
            return
        names = getattr(part, "_fields", None) or [str(i) for i in range(len(part))]  # pyright: ignore[reportUnknownArgumentType]
        for name, each in zip(names, part, strict=True):  # pyright: ignore[reportUnknownArgumentType]
            visit(each, f"{path}.{name}" if path else name)

    visit(tree, before)
    return found


def _like(x: Any, entries: Any) -> Any:
    return type(x)(*entries) if hasattr(x, "_fields") else tuple(entries)
