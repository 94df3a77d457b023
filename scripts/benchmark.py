"""Score every policy on every track, beside the optimum that none can pass.

qcar benchmark
qcar benchmark --policy my_module:my_policy --tracks budget randomised
qcar benchmark --policy run/policy.onnx --force
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from qcar_env import agents, baselines, report
from qcar_env.commands import command
from qcar_env.evaluation import benchmark, leaderboard, robustness, storage
from qcar_env.evaluation.entry import entry_of
from qcar_env.evaluation.tracks import TRACKS, track
from qcar_env.validation import whole

OPTIONS: command.Options = {
    "tracks": (
        (*TRACKS, "robustness"),
        f"tracks (default: {' '.join(TRACKS)} robustness, which is the policies of the track "
        "budget where car, road, sensors or timing are not those that they were made for)",
    ),
    "policy": (
        str,
        "a policy of yours: module:object (anything with Stable-Baselines3's predict, or a "
        "function of the scenario that makes it), the path of an ONNX file, or a run folder; "
        "may be given more than once",
        {"action": "append", "default": [], "metavar": "POLICY"},
    ),
    "baselines": (
        str,
        "only these scripted policies (default: all; none with no name)",
        {"nargs": "*", "metavar": "NAME"},
    ),
    "no-agents": (False, "leave the shipped agents out"),
    "seed": (int, "draw the episodes with another seed than the tracks' [whole number]"),
    "jobs": (os.cpu_count() or 1, "worker processes (default: one for each core)"),
    "out": (Path("results/benchmark"), "folder of the results (default: results/benchmark)"),
    "force": (False, "replace results that are there"),
    "report": (False, "write report.html, a page that opens offline"),
    "no-figures": (False, "leave the figures out"),
}


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark and write its results."""
    out: Path = arguments.out
    # Worker processes share the cores; more threads in each would only wait for one another.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    whole("jobs", arguments.jobs)
    if arguments.report:
        report.check_installed()
    if arguments.seed is not None:
        whole("seed", arguments.seed, least=0)
    storage.check_folder(out, "leaderboard.md", "table.csv", "result.json", "report.html")
    storage.check_folder(out / "figures")
    with storage.held(out):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out
    if (out / "result.json").exists() and not arguments.force:
        raise ValueError(f"{out} already holds results; give --force to replace them, or --out")
    outcome = benchmark.run(
        [
            each
            for name in dict.fromkeys(arguments.tracks)
            for each in (robustness.tracks() if name == "robustness" else (track(name),))
        ],
        (
            *baselines.entries(arguments.baselines),
            *(() if arguments.no_agents else agents.entries()),
            *(entry_of(spec) for spec in arguments.policy),
        ),
        seed=arguments.seed,
        jobs=arguments.jobs,
        progress=_progress,
    )
    try:  # what cannot be written is still said, and what cannot be said is still written
        names = leaderboard.write(out, outcome)
    finally:
        print("\n".join(["", *leaderboard.summary(outcome), ""]), flush=True)
    if not arguments.no_figures and outcome.rows:
        _draw(out / "figures", outcome)
    if arguments.report:
        from qcar_env.report.benchmark import page

        print(f"report: {page(out / 'report.html', outcome)}")
    print(f"written to {out}: {', '.join(names)}")
    for failure in outcome.failures:
        print(f"benchmark: {failure}", file=sys.stderr)
    return 1 if outcome.failures else 0


def _draw(folder: Path, outcome: benchmark.Outcome) -> None:
    from qcar_env.plots.standings import figures
    from qcar_env.plots.style import journal, save

    with journal():
        for name, figure in figures(outcome):
            save(figure, folder / name)


def _progress(name: str, done: int, total: int, spent: float) -> None:
    rest = command.left(spent, done, total)
    command.say(f"[{done}/{total}] {name}: {spent:.0f} s, about {rest:.0f} s left")


main = command.main("benchmark", __doc__, OPTIONS, run)
