"""Forces read from a table: straight lines between its points, and on beyond its ends.

    f(x) = side(x; up) - side(-x; down)
    side(x) = sum_i s_i (max(x - x_i, 0) - max(x - x_i+1, 0)),    the last x_i+1 at infinity

The lines are summed outward from the point (0, 0), which every table holds: the force at rest is
zero to the last bit, slopes that are not negative give no force of the wrong sign, and no branch
is needed.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

from qcar_env.parts.part import positive_part
from qcar_env.validation import entries, finite, shown


class Side(NamedTuple):
    """The lines on one side of zero, outward."""

    start: tuple[Any, ...]  # x_i, where a line begins
    slope: tuple[Any, ...]  # s_i


class Sides(NamedTuple):
    """The lines of a table on both sides of zero."""

    up: Side
    down: Side  # mirrored at zero


def side(x: Any, lines: Any) -> Any:
    """Return the force at `x` of the lines (a `Side`) on one side: zero for ``x <= 0``."""
    force, here = 0.0, positive_part(x - lines.start[0])
    for i in range(1, len(lines.start)):
        beyond = positive_part(x - lines.start[i])
        force = force + lines.slope[i - 1] * (here - beyond)
        here = beyond
    return force + lines.slope[-1] * here


def both_sides(x: Any, lines: Any) -> Any:
    """Return the force at `x` of the lines (`Sides`) of a table."""
    return side(x, lines.up) - side(-x, lines.down)


# Checks and preparation -----------------------------------------------------------------------


def several(name: str, value: Any, unit: str = "-") -> tuple[float, ...]:
    """Return `value`, two numbers or more, as a tuple of floats.

    Raises
    ------
    ValueError
        If there are fewer than two or one is not finite.
    """
    given = entries(value)
    if len(given) < 2:
        raise ValueError(f"{name} must be two numbers or more, got {shown(value)}; give a tuple")
    return tuple(finite(f"{name}[{i}]", each, unit) for i, each in enumerate(given))


def rising(name: str, value: Any, unit: str = "-") -> tuple[float, ...]:
    """Return `value`, two numbers or more, each above the one before, as a tuple of floats.

    Raises
    ------
    ValueError
        If there are fewer than two, one is not finite or not above the one before.
    """
    return _ordered(several(name, value, unit), name, unit, "rise", lambda a, b: a < b)


def not_falling(name: str, value: Any, unit: str = "-") -> tuple[float, ...]:
    """Return `value`, two numbers or more, none below the one before, as a tuple of floats.

    Raises
    ------
    ValueError
        If there are fewer than two, one is not finite or below the one before.
    """
    return _ordered(several(name, value, unit), name, unit, "not fall", lambda a, b: a <= b)


def outward(name: str, x: tuple[float, ...], y: tuple[float, ...]) -> Side:
    """Return the lines through points that begin at (0, 0); `name` is the table's, for messages.

    Raises
    ------
    ValueError
        If the numbers of `x` and `y` differ, the first point is not (0, 0), or two points are so
        close that the line between them has no finite slope.
    """
    _paired(name, x, y)
    if x[0] != 0.0 or y[0] != 0.0:
        raise ValueError(
            f"{name} must begin with the point (0, 0), got ({x[0]:g}, {y[0]:g}); "
            "put 0 first in both"
        )
    slope = tuple(
        finite(f"slope of {name} from {a:g}", (d - c) / (b - a))
        for (a, b), (c, d) in zip(pairwise(x), pairwise(y), strict=True)
    )
    return Side(x[:-1], slope)


def through_zero(name: str, x: tuple[float, ...], y: tuple[float, ...]) -> Sides:
    """Return the lines through points of which one is (0, 0).

    Raises
    ------
    ValueError
        If the numbers of `x` and `y` differ, no point is (0, 0), or two points are so close that
        the line between them has no finite slope.
    """
    _paired(name, x, y)
    if (0.0, 0.0) not in zip(x, y, strict=True):
        raise ValueError(
            f"{name} must hold the point (0, 0), got {shown(x)} and {shown(y)}; "
            "measure both from rest and add 0 to both"
        )
    zero = x.index(0.0)
    ahead = x[zero:], y[zero:]
    behind = tuple(-each for each in x[zero::-1]), tuple(-each for each in y[zero::-1])
    up = outward(name, *ahead) if zero < len(x) - 1 else None
    down = outward(name, *behind) if zero > 0 else None
    # A table that ends at zero goes on with the slope that it has there.
    return Sides(up or _straight(down), down or _straight(up))


def _straight(other: Side | None) -> Side:
    return Side((0.0,), other.slope[:1] if other else (0.0,))


def _paired(name: str, x: tuple[float, ...], y: tuple[float, ...]) -> None:
    if len(x) != len(y):
        raise ValueError(
            f"{name} must have as many of the one as of the other, got {len(x)} and {len(y)}; "
            "give two tuples of one length"
        )


def _ordered(numbers: tuple[float, ...], name: str, unit: str, must: str, fits: Any) -> Any:
    unit = "" if unit == "-" else f" {unit}"
    for i, (a, b) in enumerate(pairwise(numbers), start=1):
        if not fits(a, b):
            raise ValueError(
                f"{name} must {must}, got {b:g}{unit} at [{i}] after {a:g}{unit}; "
                "sort the points or mend this one"
            )
    return numbers
