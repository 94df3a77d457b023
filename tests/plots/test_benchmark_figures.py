"""The benchmark's figures draw what they are given and nothing below it."""

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from qcar_env.evaluation.statistics import Interval, share_interval
from qcar_env.plots import benchmark
from qcar_env.plots.style import shared_legend

LIMITS = [0.25, 0.5, 1.0]


def interval(value):
    return Interval(value=value, low=0.9 * value, high=1.1 * value, level=0.95)


@pytest.fixture
def ax():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def test_the_frontier_shows_values_and_intervals(ax):
    policies = {"cnvc": [interval(0.6), interval(0.3), None], "learned": [None, None, None]}
    given = benchmark.frontier(
        ax,
        LIMITS,
        policies,
        optimum_limits=[0.25, 1.0],
        lower=[0.5, 0.0],
        upper=[0.51, 1e-6],
    )
    assert given is ax
    assert ax.get_yscale() == "log"
    labels = ax.get_legend_handles_labels()[1]
    assert labels == ["optimum", "CNVC"]  # what did not run is not drawn
    drawn = ax.containers[0].lines[0]
    np.testing.assert_allclose(drawn.get_xydata(), [[0.25, 0.6], [0.5, 0.3]])


def test_bars_are_percent_above_the_optimum_where_there_is_one(ax):
    policies = {"cnvc": [interval(0.6), interval(0.3), interval(0.1)]}
    benchmark.over_optimum(ax, LIMITS, policies, [0.5, 0.25, 0.0])
    heights = [bar.get_height() for bar in ax.patches]
    np.testing.assert_allclose(heights, [20.0, 20.0])  # the third would divide by zero
    assert [label.get_text() for label in ax.get_xticklabels()] == ["0.25", "0.5"]


def test_shares_end_at_one(ax):
    benchmark.shares(ax, {"cnvc": [0.2, 0.1, 0.4]}, [0.05, 0.05, 0.1])
    for line in ax.get_lines():
        assert line.get_ydata()[0] == 0.0
        assert line.get_ydata()[-1] == 1.0
    assert ax.get_lines()[1].get_xdata()[-1] == 0.4


def test_robustness_has_a_band_of_the_share_around_each_line(ax):
    benchmark.shares(ax, {"cnvc": [0.2, 0.1, 0.4]}, [0.05, 0.05, 0.1])
    assert len(ax.collections) == 2
    for band in ax.collections:
        edges = band.get_paths()[0].vertices
        low, high = share_interval([1], 3)
        assert np.any(np.isclose(edges[:, 1], low[0]))
        assert np.any(np.isclose(edges[:, 1], high[0]))


def test_histories_and_forces(ax):
    t = np.linspace(0.0, 0.1, 21)
    x = np.stack([np.sin(60 * t)] * 4, axis=1)
    force = np.stack([280.0 * np.cos(60 * t), 33.0 * np.cos(60 * t)], axis=1)
    figure = plt.figure()
    axes = benchmark.histories(figure, {"cnvc": (t, x, force)}, (1.0, 2.0), (280.0, 33.0))
    assert axes.shape == (2, 2)
    np.testing.assert_allclose(axes[0, 1].get_lines()[0].get_ydata(), x[:, 1] / 2.0)
    np.testing.assert_allclose(axes[1, 0].get_lines()[0].get_ydata(), np.cos(60 * t))
    shared_legend(figure, list(axes.ravel()))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["CNVC"]
    plt.close(figure)
    benchmark.force_against_velocity(ax, x[:, 2], force[:, 0], "cnvc", limit=280.0)
    assert len(ax.get_lines()) == 3  # the points and both limits


def test_every_look_is_another_one():
    looks = [(look.color, look.linestyle) for look in benchmark.LOOKS.values()]
    assert len(set(looks)) == len(looks)
    assert benchmark.look("my_module:policy").color


def test_robustness_writes_every_number_and_leaves_out_what_did_not_run(ax):
    found = {"cnvc": [0.102, 1.14], "mine": [0.0006, float("nan")]}
    benchmark.robustness(ax, found, ["nominal", "speed +10 %"])
    assert [text.get_text() for text in ax.texts] == [".102", "1.14", ".001"]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["cnvc", "mine"]
