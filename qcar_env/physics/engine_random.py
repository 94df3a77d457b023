"""numpy's PCG64 in compiled code, one stream for each car.

A car draws what ``np.random.Generator(np.random.PCG64(seed)).random()`` draws, bit for bit, so
that a batch of cars and single environments with the same seeds have the same episodes, and a
reset inside compiled code needs no call back to Python.

Source: M. E. O'Neill, PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms
for Random Number Generation, HMC-CS-2014-0905, 2014 (XSL-RR 128/64); numpy guarantees the stream
of a bit generator (NEP 19).
"""

# pyright: basic

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.physics.engine import compiled

MULTIPLIER_HIGH = np.uint64(0x2360ED051FC65DA4)
MULTIPLIER_LOW = np.uint64(0x4385DF649FCCF645)
HALF = np.uint64(0xFFFFFFFF)
BITS_32 = np.uint64(32)
BITS_11 = np.uint64(11)
BITS_58 = np.uint64(58)
BITS_63 = np.uint64(63)
BITS_64 = np.uint64(64)
UNIT = 1.0 / 9007199254740992.0  # 2^-53


def streams(seeds: Iterable[int | None]) -> NDArray[np.uint64]:
    """Return the states of generators seeded with `seeds` (None: fresh entropy).

    Returns
    -------
    ndarray (n, 4) of uint64
        State and increment, high word first.
    """
    words: list[int] = []
    for seed in seeds:
        state: Any = np.random.PCG64(seed).state["state"]
        for number in (state["state"], state["inc"]):
            words += [number >> 64, number & 0xFFFFFFFFFFFFFFFF]
    return np.array(words, dtype=np.uint64).reshape(-1, 4)


@compiled
def uniform(states: Any, i: Any) -> Any:
    """Draw from [0, 1) with stream `i` of `states`, and advance it."""
    high, low = states[i, 0], states[i, 1]
    # state = state * multiplier + increment, in 128 bits
    new_low = low * MULTIPLIER_LOW
    new_high = _high_product(low, MULTIPLIER_LOW) + high * MULTIPLIER_LOW + low * MULTIPLIER_HIGH
    low = new_low + states[i, 3]
    high = new_high + states[i, 2] + np.uint64(low < new_low)
    states[i, 0], states[i, 1] = high, low
    word = high ^ low
    turn = high >> BITS_58
    word = (word >> turn) | (word << ((BITS_64 - turn) & BITS_63))
    return np.float64(word >> BITS_11) * UNIT


@compiled
def _high_product(a: Any, b: Any) -> Any:
    """Return the upper 64 bits of the 128-bit product of two 64-bit words."""
    a_high, a_low = a >> BITS_32, a & HALF
    b_high, b_low = b >> BITS_32, b & HALF
    cross = a_high * b_low + ((a_low * b_low) >> BITS_32)
    other = a_low * b_high + (cross & HALF)
    return a_high * b_high + (cross >> BITS_32) + (other >> BITS_32)
