"""Statistics of few runs: mean, mean of the worst, stratified bootstrap, shares, improvement.

Source: R. Agarwal, M. Schwarzer, P. S. Castro, A. Courville, M. G. Bellemare, Deep reinforcement
learning at the edge of the statistical precipice, NeurIPS 2021. All draws come from the generator
that is passed in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from qcar_env.validation import finite, whole

Array = NDArray[np.float64]
Statistic = Callable[[Array], Array]

WORST = 0.05  # [-] share of the episodes that `cvar` looks at
RESAMPLES = 2000  # bootstrap resamples: the ends of a 95 % interval to a few % of its width


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A statistic with the interval that the bootstrap gives it, in the values' own unit."""

    value: float
    low: float
    high: float
    level: float  # share of resamples inside [-]


def mean(values: ArrayLike) -> Array:
    """Return the mean along the last axis, shape (...), of values (..., n)."""
    return _some(values).mean(axis=-1)


def cvar(values: ArrayLike, worst: float = WORST) -> Array:
    """Return the mean of the worst, the conditional value at risk, shape (...).

    Parameters
    ----------
    values : array_like (..., n)
        At least one value; larger is worse.
    worst : float
        Which share of them [-]; at least one value is taken.

    Raises
    ------
    ValueError
        If there is no value.
    """
    ordered = np.sort(_some(values), axis=-1)
    count = max(1, round(worst * ordered.shape[-1]))
    return ordered[..., -count:].mean(axis=-1)


def bootstrap(
    strata: Sequence[ArrayLike],
    statistic: Statistic,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    level: float = 0.95,
) -> Interval:
    """Return a statistic of all values with its stratified bootstrap interval (percentiles).

    Parameters
    ----------
    strata : sequence of array_like (n_s,)
        Values by stratum (a task, a force limit, a training seed); each stratum is resampled by
        itself, so that a resample holds as many of each as the data.
    statistic : callable
        Maps ``(..., n)`` to ``(...)``, as `mean` and `cvar`.
    rng : numpy.random.Generator
        Where the draws come from.
    resamples : int
        Number of resamples.
    level : float
        Share of resamples inside the interval [-], between 0 and 1.

    Raises
    ------
    ValueError
        If a stratum is empty or not finite, or a number is out of range.
    """
    groups = _groups(strata, resamples, level)
    _check_some(groups)
    drawn = [_drawn(each, rng, resamples) for each in groups]
    found = statistic(np.concatenate(drawn, axis=1))
    return _interval(statistic(np.concatenate(groups)), found, level)


def probability_of_improvement(better: ArrayLike, worse: ArrayLike) -> float:
    """Return the probability that a run of one policy has a lower value than one of another.

    Parameters
    ----------
    better, worse : array_like (n,), (k,)
        Values (smaller is better) of the policy that is asked about, and of the other.

    Returns
    -------
    float
        Share of pairs [-]; a tie counts half (Mann and Whitney's U over ``n k``).
    """
    return float(_improvement(_values(better), _values(worse)))


def improvement_interval(
    better: Sequence[ArrayLike],
    worse: Sequence[ArrayLike],
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    level: float = 0.95,
) -> Interval:
    """Return the probability of improvement, averaged over strata, with its interval.

    Parameters
    ----------
    better, worse : sequence of array_like
        Values by stratum, the same strata in both (see `bootstrap`).
    rng, resamples, level
        See `bootstrap`.

    Raises
    ------
    ValueError
        If the numbers of strata differ, or see `bootstrap`.
    """
    ours, theirs = (_groups(each, resamples, level) for each in (better, worse))
    if len(ours) != len(theirs):
        raise ValueError(
            f"both policies must have the same strata, got {len(ours)} and {len(theirs)}; "
            "give one group of values each for every stratum"
        )
    _check_some(ours)
    total = np.zeros(resamples)
    value = 0.0
    for x, y in zip(ours, theirs, strict=True):
        a, b = _drawn(x, rng, resamples), _drawn(y, rng, resamples)
        total += _improvement(a, b) / len(ours)
        value += probability_of_improvement(x, y) / len(ours)
    return _interval(value, total, level)


def share_interval(
    successes: ArrayLike, trials: int, *, level: float = 0.95
) -> tuple[Array, Array]:
    """Return the exact interval of a share, from how often something happened in some trials.

    Parameters
    ----------
    successes : array_like (...)
        How often it happened, 0 to `trials`.
    trials : int
        Number of independent trials.
    level : float
        Share of such intervals that hold the truth, at least [-], between 0 and 1.

    Returns
    -------
    low, high : ndarray (...)
        Ends of the interval of C. J. Clopper and E. S. Pearson, Biometrika 26 (1934), 404-413.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    whole("trials", trials)
    _check_level(level)
    k = np.asarray(successes, dtype=np.float64)
    if not np.all((k >= 0.0) & (k <= trials)):
        raise ValueError(
            f"successes must lie between 0 and {trials} trials, got {successes}; count again"
        )
    tail = 0.5 * (1.0 - level)
    low = np.where(k > 0.0, stats.beta.ppf(tail, np.maximum(k, 1.0), trials - k + 1.0), 0.0)
    rest = np.maximum(trials - k, 1.0)
    high = np.where(k < trials, stats.beta.ppf(1.0 - tail, k + 1.0, rest), 1.0)
    return low, high


def _check_level(level: float) -> None:
    if not 0.0 < finite("level", level) < 1.0:
        raise ValueError(f"level must lie between 0 and 1, got {level}; give 0.95")


def _some(given: ArrayLike) -> Array:
    values = np.asarray(given, dtype=np.float64)
    if not values.ndim or not values.shape[-1]:
        raise ValueError(
            f"values must have entries along the last axis, got shape {values.shape}; "
            "give at least one"
        )
    return values


def _groups(strata: Sequence[ArrayLike], resamples: int, level: float) -> list[Array]:
    """Check what a bootstrap is given, and return its strata."""
    whole("resamples", resamples)
    _check_level(level)
    try:
        return [_values(each) for each in strata]
    except TypeError:
        raise ValueError(
            f"strata must be a sequence of groups of values, got {strata!r}; give a row for each"
        ) from None


def _check_some(groups: Sequence[Array]) -> None:
    if not groups:
        raise ValueError("strata must not be empty; give at least one group of values")


def _drawn(values: Array, rng: np.random.Generator, resamples: int) -> Array:
    """Return resamples (resamples, n) of values (n,)."""
    return values[rng.integers(len(values), size=(resamples, len(values)))]


def _improvement(better: Array, worse: Array) -> Array:
    """Return the share of pairs along the last axes that are better; a tie counts half."""

    def share(x: Array, y: Array) -> float:
        ordered = np.sort(y)
        below, not_above = (np.searchsorted(ordered, x, side) for side in ("left", "right"))
        return 1.0 - float(np.mean(below + not_above)) / (2.0 * len(y))

    return np.vectorize(share, signature="(n),(k)->()")(better, worse)


def _interval(value: ArrayLike, resampled: Array, level: float) -> Interval:
    tail = 0.5 * (1.0 - level)
    low, high = np.quantile(resampled, (tail, 1.0 - tail))
    return Interval(value=float(np.asarray(value)), low=float(low), high=float(high), level=level)


def _values(given: ArrayLike) -> Array:
    values = np.asarray(given, dtype=np.float64)
    if values.ndim != 1 or not values.size or not np.all(np.isfinite(values)):
        raise ValueError(
            f"values must be a row of finite numbers, got shape {values.shape}; "
            "leave failed runs out and say so"
        )
    return values
