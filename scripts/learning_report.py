"""Report how agents learn: amplitude against training time and steps, and what each seed reached.

    python scripts/learning_report.py                     from the runs in runs/
    python scripts/learning_report.py --train             train what is missing first, five seeds
    python scripts/learning_report.py --recipes ppo-paper sac-paper --seeds 0 1 2

Writes results/learning/: report.md, curves.csv, and a figure for each task, with CNVC, saturated
velocity feedback and the optimum as lines. Bands and intervals span all seeds; rows state the
median of the seeds on the track's held-out set, and 95 % bootstrap intervals of that median.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from agents import scoring
from agents.load import Agent
from agents.recipes import ALGORITHM_TITLES, RECIPES, Recipe
from agents.train import score_all, train
from baselines.catalogue import describe
from baselines.tune import load as load_tuned, validate
from qcar_env.evaluation.storage import (
    check_folder,
    command,
    replacing,
    versions,
    write_csv,
    write_text,
)
from qcar_env.evaluation.tracks import Track, episodes
from qcar_env.validation import known, whole

RUNS = Path("runs")
OUT = Path("results/learning")
RESAMPLES = 2000  # of the bootstrap
GRID = 60  # points of a curve
LOWEST = 1e-5  # [-] level that still has a line in a figure


def main(argv: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recipes", nargs="+", help="recipes to report (default: all with runs)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--train", action="store_true", help="train the runs that are missing")
    parser.add_argument("--runs", type=Path, default=RUNS, help="folder of the run folders")
    parser.add_argument("--out", type=Path, default=OUT, help="where the report goes")
    args = parser.parse_args(argv)
    try:
        check_folder(args.out)
        seeds = [whole("seed", each, least=0) for each in dict.fromkeys(args.seeds)]
        rows, curves = collect(args.recipes, seeds, args.runs, train_missing=args.train)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    write_csv(args.out / "curves.csv", curves)
    write_text(args.out / "report.md", report(rows))
    for task in dict.fromkeys(row["task"] for row in rows):
        _figure(task, [each for each in curves if each["task"] == task], args.out)
    print(f"wrote {args.out}/report.md")
    return 0


def collect(
    chosen: Sequence[str] | None, seeds: Sequence[int], runs: Path, *, train_missing: bool
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of the report and the points of its curves.

    Raises
    ------
    ValueError
        If a recipe is unknown, or there is nothing to report.
    """
    wanted = [known("recipe", name, RECIPES) for name in chosen or RECIPES]
    rows: list[dict[str, Any]] = []
    curves: list[dict[str, Any]] = []
    for name in wanted:
        recipe = RECIPES[name]
        folders: list[Path] = []
        for seed in seeds:
            folder = runs / f"{name}-seed{seed}"
            if not (folder / "result.json").exists() and train_missing and chosen:
                print(f"training {name}, seed {seed}")
                train(recipe, seed, folder, force=True)
            if (folder / "result.json").exists():
                folders.append(folder)
        if folders:
            rows += _rows(recipe, folders)
            curves += _curves(recipe, folders)
    if not rows:
        raise ValueError(
            f"no finished runs in {runs}; make some with scripts/train.py, or name --recipes "
            "and give --train"
        )
    return rows, curves


@cache
def best_tuned(track: Track, force_scale: float) -> tuple[str, float]:
    """Return the best tuned classical law with the same information, and its rho [-].

    The rho is the mean over the held-out set, the best one that of the same set: the harder
    comparison for what is learned. NaN if none is tuned. The tracks `paper` and `feedback` have the
    crossings of `budget`.
    """
    name = "randomised" if track.name == "randomised" else "budget"
    found = [
        (validate(each.baseline, each.gains, track, force_scale, "held-out"), each.baseline)
        for each in load_tuned()
        if (each.track, each.force_scale) == (name, force_scale)
        and (track.observe == "full" or describe(each.baseline)["reads"] == "feedback")
    ]
    rho, law = min(found, default=(float("nan"), "none"))
    return law, rho


