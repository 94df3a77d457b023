"""Random roads of ISO 8608: a spectrum of displacements over the wavenumber n in waves a metre.

    Gd(n) = Gd(n0) (n / n0)^-2,   n0 = 0.1 1/m                                               [m^3]

one-sided, so that the integral of Gd is the variance of the height [m^2]. The road is the sum

    y(s) = sum_i sqrt(2 Gd(n_i) dn) cos(2 pi n_i s + phi_i),   n_i = i dn,   dn = 1 / L

with phases phi_i drawn evenly from [0, 2 pi) (ISO 8608:2016; the sum as in Loprencipe and
Zoccali, J. Mod. Transport. 25 (2017) 24, doi 10.1007/s40534-017-0122-1). A wave of amplitude
A has the variance A^2 / 2: hence the 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.part import number, text
from qcar_env.roads.measured import Tabulated, tabulate
from qcar_env.validation import finite, known, positive, store, whole

N0 = 0.1  # [1/m], ISO 8608
# Gd(n0) of the classes [m^3]: their geometric means, four times as much from one to the next;
# a class ends at twice its mean
CLASSES = {name: 16e-6 * 4.0**k for k, name in enumerate("ABCDEFGH")}
LOWEST, HIGHEST = 0.011, 2.83  # [1/m], the band of ISO 8608


def spectrum(n: NDArray[np.float64], G: float) -> NDArray[np.float64]:
    """Return ``Gd(n)`` [m^3] of a road of ``Gd(n0) = G`` [m^3] at wavenumbers `n` [1/m]."""
    return G * (N0 / n) ** 2


@dataclass(frozen=True, kw_only=True)
class ISO8608(Tabulated):
    """A random road of length L; it begins and ends at height 0 and is flat before and after.

    Parameters
    ----------
    G : float
        ``Gd(n0)`` [m^3]; `of_class` takes the letter of a class instead.
    L : float
        Length [m]. The road is one period of its sum, so that nothing in it repeats.
    seed : int
        Of the phases. One seed is one road, whatever the spacing.
    start : float
        Where it begins [m].
    lowest, highest : float
        The band [1/m]: waves outside it are left out. ISO 8608: 0.011 to 2.83 1/m.
    spacing : float
        Largest spacing of the samples that the spline joins [m], a quarter of the shortest wave or
        less. At 0.05 m, seven samples in the shortest wave, that wave is right within 0.3 %.

    Raises
    ------
    ValueError
        If a number is out of range, or the road is shorter than the longest wave.

    Notes
    -----
    The height at the beginning is taken off the sum. As only whole waves fit into L, a short road
    has few long ones: the lowest is 1 / L. A vehicle at v [m/s] meets frequencies
    ``v lowest`` to ``v highest`` [Hz].
    """

    G: float = number("spectrum at 0.1 1/m", "m^3", positive)
    L: float = number("road length", "m", positive)
    seed: int = text()
    start: float = number("start", "m", finite, 0.0)
    lowest: float = number("lowest wavenumber", "1/m", positive, LOWEST)
    highest: float = number("highest wavenumber", "1/m", positive, HIGHEST)
    spacing: float = number("spacing", "m", positive, 0.05)

    def __post_init__(self) -> None:
        """Check every number."""
        super().__post_init__()
        store(self, seed=whole("seed", self.seed, 0))
        if self.L < 1.0 / self.lowest:
            raise ValueError(
                f"road length L must hold the longest wave of {1.0 / self.lowest:g} m, "
                f"got {self.L:g} m; give a longer road or a higher lowest wavenumber"
            )
        if not self.waves[0].size:
            raise ValueError(
                f"the band must hold a whole number of waves in {self.L:g} m, "
                f"got {self.lowest:g} to {self.highest:g} 1/m; give a wider band"
            )
        if self.spacing > 0.25 / self.highest:
            raise ValueError(
                f"spacing must be at most a quarter of the shortest wave, "
                f"{0.25 / self.highest:g} m, got {self.spacing:g} m; give a smaller one"
            )

    @classmethod
    def of_class(cls, name: str, *, L: float, seed: int, start: float = 0.0) -> ISO8608:
        """Return a road of class A (very good) to H, at the geometric mean of its class."""
        return cls(G=CLASSES[known("road class", name, CLASSES)], L=L, seed=seed, start=start)

    @cached_property
    def waves(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Wavenumbers [1/m], amplitudes [m] and phases [rad] of the sum, each array (n,)."""
        i = np.arange(math.ceil(self.lowest * self.L), math.floor(self.highest * self.L) + 1)
        n = i / self.L
        phases = np.random.default_rng(self.seed).uniform(0.0, 2.0 * math.pi, i.size)
        return n, np.sqrt(2.0 * spectrum(n, self.G) / self.L), phases

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """The cubics of `qcar_env.roads.measured`."""
        n, amplitudes, phases = self.waves
        samples = math.ceil(self.L / self.spacing)
        waves = np.zeros(samples // 2 + 1, dtype=np.complex128)
        waves[np.rint(n * self.L).astype(np.intp)] = amplitudes * np.exp(1j * phases)
        y = np.fft.irfft(waves, samples) * (0.5 * samples)
        return tabulate([(self.start, self.start + self.L, np.append(y, y[0]) - y[0])])
