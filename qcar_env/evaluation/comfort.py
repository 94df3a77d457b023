"""How much vibration a person feels: ISO 2631-1, and what the law says of a working day.

The functions take the *weighted* acceleration, `qcar_env.evaluation.weighting.weighted`: one record
(k,) or n records side by side (k, n), each sample standing for a time `dt`.

    a_w   = (1/T int a_w^2 dt)^(1/2)               root mean square [m/s^2], clause 6.1
    VDV   = (int a_w^4 dt)^(1/4)                   vibration dose value [m/s^1.75], 6.3.2
    MTVV  = max_t (1/tau int a_w^2 dt)^(1/2)       over the last tau = 1 s [m/s^2], 6.3.1
    crest = max |a_w| / a_w                        crest factor [-], 6.2.1

A hump is a shock: its root mean square depends on how much flat road the record holds, its dose
does not. Compare the dose, or the MTVV.

A quarter car's body is not a person: there is no seat, no pitch and no place in the car. The scales
are shown to rank motions, and are not validated for a quarter car.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from qcar_env.evaluation.weighting import rows
from qcar_env.validation import known, non_negative, positive

Running = Literal["linear", "exponential"]

INTEGRATION = 1.0  # [s] of the running root mean square, ISO 2631-1, 6.3.1
RUNNING = ("linear", "exponential")
DAY = 8.0 * 3600.0  # [s] that a daily exposure is referred to, Directive 2002/44/EC

# ISO 2631-1, annex C: weighted root mean square [m/s^2] from, to. The ranges overlap.
WORDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "not uncomfortable": (0.0, 0.315),
        "a little uncomfortable": (0.315, 0.63),
        "fairly uncomfortable": (0.5, 1.0),
        "uncomfortable": (0.8, 1.6),
        "very uncomfortable": (1.25, 2.5),
        "extremely uncomfortable": (2.0, math.inf),
    }
)

# Above which the root mean square says too little, ISO 2631-1, 6.2.2 and 6.3.3 [-].
CREST, MTVV_RATIO, VDV_RATIO = 9.0, 1.5, 1.75


class Exposure(NamedTuple):
    """Daily exposure of a worker, Directive 2002/44/EC, article 3."""

    a8: float  # root mean square over 8 h [m/s^2]
    vdv: float  # or the dose of the day [m/s^1.75]


ACTION = Exposure(0.5, 9.1)  # above it the employer must act
LIMIT = Exposure(1.15, 21.0)  # above it nobody must be exposed


def weighted_rms(aw: ArrayLike) -> Any:
    """Return the root mean square of a weighted acceleration (k,) or (k, n) [m/s^2].

    Returns
    -------
    float or ndarray (n,)

    Raises
    ------
    ValueError
        If the samples are not finite, or of another shape.
    """
    a = rows("weighted acceleration", aw, "m/s^2")
    return _out(np.sqrt(np.mean(a * a, axis=0)))


def vdv(aw: ArrayLike, dt: float) -> Any:
    """Return the vibration dose value [m/s^1.75] of samples every `dt` [s].

    It is the integral, not the mean, of the fourth power. Returns and errors: as `weighted_rms`.
    """
    a = rows("weighted acceleration", aw, "m/s^2")
    return _out((np.sum(a**4, axis=0) * positive("dt", dt, "s")) ** 0.25)


def running_rms(aw: ArrayLike, dt: float, running: Running = "linear") -> NDArray[np.float64]:
    """Return the running root mean square at each sample [m/s^2], of the shape of `aw`.

    Parameters
    ----------
    aw : array_like (k,) or (k, n)
        Weighted acceleration [m/s^2]; 0 before the first sample.
    dt : float
        Time between two samples [s].
    running : {"linear", "exponential"}
        Over the last second, or all that was with a weight that fades with 1 s.
    """
    a = rows("weighted acceleration", aw, "m/s^2")
    dt = positive("dt", dt, "s")
    power = a * a
    if known("running mean", running, RUNNING) == "exponential":
        fades = math.exp(-dt / INTEGRATION)
        found: Any = lfilter([1.0 - fades], [1.0, -fades], power, axis=0)
        return np.sqrt(found)
    total = np.cumsum(power, axis=0)
    count = max(1, round(INTEGRATION / dt))
    total[count:] -= total[:-count].copy()
    return np.sqrt(np.maximum(total, 0.0) * dt / max(INTEGRATION, dt))


def mtvv(aw: ArrayLike, dt: float, running: Running = "linear") -> Any:
    """Return the maximum transient vibration value [m/s^2] (arguments: as `running_rms`).

    Returns
    -------
    float or ndarray (n,)
    """
    return _out(running_rms(aw, dt, running).max(axis=0))


def crest_factor(aw: ArrayLike) -> Any:
    """Return the crest factor [-]; 0 where nothing moves. Returns and errors: as `weighted_rms`."""
    a = rows("weighted acceleration", aw, "m/s^2")
    mean = np.sqrt(np.mean(a * a, axis=0))
    return _out(np.abs(a).max(axis=0) / np.where(mean > 0.0, mean, 1.0))


def needs_more(aw: ArrayLike, dt: float) -> dict[str, Any]:
    """Return why the root mean square alone says too little, ISO 2631-1, 6.2.2 and 6.3.3.

    Returns
    -------
    dict
        The crest factor ``"crest"``, ``"mtvv"``, MTVV over root mean square, and ``"vdv"``, VDV
        over root mean square times T^(1/4) [-], of those that are above 9, 1.5 and 1.75: all that
        one has to report beside the root mean square. For n records, those of any of them.
    """
    a = rows("weighted acceleration", aw, "m/s^2")
    mean = np.sqrt(np.mean(a * a, axis=0))
    mean = np.where(mean > 0.0, mean, 1.0)
    ratios = {
        "crest": (crest_factor(a), CREST),
        "mtvv": (_out(mtvv(a, dt) / mean), MTVV_RATIO),
        "vdv": (_out(vdv(a, dt) / (mean * (len(a) * dt) ** 0.25)), VDV_RATIO),
    }
    return {name: value for name, (value, most) in ratios.items() if np.any(value > most)}


def words(rms: float) -> tuple[str, ...]:
    """Return what ISO 2631-1, annex C, calls a weighted root mean square [m/s^2].

    One word or two, as its ranges overlap. They are for public transport and minutes of it, not for
    one shock.
    """
    rms = non_negative("root mean square", rms, "m/s^2")
    return tuple(word for word, (low, high) in WORDS.items() if low <= rms <= high)


def a8(rms: float, exposure: float) -> float:
    """Return the daily exposure A(8) [m/s^2].

    Parameters
    ----------
    rms : float
        Weighted root mean square while exposed [m/s^2].
    exposure : float
        How long a day [s].
    """
    time = non_negative("exposure", exposure, "s")
    return non_negative("root mean square", rms, "m/s^2") * math.sqrt(time / DAY)


def crossings(dose: float, value: float = ACTION.vdv) -> float:
    """Return how many equal crossings a day add up to a dose, ``(value / dose)^4`` [-].

    Parameters
    ----------
    dose : float
        Vibration dose value of one [m/s^1.75].
    value : float
        That of the day [m/s^1.75]; the action value 9.1 if left out.
    """
    dose = non_negative("dose", dose, "m/s^1.75")
    ratio = positive("value", value, "m/s^1.75") / dose if dose else math.inf
    return ratio**4 if ratio < 1e75 else math.inf


def _out(found: Any) -> Any:
    return float(found) if np.ndim(found) == 0 else found
