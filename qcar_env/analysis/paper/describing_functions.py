"""Describing functions: what a law's force is at the frequency of the motion.

D is the complex amplitude of a mass's force over that of its displacement [1/s^2], for a motion
``x = a cos(psi)``, ``v = -omega a sin(psi)``. A law that is none of the known ones is averaged over
a period numerically.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.paper.forced_car import Gains
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.control.cnvc import CNVC
from qcar_env.control.lnvc import LNVC
from qcar_env.control.ndf import NDF
from qcar_env.control.passive import Passive
from qcar_env.control.pd import PD
from qcar_env.control.ppf import PPF
from qcar_env.physics.state import State
from qcar_env.validation import whole

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Fourier sums over this many samples of a period are exact for polynomial laws up to degree 62.
SAMPLES = 64
MOST_SAMPLES = 1_000_000  # chosen here


def passive(a: Any, w: Any) -> Any:
    """Return ``D = 0``."""
    return 0j * a


def cnvc(a: Any, w: Any, G: Any) -> Any:
    """Return ``D = -(3/4) i G omega^3 a^2``.

    ``v^3 = -omega^3 a^3 sin^3(psi)`` and ``sin^3 = (3 sin(psi) - sin(3 psi))/4``.
    """
    return -0.75j * G * w * w * w * a * a


def lnvc(a: Any, w: Any, G: Any) -> Any:
    """Return ``D = -i G omega``."""
    return -1j * G * w


def pd(a: Any, w: Any, p: Any, d: Any) -> Any:
    """Return ``D = -(p + i d omega)``."""
    return -(p + 1j * d * w)


def ppf(a: Any, w: Any, G: Any, stiffness: Any, damping: Any) -> Any:
    """Return ``D = G omega_f^2 / (omega_f^2 - omega^2 + 2 i zeta omega_f omega)``."""
    return G * stiffness / (stiffness - w * w + 1j * damping * w)


def ndf(a: Any, w: Any, G: Any, omega_f: Any, damping: Any) -> Any:
    """Return ``D = G omega_f omega^2 / (omega_f^2 - omega^2 + 2 i zeta omega_f omega)``.

    At ``omega = omega_f`` this is ``-i omega G/(2 zeta)``: velocity feedback.
    """
    return G * omega_f * w * w / (omega_f * omega_f - w * w + 1j * damping * w)


def hardening(a: Any, w: Any, alpha: Any, G: Any) -> Any:
    """Return ``D = -(3/4) (alpha + i G omega^3) a^2``."""
    return -0.75 * (alpha + 1j * G * w * w * w) * a * a


# by class of the law: the function of one mass, and its gains without the number of the mass
DESCRIBING_FUNCTIONS: dict[type, tuple[Callable[..., Any], tuple[str, ...]]] = {
    Passive: (passive, ()),
    CNVC: (cnvc, ("G",)),
    LNVC: (lnvc, ("G",)),
    PD: (pd, ("p", "d")),
    PPF: (ppf, ("G", "stiffness", "damping")),
    NDF: (ndf, ("G", "omega_f", "damping")),
    Hardening: (hardening, ("alpha", "G")),
}


def described_force(
    law: type, gains: Gains, A1: ComplexArray, A2: ComplexArray, *, omega1: Array, omega2: Array
) -> tuple[ComplexArray, ComplexArray] | None:
    """Return what `average_force` does for a class of `law` that is known; None for others."""
    if law not in DESCRIBING_FUNCTIONS:
        return None
    function, names = DESCRIBING_FUNCTIONS[law]
    g1, g2 = ([getattr(gains.values, f"{name}{mass}") for name in names] for mass in (1, 2))
    return function(np.abs(A1), omega1, *g1) * A1, function(np.abs(A2), omega2, *g2) * A2


def average_force(
    gains: Gains,
    A1: ComplexArray,
    A2: ComplexArray,
    *,
    omega1: Array,
    omega2: Array,
    samples: int = SAMPLES,
) -> tuple[ComplexArray, ComplexArray]:
    """Average any law over one period and return the complex amplitudes of its forces.

    Parameters
    ----------
    gains : Gains
        The law's functions and its gains, (n,).
    A1, A2 : ndarray (n,)
        Complex amplitudes of the displacements [m]: ``x = Re(A exp(i omega t))``.
    omega1, omega2 : ndarray (n,)
        Frequency that turns displacement into velocity on each mass [rad/s].
    samples : int, optional
        Samples of the period; the sum is exact for polynomial laws up to degree ``samples - 2``.

    Returns
    -------
    tuple of ndarray (n,)
        ``U1, U2`` [m/s^2]: the force at the frequency of the motion is ``Re(U exp(i omega t))``.

    Raises
    ------
    ValueError
        If the law's filter is not linear (its steady state is then not a transfer function).

    Notes
    -----
    A law may mix both masses' readings. For smooth laws the sum converges faster than any power
    of `samples`; for a law with a kink (saturation) the error falls as ``samples^-2``.
    """
    samples = whole("samples", samples, 4, MOST_SAMPLES)
    phase = 2.0 * np.pi * np.arange(samples) / samples
    turn = np.exp(1j * phase)

    def sampled(amplitude: ComplexArray) -> Array:
        return (amplitude[:, None] * turn).real

    x = State(
        sampled(A1),
        sampled(A2),
        sampled(1j * omega1 * A1),
        sampled(1j * omega2 * A2),
    )
    values = gains.values._make(np.asarray(g)[:, None] for g in gains.values)
    memory: Any = gains.law.State
    eta = memory(*(sampled(e) for e in _filter_amplitudes(gains, A1, A2, omega1, omega2)))
    u1, u2 = gains.law.command(x, eta, values)
    weight: ComplexArray = (2.0 / samples * np.conj(turn)).astype(np.complex128)
    shape = (*np.broadcast(A1, A2).shape, samples)
    U1: ComplexArray = (np.broadcast_to(u1, shape) @ weight).astype(np.complex128)
    U2: ComplexArray = (np.broadcast_to(u2, shape) @ weight).astype(np.complex128)
    return U1, U2


def _filter_amplitudes(
    gains: Gains, A1: ComplexArray, A2: ComplexArray, omega1: Array, omega2: Array
) -> list[ComplexArray]:
    """Return the filter's complex amplitudes, from its matrices found with unit vectors."""
    filter_rate, memory = gains.law.filter_rate, cast("Any", gains.law.State)
    if filter_rate is None:
        return []
    n, size = len(A1), len(memory._fields)
    values = gains.values._make(np.asarray(g)[:, None] for g in gains.values)

    def rates(columns: Array) -> Array:
        x, eta = State(*columns[:4, None, :]), memory(*columns[4:, None, :])
        shape = (n, columns.shape[1])
        return np.array([np.broadcast_to(r, shape) for r in filter_rate(x, eta, values)])

    unit = rates(np.eye(4 + size))  # (size, n, 4 + size)
    probe = np.linspace(-1.0, 2.0, 4 + size)
    if not np.allclose(rates(probe[:, None])[:, :, 0], unit @ probe, rtol=1e-9, atol=1e-9):
        raise ValueError(
            "the law's filter is not linear, so it has no describing function; "
            "use harmonic balance, which takes the filter's states as unknowns"
        )
    matrix = np.moveaxis(unit, 1, 0)  # (n, size, 4 + size)
    eta = np.zeros((n, size), dtype=np.complex128)
    for columns, omega, A in ((slice(0, 4, 2), omega1, A1), (slice(1, 4, 2), omega2, A2)):
        # each mass drives the filter at its own frequency
        turning = 1j * omega[:, None, None] * np.eye(size) - matrix[:, :, 4:]
        into = matrix[:, :, columns] @ np.array([A, 1j * omega * A]).T[:, :, None]
        eta += np.linalg.solve(turning, into)[:, :, 0]
    return [eta[:, i] for i in range(size)]
