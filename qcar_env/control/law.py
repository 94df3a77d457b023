"""What a control law is. `qcar_env.physics.closed_loop` closes it around a car.

A law of one's own is a subclass with its gains and one function:

    @dataclass(frozen=True, kw_only=True)
    class LNVC(Law):
        G1: float = number("gain", "1/s", non_negative, 1.2)
        G2: float = number("gain", "1/s", non_negative, 1.2)
        name = "LNVC"

        @staticmethod
        def command(x, eta, p):
            return -p.G1 * x.v1, -p.G2 * x.v2
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from qcar_env.parts.part import Nothing, Part
from qcar_env.physics.car import Car
from qcar_env.physics.closed_loop import ControlledState, LawFunctions
from qcar_env.validation import shown

__all__ = [
    "Command",
    "ControlledState",
    "FilterRate",
    "Law",
    "check_law",
]

Command = Callable[[Any, Any, Any], tuple[Any, Any]]
FilterRate = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True, kw_only=True)
class Law(Part):
    """Base of every closed-form control law with the paper's two specific forces `u1`, `u2`.

    A law is a part: a record of gains, and pure functions of them without branches, powers or
    library calls (see `qcar_env.parts.part`), so that simulation, baselines and compiled rollouts
    all use that one source. Two laws of one class have the same functions.
    """

    name: ClassVar[str] = "own"  # short name, as in the paper's Table 1
    State: ClassVar[type] = Nothing  # NamedTuple class of its memory
    filter_rate: ClassVar[FilterRate | None] = None  # of a law with a memory, see below

    @staticmethod
    @abstractmethod
    def command(x: Any, eta: Any, p: Any) -> Any:
        """Return the specific forces on wheel and body [m/s^2].

        Parameters
        ----------
        x : State
            State of the car.
        eta : NamedTuple
            The law's memory, of class `State`.
        p : NamedTuple
            The law's `numbers`.

        Notes
        -----
        A law with a memory has ``filter_rate(x, eta, p)`` besides, which returns the memory's time
        derivative.
        """

    def check(self, car: Car) -> None:
        """Raise ValueError where the law is known to destabilise `car`; accepts every car."""

    @property
    def functions(self) -> LawFunctions:
        """The law's functions."""
        return LawFunctions(type(self).command, type(self).filter_rate, self.State)

    @property
    def at_rest(self) -> Any:
        """The memory at rest: zeros."""
        kind: Any = self.State
        return kind(*(0.0 for _ in kind._fields))


def check_law(law: Any) -> None:
    """Refuse what is no control law.

    Raises
    ------
    ValueError
        If it is none, or has a memory and does not say how that moves.
    """
    if not isinstance(law, Law):
        raise ValueError(
            f"law must be a control law, got {shown(law)}; "
            "give one of qcar_env.control, such as CNVC(), or a subclass of control.law.Law"
        )
    if (law.filter_rate is None) != (law.State is Nothing):
        raise ValueError(
            f"law {law.name} must have both a State and a filter_rate or neither, got "
            f"{law.State.__name__} and {shown(law.filter_rate)}; add the other"
        )
