"""The Routh-Hurwitz conditions (39)-(40) of 4 x 4 matrices, one by one.

The eigenvalues of a matrix are the roots of

    lambda^4 + Gamma1 lambda^3 + Gamma2 lambda^2 + Gamma3 lambda + Gamma4 = 0                (39)

and all of them (the paper writes "both") lie in the left half-plane if and only if

    Gamma1 > 0    Gamma1 Gamma2 - Gamma3 > 0
    Gamma3 (Gamma1 Gamma2 - Gamma3) - Gamma1^2 Gamma4 > 0    Gamma4 > 0                      (40)

A loss through ``Gamma4 = 0`` is a fold or another real eigenvalue at zero; one through the third
condition a pair of imaginary eigenvalues (Hopf: the amplitudes begin to beat).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.validation import finite_array, shown

Array = NDArray[np.float64]

CONDITIONS = (
    "Gamma1 > 0",
    "Gamma1 Gamma2 - Gamma3 > 0",
    "Gamma3 (Gamma1 Gamma2 - Gamma3) - Gamma1^2 Gamma4 > 0",
    "Gamma4 > 0",
)


@dataclass(frozen=True, kw_only=True)
class RouthHurwitz:
    """The four conditions (40), one by one, for n matrices."""

    gammas: Array  # (4, n) Gamma1 ... Gamma4 [1/s, 1/s^2, 1/s^3, 1/s^4]
    values: Array  # (4, n) left sides of the conditions, in the order of `CONDITIONS`
    margins: Array  # (4, n) the same, each over the sum of its terms' sizes [-]; -1 to 1

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Which condition holds, (4, n)."""
        return self.margins > 0.0

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether all hold, (n,)."""
        return np.all(self.holds, axis=0)

    def failing(self, index: int = 0) -> tuple[str, ...]:
        """Return the conditions that matrix `index` breaks, by name."""
        return tuple(
            name for name, holds in zip(CONDITIONS, self.holds[:, index], strict=True) if not holds
        )


def characteristic_polynomial(matrices: Array) -> Array:
    """Return Gamma1 ... Gamma4 of (39) for matrices (n, 4, 4), shape (4, n).

    Faddeev and LeVerrier's recursion: exact in the entries, without eigenvalues.

    Raises
    ------
    ValueError
        If the matrices have another shape, or an entry is not finite.
    """
    matrices = _checked(matrices)
    identity = np.eye(4)
    gammas = np.empty((4, matrices.shape[0]))
    helper = np.broadcast_to(identity, matrices.shape)
    for k in range(1, 5):
        product = matrices @ helper
        gammas[k - 1] = -np.trace(product, axis1=1, axis2=2) / k
        helper = product + gammas[k - 1][:, None, None] * identity
    return gammas


def routh_hurwitz(matrices: Array) -> RouthHurwitz:
    """Evaluate the conditions (40) for matrices (n, 4, 4) of finite entries.

    Rates are measured in each matrix's own unit of time, so that the verdict does not hang on it.
    """
    matrices = _checked(matrices)
    exponent = np.frexp(np.max(np.abs(matrices), axis=(1, 2)))[1]  # of a rate, 2 to it [1/s]
    scaled = np.ldexp(matrices, -exponent[:, None, None])  # exact: only exponents change
    g1, g2, g3, g4 = gammas = characteristic_polynomial(scaled)
    inner = g1 * g2 - g3
    values = np.array([g1, inner, g3 * inner - g1 * g1 * g4, g4])  # (40)
    # the size of each condition's terms, from the magnitudes of the eigenvalues
    size = np.array([_sums_of_products(np.abs(np.linalg.eigvals(m))) for m in scaled]).T
    scale = np.array(
        [
            size[0],
            size[0] * size[1] + size[2],
            size[2] * (size[0] * size[1] + size[2]) + size[0] * size[0] * size[3],
            size[3],
        ]
    )
    margins = np.clip(values / np.maximum(scale, 1e-300), -1.0, 1.0)  # but for rounding within
    with np.errstate(over="ignore", under="ignore"):  # in 1/s^6 what is small or large is so
        gammas, values = (
            np.ldexp(each, np.array(powers)[:, None] * exponent)
            for each, powers in ((gammas, (1, 2, 3, 4)), (values, (1, 3, 6, 4)))
        )
    return RouthHurwitz(gammas=gammas, values=values, margins=margins)


def _checked(matrices: Array) -> Array:
    found = finite_array("matrices", matrices, "1/s")
    if found.shape[1:] != (4, 4):
        raise ValueError(
            f"matrices must have shape (n, 4, 4), got {shown(found.shape)}; "
            "give one or more of them"
        )
    return found


def _sums_of_products(values: Array) -> list[float]:
    """Return the elementary symmetric sums of four numbers."""
    return [float(c) for c in np.abs(np.poly(-values))[1:]]
