"""Frequency weightings of whole-body vibration, as ISO 8041-1 defines them: analogue filters.

    H(s) = band(s) transition(s) step(s)
    band       = s^2 / (s^2 + sqrt(2) w1 s + w1^2)  *  w2^2 / (s^2 + sqrt(2) w2 s + w2^2)
    transition = K (1 + s / w3) / (1 + s / (Q4 w4) + (s / w4)^2)
    step       = (1 + s / (Q5 w5) + (s / w5)^2) / (1 + s / (Q6 w6) + (s / w6)^2)  *  (w5 / w6)^2

A record is weighted in the frequency domain, where H is exact at every frequency that the record
holds. The bilinear transform, which filters of this kind are usually made with, is 9 % low at 32 Hz
and 25 % at 50 Hz in a record of 200 Hz; a state space that takes the samples as held, or joined by
lines, errs by as much, with another sign.

Source: ISO 8041-1:2017, 5.6 and annex B; ISO 2631-1:1997 for Wk, ISO 2631-4 for Wb.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import zip_longest
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.linalg import expm, matrix_balance

from qcar_env.validation import finite_array, known, positive, shown

Array = NDArray[np.float64]
TURN = 2.0 * math.pi
FADED = 1e-9  # of a filter's slowest mode is left at the end of the zeros behind a record [-]


class Weighting(NamedTuple):
    """An analogue filter by its zeros, poles and gain, as `scipy.signal.lti` takes them.

    It serves as the `weighting` of `qcar_env.analysis.optimum.hump_optimum`.
    """

    zeros: tuple[complex, ...]  # [rad/s]
    poles: tuple[complex, ...]  # [rad/s]
    gain: float  # of s^(zeros - poles)

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return the complex gain [-] at a `frequency` [Hz] of any shape."""
        s = 1j * TURN * finite_array("frequency", frequency, "Hz")
        found = np.full(s.shape, self.gain, dtype=np.complex128)
        for zero, pole in zip_longest(self.zeros, self.poles):
            found *= (1.0 if zero is None else s - zero) / (s - pole)
        return found


def _roots(f: float, Q: float) -> tuple[complex, complex]:
    """Return the roots of ``1 + s / (Q w) + (s / w)^2``."""
    w, half = TURN * f, 0.5 / Q
    root = complex(-half, math.sqrt(1.0 - half * half)) * w
    return root, root.conjugate()


def _weighting(
    f1: float, f2: float, f3: float, Q4: float, f5: float, Q5: float, f6: float, Q6: float, K: float
) -> Weighting:
    """Return a weighting from its numbers [Hz, -]; the transition has ``f4 = f3``."""
    butterworth = math.sqrt(0.5)
    zeros = (0.0j, 0.0j, complex(-TURN * f3), *_roots(f5, Q5))
    poles = (*_roots(f1, butterworth), *_roots(f2, butterworth), *_roots(f3, Q4), *_roots(f6, Q6))
    return Weighting(zeros, poles, K * (TURN * f2) ** 2 * TURN * f3)


WEIGHTINGS: Mapping[str, Weighting] = MappingProxyType(
    {
        # vertical, seated: comfort and health, ISO 2631-1
        "Wk": _weighting(0.4, 100.0, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91, 1.0),
        # vertical, in trains, ISO 2631-4
        "Wb": _weighting(0.4, 100.0, 16.0, 0.55, 2.5, 0.9, 4.0, 0.95, 1.024),
    }
)


def find_weighting(name: str | Weighting) -> Weighting:
    """Return a weighting by its name; one of one's own is returned as it is.

    Raises
    ------
    ValueError
        If there is no such weighting, or one of one's own is no stable filter.
    """
    if not isinstance(name, Weighting):
        return WEIGHTINGS[known("weighting", name, WEIGHTINGS)]
    if not name.poles or len(name.zeros) > len(name.poles) or max(np.real(name.poles)) >= 0.0:
        raise ValueError(
            f"weighting must be a stable filter with as many poles as zeros or more, got "
            f"{shown(name)}; give poles with negative real parts"
        )
    return name


