"""Is the motion chaotic? Largest Lyapunov exponent and Poincare section of the full equations.

The paper speaks of "dynamic chaos" of the uncontrolled system at resonance. A motion is chaotic if
neighbouring ones separate exponentially: if the largest Lyapunov exponent is positive. It is
estimated here by following two neighbours and pulling them together again every period:
G. Benettin, L. Galgani, A. Giorgilli, J.-M. Strelcyn, Meccanica 15, 1980. The Poincare section
takes the state once a period: one point for a periodic motion, a closed curve for a
quasi-periodic one, a scattered set for chaos.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.harmonic_balance import PeriodicSystem, of_each_state
from qcar_env.analysis.periodic_orbit import MOST_PERIODS, STEPS, flow_map
from qcar_env.validation import whole

Array = NDArray[np.float64]

SEPARATION = 1e-7  # distance of the neighbours, in sizes of the state [-]; far above rounding


@dataclass(frozen=True, kw_only=True)
class LyapunovExponents:
    """Largest Lyapunov exponents of n motions."""

    exponent: Array  # (n,) [1/s]
    history: Array  # (periods, n) running estimate [1/s]: how far it has settled
    diverged: NDArray[np.bool_]  # (n,) whether the motion left all bounds


def largest_lyapunov_exponent(
    system: PeriodicSystem,
    start: Array,
    rng: np.random.Generator,
    *,
    periods: int = 400,
    settle: int = 100,
    steps: int = STEPS,
) -> LyapunovExponents:
    """Estimate the largest Lyapunov exponents.

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    start : ndarray (m, n)
        States at phase 0.
    rng : numpy.random.Generator
        Where the direction of the first separation comes from.
    periods : int, optional
        Forcing periods over which the separation is measured; the error falls with their number.
    settle : int, optional
        Periods before the measurement, for the transient to die out.
    steps : int, optional
        RK4 steps a period.

    Returns
    -------
    LyapunovExponents

    Raises
    ------
    ValueError
        If `start` has another shape, or a count is no whole number within its range.
    """
    count = whole("periods", periods, most=MOST_PERIODS)
    settle = whole("settle", settle, 0, MOST_PERIODS)
    scale = np.asarray(system.scale, dtype=float)
    period = 2.0 * np.pi / np.asarray(system.omega, dtype=float)
    base = of_each_state("start", start, system)[:, :, None]
    aside = rng.standard_normal(scale.shape)
    aside *= SEPARATION / np.linalg.norm(aside, axis=0)
    grown = np.zeros(scale.shape[1])
    history = np.empty((count, scale.shape[1]))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for index in range(settle + count):
            pair = np.concatenate([base, base + (scale * aside)[:, :, None]], axis=2)
            moved = flow_map(system, pair, steps=steps)
            base = moved[:, :, :1]
            aside = (moved[:, :, 1] - moved[:, :, 0]) / scale
            distance = np.linalg.norm(aside, axis=0)
            aside *= SEPARATION / np.maximum(distance, 1e-300)
            if index >= settle:
                grown += np.log(np.maximum(distance, 1e-300) / SEPARATION)
                history[index - settle] = grown / ((index - settle + 1) * period)
    diverged = ~np.all(np.isfinite(base[:, :, 0]), axis=0)
    return LyapunovExponents(
        exponent=np.where(diverged, np.nan, history[-1]), history=history, diverged=diverged
    )


def poincare_section(
    system: PeriodicSystem,
    start: Array,
    *,
    periods: int = 200,
    settle: int = 200,
    steps: int = STEPS,
) -> Array:
    """Return the states once a period, at phase 0, after a transient.

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    start : ndarray (m, n)
        States at phase 0.
    periods : int, optional
        Points of the section.
    settle : int, optional
        Periods left out at the beginning.
    steps : int, optional
        RK4 steps a period.

    Returns
    -------
    ndarray (m, n, periods)

    Raises
    ------
    ValueError
        If `start` has another shape, or a count is no whole number within its range.
    """
    count = whole("periods", periods, most=MOST_PERIODS)
    settle = whole("settle", settle, 0, MOST_PERIODS)
    state = of_each_state("start", start, system)[:, :, None]
    state = flow_map(system, state, periods=settle, steps=steps)
    section = np.empty((*state.shape[:2], count))
    for index in range(count):
        section[:, :, index] = state[:, :, 0]
        state = flow_map(system, state, steps=steps)
    return section
