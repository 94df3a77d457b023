"""The exact map of a linear plant over a time without a kink, for compiled fleets.

State x, held command c and the phasors w of road and force together obey one linear equation,

    (x, c, w)' = M (x, c, w),

as a command rests, a phasor turns, and the plant's rate is linear. M is read off that rate, by
applying it to unit vectors. The first rows of ``E(t) = exp(M t)`` are the map of a time t: ``x(t) =
E (x, c, w)(0)``. A Taylor series of degree `DEGREE` sums them for a time ``t / 2^k``, short enough
for its rest to be below rounding, and k doublings ``E(2t) = E(t)^2`` follow. The other rows, those
of commands at rest and of turning phasors, are known.

What is short enough is told by ``alpha = max(|A^4|^(1/4), |A^5|^(1/5))``, of the plant's own part A
of M, whose powers of 12 and more are below those of alpha: A. H. Al-Mohy, N. J. Higham, SIAM J.
Matrix Anal. Appl. 31 (2009), 970, theorem 4.2. The norm of A itself would be too large by far, as
metres and metres a second stand in one vector.
"""

# pyright: basic
# numba has no types for what it compiles.

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from qcar_env.engine.compile import (
    compiled,
    compiled_apart,
)
from qcar_env.engine.tuples import (
    load,
    save,
    weighted,
)
from qcar_env.physics import tree
from qcar_env.physics.motion import Phasor, Phasors, angle, input_of, turn_both

DEGREE = 14  # of the Taylor series
SHORT = 0.5  # alpha t, at most: the rest of the series is 0.5^15 / 15! = 2e-17


class Exact(NamedTuple):
    """Compiled functions of a class of linear plants."""

    size: int  # numbers in a map
    keep: Any  # keep(p, row, stride, lane, fixed, t): write the map of a time t [s]
    apply: Any  # apply(p, row, stride, lane, x, w, command, turning) -> x, w after that time
    steps: Any  # like `qcar_env.engine.course.Course.steps`, whatever the number of steps


def exact(rate: Any, state: Any, command: Any) -> Exact:
    """Return the functions of a class of plants.

    Parameters
    ----------
    rate : callable
        ``rate(x, input, command, fixed)``, linear in the first three.
    state, command : tuple
        Their shapes.
    """
    PHASORS = Phasors(Phasor(0.0, 0.0), Phasor(0.0, 0.0))
    STATE, COMMAND = state, command
    S, m = len(tree.flat(STATE)), len(tree.flat(COMMAND))
    W = S + m  # where the phasors begin
    N = W + 4

    @compiled_apart
    def generator(fixed):
        """Return the first rows of M, shape (S, N)."""
        found, unit, column = np.zeros((S, N)), np.zeros(N), np.empty(S)
        for i in range(N):
            unit[:] = 0.0
            unit[i] = 1.0
            input = input_of(load(unit, W, 1, 0, PHASORS), fixed.turning)
            x, c = load(unit, 0, 1, 0, STATE), load(unit, S, 1, 0, COMMAND)
            save(column, 0, 1, 0, rate(x, input, c, fixed))
            found[:, i] = column
        return found

    @compiled
    def turned(E, by):
        """Write the rows of commands that rest and of phasors turned by an angle."""
        E[S:] = 0.0
        for i in range(S, W):
            E[i, i] = 1.0
        for i, each in ((W, by.road), (W + 2, by.force)):
            E[i, i] = each.c
            E[i, i + 1] = each.s
            E[i + 1, i] = -each.s
            E[i + 1, i + 1] = each.c

    @compiled_apart
    def product(a, b, out):
        """Write the first rows of a matrix product."""
        for i in range(S):
            for k in range(N):
                out[i, k] = a[i, 0] * b[0, k]
            for j in range(1, N):
                for k in range(N):
                    out[i, k] += a[i, j] * b[j, k]

    @compiled
    def size_of(A):
        """Return the largest sum of a column."""
        largest = 0.0
        for k in range(S):
            total = 0.0
            for i in range(S):
                total += abs(A[i, k])
            largest = max(largest, total)
        return largest

    @compiled
    def alpha_of(M):
        A = np.zeros((N, N))
        A[:S, :S] = M[:S, :S]
        square, fourth, fifth = np.zeros((N, N)), np.zeros((N, N)), np.zeros((N, N))
        product(A, A, square)
        product(square, square, fourth)
        product(fourth, A, fifth)
        return max(math.sqrt(math.sqrt(size_of(fourth))), size_of(fifth) ** 0.2)

    @compiled_apart
    def map_of(fixed, t):
        """Return the map of a time, the first S rows of an array (N, N)."""
        omega, Omega = fixed.omega, fixed.force.Omega
        M = np.zeros((N, N))
        M[:S] = generator(fixed)
        for i, each in ((W, omega), (W + 2, Omega)):
            M[i, i + 1] = each
            M[i + 1, i] = -each
        fastest = max(alpha_of(M), abs(omega), abs(Omega))
        doublings = 0
        while fastest * t > SHORT and doublings < 1000:
            t *= 0.5
            doublings += 1
        E, term, other = np.zeros((N, N)), np.zeros((N, N)), np.zeros((N, N))
        for i in range(S):
            E[i, i] = 1.0
            term[i, i] = 1.0
        for degree in range(1, DEGREE + 1):
            product(term, M, other)
            for i in range(S):
                for k in range(N):
                    term[i, k] = other[i, k] * (t / degree)
                    E[i, k] += term[i, k]
        by = Phasors(angle(omega * t), angle(Omega * t))
        for _ in range(doublings):
            turned(E, by)
            product(E, E, other)
            E[:S] = other[:S]
            by = turn_both(by, by)
        return E

    @compiled_apart
    def keep(p, row, stride, lane, fixed, t):
        E = map_of(fixed, t)
        for i in range(S):
            for k in range(N):
                p[(row + i * N + k) * stride + lane] = E[i, k]

    @compiled
    def apply(p, row, stride, lane, x, w, command, turning):
        x = weighted(p, row, stride, lane, (x, command, w), STATE)
        return x, turn_both(w, turning.by)

    def steps(rate, x, w, turning, step, n, t, kink, command, fixed, table):
        time = n * step.full
        found = map_of(fixed, time).ravel()
        x = weighted(found, 0, 1, 0, (x, command, w), STATE)
        by = Phasors(angle(fixed.omega * time), angle(fixed.force.Omega * time))
        return x, turn_both(w, by)

    return Exact(S * N, keep, apply, compiled(steps))