def weighted(acceleration: ArrayLike, dt: float, weighting: str | Weighting = "Wk") -> Array:
    """Return the weighted acceleration [m/s^2], from rest.

    Parameters
    ----------
    acceleration : array_like (k,) or (k, n)
        Evenly spaced samples of one record, or of n records side by side [m/s^2].
    dt : float
        Time between two samples [s].
    weighting : str or Weighting
        ``"Wk"``, ``"Wb"``, or a filter of one's own.

    Returns
    -------
    ndarray
        Of the same shape.

    Raises
    ------
    ValueError
        If the samples are not finite or of another shape, `dt` is not positive, or the weighting
        is unknown.

    Notes
    -----
    The spectrum of the samples times the filter's, with so many zeros behind the record that
    nothing of its end reaches its beginning: the filter is at rest before the first sample. What
    the record holds below half its sampling frequency is weighted exactly; what was folded there
    by coarse sampling stays. Jumps between samples ring, as in any band-limited record: sample
    them finely (`qcar_env.evaluation.ride` does).
    """
    filter = find_weighting(weighting)
    a = rows("acceleration", acceleration, "m/s^2")
    dt = positive("dt", dt, "s")
    k = len(a)
    settles = math.log(FADED) / max(np.real(filter.poles))  # [s]
    size = fft.next_fast_len(k + math.ceil(settles / dt), real=True)
    gain = filter.response(fft.rfftfreq(size, dt))
    spectrum: Any = fft.rfft(a, size, axis=0)
    spectrum *= gain[:, np.newaxis] if a.ndim == 2 else gain
    found: Any = fft.irfft(spectrum, size, axis=0)
    return found[:k].astype(np.float64, copy=False)


@dataclass(frozen=True, kw_only=True)
class Recursion:
    """A weighting sample by sample, for what must be known at once, such as a reward."""

    A: Array  # (f, f)
    B0: Array  # (f,) of the sample before
    B1: Array  # (f,) of the sample now
    C: Array  # (f,)
    D: float

    def start(self, count: int) -> Array:
        """Return the filter's state at rest, of `count` cars, shape (count, f)."""
        return np.zeros((count, len(self.A)))

    def step(self, state: Array, before: ArrayLike, now: ArrayLike) -> tuple[Array, Array]:
        """Return the next state (n, f) and the weighted acceleration now (n,) [m/s^2].

        Parameters
        ----------
        state : ndarray (n, f)
            State at the sample before.
        before, now : array_like (n,)
            Acceleration then and now [m/s^2].
        """
        a0, a1 = (np.asarray(each, dtype=np.float64) for each in (before, now))
        state = state @ self.A.T + np.outer(a0, self.B0) + np.outer(a1, self.B1)
        return state, state @ self.C + self.D * a1


def recursion(dt: float, weighting: str | Weighting = "Wk") -> Recursion:
    """Return a weighting of samples that come one by one, exact for samples joined by lines.

    Parameters
    ----------
    dt : float
        Time between two samples [s].
    weighting : str or Weighting
        ``"Wk"``, ``"Wb"``, or a filter of one's own.

    Notes
    -----
    Lines take ``1 - sinc(f dt)^2`` of a frequency f away: at 200 Hz 0.5 % at 8 Hz, 3 % at 20 Hz,
    19 % at 50 Hz. For what is reported take `weighted`.
    """
    from scipy import signal  # slow to import

    lti: Any = signal.lti
    found: Any = lti(*find_weighting(weighting)).to_ss()
    dt = positive("dt", dt, "s")
    balanced: Any = matrix_balance(found.A, permute=False)
    A, T = balanced
    f = len(A)
    m = np.zeros((f + 2, f + 2))  # of state, input and its change over a sample
    m[:f, :f], m[:f, f] = A * dt, np.linalg.solve(T, found.B[:, 0]) * dt
    m[f, f + 1] = 1.0
    exact = expm(m)
    B1 = exact[:f, f + 1]
    return Recursion(
        A=exact[:f, :f], B0=exact[:f, f] - B1, B1=B1, C=found.C[0] @ T, D=float(found.D[0, 0])
    )


def rows(name: str, values: ArrayLike, unit: str) -> Array:
    """Return finite samples (k,) or (k, n), at least one.

    Raises
    ------
    ValueError
        If they are none.
    """
    found = finite_array(name, values, unit)
    if found.ndim not in (1, 2) or not len(found):
        raise ValueError(
            f"{name} must have shape (k,) or (k, n) with k at least 1, got {found.shape}; give the "
            "samples of one record, or of n records side by side"
        )
    return found
