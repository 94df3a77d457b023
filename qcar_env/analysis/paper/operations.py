"""What a law costs to compute: by the paper's introduction CNVC has 'greater computing efficiency'.

Counted, not timed: the law's own functions are run once with numbers that count.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from qcar_env.control.law import Law, check_law
from qcar_env.physics import tree
from qcar_env.physics.rk4 import rk4_step, step_fractions
from qcar_env.physics.state import State


@dataclass
class Operations:
    """Operations on numbers that change in time; a sign costs nothing."""

    additions: int = 0  # and subtractions
    multiplications: int = 0  # and divisions

    @property
    def total(self) -> int:
        """Both together."""
        return self.additions + self.multiplications


@dataclass(frozen=True)
class _Counting:
    """A number that counts what is done with it."""

    count: Operations = field(default_factory=Operations)

    def _add(self, other: Any) -> _Counting:
        self.count.additions += 1
        return self

    def _multiply(self, other: Any) -> _Counting:
        self.count.multiplications += 1
        return self

    def __neg__(self) -> _Counting:
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = _add
    __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _multiply


def operations(law: Law) -> Operations:
    """Count what a law computes in a control step.

    Parameters
    ----------
    law : Law
        Any law whose functions are arithmetic.

    Returns
    -------
    Operations
        Of its command and, if it has a memory, of one Runge-Kutta step of that.
    """
    check_law(law)
    number = _Counting()
    x = State(number, number, number, number)
    eta, numbers = tree.unflat(law.at_rest, [number] * len(law.at_rest)), law.numbers
    law.functions.command(x, eta, numbers)
    filter_rate = law.functions.filter_rate
    if filter_rate is not None:

        def rate(eta: Any, x: Any) -> Any:
            return filter_rate(x, eta, numbers)

        rk4_step(rate, eta, step_fractions(1.0), x, x, x)
    return number.count
