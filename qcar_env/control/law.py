"""What a control law is. `qcar_env.physics.closed_loop` closes it around the plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from qcar_env.physics.car import QuarterCar
from qcar_env.physics.closed_loop import (
    REST,
    ControlledState,
    advance_controlled,
    controlled_rate,
    memoryless_rate,
)
from qcar_env.physics.state import Filter
from qcar_env.validation import shown

__all__ = [
    "REST",
    "Command",
    "ControlledState",
    "FilterRate",
    "Law",
    "advance_controlled",
    "check_law",
    "controlled_rate",
    "memoryless_rate",
]

Command = Callable[[Any, Any, Any], tuple[Any, Any]]
FilterRate = Callable[[Any, Any, Any], Filter]


def check_law(law: Any) -> None:
    """Refuse what is no control law.

    Raises
    ------
    ValueError
        If it has no formula.
    """
    if not callable(getattr(law, "command", None)):
        raise ValueError(
            f"law must be a control law, got {shown(law)}; "
            "give one of qcar_env.control, such as CNVC()"
        )


class Law(Protocol):
    """A closed-form control law with the paper's two specific forces `u1`, `u2` [m/s^2].

    A law is a frozen dataclass of its gains. Its formula is a pair of pure functions at module
    level, without branches, powers or library calls (see `qcar_env.physics.dynamics`), so that
    simulation, baselines and compiled rollouts all use that one source.
    """

    @property
    def name(self) -> str:
        """Short name, as in the paper's Table 1."""
        ...

    @property
    def gains(self) -> NamedTuple:
        """The gains as plain floats, as `command` and `filter_rate` take them."""
        ...

    @property
    def command(self) -> Command:
        """``command(x, eta, gains) -> (u1, u2)``: specific forces [m/s^2]."""
        ...

    @property
    def filter_rate(self) -> FilterRate | None:
        """``filter_rate(x, eta, gains) -> Filter``; None for a law without memory."""
        ...

    def check(self, car: QuarterCar) -> None:
        """Raise ValueError where the law is known to destabilise `car`."""
        ...
