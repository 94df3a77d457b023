"""What a fleet's policies read through sensors, and commands that act later.

A reading is filtered, measured with noise, held until the next sample, and delayed, all in whole
control intervals. The noise is a function of a number drawn for the episode, the interval and the
sensor: it needs no stream of its own, and a car has the same noise alone and among others.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from qcar_env.engine.compile import (
    compiled,
    each_by_its_own,
)
from qcar_env.engine.random import standard
from qcar_env.engine.tuples import (
    load,
    save,
)

TURN = 2.0 * math.pi  # [rad]
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
MIX_1, MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
SHIFT_30, SHIFT_27, SHIFT_31 = np.uint64(30), np.uint64(27), np.uint64(31)
SHIFT_11, SENSORS = np.uint64(11), np.uint64(1024)


class Sensed(NamedTuple):
    """How an entry of the observation is read; None stands for the signal itself."""

    which: int  # number of the scenario's sensor
    kind: type  # its class
    delay: int  # age of a reading [intervals]
    period: int  # intervals from one reading to the next
    filtered: bool  # whether there is a low-pass before the noise


def hashed(noise: Any, elapsed: Any, number: Any) -> Any:
    """Return a number from (0, 1) that belongs to an episode, an interval and a sensor.

    Source: G. L. Steele, D. Lea, C. H. Flood, Fast splittable pseudorandom number generators,
    OOPSLA 2014 (SplitMix64).
    """
    x = np.uint64(noise * 9007199254740992.0)
    x = x * GOLDEN + np.uint64(elapsed) * SENSORS + np.uint64(number)
    x = (x ^ (x >> SHIFT_30)) * MIX_1
    x = (x ^ (x >> SHIFT_27)) * MIX_2
    x = x ^ (x >> SHIFT_31)
    return (np.float64(x >> SHIFT_11) + 0.5) * (1.0 / 9007199254740992.0)


def sensing(sensed: tuple[Sensed | None, ...]) -> tuple[int, Any]:
    """Return how many numbers sensors remember, and the compiled function that reads them.

    The function is ``read(raw, z, row, stride, j, noise, elapsed, dt, p, begin)``: of the true
    values of the entries, a tuple; of the slab, first row, stride and lane where the memory lies;
    of the sensors' numbers. `begin` says that the episode begins.
    """
    size, functions = 0, []
    for number, each in enumerate(sensed):
        functions.append(_itself if each is None else _reading(each, number, size))
        size += 0 if each is None else 2 + each.delay
    return size, each_by_its_own(tuple(functions))


def _itself(
    value: Any,
    z: Any,
    row: Any,
    stride: Any,
    j: Any,
    noise: Any,
    elapsed: Any,
    dt: Any,
    p: Any,
    begin: Any,
) -> Any:
    return value


def _reading(sensed: Sensed, number: int, offset: int) -> Any:
    which, kind, delay, period, filtered = sensed
    measure: Any = getattr(kind, "measure")  # noqa: B009 - of a class of sensors

    def read(value, z, row, stride, j, noise, elapsed, dt, p, begin):
        numbers = p[which]
        first = (row + offset) * stride + j
        if filtered:
            if not begin:
                value = z[first] + (value - z[first]) * -math.expm1(-TURN * numbers.cutoff * dt)
            z[first] = value
        if begin or int(elapsed) % period == 0:
            z[first + stride] = measure(value, standard(hashed(noise, elapsed, number)), numbers)
        reading = z[first + stride]
        if delay == 0:
            return reading
        queue = first + 2 * stride
        oldest = reading if begin else z[queue]
        for k in range(delay):
            last = begin or k == delay - 1
            z[queue + k * stride] = reading if last else z[queue + (k + 1) * stride]
        return oldest

    return compiled(read)


def delaying(delay: int, size: int, like: Any) -> Any:
    """Return ``later(z, row, stride, j, command)``: the command of `delay` intervals before.

    The queue of commands, each a tuple like `like` of `size` numbers, lies in slab `z` from `row`.
    """

    def at_once(z, row, stride, j, command):
        return command

    def later(z, row, stride, j, command):
        oldest = load(z, row, stride, j, like)
        for k in range(delay - 1):
            save(z, row + k * size, stride, j, load(z, row + (k + 1) * size, stride, j, like))
        save(z, row + (delay - 1) * size, stride, j, command)
        return oldest

    return compiled(later if delay else at_once)


compiled(hashed)