def interval(values: Sequence[float], rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the median of `values`."""
    array = np.asarray(values, dtype=np.float64)
    drawn = array[rng.integers(len(array), size=(RESAMPLES, len(array)))]
    low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975))
    return float(low), float(high)


def _rows(recipe: Recipe, folders: Sequence[Path]) -> list[dict[str, Any]]:
    results = [json.loads((each / "result.json").read_text("utf-8")) for each in folders]
    held_out = [score_all(Agent(each), recipe, "held-out") for each in folders]
    histories = [_history(each) for each in folders]
    rng = np.random.default_rng(0)
    rows = []
    for scale in recipe.force_scales:
        at = [each[f"{scale:g}"] for each in held_out]
        rho = [each["rho"] for each in at]
        low, high = interval(rho, rng)
        drawn = episodes(recipe.track, "held-out", force_scale=scale)
        law, tuned = best_tuned(recipe.track, scale)
        cnvc = scoring.reference("cnvc", recipe.track, scale, drawn)
        rows.append(
            {
                "algorithm": recipe.algorithm,
                "task": recipe.task,
                "s": scale,
                "seeds": len(folders),
                "x1": float(np.median([each["x1"] for each in at])),
                "x2": float(np.median([each["x2"] for each in at])),
                "rho": float(np.median(rho)),
                "low": low,
                "high": high,
                "optimum": at[0]["optimum"],
                "cnvc": float(cnvc.rho.mean()),
                "velocity": float(
                    scoring.reference("velocity", recipe.track, scale, drawn).rho.mean()
                ),
                "tuned_law": law,
                "tuned": tuned,
                "steps": int(np.median([each["steps"] for each in results])),
                "wall": float(np.median([each["wall_s"] for each in results])),
                "cpu": float(np.median([each["cpu_s"] for each in results])),
                # live evaluations are a mean over the limits
                "passed": math.nan
                if recipe.observe_limit
                else float(np.median([_passed(each, cnvc) for each in histories])),
            }
        )
    return rows


def _history(folder: Path) -> list[dict[str, float]]:
    with (folder / "progress.csv").open(newline="", encoding="utf-8") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def _passed(history: Sequence[dict[str, float]], cnvc: scoring.Score) -> float:
    """Return the processor time [s] of the first live evaluation with both masses below CNVC."""
    x1, x2 = cnvc.relative.mean(axis=0)
    return next((at["cpu"] for at in history if at["x1"] < x1 and at["x2"] < x2), math.inf)


def _curves(recipe: Recipe, folders: Sequence[Path]) -> list[dict[str, Any]]:
    names = {"recipe": recipe.name, "task": recipe.task, "algorithm": recipe.algorithm}
    return [{**names, "run": folder.name, **row} for folder in folders for row in _history(folder)]


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# How the agents learn",
        "",
        f"Made by `{command()}`",
        "with " + ", ".join(f"{name} {version}" for name, version in versions().items()) + ".",
        "",
        "rho is max(a1/A1, a2/A2) in steady state on the held-out set, mean over its crossings;",
        "x1 and x2 are the largest amplitudes [m]. Median over seeds; the interval is a 95 %",
        "bootstrap of that median. Times are of training alone [s], on one thread: to the end, and",
        "on the processor to the first live evaluation with both masses below CNVC (0: so begins",
        "the search, at velocity feedback).",
        "",
        "| task | s | algorithm | seeds | x1 | x2 | rho | interval | optimum |"
        " tuned | velocity | CNVC | steps | wall | CPU | below CNVC |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=lambda each: (each["task"], -each["s"], each["rho"])):
        lines.append(
            f"| {row['task']} | {row['s']:g} | {row['algorithm']} | {row['seeds']} "
            f"| {row['x1']:.5f} | {row['x2']:.5f} | {row['rho']:.4f} "
            f"| {row['low']:.4f} to {row['high']:.4f} | {row['optimum']:.4f} "
            f"| {row['tuned']:.4f} ({row['tuned_law']}) | {row['velocity']:.4f} "
            f"| {row['cnvc']:.4f} | {row['steps']:,} | {row['wall']:.0f} | {row['cpu']:.0f} "
            f"| {'' if math.isnan(row['passed']) else format(row['passed'], '.1f')} |"
        )
    present = dict.fromkeys(row["algorithm"] for row in rows)
    lines += ["", *(f"- {name}: {ALGORITHM_TITLES[name]}" for name in present)]
    lines += [
        "- tuned: the best classical law of scripts/tune.py with the same information, chosen and",
        "  scored on the same held-out set, which favours it",
        "- velocity: saturated linear velocity feedback with gain 100 1/s on both masses",
        "- CNVC: the paper's law with its gain 1.2, saturated at the same limit",
        "",
    ]
    return "\n".join(lines)


def _figure(task: str, points: Sequence[dict[str, Any]], out: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    from qcar_env.plots.learning import COLOURS, learning_curve, reference_lines

    names = list(dict.fromkeys(each["recipe"] for each in points))
    recipe = RECIPES[names[0]]
    scale = recipe.force_scales[0]
    law, tuned = best_tuned(recipe.track, scale)
    drawn = episodes(recipe.track, "held-out", force_scale=scale)
    levels = {
        "CNVC": float(scoring.reference("cnvc", recipe.track, scale, drawn).rho.mean()),
        "velocity": float(scoring.reference("velocity", recipe.track, scale, drawn).rho.mean()),
        f"tuned {law}": tuned,
        "optimum": float(np.mean([scoring.optimum(each.scenario) for each in drawn])),
    }
    lowest = 0.8 * min(each["rho"] for each in points)
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, across, label in (
        (left, "cpu", "training time on the processor [s]"),
        (right, "steps", "environment steps"),
    ):
        for name, colour in zip(names, COLOURS, strict=False):
            runs: dict[str, list[tuple[float, float]]] = {}
            for each in points:
                if each["recipe"] == name and each["steps"] > 0:
                    runs.setdefault(each["run"], []).append((each[across], each["rho"]))
            begin = max(run[0][0] for run in runs.values())
            end = min(run[-1][0] for run in runs.values())
            at = np.geomspace(begin, end, GRID)
            curves = [np.interp(at, *np.array(run).T) for run in runs.values()]
            learning_curve(axes, at, curves, label=f"{name}, {len(curves)} seeds", colour=colour)
        axes.set_xscale("log")
        axes.set_xlabel(label)
        lowest = min(lowest, 0.8 * min(filter(lambda level: level > LOWEST, levels.values())))
        reference_lines(axes, {name: each for name, each in levels.items() if each > lowest})
    left.set_ylim(bottom=lowest)
    left.set_ylabel("rho, live evaluation [-]")
    right.legend(fontsize="small", loc="lower left")
    below = ", ".join(f"{name} {each:.1g}" for name, each in levels.items() if each <= lowest)
    figure.suptitle(
        f"{task}: median and range of the seeds" + (f"; below the axis: {below}" if below else ""),
        fontsize="medium",
    )
    with replacing(out / f"{task}.png") as path:
        figure.savefig(path, dpi=150)


if __name__ == "__main__":
    raise SystemExit(main())
