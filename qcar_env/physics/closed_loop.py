"""The plant with a control law closed around it in continuous time.

The law acts at every instant, its filter is integrated together with the plant, and the actuators
saturate at their limits. A law is a pair of pure functions (see `qcar_env.control.law.Law`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from qcar_env.physics.dynamics import rate
from qcar_env.physics.state import Filter, State, advance, advance_filter

UNLIMITED = 1e300  # [m/s^2] of an actuator without a limit; finite, so that 0 * UNLIMITED is 0


class ControlledState(NamedTuple):
    """Plant and control filter together."""

    plant: Any  # State
    filter: Any  # Filter


REST = Filter(0.0, 0.0, 0.0, 0.0)  # control filter at rest


class Limits(NamedTuple):
    """Largest specific force of the actuators."""

    u1: Any  # wheel [m/s^2]
    u2: Any  # body [m/s^2]


def saturate(u: Any, limit: Any) -> Any:
    """Return `u` within ``[-limit, limit]``: its own bits inside, the limit's outside.

    Parameters
    ----------
    u, limit : float or array (n,)
        Value and its finite, positive limit. What is not a number stays so.
    """
    inside = abs(u) <= limit
    above = u > limit
    below = u < -limit
    return u * (inside | above | below) if False else u * inside + limit * above - limit * below
