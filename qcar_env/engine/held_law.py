"""Laws held over control intervals, in compiled code: what tuning and policy search spend time on.

A law is a function ``act(seen, gains, shared, action)``: of the observation (size,) of one car in
single precision, as a policy gets it, of the law's gains, and of what laws share; it writes the
action (m,). It is compiled as it stands, into the loop over the intervals of
`qcar_env.engine.stepping`, so that a crossing is that of the environment bit for bit.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from qcar_env.engine.compile import (
    LANES,
    compiled,
    kernel,
    source_stamp,
)

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
    sources = source_stamp(driver, act)

    @kernel
    def drive(fleet, outputs, seen, actions, gains, group, shared, intervals, window, peak):
        sources  # noqa: B018  # pyright: ignore  part of the cache's key
        rewards, push, ends = outputs
        for block in range(fleet[0].shape[0]):
            first, last = block * LANES, min((block + 1) * LANES, seen.shape[0])
            x = fleet[0][block]  # which begins with x1, x2
            for k in range(intervals):
                for i in range(first, last):
                    action = actions[i]
                    act(seen[i], gains[i // group], shared, action)
                    for a in range(action.shape[0]):
                        if not abs(action[a]) <= HIGHEST:
                            action[a], peak[i] = 0.0, np.nan
                step(*fleet, block, block + 1, actions, seen, rewards, push, ends)
                if k >= intervals - window:
                    for mass in range(2):
                        for i in range(first, last):
                            size = abs(x[mass * LANES + i - first])
                            if size > peak[i, mass] or math.isnan(size):
                                peak[i, mass] = size

    return drive
