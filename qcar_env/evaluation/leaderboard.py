"""The results of a benchmark as words and files."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.evaluation import storage, tables
from qcar_env.evaluation.benchmark import Outcome
from qcar_env.evaluation.statistics import mean
from qcar_env.evaluation.tracks import Track
from qcar_env.scenarios.files import as_record

HEADER = (
    *("#", "policy", "gains", "reads", "rho", "95 % interval", "over the optimum"),
    *("worst 5 %", "worst", "above 1", "settled [s]", "P(< CNVC)"),
)
OTHERS = ("table.*", "report.html", "figures/*.png", "figures/*.pdf")  # that results may have
_ENDS = ("lower", "upper")


def summary(outcome: Outcome) -> list[str]:
    """Return what is found, one line each."""
    said = (*outcome.findings, *outcome.failures)
    return [f"- {each}" for each in said]


def leaderboard(outcome: Outcome) -> str:
    """Return the result as Markdown."""
    found = map(tables.plain, summary(outcome))  # errors have any words
    lines = ["# Leaderboard", "", "## What is found", "", *found]
    lines += [
        "",
        "rho is the share of the uncontrolled amplitude that is left, the larger of wheel and "
        "body, at every instant: mean over the episodes, with its 95 % bootstrap interval, mean of "
        "the worst 5 % of them, the worst, and the share of them that end above no control. "
        "Settled: after how long the motion stays within 5 % of the uncontrolled amplitude above "
        "what is left, the median. The optimum is the certified lower bound: no force within the "
        "limit, of any shape, leaves less. P(< CNVC) is the probability that an episode ends with "
        "a lower rho than CNVC's with the paper's gain 1.2.",
    ]
    for each in outcome.homes:
        lines += ["", f"## Track `{each.name}`, version {each.version}: {each.title}"]
        lines += [
            "",
            f"{each.episodes} held-out episodes of {each.duration:g} s at each limit, amplitudes "
            f"over {_measured(each)}; policies may read: "
            + ("the state alone." if each.observe == "feedback" else "state, road and force."),
        ]
        for scale in each.force_scales:
            lines += ["", f"### Force limit x {scale:g}", "", *_table(outcome, each, scale)]
    if outcome.cases:
        lines += ["", *_robustness(outcome)]
    return "\n".join(lines) + "\n"


def _robustness(outcome: Outcome) -> list[str]:
    """Return the table of the cases that policies were not made for, the least bad first."""
    first = outcome.cases[0]
    home, names = first.home, [each.name for each in outcome.cases]
    table = tables.markdown(
        ("policy", *names),
        [[name, *map(_rho, values)] for name, values in outcome.by_case().items()],
        right="l" + "r" * len(names),
    )
    return [
        "## Robustness",
        "",
        f"Policies of track `{home.name}` at force limit x {first.force_scales[0]:g}, as they are, "
        "where one thing is another than what they were made for: mean rho over "
        f"{first.episodes} episodes, relative to the uncontrolled motion of the case itself. An "
        f"interval is {1e3 * home.nominal.dt:g} ms; noise is a share of each signal's largest "
        "uncontrolled value. Sorted by the worst case.",
        "",
        *table,
    ]


def write(folder: Path, outcome: Outcome) -> list[str]:
    """Write leaderboard.md, result.json and the rows as table.csv, and table.parquet with pyarrow.

    Tables, report and figures of older results go with them.

    Returns
    -------
    list of str
        The files' names.
    """
    rows = [dataclasses.asdict(row) for row in outcome.rows]
    files: dict[str, str | bytes] = {"leaderboard.md": leaderboard(outcome)}
    if rows:
        files |= {"table.csv": storage.as_csv(rows), **_parquet(rows)}
    result = {
        "command": storage.command(),
        "versions": storage.versions(),
        "seed": outcome.seed,
        "tracks": [as_record(each) for each in outcome.tracks],
        "findings": list(outcome.findings),
        "standings": [dataclasses.asdict(each) for each in outcome.standings],
        "optimum": [
            {"track": name, "force_scale": scale, "episodes": list(map(dataclasses.asdict, each))}
            for (name, scale), each in outcome.bounds.items()
        ],
        "failures": [dataclasses.asdict(each) for each in outcome.failures],
        "rows": rows,
    }
    storage.write_results(folder, files, result, OTHERS)
    return [*files, "result.json"]


def _measured(track: Track) -> str:
    return "the whole episode" if track.periods is None else f"the last {track.periods} periods"


def _table(outcome: Outcome, where: Track, scale: float) -> list[str]:
    bound = outcome.bounds[(where.name, scale)]
    rows: list[list[str]] = []
    if bound:
        low, high = (_rho(float(mean([getattr(b, end) for b in bound]))) for end in _ENDS)
        rows.append(["", "*optimum*", "", "everything", low, f"up to {high} reached", *[""] * 6])
    held = [each.held for each in bound if each.held is not None]
    if held:
        rate = f"*optimum at {1.0 / where.nominal.dt:g} Hz*"
        shape = "forces held over the control interval"
        rows.append(["", rate, "", "everything", _rho(max(held)), shape, *[""] * 6])
    for number, each in enumerate(outcome.ranked(where.name, scale), start=1):
        chance = each.improvement
        left = f", {each.terminated} episodes left the travel limits" if each.terminated else ""
        rows.append(
            [
                str(number),
                each.policy + left,
                each.kind,
                each.reads,
                _rho(each.rho.value),
                f"{_rho(each.rho.low)} to {_rho(each.rho.high)}",
                f"x {each.over_optimum:.3f}" if np.isfinite(each.over_optimum) else "-",
                _rho(each.cvar),
                _rho(each.worst),
                f"{100.0 * each.above:.3g} %",
                f"{each.settling:.2f}" if np.isfinite(each.settling) else "-",
                f"{chance.value:.2f} ({chance.low:.2f} to {chance.high:.2f})" if chance else "",
            ]
        )
    return tables.markdown(HEADER, rows, right="rlllrlrrrrrl")


def _rho(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.2e}" if value < 1e-3 else f"{value:.4f}"


def _parquet(rows: Sequence[Mapping[str, Any]]) -> dict[str, bytes]:
    """Return the table as a Parquet file by name, where pandas and pyarrow are installed."""
    try:
        pandas = importlib.import_module("pandas")
        importlib.import_module("pyarrow")
    except ImportError:
        return {}
    return {"table.parquet": pandas.DataFrame(rows).to_parquet()}
