"""Figures have labelled axes, one colour for each law, and draw what they are given."""

import dataclasses

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from qcar_env.analysis.paper import experiments
from qcar_env.analysis.paper.forced_car import from_scenario, stack, sweep
from qcar_env.analysis.paper.frequency_response import Bifurcation, response
from qcar_env.analysis.paper.stability import compare_with_floquet, stability_map
from qcar_env.control import CNVC, PPF, Passive
from qcar_env.plots import paper_figures, response as drawing
from qcar_env.plots.style import LINES, journal
from qcar_env.scenarios import scenario

LAWS = {"none": Passive(), "cnvc": CNVC()}


@pytest.fixture(scope="module")
def car():
    return from_scenario(scenario("paper"))


@pytest.fixture(autouse=True)
def _headless():
    previous = mpl.get_backend()
    plt.switch_backend("Agg")
    with journal():
        yield
    plt.close("all")
    plt.switch_backend(previous)


@pytest.fixture(scope="module")
def curve(car):
    return response(car, "sigma1", -5.0, 5.0, longest=0.3)


@pytest.fixture(scope="module")
def histories(car):
    return experiments.time_histories(car, LAWS, duration=2.0)


def every_axis_is_labelled(figure):
    axes = [ax for ax in figure.axes if ax.get_visible() and ax.get_label() != "<colorbar>"]
    assert axes
    for ax in axes:
        assert "[" in ax.get_xlabel()
        # panels of a row may share the label of the first
        row = [
            other
            for other in axes
            if other.get_subplotspec().rowspan == ax.get_subplotspec().rowspan
        ]
        assert any("[" in other.get_ylabel() for other in row)
    return figure


def colors(figure):
    return {to_hex(each.get_color()) for ax in figure.axes for each in ax.get_lines()}


def test_stable_parts_are_solid_and_unstable_dashed(curve):
    half = np.where(np.arange(len(curve.values))[:, None] < 4, 1.0, -1.0) + 0j * curve.eigenvalues
    fold = Bifurcation(kind="fold", value=0.0, a1=0.5, a2=0.5)
    made_up = dataclasses.replace(curve, eigenvalues=half, bifurcations=(fold,))
    _, ax = plt.subplots()
    assert drawing.response_curve(ax, made_up, "a1", label="one", color="#123456") is ax
    dashed, solid, tick = ax.get_lines()
    assert dashed.get_linestyle() == "--"
    assert solid.get_linestyle() == "-"
    assert tick.get_xdata()[0] == 0.0
    np.testing.assert_array_equal(dashed.get_xdata(), curve.values[:5])  # joined to the next part
    np.testing.assert_array_equal(solid.get_ydata(), curve.a1[4:])
    assert ax.get_legend_handles_labels()[1] == ["one"]


def test_figure_3(car, histories):
    figure = paper_figures.time_and_phase(histories, 2 * np.pi / car.omega, 1.5)
    every_axis_is_labelled(figure)
    assert len(figure.axes) == 6
    assert colors(figure) == {LINES["none"].color.lower(), LINES["cnvc"].color.lower()}


def test_figures_4_and_14(car, curve):
    curves = {"sigma1": {"none": curve}, "sigma2": {"none": curve}}
    points = experiments.SimulatedPoints(
        parameter="sigma1", values=np.zeros(3), a1=np.ones(3), a2=np.ones(3)
    )
    every_axis_is_labelled(paper_figures.responses(curves))
    simulated = {name: {"none": points} for name in curves}
    figure = paper_figures.responses(curves, simulated, curves)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [
        "no control, averaged",
        "no control, harmonic balance",
        "no control, simulated",
    ]


def test_legends_stay_inside_the_figure(car, curve):
    """The legend of Fig. 14 was cut off at both sides once."""
    curves = {"sigma1": dict.fromkeys(LAWS, curve), "sigma2": dict.fromkeys(LAWS, curve)}
    points = experiments.SimulatedPoints(
        parameter="sigma1", values=np.zeros(3), a1=np.ones(3), a2=np.ones(3)
    )
    figure = paper_figures.responses(
        curves, {name: dict.fromkeys(LAWS, points) for name in curves}, curves
    )
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.width


