"""How agents learn: what each seed of a recipe reached, and the curves on the way, from its runs.

Rows state the median of the seeds on the track's held-out set, with the 95 % bootstrap interval of
that median.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.agents import scoring
from qcar_env.agents.recipes import ALGORITHM_TITLES, RECIPES, Recipe
from qcar_env.agents.scoring import score_all
from qcar_env.agents.train import train
from qcar_env.evaluation.agent import Agent
from qcar_env.evaluation.statistics import bootstrap
from qcar_env.evaluation.storage import command, made_with
from qcar_env.evaluation.tables import markdown
from qcar_env.evaluation.tracks import Track, episodes
from qcar_env.validation import known

Tuned = Callable[[Track, float], tuple[str, float]]

HEADER = (
    *("task", "s", "algorithm", "seeds", "x1", "x2", "rho", "interval", "optimum", "tuned"),
    *("velocity", "CNVC", "steps", "wall", "CPU", "below CNVC"),
)


def collect(
    chosen: Sequence[str] | None,
    seeds: Sequence[int],
    runs: Path,
    *,
    tuned: Tuned,
    train_missing: bool,
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the rows of the report and the points of its curves.

    Parameters
    ----------
    chosen : sequence of str, optional
        Recipes; all that have runs if left out.
    seeds : sequence of int
        Which seeds of each.
    runs : Path
        Folder of the run folders.
    tuned : callable
        Returns the best tuned law on a track at a force limit, and its rho [-].
    train_missing : bool
        Whether to train the chosen recipes' runs that are missing.

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
            rows += _rows(recipe, folders, tuned)
            curves += _curves(recipe, folders)
    if not rows:
        raise ValueError(
            f"no finished runs in {runs}; make some with qcar train, or name --recipes "
            "and give --train"
        )
    return rows, curves


def _rows(recipe: Recipe, folders: Sequence[Path], tuned: Tuned) -> list[dict[str, Any]]:
    results = [json.loads((each / "result.json").read_text("utf-8")) for each in folders]
    held_out = [score_all(Agent(each), recipe, "held-out") for each in folders]
    histories = [_history(each) for each in folders]
    rng = np.random.default_rng(0)
    rows = []
    for scale in recipe.force_scales:
        at = [each[f"{scale:g}"] for each in held_out]
        rho = [each["rho"] for each in at]
        median = bootstrap([rho], _median, rng)
        law, best = tuned(recipe.track, scale)
        cnvc, velocity = _references(recipe, scale)
        rows.append(
            {
                "algorithm": recipe.algorithm,
                "task": recipe.task,
                "s": scale,
                "seeds": len(folders),
                "x1": float(np.median([each["x1"] for each in at])),
                "x2": float(np.median([each["x2"] for each in at])),
                "rho": median.value,
                "low": median.low,
                "high": median.high,
                "optimum": at[0]["optimum"],
                "cnvc": float(cnvc.rho.mean()),
                "velocity": float(velocity.rho.mean()),
                "tuned_law": law,
                "tuned": best,
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


def _median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.median(values, axis=-1)


@cache
def _references(recipe: Recipe, scale: float) -> tuple[scoring.Score, scoring.Score]:
    """Return the scores of CNVC and of velocity feedback on the held-out set."""
    drawn = episodes(recipe.track, "held-out", force_scale=scale)
    cnvc, velocity = (
        scoring.reference(name, recipe.track, scale, drawn) for name in ("cnvc", "velocity")
    )
    return cnvc, velocity


def levels(recipe: Recipe, tuned: Tuned) -> dict[str, float]:
    """Return rho of what a recipe's curves are drawn beside, by name [-]."""
    scale = recipe.force_scales[0]
    drawn = episodes(recipe.track, "held-out", force_scale=scale)
    cnvc, velocity = _references(recipe, scale)
    law, best = tuned(recipe.track, scale)
    return {
        "CNVC": float(cnvc.rho.mean()),
        "velocity": float(velocity.rho.mean()),
        f"tuned {law}": best,
        "optimum": float(np.mean([scoring.optimum(each.scenario) for each in drawn])),
    }


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the report as Markdown."""
    lines = [
        "# How the agents learn",
        "",
        f"Made by `{command()}`",
        f"with {made_with()}.",
        "",
        "rho is max(a1/A1, a2/A2) in steady state on the held-out set, mean over its episodes;",
        "x1 and x2 are the largest amplitudes [m]. Median over seeds; the interval is a 95 %",
        "bootstrap of that median. Times are of training alone [s], on one thread: to the end, and",
        "on the processor to the first live evaluation with both masses below CNVC (0: so begins",
        "the search, at velocity feedback).",
        "",
    ]
    cells = [
        (
            row["task"], f"{row['s']:g}", row["algorithm"], str(row["seeds"]),
            f"{row['x1']:.5f}", f"{row['x2']:.5f}",
            f"{row['rho']:.4f}", f"{row['low']:.4f} to {row['high']:.4f}",
            f"{row['optimum']:.4f}", f"{row['tuned']:.4f} ({row['tuned_law']})",
            f"{row['velocity']:.4f}", f"{row['cnvc']:.4f}",
            f"{row['steps']:,}", f"{row['wall']:.0f}", f"{row['cpu']:.0f}",
            "" if math.isnan(row["passed"]) else f"{row['passed']:.1f}",
        )
        for row in sorted(rows, key=lambda each: (each["task"], -each["s"], each["rho"]))
    ]  # fmt: skip
    lines += markdown(HEADER, cells)
    present = dict.fromkeys(row["algorithm"] for row in rows)
    lines += ["", *(f"- {name}: {ALGORITHM_TITLES[name]}" for name in present)]
    lines += [
        "- tuned: the best classical law of qcar tune with the same information, chosen and",
        "  scored on the same held-out set, which favours it",
        "- velocity: saturated linear velocity feedback with gain 100 1/s on both masses",
        "- CNVC: the paper's law with its gain 1.2, saturated at the same limit",
        "",
    ]
    return "\n".join(lines)
