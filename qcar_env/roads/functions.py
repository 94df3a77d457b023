"""A road from plain Python functions of the distance.

def waves(s):
    return 0.02 * math.sin(s) + 0.001 * math.sin(9.0 * s)

road = FunctionRoad(profile=waves)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.part import text
from qcar_env.roads.profile import ROUNDING, Road, frozen
from qcar_env.validation import finite, shown, store

Profile = Callable[[float], float]

DISTANCE = 1e-5  # [m] of the difference that stands for a missing slope, see FunctionRoad
LEAST_PIECE = 1e-3  # [m] between two kinks, chosen here: far above DISTANCE


@dataclass(frozen=True, kw_only=True)
class FunctionRoad(Road):
    """The road ``y = profile(s)``.

    Parameters
    ----------
    profile : callable
        Height [m] at a distance [m], of floats. At a kink it gives the height after it.
    gradient : callable, optional
        Its derivative [-]. Without it a difference of heights stands for it.
    kinks_at : tuple of float
        Where `profile` or its derivative jumps [m], rising, at least 1 mm apart.

    Raises
    ------
    ValueError
        If kinks do not rise, or if numba cannot compile a function.

    Notes
    -----
    The functions run in compiled code: they may use `math`, `if`, loops, numbers of the module
    around them, and other functions only if those are decorated with `numba.njit`.

    The difference that stands for a missing slope is that of three heights ``d = 1e-5 m`` apart,
    all in one piece, exact for a parabola. Its error is ``d^2 |y'''| / 6`` or, at a kink, up to
    twice that, plus the rounding of heights over d: 1e-9 for a sine of 1 cm and 0.3 m length.

    The height before a kink is that at the last float before it.
    """

    profile: Profile = text()
    gradient: Profile | None = text(None)
    kinks_at: tuple[float, ...] = text(())

    def __post_init__(self) -> None:
        """Check the kinks, compile the functions, and take them."""
        for name, given in (("profile", self.profile), ("gradient", self.gradient)):
            if not callable(given) and (name == "profile" or given is not None):
                raise ValueError(f"{name} must be a function of s, got {shown(given)}; give one")
        kinks = tuple(finite("kinks_at", each, "m") for each in self.kinks_at)
        for before, after in itertools.pairwise(kinks):
            if after - before < LEAST_PIECE:
                raise ValueError(
                    f"kinks_at must rise by at least {LEAST_PIECE} m, got {shown(kinks)}; "
                    "give them in order, each once"
                )
        store(self, kinks_at=kinks, __class__=_functions_of(self.profile, self.gradient))
        super().__post_init__()

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """Of each kink: where it is, the last float before it, the jump there; array (3 n,)."""
        rows: list[float] = []
        for kink in self.kinks_at:
            before = math.nextafter(kink, -math.inf)
            jump = float(self.profile(kink)) - float(self.profile(before))
            rows += [kink, before, jump if abs(jump) > ROUNDING else 0.0]
        return frozen(np.array(rows, dtype=np.float64))

    @staticmethod
    def kink(piece: int, p: Any, table: Any) -> float:
        """Return where a piece ends [m]."""
        return table[3 * piece] if 3 * piece < len(table) else math.inf

    @staticmethod
    def jump(piece: int, p: Any, table: Any) -> float:
        """Return the jump of the height where a piece ends [m]."""
        return table[3 * piece + 2] if 3 * piece < len(table) else 0.0

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by what made it: its class is found again by its functions."""
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        return partial(FunctionRoad, **given), ()


def within(s: float, piece: int, table: Any, margin: float) -> float:
    """Return `s` held inside its piece, `margin` [m] from both its ends."""
    if piece > 0 and s < table[3 * piece - 3] + margin:
        return table[3 * piece - 3] + margin
    if 3 * piece < len(table) and s > table[3 * piece + 1] - margin:
        return table[3 * piece + 1] - margin
    return s


@cache
def _functions_of(profile: Profile, gradient: Profile | None) -> type[FunctionRoad]:
    """Return the class of roads of two functions."""
    given = _compilable("profile", profile)

    def height(s: float, piece: int, p: Any, table: Any) -> float:
        return float(given(within(s, piece, table, 0.0)))

    if gradient is None:

        def slope(s: float, piece: int, p: Any, table: Any) -> float:
            c = within(s, piece, table, DISTANCE)
            a, b = given(c - DISTANCE), given(c + DISTANCE)
            bend = (a - 2.0 * given(c) + b) / (DISTANCE * DISTANCE)
            return (b - a) / (2.0 * DISTANCE) + (within(s, piece, table, 0.0) - c) * bend

    else:
        derivative = _compilable("gradient", gradient)

        def slope(s: float, piece: int, p: Any, table: Any) -> float:
            return float(derivative(within(s, piece, table, 0.0)))

    members = {"__module__": __name__, "__doc__": FunctionRoad.__doc__}
    members |= {"height": staticmethod(height), "slope": staticmethod(slope)}
    return type("FunctionRoad", (FunctionRoad,), members)


def _compilable(name: str, function: Profile) -> Profile:
    """Return a function as plain Python if numba compiles it."""
    import numba  # slow to import
    from numba.core.errors import NumbaError

    plain: Any = getattr(function, "py_func", function)  # of one decorated with numba.njit
    try:
        compiled: Any = numba.njit(plain)
        compiled.compile((numba.float64,))
        returned = compiled.nopython_signatures[0].return_type
        if returned in (numba.float64, numba.int64):
            return plain
        problem = f"it returns {returned}"
    except (NumbaError, TypeError, AttributeError) as error:
        problem = str(error).strip().splitlines()[-1]
    raise ValueError(
        f"{name} must be a function of floats that numba compiles, got {shown(function)} "
        f"({problem}); use math and plain numbers only, decorate functions that it calls with "
        "numba.njit, or sample it: SampledRoad.from_function"
    )
