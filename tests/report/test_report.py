"""A report holds what was measured, in plotly's words, and nothing that could break the page."""

import base64
import dataclasses
import json
import re

import numpy as np
import plotly.graph_objects as go
import pytest

import qcar_env.report
from qcar_env.agents.load import load
from qcar_env.analysis.optimum import period_optimum
from qcar_env.baselines import catalogue
from qcar_env.commands import compare
from qcar_env.control import LAWS
from qcar_env.evaluation.benchmark import run
from qcar_env.evaluation.comparison import PERIODS, Comparison
from qcar_env.evaluation.outcome import outcome
from qcar_env.evaluation.rollouts import rollout
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.physics.tree import flat
from qcar_env.plots.style import line
from qcar_env.report.benchmark import benchmark, page
from qcar_env.report.comparison import comparison, page as page_of_comparison
from qcar_env.report.content import Chart, Column, Curve, history, parameters
from qcar_env.report.page import cell, render, specification
from qcar_env.scenarios import SCENARIOS, scenario


def compared(name, laws, duration, learned=()):
    base = scenario(name)
    policies = {law: catalogue.make(law, base) for law in laws}
    policies |= {agent: load(agent) for agent in learned}
    rollouts = {law: rollout(policy, base, duration=duration) for law, policy in policies.items()}
    periods = PERIODS if base.excitation.harmonic else None
    outcomes = [outcome(law, each, periods=periods) for law, each in rollouts.items()]
    return Comparison(
        scenario=base,
        outcomes=tuple(outcomes),
        rollouts=rollouts,
        laws={law: policies[law].law for law in laws},
        learned=tuple(learned),
        duration=duration,
    )


def report_of(name, laws, duration):
    found = compared(name, laws, duration)
    content = comparison(found, {"command": "a test"})
    return found.scenario, found.rollouts, found.outcomes, content


@pytest.fixture(scope="module")
def paper():
    return report_of("paper", ("none", "cnvc", "lnvc"), 40.0)  # steady


def test_the_page_has_the_policies_of_the_comparison_and_its_headline_the_best(tmp_path):
    """Learned ones were left out, and CNVC was said to leave the least."""
    found = compared("paper", ("none", "cnvc", "lnvc"), 40.0, ("ppo-paper", "sac-paper"))
    text = page_of_comparison(tmp_path / "report.html", found).read_text(encoding="utf-8")
    assert "PPO leaves the least vibration" in text
    content = comparison(found, {"command": "a test"})
    labels = {line(each.policy).label for each in found.outcomes}
    assert {row[0] for row in content.tables[0].rows} == labels
    assert content.shown == ("no control", "PPO", "CNVC", "LNVC")


def test_the_leaderboard_has_every_policy_best_first(paper):
    _, _, outcomes, content = paper
    board = content.tables[0]
    assert [row[0] for row in board.rows] == ["CNVC", "LNVC", "no control"]
    by_label = {line(each.policy).label: each for each in outcomes}
    for row, colour in zip(board.rows, board.colours, strict=True):
        found = by_label[row[0]]
        assert row[1:4] == (found.rho, *found.amplitudes)
        assert colour == line(found.policy).color
        assert len(row) == len(board.columns)


def test_no_policy_lies_below_the_optimum_line(paper):
    base, _, outcomes, content = paper
    frontier = content.charts[0]
    optimum = frontier.curves[0]
    assert optimum.y[-1] == pytest.approx(period_optimum(base).rho, abs=1e-9)
    for curve in frontier.curves[1:]:
        assert curve.y[0] >= np.interp(curve.x[0], optimum.x, optimum.y) - 0.3 / 100  # chord
    assert {each.policy for each in outcomes} == {"none", "cnvc", "lnvc"}


def test_response_curves_pass_through_the_uncontrolled_amplitude(paper):
    base, _, _, content = paper
    for chart, amplitude in zip(content.charts[1:], base.reference_amplitudes, strict=True):
        free = next(each for each in chart.curves if each.label == "no control")
        assert np.interp(55.0, free.x, free.y) == pytest.approx(amplitude, rel=1e-3)


def test_a_history_keeps_beginning_end_and_peaks(paper):
    base, rollouts, _, _ = paper
    each = rollouts["cnvc"]
    kept = history("cnvc", each)
    k = len(kept.first)
    np.testing.assert_array_equal(kept.first[:, 0], each.x1[:k])
    np.testing.assert_array_equal(kept.last[:, 3], each.v2[-len(kept.last) :])
    np.testing.assert_array_equal(kept.last[:, 4:], each.force[-len(kept.last) :])
    assert kept.last_start == each.t[-len(kept.last)]
    assert len(kept.last) * each.scenario.dt >= 5 * 2.0 * np.pi / base.reference_frequency - 0.03
    assert kept.high.max() <= max(each.x1.max(), each.x2.max())
    period = 2.0 * np.pi / base.reference_frequency
    near = np.abs(each.t - kept.middles[-1]) <= 0.5 * period
    assert kept.high[-1, 0] == pytest.approx(each.x1[near].max(), rel=0.05)  # 23 samples a period


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_parameter_of_every_scenario_is_listed(name):
    base = scenario(name)
    table = parameters(base)
    values = [row[2] for row in table.rows]
    numbers = flat((base.car.numbers, base.excitation.h, base.actuator.limit, base.dt, base.speed))
    for number in numbers:
        assert number in values
    assert base.source in table.note
    if base.randomisation:
        assert any("drawn" in str(row[0]) for row in table.rows)


