"""The report of `qcar benchmark`: every policy on every track, beside the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.evaluation import storage
from qcar_env.evaluation.benchmark import Outcome, Unit
from qcar_env.evaluation.score import Row
from qcar_env.evaluation.standings import Standing
from qcar_env.evaluation.tracks import Track
from qcar_env.plots.benchmark import LOOKS, look
from qcar_env.plots.style import Line, line
from qcar_env.report import content
from qcar_env.report.content import (
    Cell,
    Chart,
    Curve,
    Report,
    Table,
    curve,
    number,
    raised,
    thinned,
    words,
)
from qcar_env.report.page import write

SMALLEST = 1e-5  # [-] lower edge of logarithmic axes: stillness for any purpose
LEARNED_DASHES = ("-", (0, (6, 2)), (0, (1, 1)), (0, (4, 1, 1, 1)))  # all are of one colour
MOST_CURVES = 10  # in a chart at first; more than that hide one another


def page(path: Path, outcome: Outcome) -> Path:
    """Write the report of a benchmark to a file ending in .html, and return where."""
    provenance = {
        "command": storage.command(),
        "seed of the episodes": "the tracks' own" if outcome.seed is None else str(outcome.seed),
        "versions": storage.made_with(),
        "failed": "; ".join(map(str, outcome.failures)) or "none",
        "numbers": "table.csv and result.json beside this file",
    }
    return write(path, benchmark(outcome, provenance))


def benchmark(outcome: Outcome, provenance: Mapping[str, str]) -> Report:
    """Collect the report of a benchmark, with what is needed to make it again."""
    tracks, standings = outcome.homes, outcome.standings
    nominal = outcome.tracks[0].nominal
    shown = _shown(standings)
    looks = _looks(standings)
    charts = [
        _frontier(each, outcome, shown, looks) for each in tracks if len(each.force_scales) > 1
    ]
    charts += [
        _distribution(each, scale, outcome, shown, looks)
        for each in tracks
        if each.nominal.randomisation
        for scale in each.force_scales
    ]
    return Report(
        title="Benchmark",
        lead="How much vibration does each policy leave at equal force, and how far is that from "
        "the best that any force could do? rho is the larger of the two steady amplitudes over "
        "those without control: 1 is no control, 0 is stillness.",
        findings=outcome.findings,
        tables=(
            *(_board(each, outcome, looks) for each in tracks),
            *(_robustness(outcome, looks) for _ in outcome.cases[:1]),
            _everything(outcome.rows, nominal.actuator.unit, looks),
        ),
        charts=tuple(charts),
        histories=tuple(_histories(outcome, shown, looks)),
        force_unit=nominal.actuator.unit,
        parameters=content.parameters(nominal),
        provenance=provenance,
        shown=tuple(looks[name].label for name in shown[:4]),
        parts=("last",),
    )


def _looks(standings: Sequence[Standing]) -> dict[str, Line]:
    """Return how each policy is drawn; learned ones in one colour, told apart by their lines."""
    kinds = {each.policy: each.kind for each in standings}
    looks = {policy: look(policy) for policy in kinds}
    learned = [policy for policy, kind in kinds.items() if kind == "learned"]
    for policy, style in zip(learned, cycle(LEARNED_DASHES)):
        looks[policy] = Line(line("learned").color, style, policy)
    return looks


def _shown(standings: Sequence[Standing]) -> list[str]:
    """Return the policies that charts show: those with a look of their own, the best, yours."""
    there = list(dict.fromkeys(each.policy for each in standings))
    best: dict[Unit, Standing] = {}
    for each in sorted(standings, key=lambda each: each.rho.value):
        if each.kind == "learned":
            best.setdefault((each.track, each.force_scale), each)
    chosen = [name for name in LOOKS if name in there]
    chosen += list(dict.fromkeys(each.policy for each in best.values()))
    chosen += [each.policy for each in standings if each.kind == "yours"]
    return list(dict.fromkeys(chosen or there[:MOST_CURVES]))


def _board(track: Track, outcome: Outcome, looks: Mapping[str, Line]) -> Table:
    """Return a track's leaderboard: a row for each policy, a pair of columns for each limit."""
    scales = track.force_scales
    several = len(scales) > 1
    columns = words("policy")
    optimum: list[Cell] = ["optimum"]
    places: dict[str, dict[float, Standing]] = {}
    for scale in scales:
        where = f" at {scale:g}" if several else ""
        columns.append(number(f"rho{where}", "", 3, "mean over the episodes"))
        columns += words("95 %", note="bootstrap interval of rho")
        ranked = outcome.ranked(track.name, scale)
        optimum += [ranked[0].optimum if ranked else None, "certified"]
        for each in ranked:
            places.setdefault(each.policy, {})[scale] = each
        if not several:
            columns.append(number("worst", "", 3, "over the episodes"))
            columns.append(number("above 1", "%", 2, "episodes that end above no control"))
            columns.append(number("settled", "s", 2, "median"))
            optimum += [None, None, None]
    columns += words("gains", note="published, tuned, learned, or yours")
    columns += words("reads", note="what the policy is shown")
    rows: list[tuple[Cell, ...]] = [(*optimum, "", "")]
    for policy, found in places.items():
        cells: list[Cell] = [policy]
        for scale in scales:
            each = found.get(scale)
            if each is None:
                cells += [None, None]
                continue
            left = f", {each.terminated} left the travel limit" if each.terminated else ""
            cells += [each.rho.value, f"{each.rho.low:.3g} to {each.rho.high:.3g}{left}"]
            if not several:
                cells += [each.worst, 100.0 * each.above, each.settling]
        any_of = next(iter(found.values()))
        rows.append((*cells, any_of.kind, any_of.reads))
    note = "; the number behind rho is the force limit over the scenario's own" if several else ""
    return Table(
        title=f"Track {track.name}",
        note=f"{track.title}. Version {track.version}, {track.episodes} episodes of "
        f"{track.duration:g} s{note}.",
        columns=tuple(columns),
        rows=tuple(rows),
        colours=(line("optimum").color, *(looks[policy].color for policy in places)),
    )


