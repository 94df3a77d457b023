import numpy as np
import pytest
from scipy import stats

from qcar_env.evaluation.statistics import (
    bootstrap,
    cvar,
    improvement_interval,
    mean,
    probability_of_improvement,
    share_interval,
)


@pytest.mark.parametrize(("n", "count"), [(1, 1), (8, 1), (64, 3), (512, 26)])
def test_cvar_is_the_mean_of_the_worst(n, count):
    values = np.random.default_rng(n).permutation(np.arange(float(n)))
    assert cvar(np.tile(values, (2, 1))).tolist() == [n - 0.5 * (count + 1)] * 2
    assert cvar(values, worst=1.0) == mean(values)


def test_the_interval_holds_the_truth_as_often_as_it_says():
    # 400 intervals of 95 %: the share inside has a standard deviation of 1.1 %; percentile
    # intervals of 40 values are known to be somewhat narrow (a mean's by sqrt(39/40) and the
    # t quantile), so 92 to 98 %.
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(400):
        found = bootstrap([rng.normal(3.0, 2.0, 40)], mean, rng, resamples=400)
        inside += found.low <= 3.0 <= found.high
    assert 0.91 <= inside / 400 <= 0.98


def test_the_width_is_that_of_the_standard_error():
    values = np.random.default_rng(2).normal(size=400)
    found = bootstrap([values], mean, np.random.default_rng(0), resamples=4000)
    expected = 2.0 * 1.96 * values.std() / np.sqrt(400)
    assert found.high - found.low == pytest.approx(expected, rel=0.08)  # 4000 resamples: 3 %
    assert found.value == pytest.approx(values.mean())


def test_strata_keep_their_shares():
    # Between the strata lies everything, inside them nothing: no resample moves the mean.
    found = bootstrap([np.zeros(10), np.full(30, 4.0)], mean, np.random.default_rng(0))
    assert (found.low, found.value, found.high) == (3.0, 3.0, 3.0)


def test_a_seed_decides():
    values = [np.arange(20.0)]
    first = bootstrap(values, mean, np.random.default_rng(5))
    assert first == bootstrap(values, mean, np.random.default_rng(5))
    assert first != bootstrap(values, mean, np.random.default_rng(6))


def test_probability_of_improvement_is_mann_whitney():
    rng = np.random.default_rng(3)
    x, y = rng.normal(0.0, 1.0, 60), rng.normal(0.5, 1.0, 80)
    u = stats.mannwhitneyu(y, x).statistic  # counts y > x
    assert probability_of_improvement(x, y) == pytest.approx(u / (60 * 80))
    assert probability_of_improvement(x, y) + probability_of_improvement(y, x) == 1.0
    assert probability_of_improvement([1.0, 1.0], [1.0]) == 0.5


def test_probability_of_improvement_of_shifted_normals():
    # P(X < Y) = Phi(d / sqrt 2) for unit normals d apart.
    rng = np.random.default_rng(4)
    x, y = rng.normal(0.0, 1.0, 400), rng.normal(1.0, 1.0, 400)
    found = improvement_interval([x[:200], x[200:]], [y[:200], y[200:]], rng, resamples=300)
    truth = stats.norm.cdf(1.0 / np.sqrt(2.0))
    assert found.low < truth < found.high
    assert found.high - found.low < 0.1


@pytest.mark.parametrize("trials", [1, 7, 48])
def test_the_interval_of_a_share_is_that_of_the_binomial_test(trials):
    count = np.arange(trials + 1)
    low, high = share_interval(count, trials, level=0.9)
    for k in count:
        expected = stats.binomtest(int(k), trials).proportion_ci(0.9, method="exact")
        assert low[k] == pytest.approx(expected.low, abs=1e-12)
        assert high[k] == pytest.approx(expected.high, abs=1e-12)


def test_the_interval_of_a_share_refuses_impossible_counts():
    with pytest.raises(ValueError, match="between 0 and 4 trials"):
        share_interval([1, 5], 4)
    with pytest.raises(ValueError, match="level must lie between"):
        share_interval([1], 4, level=1.0)


def test_bad_values_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="strata must not be empty"):
        bootstrap([], mean, rng)
    with pytest.raises(ValueError, match="row of finite numbers"):
        bootstrap([[1.0, np.nan]], mean, rng)
    with pytest.raises(ValueError, match="level must lie between 0 and 1"):
        bootstrap([[1.0]], mean, rng, level=95.0)
    with pytest.raises(ValueError, match="same strata"):
        improvement_interval([[1.0]], [], rng)


@pytest.mark.parametrize("statistic", [cvar, mean])
@pytest.mark.parametrize("values", [[], np.empty((3, 0)), 1.0], ids=["empty", "empty rows", "bare"])
def test_a_statistic_of_nothing_is_refused(statistic, values):
    with pytest.raises(
        ValueError, match=r"values must have entries .* got shape .*; give at least"
    ):
        statistic(values)


@pytest.mark.parametrize(
    ("better", "worse", "options", "message"),
    [
        ([], [], {}, "strata must not be empty; give at least one group"),
        (None, [[1.0]], {}, "strata must be a sequence of groups of values, got None; give a row"),
        ([1.0], [2.0], {}, r"values must be a row of finite numbers, got shape \(\)"),
        ([[1.0]], [], {}, "must have the same strata, got 1 and 0; give one group"),
        ([[1.0]], [[2.0]], {"level": 2.0}, "level must lie between 0 and 1, got 2.0; give 0.95"),
        ([[1.0]], [[2.0]], {"level": np.nan}, "level must be finite, got nan"),
        ([[1.0]], [[2.0]], {"level": None}, "level must be a number, got None"),
        ([[1.0]], [[2.0]], {"resamples": 0}, "resamples must be at least 1, got 0"),
    ],
)
def test_the_improvement_of_nothing_is_refused(better, worse, options, message):
    with pytest.raises(ValueError, match=message):
        improvement_interval(better, worse, np.random.default_rng(0), **options)
