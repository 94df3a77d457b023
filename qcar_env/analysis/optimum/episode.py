"""The optimum of an episode: a road of any profile, from a given state, for a finite time.

The force may know the whole road beforehand: no policy, which only sees the road as it comes, does
better.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from qcar_env.analysis.optimum.grid import MOST_NODES, Array, grid_of
from qcar_env.analysis.optimum.program import solve
from qcar_env.analysis.optimum.result import Aim, Objective, Optimum
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import finite, finite_array, non_negative, positive, shown, whole


def episode_optimum(
    scenario: str | Scenario,
    *,
    state: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    start: float = 0.0,
    duration: float | None = None,
    dt: float | None = None,
    inside: int = 1,
    after: float = 0.0,
    objective: Objective = "max",
    weights: Sequence[float] = (1.0, 1.0),
) -> Optimum:
    """Return the optimum of an episode that begins in a given state.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road of any profile, external force and actuator with its limit.
    state : array_like (4,)
        Start ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    start : float
        Time on the road at the start [s].
    duration : float, optional
        Length of the episode [s]; the scenario's if left out.
    dt : float, optional
        How long each force is held [s]; the scenario's if left out.
    inside : int
        Nodes in each hold (see `period_optimum`); a kink of the road adds one.
    after : float
        Displacements count from this long after the start [s].
    objective, weights
        See `result.Aim`; the uncontrolled amplitudes are the scenario's reference.

    Returns
    -------
    Optimum

    Raises
    ------
    ValueError
        If an argument is out of range.
    RuntimeError
        If the solver fails.
    """
    scenario = find_scenario(scenario)
    x0 = finite_array("state", state)
    if x0.shape != (4,):
        raise ValueError(
            f"state must be four finite numbers (x1, x2, v1, v2), got {shown(state)}; "
            "give metres and metres a second"
        )
    aim = Aim(objective=objective, weights=weights)
    inside = whole("inside", inside, most=MOST_NODES)
    hold = scenario.dt if dt is None else positive("dt", dt, "s")
    length = scenario.duration if duration is None else positive("duration", duration, "s")
    if length / hold * inside > MOST_NODES:
        raise ValueError(
            f"duration must be at most {MOST_NODES} nodes, got {length:g} s with dt = {hold:g} s "
            f"and inside = {inside}; give a shorter duration or a longer dt"
        )
    holds = round(length / hold)
    if holds < 1:
        raise ValueError(
            f"duration must hold a control interval, got {length:g} s with dt = {hold:g} s; "
            f"give {hold:g} s or more"
        )
    if non_negative("after", after, "s") >= holds * hold:
        raise ValueError(
            f"after must be below the duration of {holds * hold:g} s, got {after:g} s; "
            "give an earlier time"
        )
    begin = finite("start", start, "s")
    times: Array = begin + hold / inside * np.arange(holds * inside + 1, dtype=np.float64)
    kinks = np.array(scenario.excitation.kinks(times[0], times[-1]))
    number = np.arange(len(times)) / inside
    if kinks.size:  # a kink that falls on a node takes its place
        near = np.min(np.abs(times[:, np.newaxis] - kinks), axis=1) < 1e-9 * hold
        number = np.concatenate([number[~near], np.round((kinks - begin) / hold * 1e9) / 1e9])
        times = np.concatenate([times[~near], kinks])
        order = np.argsort(times)
        times, number = times[order], number[order]
    held = np.floor(number[:-1] + 1e-9).astype(np.intp)
    grid = grid_of(scenario, times, held, hold, start=x0, after=after)
    return solve(grid, aim)
