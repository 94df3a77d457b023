"""Score every policy on every track, beside the optimum that none can pass.

python scripts/benchmark.py
python scripts/benchmark.py --policy my_module:my_policy --tracks budget randomised
python scripts/benchmark.py --policy run/policy.onnx --force
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

# Worker processes share the cores; more threads in each would only wait for one another.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import matplotlib  # noqa: E402

import agents  # noqa: E402
import baselines  # noqa: E402
from qcar_env import report  # noqa: E402
from qcar_env.evaluation import benchmark, leaderboard, storage  # noqa: E402
from qcar_env.evaluation.entry import entry_of  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, track  # noqa: E402
from qcar_env.validation import whole  # noqa: E402


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark and write its results; return the exit status."""
    arguments = _parse(argv)
    out: Path = arguments.out
    try:
        whole("jobs", arguments.jobs)
        if arguments.report:
            report.check_installed()
        if arguments.seed is not None:
            whole("seed", arguments.seed, least=0)
        storage.check_folder(out)
        if (out / "result.json").exists() and not arguments.force:
            raise ValueError(f"{out} already holds results; give --force to replace them, or --out")
        outcome = benchmark.run(
            [track(name) for name in dict.fromkeys(arguments.tracks)],
            (
                *baselines.entries(arguments.baselines),
                *(() if arguments.no_agents else agents.entries()),
                *(entry_of(spec) for spec in arguments.policy),
            ),
            seed=arguments.seed,
            jobs=arguments.jobs,
            progress=_progress,
        )
    except ValueError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 2
    if not arguments.no_figures and outcome.rows:
        _draw(out / "figures", outcome)
    names = leaderboard.write(out, outcome)
    if arguments.report:
        from qcar_env.report.benchmark import page

        print(f"report: {page(out / 'report.html', outcome)}")
    print("\n".join(["", *leaderboard.summary(outcome), ""]))
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
    print(
        f"... [{done}/{total}] {name}: {spent:.0f} s, about "
        f"{spent / done * (total - done):.0f} s left",
        file=sys.stderr,
        flush=True,
    )


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=list(TRACKS),
        help=f"tracks (default: {' '.join(TRACKS)})",
    )
    parser.add_argument(
        "--policy",
        action="append",
        default=[],
        metavar="POLICY",
        help="a policy of yours: module:object (anything with Stable-Baselines3's predict, or a "
        "function of the scenario that makes it), the path of an ONNX file, or a run folder; "
        "may be given more than once",
    )
    parser.add_argument(
        "--baselines",
        nargs="*",
        metavar="NAME",
        help="only these scripted policies (default: all; none with no name)",
    )
    parser.add_argument("--no-agents", action="store_true", help="leave the shipped agents out")
    parser.add_argument(
        "--seed",
        type=int,
        help="draw the crossings with another seed than the tracks' [whole number]",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="worker processes (default: one for each core)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/benchmark"),
        help="folder of the results (default: results/benchmark)",
    )
    parser.add_argument("--force", action="store_true", help="replace results that are there")
    parser.add_argument(
        "--report", action="store_true", help="write report.html, a page that opens offline"
    )
    parser.add_argument("--no-figures", action="store_true", help="leave the figures out")
    return parser.parse_args(argv)


if __name__ == "__main__":
    matplotlib.use("Agg")
    sys.exit(main())
