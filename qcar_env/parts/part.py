"""What a part is: a frozen record of SI numbers, and pure functions of them.

    @dataclass(frozen=True, kw_only=True)
    class CubicSpring(Part):
        k: float = number("stiffness", "N/m", positive)
        k3: float = number("cubic stiffness", "N/m^3", finite, 0.0)

        @staticmethod
        def force(travel, p):
            return p.k * travel + p.k3 * travel * travel * travel

The numbers enter the functions as a named tuple `p`, so that one source runs on floats, on arrays
``(n,)`` and in compiled code, where each car has numbers of its own.
"""

from __future__ import annotations

import dataclasses
from collections import namedtuple
from collections.abc import Callable
from dataclasses import MISSING, dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

from qcar_env.validation import store

Check = Callable[[str, Any, str], Any]

UNLIMITED = 1e300  # a limit that is none; finite, so that 0 * UNLIMITED is 0


class Nothing(NamedTuple):
    """No numbers, or no memory."""


def number(title: str, unit: str, check: Check, default: Any = MISSING) -> Any:
    """Declare a number of a part.

    Parameters
    ----------
    title : str
        What it is, for messages and tables.
    unit : str
        Its unit; "-" for none.
    check : callable
        ``check(name, value, unit)`` returns the value as a float or raises ValueError:
        `qcar_env.validation.positive`, `non_negative`, `finite`. For a tuple of numbers it
        returns a tuple: `qcar_env.parts.table.several`, `rising`.
    default : float, optional
        Its value where none is given.
    """
    metadata = {"title": title, "unit": unit, "check": check}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Part:
    """Base of everything that has numbers; checks them where they enter.

    A base of parts marks what its subclasses must define with `abc.abstractmethod`.
    """

    Numbers: ClassVar[Any] = (
        None  # NamedTuple class of the numbers, made when they are first asked for
    )

    def __post_init__(self) -> None:
        """Check every number, and that the class has all functions of its kind.

        Raises
        ------
        TypeError
            If one was forgotten.
        """
        if forgotten := _forgotten(type(self)):
            name, base = forgotten
            raise TypeError(
                f"{type(self).__name__} must define {name}, as {base} describes it; "
                "add it as a static method"
            )
        for each in dataclasses.fields(self):
            if "check" in each.metadata:
                check, unit = each.metadata["check"], each.metadata["unit"]
                name = f"{each.metadata['title']} {each.name}".strip()
                store(self, **{each.name: check(name, getattr(self, each.name), unit)})

    @property
    def numbers(self) -> Any:
        """The numbers as a named tuple, those of its own parts nested in it.

        A part whose functions want other numbers than its fields makes them here (a table: slopes).
        """
        return numbers_class(type(self))(*(_numbers(getattr(self, name)) for name in _fields(self)))


@cache
def _forgotten(kind: type) -> tuple[str, str] | None:
    """Return a function that a class of parts lacks, and the base that says what it must be."""
    for base in kind.__mro__:
        for name in vars(base):
            if getattr(getattr(kind, name), "__isabstractmethod__", False):
                return name, base.__name__
    return None


@cache
def numbers_class(kind: type[Part]) -> Any:
    """Return the NamedTuple class of the numbers of a class of parts, its `Numbers`."""
    made: Any = namedtuple("Numbers", _fields(kind))  # pyright: ignore[reportUntypedNamedTuple]
    made.__module__, made.__qualname__ = kind.__module__, f"{kind.__qualname__}.Numbers"
    kind.Numbers = made  # so that caches of compiled code find it by its name
    return made


def units(kind: type[Part]) -> dict[str, str]:
    """Return the unit of each number of a class of parts."""
    fields = dataclasses.fields(kind)
    return {each.name: each.metadata["unit"] for each in fields if "unit" in each.metadata}


def _fields(part: Any) -> list[str]:
    """Return the names of fields that hold numbers: not of texts and switches."""
    return [each.name for each in dataclasses.fields(part) if each.metadata.get("numeric", True)]


def text(default: Any = MISSING) -> Any:
    """Declare a field of a part that is no number: a name, a switch."""
    return dataclasses.field(default=default, metadata={"numeric": False})


def _numbers(value: Any) -> Any:
    if isinstance(value, Part):
        return value.numbers
    if isinstance(value, tuple):
        return tuple(float(each) for each in value)
    return float(value)


# Branch-free forms, the same on floats, arrays and in compiled code ---------------------------


def least(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers."""
    return a * (a <= b) + b * (b < a) + 0.0


def most(a: Any, b: Any) -> Any:
    """Return the larger of two numbers."""
    return a * (a >= b) + b * (b > a) + 0.0


def positive_part(value: Any) -> Any:
    """Return a finite number where it is above zero, else zero."""
    return value * (value > 0.0) + 0.0


def clamp(value: Any, low: Any, high: Any) -> Any:
    """Return `value` held within ``[low, high]``; all three are finite."""
    inside = (value >= low) * (value <= high)
    return value * inside + low * (value < low) + high * (value > high) + 0.0
