"""Several humps of one shape, made of the shape's own functions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any, cast

from qcar_env.parts.part import number
from qcar_env.roads.profile import NEAREST, Road, Shape
from qcar_env.validation import finite, instance, non_negative, store, whole

MOST_HUMPS = 1_000_000  # chosen here: their two million kinks are listed in a second


def _count(name: str, value: Any, unit: str) -> float:
    return float(whole(name, value, 1, MOST_HUMPS))


@dataclass(frozen=True, kw_only=True)
class Train(Road):
    """Humps of one shape, one after the other.

    Parameters
    ----------
    shape : Shape
        The first hump; it says where the train begins.
    count : int
        Number of humps, 1 to 1 000 000 [-].
    gap : float
        Flat stretch from the end of one to the beginning of the next [m]; 0 for none.

    Notes
    -----
    The functions of a train depend on its shape's class, so each has a class of its own, below
    this one. Where the gap is less than a nanometre, the end of one hump and the beginning of the
    next are two kinks at the very same distance.
    """

    shape: Shape
    count: float = number("number of humps", "-", _count)
    gap: float = number("gap", "m", non_negative)

    def __post_init__(self) -> None:
        """Check every number, and take the functions of the shape."""
        instance("shape of a train", self.shape, Shape)
        store(self, __class__=_train_of(type(self.shape)))
        super().__post_init__()

    @classmethod
    def of_pitch(cls, *, shape: Shape, count: int, pitch: float) -> Train:
        """Return the train whose humps begin `pitch` [m] apart.

        Raises
        ------
        ValueError
            If a hump is longer than that.
        """
        instance("shape of a train", shape, Shape)
        if finite("pitch of a train", pitch, "m") < shape.extent - NEAREST:
            raise ValueError(
                f"pitch of a train must be at least its hump's length of {shape.extent:g} m, "
                f"got {pitch:g} m; give a larger pitch or a shorter hump"
            )
        return cls(shape=shape, count=count, gap=max(pitch - shape.extent, 0.0))

    @property
    def pitch(self) -> float:
        """Distance from the beginning of one hump to that of the next [m]."""
        return self.shape.extent + self.gap

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle it by what made it: its class is found again by its shape."""
        return partial(Train, **{each.name: getattr(self, each.name) for each in fields(self)}), ()


@cache
def _train_of(kind: type[Shape]) -> type[Train]:
    """Return the class of trains of a class of shapes."""
    one_height: Callable[..., float] = kind.height
    one_slope: Callable[..., float] = kind.slope
    one_kink: Callable[..., float] = kind.kink
    one_jump: Callable[..., float] = kind.jump
    each = kind.kink_count  # piece `each` of one hump is piece 0 of the next

    def shift(humps: int, p: Any, table: Any) -> float:
        extent = one_kink(each - 1, p.shape, table) - one_kink(0, p.shape, table)
        return humps * (extent + p.gap)

    def height(s: float, piece: int, p: Any, table: Any) -> float:
        humps = piece // each
        return one_height(s - shift(humps, p, table), piece - humps * each, p.shape, table)

    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        humps = piece // each
        return one_slope(s - shift(humps, p, table), piece - humps * each, p.shape, table)

    def kink(piece: int, p: Any, table: Any) -> float:
        humps = piece // each
        if humps >= p.count:
            return math.inf
        local = piece - humps * each
        where = one_kink(local, p.shape, table) + shift(humps, p, table)
        if local < each - 1:
            return where
        following = one_kink(0, p.shape, table) + shift(humps + 1, p, table)
        return where if following - where > NEAREST else following

    def jump(piece: int, p: Any, table: Any) -> float:
        humps = piece // each
        return one_jump(piece - humps * each, p.shape, table) if humps < p.count else 0.0

    members: dict[str, Any] = {"__module__": __name__, "__doc__": Train.__doc__}
    members["turning"] = kind.turning
    for function in (height, slope, kink, jump):
        members[function.__name__] = staticmethod(cast("Any", function))
    return type("Train", (Train,), members)
