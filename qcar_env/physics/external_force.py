"""The external force on the body: ``F(t) = f cos(Omega t)``, the right-hand side of (4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.physics.motion import Phasor
from qcar_env.validation import finite, finite_array, non_negative, store


@dataclass(frozen=True, kw_only=True)
class ExternalForce:
    """A harmonic specific force on the body.

    Parameters
    ----------
    f : float
        Amplitude [m/s^2]; 0 for none.
    Omega : float
        Angular frequency [rad/s]; not negative, 0 for a constant force.

    Raises
    ------
    ValueError
        If a value is not finite or `Omega` is negative.
    """

    f: float = 0.0
    Omega: float = 0.0

    def __post_init__(self) -> None:
        """Check every argument."""
        store(
            self,
            f=finite("f", self.f, "m/s^2"),
            Omega=non_negative("Omega", self.Omega, "rad/s"),
        )

    def phasor(self, t: ArrayLike) -> Phasor:
        """Return sine and cosine of ``Omega t`` at `t` [s], arrays (n,)."""
        angle = self.Omega * finite_array("t", t, "s")
        return Phasor(np.sin(angle), np.cos(angle))

    def value(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return F at `t` [s], array (n,) [m/s^2]."""
        return self.f * self.phasor(t).c

    def rate(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return F' at `t` [s], array (n,) [m/s^3]."""
        return -self.f * self.Omega * self.phasor(t).s
