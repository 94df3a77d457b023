"""The classical fourth-order Runge-Kutta step, which knows nothing of cars.

    k1 = f(x, w(t))
    k2 = f(x + step/2 k1, w(t + step/2))
    k3 = f(x + step/2 k2, w(t + step/2))
    k4 = f(x + step k3, w(t + step))
    x(t + step) = x + step/6 k1 + step/3 (k2 + k3) + step/6 k4

for ``x' = f(x, w(t))`` with an input `w` that is known at the stage times. Source: E. Hairer,
S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., table II.1.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from qcar_env.physics.tree import add, advance

# The method is stable for a linear mode while step * lambda stays within its stability region,
# which reaches -2.785 on the real axis, 2.828 on the imaginary one, and least far, to 2.616, for
# a mode of damping ratio 0.53 (region: Hairer and Wanner, Solving Ordinary Differential Equations
# II, section IV.2; its least extent: tests/physics/test_rk4.py).
STABILITY_LIMIT = 2.6  # [-] refuse above: the region's least extent, with a margin
ACCURACY_LIMIT = 0.5  # [-] warn above: local error of a mode (0.5^5 / 120 = 2.6e-4 a step)


class Step(NamedTuple):
    """An integration step and its fractions, prepared once so that no literal changes a dtype."""

    full: Any  # step [s]
    half: Any  # step / 2 [s]
    third: Any  # step / 3 [s]
    sixth: Any  # step / 6 [s]


def step_fractions(step: Any) -> Step:
    """Return `step` [s] with its half, third and sixth."""
    return Step(step, step / 2, step / 3, step / 6)


def rk4_step(
    rate: Callable[..., Any],
    x: Any,
    step: Any,
    w_start: Any,
    w_middle: Any,
    w_end: Any,
    *args: Any,
) -> Any:
    """Advance ``x' = rate(x, w, *args)`` by one step.

    Parameters
    ----------
    rate : callable
        Right-hand side ``rate(x, w, *args)``, of the kind of `x`.
    x : tuple
        State at the start of the step: a named tuple of numbers or of named tuples.
    step : Step
        Step size and its fractions [s].
    w_start, w_middle, w_end
        Input at the stage times ``t``, ``t + step/2`` and ``t + step``.
    *args
        Passed on to `rate`.

    Returns
    -------
    tuple
        State at the end of the step, of the same kind as `x`.
    """
    k1 = rate(x, w_start, *args)
    k2 = rate(advance(x, step.half, k1), w_middle, *args)
    k3 = rate(advance(x, step.half, k2), w_middle, *args)
    k4 = rate(advance(x, step.full, k3), w_end, *args)
    x = advance(x, step.sixth, k1)
    x = advance(x, step.third, add(k2, k3))
    return advance(x, step.sixth, k4)