def test_one_actuator_and_a_hump_make_a_report_too():
    _, _, _, content = report_of("mathworks-hump", ("none", "lnvc"), 2.0)
    assert content.charts == ()  # a crossing has no steady state, so no optimum line over it
    assert content.histories[0].first.shape[1] == 5
    assert "mathworks-hump" in render(content)


def test_charts_are_valid_plotly(paper):
    _, _, _, content = paper
    curves = (
        *content.charts[0].curves,
        Curve(
            label="interval",
            x=np.arange(3.0),
            y=np.array([1.0, np.nan, 3.0]),
            colour="#0072B2",
            low=np.zeros(3),
            high=np.full(3, 4.0),
        ),
    )
    chart = Chart(title="c", x_label="x", y_label="y", curves=curves, logarithmic=True)
    for each in (*content.charts, chart):
        go.Figure(specification(each))  # raises on a property that plotly does not know
    assert specification(chart)["data"][-1]["y"] == [1.0, None, 3.0]


def test_a_label_that_is_markup_does_not_end_the_data(paper):
    """After "<!--<script>" a browser takes the next "</script>" for a part of the data."""
    label = "<!--<script></script>"
    *_, content = paper
    first, *others = content.histories
    histories = (dataclasses.replace(first, label=label), *others)
    page = render(dataclasses.replace(content, histories=histories))
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page)[1]
    assert "<" not in data
    assert json.loads(data)["histories"][0]["label"] == label


def test_packed_arrays_are_the_rollouts_to_32_bits(paper):
    _, rollouts, _, content = paper
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', render(content))
    packed = json.loads(found[1])["histories"][1]["first"]
    values = np.frombuffer(base64.b64decode(packed["data"]), dtype="<f4").reshape(packed["shape"])
    np.testing.assert_array_equal(values[:, 0], rollouts["cnvc"].x1[:600].astype("<f4"))


def test_the_page_needs_nothing_from_outside(paper):
    page = render(paper[3])
    markup = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"(src|href|url)\W{1,3}https?:|@import", markup)
    assert len(page.encode()) < 8e6


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "–"),
        ("text", "text"),
        (0.0, "0"),
        (280.0, "280"),
        (0.11384, "0.1138"),
        (1.0, "1"),
        (-19.83, "-19.83"),
        (3.2e-7, "3.200e-07"),
        (float("inf"), "∞"),
        (float("nan"), "–"),
    ],
)
def test_numbers_have_the_digits_of_their_column(value, shown):
    assert cell(value, Column(title="x", digits=4)) == shown


def test_parameters_show_no_digits_that_they_do_not_have():
    column = Column(title="value", digits=5, exact=True)
    assert [cell(value, column) for value in (0.005, 2510.0, 0.71)] == ["0.005", "2510", "0.71"]


def test_compare_writes_a_report_when_asked(tmp_path, capsys):
    arguments = ["--scenario", "paper-hump", "--laws", "none", "cnvc", "--duration", "2"]
    assert compare.main([*arguments, "--out", str(tmp_path), "--report"]) == 0
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert "report.html" in capsys.readouterr().out


def test_absent_plotly_is_named_before_anything_is_simulated(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(qcar_env.report, "find_spec", lambda name: None)
    assert compare.main(["--out", str(tmp_path), "--report"]) == 2
    assert "a report needs plotly: pip install" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_every_law_of_the_catalogue_has_a_colour_of_its_own():
    colours = [line(name).color for name in LAWS]
    assert len(set(colours)) == len(colours)


@pytest.fixture(scope="module")
def benchmark_report():
    """A report of two policies on the track with several limits, in the process of the test."""
    where = dataclasses.replace(TRACKS["budget"], force_scales=(1.0, 0.5), episodes=2)
    return where, run([where], [catalogue.entry("cnvc"), catalogue.entry("lnvc")])


def test_the_benchmarks_report_has_every_standing_and_the_optimum(benchmark_report):
    _, outcome = benchmark_report
    content = benchmark(outcome, {"command": "a test"})
    board = content.tables[0]
    assert [row[0] for row in board.rows] == ["optimum", "cnvc", "lnvc"]
    for each in outcome.standings:
        row = next(row for row in board.rows if row[0] == each.policy)
        assert each.rho.value in row
    frontier = content.charts[0]
    assert frontier.curves[0].label.startswith("optimum")
    for curve in frontier.curves[1:]:
        assert np.all(curve.y >= frontier.curves[0].y - 1e-6)
        assert np.all(curve.low <= curve.y)
        assert np.all(curve.y <= curve.high)
    assert {each.group for each in content.histories} == {
        "budget, force limit 1",
        "budget, force limit 0.5",
    }
    assert len(content.tables[1].rows) == 4
    for each in content.charts:
        go.Figure(specification(each))
    page = render(content)
    assert "budget, force limit 0.5" in page
    assert '<option value="whole"' not in page


def test_the_benchmarks_page_is_written_from_its_outcome(benchmark_report, tmp_path):
    _, outcome = benchmark_report
    found = page(tmp_path / "report.html", outcome)
    assert found.read_text(encoding="utf-8").startswith("<!doctype html>")
