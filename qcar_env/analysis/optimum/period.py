"""The optimum of the steady motion: a periodic force over a period of road and force.

**Why it bounds every policy.** Take any policy, feedback or not, with memory or without, holding
its force for any time or none. Let u(t) be the force that it applies, |u_j| <= L_j, and x(t) the
bounded motion, in the limit |w_i x_i| / A_i <= r. The forcing repeats with period T. Shift force
and motion by 0, T, 2T, ... and average over the first N shifts: the average is again a motion of
the linear plant under the same forcing, its force is within L because L is a convex set, its
displacement within r for the same reason, and ``x(T) - x(0)`` of the average is that of the
original over N periods divided by N, which vanishes. A subsequence converges to a T-periodic
motion within r. Hence r is at least the least value over T-periodic forces u(t), whatever their
shape: the optimum of continuous time, which no sampling enters. (Forcing that only changes its
sign after T/2 allows the same with half periods and alternating signs: half the program.) The
argument is worked out here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from qcar_env.analysis.optimum.grid import MOST_NODES, Array, grid_of
from qcar_env.analysis.optimum.program import solve
from qcar_env.analysis.optimum.result import Aim, Objective, Optimum
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import positive, whole

LARGEST_RATIO = 32  # numerator and denominator of omega / Omega that still share a period
MOST_HOLDS = 2000  # holds in a program over the periods that a control interval nearly divides
HOLD_TOLERANCE = 1e-4  # how nearly [-]
FINE = 256  # holds in a period from which on one node in each is enough
COUNTED = 512  # nodes in a period at which the displacement is limited, at most


def period_optimum(
    scenario: str | Scenario,
    *,
    samples: int = 64,
    dt: float | None = None,
    inside: int | None = None,
    objective: Objective = "max",
    weights: Sequence[float] = (1.0, 1.0),
) -> Optimum:
    """Return the optimum of the steady motion on a harmonic road.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road, external force and actuator with its limit. What it draws is not looked at.
    samples : int
        Forces held in one period.
    dt : float, optional
        Instead of `samples`: hold each force for this long [s], as an environment does. A control
        interval that does not divide the period is taken over as many periods as it nearly does
        (to 1e-4, at most 2000 holds); `Optimum.hold` has what was used.
    inside : int, optional
        Nodes in each hold at which the displacement is limited. With 1 the program may buy calm
        samples with motion between them. By default 2, and 1 from 257 holds on, when the holds
        are short for that.
    objective, weights
        What is made small, see `result.Aim`; weights ``(1, 0)`` ask for the wheel alone.

    Returns
    -------
    Optimum

    Raises
    ------
    ValueError
        If the road is not harmonic, road and force share no period, or an argument is out of
        range.
    RuntimeError
        If the solver fails.
    """
    scenario = find_scenario(scenario)
    samples = whole("samples", samples, 2, MOST_NODES)
    aim = Aim(objective=objective, weights=weights)
    period, half = _common_period(scenario)
    periods = 1
    if dt is not None:
        samples, periods = _commensurate(period, positive("dt", dt, "s"))
    nodes = 2 if samples <= FINE else 1
    if inside is not None:
        nodes = whole("inside", inside, most=max(1, MOST_NODES // samples))
    half = half and samples % 2 == 0 and periods % 2 == 1
    number = np.arange((samples // 2 if half else samples) * nodes)
    t: Array = periods * period / (samples * nodes) * np.arange(len(number) + 1.0)
    hold = period * periods / samples
    grid = grid_of(scenario, t, number // nodes, hold, closing=-1.0 if half else 1.0)
    found = solve(grid, aim, every=max(1, samples * nodes // (COUNTED * periods)))
    return _unfold(found) if half else found


def _unfold(half: Optimum) -> Optimum:
    """Return a motion over half a period and its mirror image as one over the whole."""
    return dataclasses.replace(
        half,
        t=np.concatenate([half.t, half.t[1:] + (half.t[-1] - half.t[0])]),
        x=np.concatenate([half.x, -half.x[1:]]),
        u=np.concatenate([half.u, -half.u]),
    )


def _common_period(scenario: Scenario) -> tuple[float, bool]:
    """Return the period of road and force together [s], and whether half of it turns their sign."""
    road, force = scenario.excitation, scenario.force
    if not road.harmonic:
        raise ValueError(
            f"a steady motion needs a harmonic road, got a {type(road.road).__name__}; "
            "use episode_optimum"
        )
    moving = [w for w, on in ((road.omega, road.h), (force.Omega, force.f)) if on and w > 0.0]
    if not moving:
        raise ValueError("nothing moves the car, got h = 0 and f = 0; give road or force a size")
    constant = bool(force.f) and force.Omega == 0.0
    if len(moving) == 1:
        return 2.0 * math.pi / moving[0], not constant
    ratio = moving[0] / moving[1]
    near = Fraction(ratio).limit_denominator(LARGEST_RATIO)
    if near == 0 or near.numerator > LARGEST_RATIO or abs(ratio / float(near) - 1.0) > 1e-9:
        raise ValueError(
            f"road and force must share a period, got omega / Omega = {ratio:.6g}, no ratio of "
            f"whole numbers up to {LARGEST_RATIO}; use episode_optimum over a long time"
        )
    odd = near.numerator % 2 == 1 and near.denominator % 2 == 1
    return 2.0 * math.pi * near.numerator / moving[0], odd


def _commensurate(period: float, dt: float) -> tuple[int, int]:
    """Return the fewest holds and periods of equal length, to `HOLD_TOLERANCE`."""
    for periods in range(1, MOST_HOLDS):
        if periods * period / dt > MOST_HOLDS + 0.5:
            break
        holds = round(periods * period / dt)
        if holds >= 2 and abs(holds * dt / (periods * period) - 1.0) <= HOLD_TOLERANCE:
            return holds, periods
    raise ValueError(
        f"dt = {dt:g} s nearly divides no number of periods of {period:g} s within "
        f"{MOST_HOLDS} holds; give samples instead"
    )
