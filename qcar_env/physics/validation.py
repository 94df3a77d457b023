"""Checks of numbers that enter the library: each names the value, the range and the remedy."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable


def finite(name: str, value: float, unit: str = "-") -> float:
    """Return `value` as a float.

    Raises
    ------
    ValueError
        If it is not a finite number.
    """
    number = _number(name, value, unit)
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {number}{_unit(unit)}; give a finite number")
    return number


def positive(name: str, value: float, unit: str = "-") -> float:
    """Return `value` as a float.

    Raises
    ------
    ValueError
        If it is not a finite number above zero.
    """
    number = finite(name, value, unit)
    if number <= 0.0:
        unit = _unit(unit)
        raise ValueError(
            f"{name} must be positive, got {number:g}{unit}; give a value above 0{unit}"
        )
    return number


def non_negative(name: str, value: float, unit: str = "-") -> float:
    """Return `value` as a float.

    Raises
    ------
    ValueError
        If it is not a finite number of at least zero.
    """
    number = finite(name, value, unit)
    if number < 0.0:
        unit = _unit(unit)
        raise ValueError(f"{name} must not be negative, got {number:g}{unit}; give 0{unit} or more")
    return number


def whole(name: str, value: int, least: int = 1) -> int:
    """Return `value` as an int.

    Raises
    ------
    ValueError
        If it is not a whole number of at least `least`.
    """
    try:
        number = math.nan if isinstance(value, (bool, str)) else int(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if number != value:
        raise ValueError(f"{name} must be a whole number, got {value!r}; give {least} or more")
    if number < least:
        raise ValueError(f"{name} must be at least {least}, got {value}; give {least} or more")
    return int(number)


def known(kind: str, name: str, names: Iterable[str]) -> str:
    """Return `name` if it is one of `names`.

    Raises
    ------
    ValueError
        If it is not; the message gives the nearest name and the whole list.
    """
    choices = sorted(names)
    if name in choices:
        return name
    lower = {choice.lower(): choice for choice in choices}
    near = difflib.get_close_matches(str(name).lower(), lower, n=1)
    hint = f"; did you mean {lower[near[0]]!r}?" if near else "."
    raise ValueError(f"unknown {kind} {name!r}{hint} Known: {', '.join(choices) or 'none'}")


def _number(name: str, value: float, unit: str) -> float:
    try:
        if not isinstance(value, (bool, str)):
            return float(value)
    except (TypeError, ValueError):
        pass
    kind = "a number" if unit == "-" else f"a number in {unit}"
    raise ValueError(f"{name} must be {kind}, got {value!r}; give a finite number")


def _unit(unit: str) -> str:
    return "" if unit == "-" else f" {unit}"
