"""The report of `scripts/benchmark.py`: every policy on every track, beside the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from qcar_env.evaluation import storage
from qcar_env.evaluation.benchmark import Outcome, Unit
from qcar_env.evaluation.score import Row
from qcar_env.evaluation.standings import Standing, findings
from qcar_env.evaluation.tracks import Track
from qcar_env.plots.benchmark import LOOKS, look
from qcar_env.plots.style import Line, line
from qcar_env.report import content
from qcar_env.report.content import Cell, Chart, Column, Curve, Report, Table, dashes, thinned
from qcar_env.report.page import write

SMALLEST = 1e-5  # [-] lower edge of logarithmic axes: stillness for any purpose
LEARNED_DASHES = ("-", (0, (6, 2)), (0, (1, 1)), (0, (4, 1, 1, 1)))  # all are of one colour
MOST_CURVES = 10  # in a chart at first; more than that hide one another


def page(path: Path, outcome: Outcome) -> Path:
    """Write the report of a benchmark to a file ending in .html, and return where."""
    provenance = {
        "command": storage.command(),
        "seed of the crossings": "the tracks' own" if outcome.seed is None else str(outcome.seed),
        "versions": storage.made_with(),
        "failed": "; ".join(map(str, outcome.failures)) or "none",
        "numbers": "table.csv and result.json beside this file",
    }
    return write(path, benchmark(outcome, provenance))


def benchmark(outcome: Outcome, provenance: Mapping[str, str]) -> Report:
    """Collect the report of a benchmark, with what is needed to make it again."""
    tracks, standings = outcome.tracks, outcome.standings
    nominal = tracks[0].nominal
    shown = _shown(standings)
    looks = _looks(standings)
    charts = [
        chart for each in tracks if (chart := _frontier(each, outcome, shown, looks)) is not None
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
        findings=findings(standings),
        tables=(
            *(_board(each, standings, looks) for each in tracks),
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
    found: dict[str, Line] = {}
    learned = 0
    for each in standings:
        if each.policy in found:
            continue
        if each.kind == "learned":
            style = LEARNED_DASHES[learned % len(LEARNED_DASHES)]
            found[each.policy] = Line(line("learned").color, style, each.policy)
            learned += 1
        else:
            found[each.policy] = look(each.policy)
    return found


def _shown(standings: Sequence[Standing]) -> list[str]:
    """Return the policies that charts show: those with a look of their own, the best, yours."""
    there = list(dict.fromkeys(each.policy for each in standings))
    learned = [each for each in standings if each.kind == "learned"]
    best: dict[Unit, Standing] = {}
    for each in sorted(learned, key=lambda each: each.rho.value):
        best.setdefault((each.track, each.force_scale), each)
    chosen = [name for name in LOOKS if name in there]
    chosen += list(dict.fromkeys(each.policy for each in best.values()))
    chosen += [each.policy for each in standings if each.kind == "yours"]
    return list(dict.fromkeys(chosen or there[:MOST_CURVES]))


def _board(track: Track, standings: Sequence[Standing], looks: Mapping[str, Line]) -> Table:
    """Return a track's leaderboard: a row for each policy, a pair of columns for each limit."""
    found = {
        (each.policy, each.force_scale): each for each in standings if each.track == track.name
    }
    policies = list(dict.fromkeys(each.policy for each in standings if each.track == track.name))

    def first(policy: str) -> float:
        each = found.get((policy, track.force_scales[0]))
        return each.rho.value if each else np.inf

    policies.sort(key=first)
    columns = [Column(title="policy", numeric=False)]
    several = len(track.force_scales) > 1
    for scale in track.force_scales:
        where = f" at {scale:g}" if several else ""
        columns += [
            Column(title=f"rho{where}", digits=3, note="interquartile mean over the crossings"),
            Column(title="95 %", numeric=False, note="bootstrap interval of rho"),
        ]
        if not several:
            columns += [Column(title="better than CNVC", unit="%", digits=2, note="probability")]
    columns += [
        Column(title="gains", numeric=False, note="published, tuned, learned, or yours"),
        Column(title="reads", numeric=False, note="what the policy is shown"),
    ]
    table: list[tuple[Cell, ...]] = []
    optimum: list[Cell] = ["optimum"]
    for scale in track.force_scales:
        bound = next((each.optimum for each in found.values() if each.force_scale == scale), None)
        optimum += [bound, "certified"] if several else [bound, "certified", None]
    table.append((*optimum, "", ""))
    for policy in policies:
        any_of = next(each for each in found.values() if each.policy == policy)
        cells: list[Cell] = [policy]
        for scale in track.force_scales:
            each = found.get((policy, scale))
            if each is None:
                cells += [None, None] if several else [None, None, None]
                continue
            left = f", {each.terminated} left the travel limit" if each.terminated else ""
            cells += [each.rho.value, f"{each.rho.low:.3g} to {each.rho.high:.3g}{left}"]
            if not several:
                better = each.improvement
                cells.append(100.0 * better.value if better else None)
        table.append((*cells, any_of.kind, any_of.reads))
    return Table(
        title=f"Track {track.name}",
        note=f"{track.title}. Version {track.version}, {track.episodes} crossings of "
        f"{track.duration:g} s"
        + (
            "; the number behind rho is the force limit over the scenario's own."
            if several
            else "."
        ),
        columns=tuple(columns),
        rows=tuple(table),
        colours=(line("optimum").color, *(looks[policy].color for policy in policies)),
    )


