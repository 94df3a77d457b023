"""Score every policy on every track, beside the optimum that none can pass.

qcar benchmark
qcar benchmark --policy my_module:my_policy --tracks budget randomised
qcar benchmark --policy run/policy.onnx --force
qcar benchmark --ray --address 10.0.0.1:6379 --seeds 0 1 2
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from qcar_env import agents, baselines, report
from qcar_env.commands import command
from qcar_env.evaluation import benchmark, leaderboard, ray_workers, robustness, storage
from qcar_env.evaluation.entry import Entry, entry_of
from qcar_env.evaluation.tracks import TRACKS, Track, track
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
    "seeds": (
        int,
        "several of them; the results of each go into seed-N of the folder",
        {"nargs": "+", "metavar": "N"},
    ),
    "jobs": (os.cpu_count() or 1, "worker processes (default: one for each core)"),
    "ray": (False, "run as a grid on Ray: a file for each cell in cells/, skipped if present"),
    "address": (
        str,
        "host:port of a Ray cluster to join (default: a local one with --jobs cores)",
        {"metavar": "HOST:PORT"},
    ),
    "merge": (False, "run nothing: make the results of what cells/ holds"),
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
    for each in (*(arguments.seeds or ()), arguments.seed):
        if each is not None:
            whole("seed", each, least=0)
    storage.check_folder(out, "leaderboard.md", "table.csv", "result.json", "report.html")
    storage.check_folder(out / "figures")
    if arguments.seeds and arguments.seed is not None:
        raise ValueError(f"--seed {arguments.seed} and --seeds cannot both be given; leave one out")
    if arguments.ray and arguments.merge:
        raise ValueError("--merge runs nothing; leave it or --ray out")
    if arguments.address is not None and not arguments.ray:
        raise ValueError(f"--address {arguments.address} is of a Ray cluster; give --ray too")
    if arguments.ray:
        ray_workers.check_installed()
    with storage.held(out):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    out: Path = arguments.out
    seeds: list[int | None] = list(dict.fromkeys(arguments.seeds or [arguments.seed]))
    folders = [out / f"seed-{each}" if arguments.seeds else out for each in seeds]
    for each in folders:
        if (each / "result.json").exists() and not arguments.force:
            raise ValueError(
                f"{each} already holds results; give --force to replace them, or --out"
            )
    there = [
        each
        for name in dict.fromkeys(arguments.tracks)
        for each in (robustness.tracks() if name == "robustness" else (track(name),))
    ]
    entered = (
        *baselines.entries(arguments.baselines),
        *(() if arguments.no_agents else agents.entries()),
        *(entry_of(spec) for spec in arguments.policy),
    )
    if arguments.ray or arguments.merge:
        outcomes = _grid(there, entered, seeds, arguments)
    else:
        outcomes = (
            benchmark.run(there, entered, seed=each, jobs=arguments.jobs, progress=_progress)
            for each in seeds
        )
    return max(_write(*each, arguments) for each in zip(folders, outcomes, strict=True))


def _grid(
    there: Sequence[Track],
    entered: Sequence[Entry],
    seeds: Sequence[int | None],
    arguments: argparse.Namespace,
) -> tuple[benchmark.Outcome, ...]:
    """Run the grid on Ray, or merge what is there."""
    cells = arguments.out / "cells"
    if arguments.merge:
        return benchmark.run_grid(there, entered, cells, None, seeds=seeds)
    if arguments.force:  # code that has changed under the same version does not show in a cell
        shutil.rmtree(cells, ignore_errors=True)
    begin = time.monotonic()

    def progress(done: int, total: int) -> None:
        spent = time.monotonic() - begin
        rest = command.left(spent, done, total) if done else 0.0
        command.say(f"[{done}/{total}] cells: {spent:.0f} s, about {rest:.0f} s left")

    with ray_workers.cluster(arguments.address, arguments.jobs):
        return benchmark.run_grid(
            there, entered, cells, ray_workers.each_done, seeds=seeds, progress=progress
        )


def _write(out: Path, outcome: benchmark.Outcome, arguments: argparse.Namespace) -> int:
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

if __name__ == "__main__":
    raise SystemExit(main())
