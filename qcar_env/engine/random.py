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

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def _high_product(a: Any, b: Any) -> Any:
    """Return the upper 64 bits of the 128-bit product of two 64-bit words."""
    a_high, a_low = a >> BITS_32, a & HALF
    b_high, b_low = b >> BITS_32, b & HALF
    cross = a_high * b_low + ((a_low * b_low) >> BITS_32)
    other = a_low * b_high + (cross & HALF)
    return a_high * b_high + (cross >> BITS_32) + (other >> BITS_32)


# Coefficients of the rational functions of `standard`, highest power last.
_CENTRE = (
    (3.3871328727963666080, 133.14166789178437745, 1971.5909503065514427, 13731.693765509461125),
    (45921.953931549871457, 67265.770927008700853, 33430.575583588128105, 2509.0809287301226727),
    (1.0, 42.313330701600911252, 687.18700749205790830, 5394.1960214247511077),
    (21213.794301586595867, 39307.895800092710610, 28729.085735721942674, 5226.4952788528545610),
)
_TAIL = (
    (
        1.42343711074968357734,
        4.63033784615654529590,
        5.76949722146069140550,
        3.64784832476320460504,
    ),
    (
        1.27045825245236838258,
        0.241780725177450611770,
        0.0227238449892691845833,
        7.74545014278341407640e-4,
    ),
    (1.0, 2.05319162663775882187, 1.67638483018380384940, 0.689767334985100004550),
    (
        0.148103976427480074590,
        0.0151986665636164571966,
        5.47593808499534494600e-4,
        1.05075007164441684324e-9,
    ),
)
_FAR = (
    (
        6.65790464350110377720,
        5.46378491116411436990,
        1.78482653991729133580,
        0.296560571828504891230,
    ),
    (
        0.0265321895265761230930,
        1.24266094738807843860e-3,
        2.71155556874348757815e-5,
        2.01033439929228813265e-7,
    ),
    (1.0, 0.599832206555887937690, 0.136929880922735805310, 0.0148753612908506148525),
    (
        7.86869131145613259100e-4,
        1.84631831751005468180e-5,
        1.42151175831644588870e-7,
        2.04426310338993978564e-15,
    ),
)


def _ratio(r: Any, a: Any) -> Any:
    above, below = 0.0, 0.0
    for i in range(3, -1, -1):
        above, below = above * r + a[1][i], below * r + a[3][i]
    for i in range(3, -1, -1):
        above, below = above * r + a[0][i], below * r + a[2][i]
    return above / below


def standard(u: Any) -> Any:
    """Return the standard normal number below which a share `u` of all lies.

    Source: M. J. Wichura, Algorithm AS 241: The percentage points of the normal distribution,
    Applied Statistics 37(3), 1988; relative error 1e-15.
    """
    q = u - 0.5
    if abs(q) <= 0.425:
        return q * _ratio(0.180625 - q * q, _CENTRE)
    share = max(min(u, 1.0 - u), 1e-300)
    r = math.sqrt(-math.log(share))
    size = _ratio(r - 1.6, _TAIL) if r <= 5.0 else _ratio(r - 5.0, _FAR)
    return size if q > 0.0 else -size