def _everything(rows: Sequence[Row], unit: str, looks: Mapping[str, Line]) -> Table:
    """Return the means of every metric by policy, track and limit."""
    unit = unit.replace("^2", "²")
    groups: dict[tuple[str, str, float], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.policy, row.track, row.force_scale), []).append(row)
    metrics = (
        ("x1", "x1", "m"),
        ("x2", "x2", "m"),
        ("reduction_db_x1", "reduction x1", "dB"),
        ("reduction_db_x2", "reduction x2", "dB"),
        ("peak_force_1", "peak force wheel", unit),
        ("peak_force_2", "peak force body", unit),
        ("rms_force_1", "RMS force wheel", unit),
        ("rms_force_2", "RMS force body", unit),
        ("settling_time", "settling time", "s"),
    )
    return Table(
        title="All metrics",
        note="Means over the crossings of each track and force limit.",
        columns=(
            Column(title="policy", numeric=False),
            Column(title="track", numeric=False),
            Column(title="limit", digits=2),
            *(Column(title=title, unit=each, digits=3) for _, title, each in metrics),
        ),
        rows=tuple(
            (
                policy,
                track,
                scale,
                *(_mean(group, name) for name, _, _ in metrics),
            )
            for (policy, track, scale), group in groups.items()
        ),
        colours=tuple(looks[policy].color for policy, _, _ in groups),
    )


def _mean(rows: Sequence[Row], name: str) -> float:
    found = float(np.mean([getattr(row, name) for row in rows]))
    return 0.0 if name.startswith("reduction") and abs(found) < 0.01 else found


def _frontier(
    track: Track, outcome: Outcome, shown: Sequence[str], looks: Mapping[str, Line]
) -> Chart | None:
    """Return rho against the force limit, with the optimum below it."""
    scales = sorted(track.force_scales)
    if len(scales) < 2:
        return None
    bounds = [outcome.bounds[(track.name, s)] for s in scales]
    best = [float(np.mean([each.lower for each in b])) if b else np.nan for b in bounds]
    x = np.array(scales)
    optimum = look("optimum")
    curves = [
        Curve(
            label="optimum: no policy can be below",
            x=x,
            y=np.maximum(best, SMALLEST),
            colour=optimum.color,
            dash="dot",
            mode="lines+markers",
        )
    ]
    for policy in shown:
        there = {
            each.force_scale: each.rho
            for each in outcome.standings
            if (each.policy, each.track) == (policy, track.name)
        }
        at = [s for s in scales if s in there]
        if not at:
            continue
        style = looks[policy]
        curves.append(
            Curve(
                label=style.label,
                x=np.array(at),
                y=np.maximum([there[s].value for s in at], SMALLEST),
                low=np.maximum([there[s].low for s in at], SMALLEST),
                high=np.maximum([there[s].high for s in at], SMALLEST),
                colour=style.color,
                dash=dashes(style.linestyle),
                mode="lines+markers",
            )
        )
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
    """Return the share of held-out crossings that end below each rho."""

    def curve(values: Sequence[float], label: str, colour: str, pattern: str) -> Curve:
        ordered = np.sort(np.asarray(values, dtype=np.float64))
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        return Curve(
            label=label,
            x=np.maximum(ordered, SMALLEST),
            y=100.0 * share,
            colour=colour,
            dash=pattern,
        )

    curves = [
        curve(
            [each.lower for each in outcome.bounds[(track.name, scale)]],
            "optimum",
            look("optimum").color,
            "dot",
        )
    ]
    for policy in shown:
        values = [
            row.rho
            for row in outcome.rows
            if (row.policy, row.track, row.force_scale) == (policy, track.name, scale)
        ]
        if values:
            style = looks[policy]
            curves.append(curve(values, style.label, style.color, dashes(style.linestyle)))
    return Chart(
        title=f"Held-out crossings, force limit {scale:g}",
        note="How many of the drawn crossings end below a rho: further left is better.",
        x_label="rho [-]",
        y_label="share of crossings [%]",
        curves=tuple(curves),
        logarithmic_x=True,
    )


def _histories(
    outcome: Outcome, shown: Sequence[str], looks: Mapping[str, Line]
) -> list[content.History]:
    """Thin the histories of the shown policies, on the track with the most force limits."""
    histories, tracks = outcome.histories, [each.name for each in outcome.tracks]
    period = 2.0 * np.pi / outcome.tracks[0].nominal.reference_frequency
    counts = {name: len({s for _, t, s in histories if t == name}) for name in tracks}
    where = max(counts, key=lambda name: (counts[name], -tracks.index(name)))
    found: list[content.History] = []
    for scale in sorted({s for _, t, s in histories if t == where}, reverse=True):
        for policy in shown:
            each = histories.get((policy, where, scale))
            if each is None or len(each.t) < 2:
                continue
            style = looks[policy]
            found.append(
                thinned(
                    each.t,
                    each.x,
                    each.force,
                    period=period,
                    first=0.0,
                    label=style.label,
                    colour=style.color,
                    dash=dashes(style.linestyle),
                    group=f"{where}, force limit {scale:g}",
                )
            )
    return found
