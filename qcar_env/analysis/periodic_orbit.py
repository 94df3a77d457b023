"""Periodic orbits of the full equations by shooting, and their Floquet multipliers.

The flow map P carries the state at phase 0 over one period of the forcing. A periodic motion is a
fixed point of P; the eigenvalues of its derivative, the Floquet multipliers, decide its stability:
all inside the unit circle, and every small disturbance dies out. A. H. Nayfeh, B. Balachandran,
Applied Nonlinear Dynamics, Wiley 1995, chapters 3 and 6. No averaging is involved: this is what
the averaged statement is held against.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.harmonic_balance import MOST_SAMPLES, PeriodicSystem, of_each_state
from qcar_env.analysis.newton import newton, numerical_jacobian
from qcar_env.physics.rk4 import rk4_step, step_fractions
from qcar_env.validation import whole

Array = NDArray[np.float64]

MOST_PERIODS = 1_000_000  # of one call, chosen here: hours
FINER = 8  # times as many samples, by Fourier interpolation, for the peaks of an orbit
STEPS = 256  # RK4 steps a period: (2 pi / 256)^4 / 120 = 3e-9 of a period's phase


@dataclass(frozen=True, kw_only=True)
class PeriodicOrbits:
    """Periodic orbits of n systems, at phase 0."""

    state: Array  # (m, n) states at phase 0
    peaks: Array  # (m, n) largest magnitude of each state over the period
    multipliers: NDArray[np.complex128]  # (n, m) Floquet multipliers, largest magnitude first [-]
    period: Array  # (n,) [s]
    converged: NDArray[np.bool_]  # (n,)

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every multiplier lies inside the unit circle, (n,)."""
        return np.abs(self.multipliers[:, 0]) < 1.0

    @property
    def exponents(self) -> NDArray[np.complex128]:
        """Floquet exponents ``log(multiplier) / period`` [1/s], (n, m).

        Their real parts are the rates at which disturbances grow; the imaginary parts are known
        up to the forcing frequency.
        """
        return (np.log(self.multipliers) / self.period[:, None]).astype(np.complex128)


def flow_map(
    system: PeriodicSystem, state: Array, *, periods: int = 1, steps: int = STEPS
) -> Array:
    """Carry states over whole periods of the forcing, from phase 0 (RK4).

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    state : ndarray (m, n, k)
        k starts of each system.
    periods : int, optional
        How many periods.
    steps : int, optional
        RK4 steps a period.

    Returns
    -------
    ndarray (m, n, k)

    Raises
    ------
    ValueError
        If `periods` or `steps` is no whole number within its range.
    """
    for _ in range(whole("periods", periods, 0, MOST_PERIODS)):
        *_, state = orbit_states(system, state, steps=steps)
    return state


def orbit_states(system: PeriodicSystem, state: Array, *, steps: int = STEPS) -> Iterator[Array]:
    """Yield the states (m, n, k) after each of `steps` RK4 steps of one period."""
    steps = whole("steps", steps, most=MOST_SAMPLES)
    step = step_fractions((2.0 * np.pi / steps / system.omega)[:, None])
    turn = 2.0 * np.pi / steps
    x = np.asarray(state, dtype=float)
    for index in range(steps):
        begin, middle, end = (np.array([turn * (index + part)]) for part in (0.0, 0.5, 1.0))
        x = rk4_step(system.rate, x, step, begin, middle, end)
        yield x


def monodromy(system: PeriodicSystem, state: Array, *, steps: int = STEPS) -> Array:
    """Return the derivative of the flow map over one period, (n, m, m), at `state` (m, n)."""
    n = state.shape[1]

    def carried(columns: Array) -> Array:
        starts = columns.reshape(columns.shape[0], -1, n).transpose(0, 2, 1)
        return flow_map(system, starts, steps=steps).transpose(0, 2, 1).reshape(columns.shape)

    scale = np.asarray(system.scale, dtype=float)
    repeats = 2 * scale.shape[0]
    wide = np.tile(scale, (1, repeats))
    derivative = numerical_jacobian(lambda c: carried(c * wide) / wide, state / scale)
    return derivative * scale.T[:, :, None] / scale.T[:, None, :]


def periodic_orbits(system: PeriodicSystem, start: Array, *, steps: int = STEPS) -> PeriodicOrbits:
    """Find periodic orbits by Newton's method on the flow map.

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    start : ndarray (m, n)
        Guess of the states at phase 0, from averaging or harmonic balance.
    steps : int, optional
        RK4 steps a period; a law that makes the loop stiff needs more.

    Returns
    -------
    PeriodicOrbits
        With `converged` false where the iteration failed.

    Raises
    ------
    ValueError
        If `start` has another shape, or `steps` is no whole number within its range.
    """
    start, steps = of_each_state("start", start, system), whole("steps", steps, most=MOST_SAMPLES)
    scale = np.asarray(system.scale, dtype=float)

    def defect(z: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            moved = flow_map(system, (z * scale)[:, :, None], steps=steps)[:, :, 0]
        return moved / scale - z

    def derivative(z: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            carried = monodromy(system, z * scale, steps=steps)
        scaled = carried * scale.T[:, None, :] / scale.T[:, :, None]
        return scaled - np.eye(scale.shape[0])

    found = newton(defect, derivative, start / scale, tolerance=1e-9, max_iterations=25)
    state = found.z * scale
    orbit = np.stack([x[:, :, 0] for x in orbit_states(system, state[:, :, None], steps=steps)])
    with np.errstate(invalid="ignore"):
        dense = np.fft.irfft(np.fft.rfft(orbit, axis=0) * FINER, n=FINER * steps, axis=0)
    matrices = monodromy(system, state, steps=steps)
    multipliers = np.zeros((state.shape[1], state.shape[0]), dtype=np.complex128)
    for index in np.flatnonzero(found.converged):
        values = np.linalg.eigvals(matrices[index])
        multipliers[index] = values[np.argsort(-np.abs(values))]
    multipliers[~found.converged] = np.nan
    return PeriodicOrbits(
        state=state,
        peaks=np.max(np.abs(dense), axis=0),
        multipliers=multipliers,
        period=2.0 * np.pi / np.asarray(system.omega, dtype=float),
        converged=found.converged,
    )