def _robustness(outcome: Outcome, looks: Mapping[str, Line]) -> Table:
    """Return rho where policies meet what they were not made for."""
    found, first = outcome.by_case(), outcome.cases[0]
    return Table(
        title="Robustness",
        note=f"Policies of track {first.home.name} at force limit {first.force_scales[0]:g}, as "
        "they are, where one thing is another than what they were made for. Mean rho over "
        f"{first.episodes} episodes, relative to the uncontrolled motion of the case itself.",
        columns=(*words("policy"), *(number(each.name, "", 3) for each in outcome.cases)),
        rows=tuple((name, *values) for name, values in found.items()),
        colours=tuple(looks[name].color for name in found),
    )


def _everything(rows: Sequence[Row], unit: str, looks: Mapping[str, Line]) -> Table:
    """Return the means of every metric by policy, track and limit."""
    groups: dict[tuple[str, str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.policy, row.track, row.force_scale), []).append(row)
    metrics = (
        ("x1", "x1", "m"),
        ("x2", "x2", "m"),
        ("reduction_db_x1", "reduction x1", "dB"),
        ("reduction_db_x2", "reduction x2", "dB"),
        ("peak_force_1", "peak force wheel", raised(unit)),
        ("peak_force_2", "peak force body", raised(unit)),
        ("rms_force_1", "RMS force wheel", raised(unit)),
        ("rms_force_2", "RMS force body", raised(unit)),
        ("settling_time", "settling time", "s"),
    )
    return Table(
        title="All metrics",
        note="Means over the episodes of each track and force limit.",
        columns=(
            *words("policy", "track"),
            number("limit", digits=2),
            *(number(title, each, 3) for _, title, each in metrics),
        ),
        rows=tuple(
            (*key, *(_mean(group, name) for name, _, _ in metrics)) for key, group in groups.items()
        ),
        colours=tuple(looks[policy].color for policy, _, _ in groups),
    )


