"""Metrics of a controlled episode, the paper's and the field's."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.validation import finite, numbers, positive, shown, whole

Array = NDArray[np.float64]


def percentage_error(uncontrolled: float, controlled: float) -> float:
    """Return the paper's percentage error, ``(vA1 - vA2) / vA2 * 100`` [%].

    Parameters
    ----------
    uncontrolled, controlled : float
        Amplitudes without and with control, `vA1` and `vA2` [m].

    Notes
    -----
    Table 1 of the paper. It divides by the controlled amplitude, so that it has no upper bound:
    2556 % is a reduction of 96.2 %.

    Raises
    ------
    ValueError
        If an amplitude is negative or no number.
    """
    _check_amplitudes(uncontrolled, controlled)
    return (uncontrolled - controlled) / controlled * 100.0 if controlled else math.inf


def reduction_db(uncontrolled: float, controlled: float) -> float:
    """Return how far the amplitude lies below the uncontrolled one, ``20 log10(vA1/vA2)`` [dB].

    It is infinite where control leaves nothing, and minus infinity where control alone moves the
    mass or its amplitude is infinite.

    Raises
    ------
    ValueError
        If an amplitude is negative or no number.
    """
    _check_amplitudes(uncontrolled, controlled)
    if not controlled:
        return math.inf
    ratio = uncontrolled / controlled
    return 20.0 * math.log10(ratio) if ratio else -math.inf


def rho(amplitudes: ArrayLike, uncontrolled: ArrayLike) -> float:
    """Return the larger of the two relative amplitudes, ``max_i(a_i / A_i)`` [-].

    Parameters
    ----------
    amplitudes, uncontrolled : array_like (2,)
        Of wheel and body with and without control [m].

    Raises
    ------
    ValueError
        If one is negative or no number, or an uncontrolled one is zero or infinite.
    """
    left, free = numbers("amplitudes", amplitudes), numbers("uncontrolled amplitudes", uncontrolled)
    if not (left.shape == free.shape == (2,) and np.all(left >= 0.0)):
        raise ValueError(
            f"amplitudes must be two, of at least 0 m, with and without control, got {shown(left)} "
            f"and {shown(free)}; give those of wheel and body"
        )
    if not np.all((free > 0.0) & (free < math.inf)):
        raise ValueError(
            f"uncontrolled amplitudes must be positive and finite, got {shown(free)} m; where "
            "nothing moves without control no share of it can be left"
        )
    return float(np.max(left / free))


def last_periods(t: ArrayLike, omega: float, periods: int = 5) -> slice:
    """Return the samples of the last whole periods of a motion.

    Parameters
    ----------
    t : array_like (k,)
        Evenly spaced times [s].
    omega : float
        Frequency of the motion [rad/s].
    periods : int
        How many periods.

    Raises
    ------
    ValueError
        If the record is empty or shorter than that.
    """
    time = _row("t", t)
    length = whole("periods", periods) * 2.0 * math.pi / positive("omega", omega, "rad/s")
    samples, held = len(time), float(time[-1] - time[0])
    count = math.ceil(length * (samples - 1) / held - 1e-9) if held > 0.0 else samples + 1
    if count > samples:
        raise ValueError(
            f"record must hold {periods} periods ({length:.3g} s), got {held:.3g} s; "
            "simulate longer"
        )
    return slice(samples - count, samples)


def rms(values: ArrayLike) -> float:
    """Return the root mean square of `values`, array (k,), in their own unit.

    Raises
    ------
    ValueError
        If there are none, or they are no numbers.
    """
    array = _row("values", values)
    return float(np.sqrt(np.mean(array * array)))


def settling_time(t: ArrayLike, envelope: ArrayLike, left: float, band: float = 0.05) -> float:
    """Return when an envelope comes down to what is left in the end, for good.

    Parameters
    ----------
    t : array_like (k,)
        Times [s].
    envelope : array_like (k,)
        Envelope amplitude over the uncontrolled one [-].
    left : float
        What is left of it in the end [-].
    band : float
        How far above that counts as settled [-]: a share of the uncontrolled amplitude.

    Returns
    -------
    float
        Time since `t[0]` [s]; infinite where it is outside the band to the last sample, or does
        not stay finite.

    Raises
    ------
    ValueError
        If there is no sample, the lengths differ, times do not rise, or a number is out of range.
    """
    positive("band", band)
    finite("what is left", left, "-")
    time, values = _record(t, "envelope", envelope)
    if not np.all(np.diff(time) > 0.0):
        raise ValueError("t must rise, got times that fall or repeat; sort the samples")
    inside = values <= left + band  # false where it is no number
    outside = np.flatnonzero(~inside)
    first = int(outside[-1]) + 1 if outside.size else 0
    return float(time[first] - time[0]) if first < len(time) else math.inf


def _check_amplitudes(uncontrolled: float, controlled: float) -> None:
    for name, value in (("uncontrolled", uncontrolled), ("controlled", controlled)):
        if value != math.inf:  # a motion that grows for ever has that amplitude
            finite(f"{name} amplitude", value, "m")
        if value < 0.0:
            raise ValueError(
                f"{name} amplitude must not be negative, got {value:g} m; give 0 m or more"
            )


def _record(t: ArrayLike, name: str, values: ArrayLike) -> tuple[Array, Array]:
    time, array = _row("t", t), _row(name, values)
    if len(array) != len(time):
        raise ValueError(
            f"{name} must have the {len(time)} samples of t, got {len(array)}; give one for each"
        )
    return time, array


def _row(name: str, values: ArrayLike) -> Array:
    array = numbers(name, values)
    if array.ndim != 1 or not array.size:
        raise ValueError(
            f"{name} must be a row of numbers, got shape {array.shape}; give at least one"
        )
    return array
