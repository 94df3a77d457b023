"""Trials of a sweep: each is a run folder; the sweep goes on by looking which of them are whole.

`run` trains what is left through an executor: worker processes, a Slurm array or Ray Tune. What
comes of it is a table, settings ranked on the validation set, and the best of them in the
benchmark's table, on the held-out episodes.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qcar_env.agents.recipes import TASKS, as_dict
from qcar_env.agents.sweep import Row, Search, Sweep, Trial
from qcar_env.evaluation import benchmark, leaderboard, storage, tables, tracks, workers
from qcar_env.evaluation.entry import Entry, entry_of

if TYPE_CHECKING:
    from qcar_env.agents.train import Progress

HELD = 60.0  # [s] that a lost trial's process has to end before the trial goes on elsewhere

Tell = Callable[[Row], None]
Execute = Callable[[Sequence[Trial], Path, Tell], None]


def run_trial(trial: Trial, out: Path, report: Callable[[Progress], None] | None = None) -> Row:
    """Train a trial, or go on where it was killed; one that is whole is returned as it is.

    Parameters
    ----------
    trial : Trial
        Which.
    out : Path
        Folder of the sweep.
    report : callable, optional
        Called after each live evaluation.
    """
    from qcar_env.agents.train import train  # knows torch, which --help does without

    folder = out / "runs" / trial.name
    with storage.held(folder, wait=HELD):
        if (row := finished(trial, out)) is not None:
            return row
        told = None if report is None else lambda progress, beside: report(progress)
        again = f"qcar sweep --resume {out}"  # a worker has no command line of its own
        begin = partial(train, trial.recipe, trial.seed, folder, report=told, command=again)
        killed = (folder / "checkpoint.pt").exists()
        try:
            begin(resume=killed, force=True)
        except ValueError:
            if not killed:
                raise
            begin(force=True)  # the checkpoint is damaged, or of another version
    row = finished(trial, out)
    assert row is not None
    return row


def finished(trial: Trial, out: Path) -> Row | None:
    """Return the row of a trial whose run folder is whole, or which has been stopped early."""
    folder = out / "runs" / trial.name
    try:
        made = json.loads((folder / "recipe.json").read_text(encoding="utf-8"))
        if any(made.get(key) != value for key, value in _plain(as_dict(trial.recipe)).items()):
            return None
        if (folder / "result.json").exists():
            found = json.loads((folder / "result.json").read_text(encoding="utf-8"))
            limits = found["validation"].values()
            rho = float(np.mean([_number(each["rho"]) for each in limits]))
            if not math.isfinite(rho):
                return failed(trial, ValueError(f"rho must be finite, got {rho}; see {folder}"))
            return _row(
                trial,
                status="done",
                steps=found["steps"],
                rho=rho,
                x1=max(_number(each["x1"]) for each in limits),
                x2=max(_number(each["x2"]) for each in limits),
            )
        return _row(trial, status="stopped", **json.loads((folder / "stopped.json").read_text()))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def stop(trial: Trial, out: Path, last: Mapping[str, float]) -> Row:
    """Take note that a trial has been stopped early, after its last live evaluation."""
    kept = {name: last[name] for name in ("steps", "rho", "x1", "x2")}
    storage.write_json(out / "runs" / trial.name / "stopped.json", kept)
    return _row(trial, status="stopped", **kept)


def failed(trial: Trial, error: BaseException) -> Row:
    """Return the row of a trial that raised."""
    words = f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"
    nan = float("nan")
    return _row(trial, status="failed", steps=0, rho=nan, x1=nan, x2=nan, error=words)


def run(
    sweep: Sweep,
    out: Path,
    execute: Execute,
    *,
    progress: Callable[[Row, int, int], None] = lambda row, done, total: None,
) -> list[Row]:
    """Run a sweep, or what is left of it.

    Parameters
    ----------
    sweep : Sweep
        What.
    out : Path
        Its folder, on a disk that all workers share.
    execute : callable
        ``execute(trials, out, tell)`` runs trials and tells the row of each: `in_workers` with one
        of the executors, or `qcar_env.agents.ray_sweep.execute`.
    progress : callable, optional
        Called with each row, and how many of how many there are.

    Returns
    -------
    list of Row
        One for each trial, in the order of algorithm, task, settings and seed.
    """
    search = Search(sweep)
    rows: dict[str, Row] = {}
    found: list[Row] = []

    def tell(row: Row) -> None:
        rows[row.run] = row
        progress(row, len(rows), sweep.trials)

    while batch := search.ask():
        todo: dict[str, Trial] = {}
        for trial in batch:
            row = rows.get(trial.name) or finished(trial, out)
            if row is None:
                todo[trial.name] = trial
            elif trial.name not in rows:
                tell(row)
        if todo:
            execute(list(todo.values()), out, tell)
        for name, trial in todo.items():
            if name not in rows:
                tell(failed(trial, RuntimeError("it ended without a word")))
        search.tell(rows)
        found += [
            dataclasses.replace(rows[name], point=trial.point)
            for name, trial in {each.name: each for each in reversed(batch)}.items()
        ]
    pairs = list(sweep.pairs)
    return sorted(
        {row.run: row for row in reversed(found)}.values(),
        key=lambda row: (pairs.index((row.algorithm, row.task)), row.point, row.seed),
    )


def in_workers(
    each_done: Callable[[Sequence[workers.Task]], Iterator[tuple[int, Any, BaseException | None]]],
    trials: Sequence[Trial],
    out: Path,
    tell: Tell,
) -> None:
    """Run trials through an executor of tasks, such as `qcar_env.evaluation.workers.each_done`."""
    tasks: list[workers.Task] = [partial(run_trial, each, out) for each in trials]
    for index, row, error in each_done(tasks):
        # a worker may have ended after its trial did
        tell(row or finished(trials[index], out) or failed(trials[index], error))


def write(out: Path, rows: Sequence[Row]) -> str:
    """Write table.csv and leaderboard.md, and return the latter."""
    text = ranking(rows)
    storage.write_csv(out / "table.csv", [dataclasses.asdict(row) for row in rows])
    storage.write_text(out / "leaderboard.md", text)
    return text


def ranking(rows: Sequence[Row]) -> str:
    """Return the settings of each task as Markdown, best first on the validation set."""
    lines = ["# Sweep", ""]
    counted = {each: sum(row.status == each for row in rows) for each in _STATUS}
    lines += [", ".join(f"{count} {name}" for name, count in counted.items()) + "."]
    for task in dict.fromkeys(row.task for row in rows):
        ranked = _ranked([row for row in rows if row.task == task])
        cells = [
            (
                *(str(place), of[0].algorithm, of[0].settings, str(len(of))),
                f"{np.mean([row.rho for row in of]):.4f}",
                f"{min(row.rho for row in of):.4f} to {max(row.rho for row in of):.4f}",
                ", ".join(dict.fromkeys(row.status for row in of)),
            )
            for place, of in enumerate(ranked, start=1)
        ]
        header = ("#", "algorithm", "settings", "seeds", "rho", "over the seeds", "status")
        lines += ["", f"## {task}", "", *tables.markdown(header, cells, right="rllrrrl")]
    for row in rows:
        if row.status == "failed":
            lines += ["", tables.plain(f"{row.run} {row.settings}: {row.error}")]
    return "\n".join(lines) + "\n"


def score_best(out: Path, rows: Sequence[Row], *, jobs: int = 1) -> list[str]:
    """Enter the best settings of each algorithm and task in the benchmark, all seeds.

    They were chosen on the validation set; the benchmark's episodes are held out.

    Returns
    -------
    list of str
        The files in ``benchmark/``; none where no trial is whole.
    """
    entries: list[Entry] = []
    tasks: dict[str, None] = {}
    done = [row for row in rows if row.status == "done"]
    for pair in dict.fromkeys((row.algorithm, row.task) for row in done):
        best = _ranked([row for row in done if (row.algorithm, row.task) == pair])[0]
        entries += [entry_of(str(out / "runs" / row.run)) for row in best]
        tasks[pair[1]] = None
    if not entries:
        return []
    limits: dict[str, tuple[float, ...]] = {}
    for task in tasks:
        found = TASKS[task]
        limits[found.track] = tuple(
            dict.fromkeys((*limits.get(found.track, ()), *found.force_scales))
        )
    there = [
        dataclasses.replace(tracks.track(name), force_scales=scales)
        for name, scales in limits.items()
    ]
    return leaderboard.write(out / "benchmark", benchmark.run(there, entries, jobs=jobs))


_STATUS = ("done", "stopped", "failed")


def _ranked(rows: Sequence[Row]) -> list[list[Row]]:
    """Return the rows of each setting, the lowest mean rho first; nan is last."""
    points: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        points.setdefault((row.algorithm, row.settings), []).append(row)

    def mean(of: Sequence[Row]) -> float:
        value = float(np.mean([row.rho for row in of]))
        return value if math.isfinite(value) else math.inf

    return sorted(points.values(), key=mean)


def _row(trial: Trial, **found: Any) -> Row:
    return Row(
        algorithm=trial.algorithm,
        task=trial.task,
        point=trial.point,
        settings=json.dumps(dict(trial.settings)),
        seed=trial.seed,
        run=trial.name,
        **found,
    )


def _plain(content: Any) -> Any:
    return json.loads(json.dumps(content))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value  # JSON has no nan (storage.write_json)