@pytest.mark.parametrize("effects", experiments.EFFECTS, ids=lambda e: f"figure {e.figure}")
def test_figures_5_to_8(car, curve, effects):
    from qcar_env.analysis.paper.parameter_study import Curve

    panels = {
        name: [Curve(setting={name: value}, response=curve) for value in (1.0, 2.0, 3.0)]
        for name in effects.claims
    }
    figure = every_axis_is_labelled(paper_figures.parameter_effects(effects, panels))
    shown = [ax for ax in figure.axes if ax.get_visible()]
    assert len(shown) == len(effects.claims)
    assert [ax.get_title(loc="left") for ax in shown[:2]] == ["(A)", "(B)"]


def test_figure_9(histories, curve):
    wide = dataclasses.replace(curve, values=np.linspace(30.0, 80.0, len(curve.values)))
    figure = paper_figures.frequency_effect(
        {33.0: histories["cnvc"], 55.0: histories["cnvc"]}, {"none": wide, "cnvc": wide}, 0.5
    )
    every_axis_is_labelled(figure)


def test_figures_10_to_13(car, histories, curve):
    figure = paper_figures.hump_height({"frequencies": {33.0: curve}, "f": {10.0: curve}})
    every_axis_is_labelled(figure)
    every_axis_is_labelled(paper_figures.step_hump(histories, histories))
    ppf = experiments.time_histories(car, {"ppf": PPF()}, duration=2.0)["ppf"]
    rows = [
        {"none": ("none", histories["none"]), "30": ("ppf", ppf), "70": ("ppf", ppf)},
        {"cnvc": ("cnvc", histories["cnvc"])},
    ]
    figure = every_axis_is_labelled(paper_figures.law_comparison(rows, 2 * np.pi / car.omega, 2.0))
    first, second = (each.get_color() for each in figure.axes[0].get_lines()[1:])
    assert to_hex(first) == LINES["ppf"].color.lower()
    assert first != second
    both = {law: experiments.transient(experiments.with_law(car, one), duration=2.0)
            for law, one in LAWS.items()}  # fmt: skip
    every_axis_is_labelled(
        paper_figures.numerical_and_averaged(both, 2 * np.pi / car.omega, {"none": 1, "cnvc": 1})
    )


def test_peaks_of_each_period(histories, car):
    """The drawn envelope of a known motion: x = e^-t cos(omega t)."""
    t = np.arange(0.0, 2.0, 1e-3)
    x = np.exp(-t) * np.cos(car.omega * t)
    motion = dataclasses.replace(histories["none"], t=t, x1=x)
    middle, peaks = paper_figures._peaks(motion, 0, 2 * np.pi / car.omega)
    np.testing.assert_allclose(peaks, np.exp(-middle), rtol=0.08)  # half a period of decay


def test_our_own_figures(car):
    sigma = np.linspace(-5.0, 5.0, 5)
    found = experiments.approximation_errors(car, "sigma1", sigma, duration=30.0)
    every_axis_is_labelled(paper_figures.accuracy({"none": {"sigma1": found, "sigma2": found}}))
    regions = stability_map(car, "E3", [1.0, 300.0, 600.0], "E2", [1.0, 4.0, 8.0])
    rates = compare_with_floquet(stack(list(sweep(car, "E3", [1.0, 600.0]))))
    figure = paper_figures.stability(regions, {"none": (np.array([1.0, 600.0]), rates)}, "E3")
    every_axis_is_labelled(figure)


@pytest.mark.parametrize("law", paper_figures.SHADES)
def test_shades_of_a_law_are_told_apart_in_grey(law):
    """Relative luminance of neighbours differs by at least 0.1."""
    luminance = [
        float(np.dot([0.2126, 0.7152, 0.0722], to_rgb(c))) for c in paper_figures.SHADES[law]
    ]
    assert min(-np.diff(luminance)) > 0.1
    assert paper_figures.SHADES[law][1].lower() == LINES[law].color.lower()