def _mean(rows: Sequence[Row], name: str) -> float:
    found = float(np.mean([getattr(row, name) for row in rows]))
    return 0.0 if name.startswith("reduction") and abs(found) < 0.01 else found


def _frontier(
    track: Track, outcome: Outcome, shown: Sequence[str], looks: Mapping[str, Line]
) -> Chart:
    """Return rho against the force limit, with the optimum below it."""
    scales = sorted(track.force_scales)
    bounds = [outcome.bounds[(track.name, s)] for s in scales]
    best = [float(np.mean([each.lower for each in b])) if b else np.nan for b in bounds]
    label = "optimum: no policy can be below"
    optimum: dict[str, Any] = {"label": label, "dash": "dot", "mode": "lines+markers"}
    curves = [curve(look("optimum"), scales, np.maximum(best, SMALLEST), **optimum)]
    found = {s: {each.policy: each.rho for each in outcome.ranked(track.name, s)} for s in scales}
    for policy in shown:
        there = {s: each[policy] for s, each in found.items() if policy in each}
        if there:
            value, low, high = (
                np.maximum([getattr(each, name) for each in there.values()], SMALLEST)
                for name in ("value", "low", "high")
            )
            band: dict[str, Any] = {"low": low, "high": high, "mode": "lines+markers"}
            curves.append(curve(looks[policy], list(there), value, **band))
    return Chart(
        title=f"Amplitude against force limit, track {track.name}",
        note="Bands are 95 % intervals. Press a name in the legend to hide it, twice to see it "
        f"alone. The optimum is certified; {SMALLEST:g} and less is drawn as stillness.",
        x_label="force limit over the scenario's own [-]",
        y_label="rho [-]",
        curves=tuple(curves),
        logarithmic=True,
    )


def _distribution(
    track: Track, scale: float, outcome: Outcome, shown: Sequence[str], looks: Mapping[str, Line]
) -> Chart:
    """Return the share of held-out episodes that end below each rho."""

    def share(values: Sequence[float], style: Line, **more: Any) -> Curve:
        ordered = np.sort(np.asarray(values, dtype=np.float64))
        below = 100.0 * (np.arange(1, len(ordered) + 1) / len(ordered))
        return curve(style, np.maximum(ordered, SMALLEST), below, **more)

    lower = [each.lower for each in outcome.bounds[(track.name, scale)]]
    rho = outcome.by_policy(track.name, scale)
    curves = [share(lower, look("optimum"), dash="dot")]
    curves += [share(rho[policy], looks[policy]) for policy in shown if policy in rho]
    return Chart(
        title=f"Held-out episodes, force limit {scale:g}",
        note="How many of the drawn episodes end below a rho: further left is better.",
        x_label="rho [-]",
        y_label="share of episodes [%]",
        curves=tuple(curves),
        logarithmic_x=True,
    )


def _histories(
    outcome: Outcome, shown: Sequence[str], looks: Mapping[str, Line]
) -> list[content.History]:
    """Thin the histories of the shown policies, on the first track with several force limits."""
    histories, tracks = outcome.histories, [each.name for each in outcome.tracks]
    period = 2.0 * np.pi / outcome.tracks[0].nominal.reference_frequency
    counts = {name: len({s for _, t, s in histories if t == name}) for name in tracks}
    where = next((name for name in tracks if counts[name] > 1), tracks[0])
    found: list[content.History] = []
    for scale in sorted({s for _, t, s in histories if t == where}, reverse=True):
        for policy in shown:
            each = histories.get((policy, where, scale))
            if each is None or len(each.t) < 2:
                continue
            group = f"{where}, force limit {scale:g}"
            kept: dict[str, Any] = {"period": period, "group": group, "first": 0.0}
            found.append(thinned(each.t, each.x, each.force, looks[policy], **kept))
    return found
