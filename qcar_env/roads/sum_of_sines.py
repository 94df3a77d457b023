"""A road that is a sum of sines, endless."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.part import text
from qcar_env.roads.profile import Road, frozen
from qcar_env.validation import finite_array, positive, shown, store


@dataclass(frozen=True, kw_only=True)
class SumOfSines(Road):
    """The road ``y = sum_i amplitudes_i sin(wavenumbers_i s + phases_i)``, without end.

    Parameters
    ----------
    amplitudes, wavenumbers, phases : sequence of float (n,)
        Amplitudes [m], positive wavenumbers [rad/m] and phases [rad].

    Notes
    -----
    Each sine costs its own time in every step; a random road of hundreds of them is
    `qcar_env.roads.iso8608.ISO8608`, which costs as much as one.
    """

    amplitudes: tuple[float, ...] = text()
    wavenumbers: tuple[float, ...] = text()
    phases: tuple[float, ...] = text()

    def __post_init__(self) -> None:
        """Check every number."""
        super().__post_init__()
        units = {"amplitudes": "m", "wavenumbers": "rad/m", "phases": "rad"}
        found = {
            name: finite_array(name, getattr(self, name), unit) for name, unit in units.items()
        }
        shapes = {name: each.shape for name, each in found.items()}
        size = found["amplitudes"].size
        if size == 0 or any(shape != (size,) for shape in shapes.values()):
            raise ValueError(
                f"amplitudes, wavenumbers and phases must be of one length of at least 1, "
                f"got shapes {shown(shapes)}; give one of each for each sine"
            )
        for each in found["wavenumbers"].tolist():
            positive("wavenumbers", each, "rad/m")
        store(self, **{name: tuple(each.tolist()) for name, each in found.items()})

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """Amplitude, wavenumber and phase of one sine after the other, array (3 n,)."""
        return frozen(np.array([self.amplitudes, self.wavenumbers, self.phases]).T.ravel())

    @staticmethod
    def height(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the height [m]."""
        y = 0.0
        for i in range(0, len(table), 3):
            y += table[i] * math.sin(table[i + 1] * s + table[i + 2])
        return y

    @staticmethod
    def slope(s: float, piece: int, p: Any, table: Any) -> float:
        """Return the slope [-]."""
        y = 0.0
        for i in range(0, len(table), 3):
            y += table[i] * table[i + 1] * math.cos(table[i + 1] * s + table[i + 2])
        return y
