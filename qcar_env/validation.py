"""Checks of numbers that enter the library: each names the value, the range and the remedy."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

MOST_SHOWN = 200  # characters of a refused value in a message, chosen here


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


def whole(name: str, value: int, least: int = 1, most: int | None = None) -> int:
    """Return `value` as an int.

    Raises
    ------
    ValueError
        If it is not a whole number of at least `least` and, where there is one, at most `most`.
    """
    given: Any = _scalar(value)
    try:
        number = math.nan if isinstance(given, (bool, str)) else int(given)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(number, float) or number != given:
        raise ValueError(f"{name} must be a whole number, got {shown(value)}; give {least} or more")
    if number < least:
        got = shown(number)
        raise ValueError(f"{name} must be at least {least}, got {got}; give {least} or more")
    if most is not None and number > most:
        got = shown(number)
        raise ValueError(f"{name} must be at most {most}, got {got}; give {least} to {most}")
    return number


def entries(value: Any) -> tuple[Any, ...]:
    """Return the entries of a tuple, a list or an array (n,); none of anything else."""
    if isinstance(value, (tuple, list)):
        return tuple(cast("Sequence[Any]", value))
    return tuple(value.tolist()) if isinstance(value, np.ndarray) and value.ndim == 1 else ()


def finite_array(name: str, value: Any, unit: str = "-") -> NDArray[np.float64]:
    """Return `value`, a number or numbers of any shape, as an array.

    Raises
    ------
    ValueError
        If it holds something else than finite numbers.
    """
    try:
        found = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        found = np.array(None)
    odd = found.dtype.kind not in "iuf" or np.ma.is_masked(value)
    if odd or not np.isfinite(found).all():
        raise ValueError(
            f"{name} must be finite{'' if unit == '-' else f' [{unit}]'}, got {shown(value)}; "
            "give a finite number or an array of them"
        )
    return found.astype(np.float64, copy=False)


def numbers(name: str, given: Any) -> NDArray[np.float64]:
    """Return what is given as an array of float64, of any shape; an entry need not be finite.

    Raises
    ------
    ValueError
        If it is not made of numbers: text, complex numbers and entries that are masked are none.
    """
    try:
        found = np.asarray(given)
        odd = found.dtype.kind == "O" and any(isinstance(each, (str, bytes)) for each in found.flat)
        if found.dtype.kind in "biufO" and not odd and not np.ma.is_masked(given):
            return found.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # the last: torch's
        pass
    raise ValueError(
        f"{name} must be numbers, got {shown(given)}; give a list or an array of numbers"
    )


def instance(name: str, value: Any, kind: type) -> None:
    """Refuse a `value` of another class.

    Raises
    ------
    ValueError
        If it is none of `kind`.
    """
    if not isinstance(value, kind):
        raise ValueError(
            f"{name} must be of class {kind.__name__}, got {shown(value)}; give such an object"
        )


def known(kind: str, name: str, names: Iterable[str]) -> str:
    """Return `name` if it is one of `names`.

    Raises
    ------
    ValueError
        If it is not; the message gives the nearest name and the whole list.
    """
    choices = sorted(names)
    if isinstance(name, str) and name in choices:
        return choices[choices.index(name)]
    lower = {choice.lower(): choice for choice in choices}
    near = difflib.get_close_matches(shown(name).strip("'").lower(), lower, n=1)
    hint = f"; did you mean {lower[near[0]]!r}?" if near else "."
    raise ValueError(f"unknown {kind} {shown(name)}{hint} Known: {', '.join(choices) or 'none'}")


def store(instance: object, **values: Any) -> None:
    """Put checked values into a frozen dataclass, in its `__post_init__`.

    What is stored is what the checks returned: a float for a numpy scalar, a tuple for a list.
    """
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def shown(value: Any) -> str:
    """Return `value` as a message shows it, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python prints no int of more than 4300 digits
        text = "a number of more digits than can be printed"
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def _number(name: str, value: float, unit: str) -> float:
    if type(value) is float:  # nearly always, and quicker
        return value
    given: Any = _scalar(value)
    try:
        if not isinstance(given, (bool, str, bytes, bytearray)):
            return float(given)
    except OverflowError:
        raise ValueError(
            f"{name} must be finite, got {shown(value)}{_unit(unit)}; give a finite number"
        ) from None
    except (TypeError, ValueError):
        pass
    kind = "a number" if unit == "-" else f"a number in {unit}"
    raise ValueError(f"{name} must be {kind}, got {shown(value)}; give a finite number")


def _scalar(value: Any) -> Any:
    """Return a number of numpy as one of Python; None for an array with a length."""
    if not isinstance(value, (np.ndarray, np.generic)):
        return value
    return value.item() if value.ndim == 0 else None


def _unit(unit: str) -> str:
    return "" if unit == "-" else f" {unit}"
