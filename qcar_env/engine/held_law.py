"""Laws held over control intervals, in compiled code: what tuning and policy search spend time on.

A law is a function ``act(seen, gains, shared, action)``: of the observation (size,) of one car in
single precision, as a policy gets it, of the law's gains, and of what laws share; it writes the
action (m,). It is compiled as it stands, into the loop over the intervals of
`qcar_env.engine.stepping`, so that an episode is that of the environment bit for bit.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from qcar_env.engine.compile import LANES, compiled, kernel, source_stamp
from qcar_env.physics.peaks import largest_between

HIGHEST = np.finfo(np.float32).max


def linear_law(seen: Any, gains: Any, shared: Any, action: Any) -> None:
    """Write ``clip(gains @ seen, -1, 1)`` with gains (m, k) of the first k entries seen."""
    for a in range(action.shape[0]):
        command = 0.0
        for q in range(gains.shape[1]):
            command += gains[a, q] * seen[q]
        action[a] = min(max(command, -1.0), 1.0)


@cache
def driver(step: Any, act: Any) -> Any:
    """Return the compiled loop of a law over intervals of ``Kernels.step``; see `Cars.drive`."""
    compiled(act)
    compiled(largest_between)
    sources = source_stamp(driver, act, largest_between)

    @kernel
    def drive(fleet, outputs, seen, actions, gains, group, shared, intervals, window, dt, peak):
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        rewards, push, ends = outputs
        before = np.empty(4 * LANES)
        for block in range(fleet[0].shape[0]):
            first, last = block * LANES, min((block + 1) * LANES, seen.shape[0])
            x = fleet[0][block]  # which begins with x1, x2, v1, v2
            for k in range(intervals):
                for i in range(first, last):
                    action = actions[i]
                    act(seen[i], gains[i // group], shared, action)
                    for a in range(action.shape[0]):
                        if not abs(action[a]) <= HIGHEST:
                            action[a], peak[i] = 0.0, np.nan
                measured = k >= intervals - window
                for row in range(4 * LANES if measured else 0):
                    before[row] = x[row]
                step(*fleet, block, block + 1, actions, seen, rewards, push, ends)
                if measured:
                    for mass in range(2):
                        for i in range(first, last):
                            r = mass * LANES + i - first
                            v = r + 2 * LANES
                            size = largest_between(before[r], before[v], x[r], x[v], dt)
                            if size > peak[i, mass] or math.isnan(size):
                                peak[i, mass] = size

    return drive
