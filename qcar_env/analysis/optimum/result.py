"""What is made small, and what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.validation import entries, known, non_negative, shown, store

Array = NDArray[np.float64]
Objective = Literal["max", "sum", "rms"]
OBJECTIVES: tuple[Objective, ...] = ("max", "sum", "rms")


@dataclass(frozen=True, kw_only=True)
class Aim:
    """What the force is to make small, in shares of the uncontrolled amplitudes A_i.

    Parameters
    ----------
    objective : {"max", "sum", "rms"}
        ``max_i w_i a_i / A_i``, ``sum_i w_i a_i / A_i`` with `a_i` the largest |x_i|, or
        ``sqrt(mean(sum_i (w_i x_i / A_i)^2))`` over the nodes.
    weights : sequence of float
        ``(w1, w2)`` [-]; not negative, one of them positive.

    Raises
    ------
    ValueError
        If the objective is unknown or the weights are out of range.
    """

    objective: Objective
    weights: Sequence[float]

    def __post_init__(self) -> None:
        """Check both."""
        found = tuple(non_negative("weight", each) for each in entries(self.weights))
        if len(found) != 2 or not any(found):
            raise ValueError(
                "weights must be two numbers, one of them positive, got "
                f"{shown(self.weights)}; give (1, 1)"
            )
        known("objective", self.objective, OBJECTIVES)
        store(self, weights=found)


@dataclass(frozen=True, kw_only=True)
class Optimum:
    """The least vibration, the force that reaches it, and the proof that none does better.

    Values are in shares of the uncontrolled amplitudes: with ``objective="max"`` and weights 1,
    rho. States and nodes belong to the found force.
    """

    objective: Objective
    weights: tuple[float, float]  # of wheel and body [-]
    value: float  # of the program: the found force, measured at the nodes [-]
    dual: float  # value of the program's dual [-]
    upper: float  # the found force, measured at every instant (rms: at the nodes) [-]
    bound: float  # no force within the limit, of any shape, leaves less [-]
    amplitudes: tuple[float, float]  # largest |x1|, |x2| of the found force, at every instant [m]
    t: Array  # (n + 1,) nodes [s]
    x: Array  # (n + 1, 4) state at the nodes [m, m, m/s, m/s]
    u: Array  # (n, m) force held from each node to the next [m/s^2] or [N]
    hold: float  # time for which a force is held [s]
    status: str  # the solver's own words
    iterations: int  # of the solver

    @property
    def gap(self) -> float:
        """Distance between the values of program and dual [-]: what the solver left."""
        return abs(self.value - self.dual)

    @property
    def margin(self) -> float:
        """Width of the bracket around the optimum of continuous time [-]."""
        return self.upper - self.bound

    @property
    def rho(self) -> float:
        """Share of vibration that the found force leaves, ``max_i(a_i / A_i)``, as `upper`."""
        return self.upper
