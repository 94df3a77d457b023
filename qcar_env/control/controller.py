"""A linear controller of the one force between the masses, sampled.

    F_k = C z_k + D r_k                   force asked for on the body, the wheel gets -F      [N]
    z_{k+1} = A z_k + B r_k + E f_k       what it remembers

r are the readings in SI units, f is the force that was given: F within the limits of the actuator.
So a saturated actuator winds no integrator up and misleads no observer. All controllers of one
force that are linear have this form, and one policy drives them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.physics.signals import SIGNALS
from qcar_env.validation import finite_array, known, store

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Controller:
    """The matrices of a controller with k readings and m numbers of memory.

    Parameters
    ----------
    name : str
        What it is called.
    signals : tuple of str
        What it reads, names of `qcar_env.physics.signals.SIGNALS`.
    D : array_like (k,)
        Force for each reading [N per unit].
    A, B, E, C : array_like (m, m), (m, k), (m,), (m,)
        Of the memory; left out where it has none.

    Raises
    ------
    ValueError
        If a shape does not fit, a number is not finite, or a signal is unknown.
    """

    name: str
    signals: tuple[str, ...]
    D: Array
    A: Array = field(default_factory=lambda: np.zeros((0, 0)))
    B: Array = field(default_factory=lambda: np.zeros((0, 0)))
    E: Array = field(default_factory=lambda: np.zeros(0))
    C: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check names and shapes."""
        for each in self.signals:
            known("signal", each, SIGNALS)
        k, m = len(self.signals), len(self.A)
        shapes = {"D": (k,), "A": (m, m), "B": (m, k), "E": (m,), "C": (m,)}
        for name, shape in shapes.items():
            given = finite_array(f"matrix {name} of {self.name}", getattr(self, name))
            if given.size != np.prod(shape):
                raise ValueError(
                    f"matrix {name} of {self.name} must have shape {shape}, got {given.shape}; "
                    f"give one number for each of {k} signals and {m} numbers of memory"
                )
            store(self, **{name: given.reshape(shape)})

    @property
    def memory(self) -> int:
        """Numbers that it remembers."""
        return len(self.C)

    def asked(self, z: Array, r: Array) -> Array:
        """Return the force asked for [N] (n,), of memories (n, m) and readings (n, k)."""
        return times(self.D[np.newaxis], r)[:, 0] + times(self.C[np.newaxis], z)[:, 0]

    def following(self, z: Array, r: Array, given: Array) -> Array:
        """Return the memories (n, m) after an interval in which the forces `given` [N] acted."""
        return times(self.A, z) + times(self.B, r) + given[:, np.newaxis] * self.E


def feedback(name: str, gains: dict[str, float]) -> Controller:
    """Return the controller without a memory that has a gain [N per unit] for each signal."""
    return Controller(name=name, signals=tuple(gains), D=np.array(list(gains.values())))


def times(matrix: ArrayLike, rows: Array) -> Array:
    """Return ``rows @ matrix.T`` (n, m), each row as if it were alone.

    A library's product adds in an order that depends on how many rows there are; a car must not be
    moved by those beside it.
    """
    m = np.asarray(matrix, dtype=np.float64)
    total = np.zeros((len(rows), len(m)))
    for j in range(m.shape[1]):
        total += rows[:, j : j + 1] * m[:, j]
    return total
