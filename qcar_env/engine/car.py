"""A car by itself: what the scalar environment drives."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.compile import (
    aligned,
)
from qcar_env.engine.driving import CLOCKS
from qcar_env.engine.stepping import FINE, NOT_FINITE, OVER, WRONG_SHAPE, compose
from qcar_env.engine.storage import SHOWN, Array, Plan

_NUMBERS = numba.types.Array(numba.types.float64, 1, "C")
_ONE = (  # what a step takes; an action may lie in memory in any way
    _NUMBERS,
    numba.types.Array(numba.types.float32, 1, "A"),
    numba.types.Array(numba.types.float32, 1, "C"),
    _NUMBERS,
)


class Car:
    """A car.

    A step is ``advance(array, action, seen, force)`` with the action (m,) of float32; observation
    (size,) of float32 and forces (m,) are written. It returns a code (`FINE`, `OVER`, `NOT_FINITE`,
    `WRONG_SHAPE`), the reward, whether the episode is terminated or truncated, the reward's terms
    and the penalty for leaving the travel.

    Parameters
    ----------
    plan : Plan
        What it is, and what it draws its episodes from.
    """

    def __init__(self, plan: Plan) -> None:
        self.array = np.zeros(0)
        self.plan = plan
        self._compile()
        self.take(plan)
        self.array[self._clock_row("done")] = 1.0

    def take(self, plan: Plan) -> None:
        """Let the next episode be drawn from another plan of the same composition."""
        own, table = self.kernels.own, plan.source.table
        self.size = len(plan.composition.observed)
        self.actions: int = plan.composition.actuator.size
        array = aligned((own.table + len(table),))
        array[: own.table] = self.array[: own.table] if len(self.array) else 0.0
        array[own.dt : own.dt + 2] = plan.dt, plan.substeps
        array[own.table :] = table
        self.array, self._source, self.plan = array, plan.source, plan

    def _compile(self) -> None:
        self.kernels = compose(self.plan.composition, False)
        self.advance = self.kernels.step_one.compile(_ONE)

    def _clock_row(self, name: str) -> int:
        return self.kernels.own.clock + CLOCKS.find(f"clock.{name}")

    def __getstate__(self) -> dict[str, Any]:
        """Leave compiled code behind; it is made anew."""
        made = ("kernels", "advance")
        return {name: value for name, value in vars(self).items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore everything else, and compile."""
        vars(self).update(state)
        self._compile()
        self.take(self.plan)

    def begin(self, uniforms: Array, given: Array) -> NDArray[np.float32]:
        """Begin an episode; return the observation (size,).

        Parameters
        ----------
        uniforms : ndarray (count,)
            Numbers from [0, 1) that it is drawn from, `Source.uniforms` of them.
        given : ndarray (5,)
            State and phase where they are not drawn, else not a number.
        """
        source, seen = self._source, np.empty(self.size, SHOWN)
        self.kernels.reset_one(
            self.array,
            uniforms,
            given,
            source.row,
            source.row.copy(),
            source.draws,
            source.targets,
            seen,
        )
        return seen

    @property
    def state(self) -> Array:
        """State (x1, x2, v1, v2) [m, m, m/s, m/s], shape (4,)."""
        row = self.kernels.moving.row("state")
        return self.array[row : row + 4].copy()

    @property
    def held(self) -> Array:
        """The commands that the actuators hold, shape (m,)."""
        row = self.kernels.moving.row("held")
        return self.array[row : row + self.actions].copy()

    @property
    def memory(self) -> Array:
        """Memory of the actuators, shape (k,); k is 0 where they have none."""
        row = self.kernels.moving.row("state")
        return self.array[row + 4 : self.kernels.moving.row("phasors")].copy()

    def clock(self, name: str) -> float:
        """Return an entry of `qcar_env.engine.starts.Clock`."""
        return float(self.array[self._clock_row(name)])


__all__ = ["FINE", "NOT_FINITE", "OVER", "WRONG_SHAPE", "Car"]
