"""Sweeps: many trainings, algorithm x settings x task x seed, each a run folder of its own.

What is trained hangs on the sweep alone, never on who finishes first: Optuna draws the settings in
rounds, each from the results of all rounds before, in the order of the points. One machine or many,
killed and resumed or not, a sweep has the same trials and, unless it stops some early, the same
table. There is no state but the run folders: a sweep goes on by looking which of them are whole.

A sweep's folder holds

    sweep.json   what is swept           runs/      the run folder of each trial
    table.csv    a row for each trial    leaderboard.md   settings ranked on the validation set
    benchmark/   the best settings of each algorithm and task in the benchmark's table
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qcar_env.agents.recipes import ALGORITHMS, RECIPES, TASKS, Recipe, as_dict, recipe
from qcar_env.evaluation import benchmark, leaderboard, storage, tables, tracks, workers
from qcar_env.evaluation.entry import Entry, entry_of
from qcar_env.evaluation.grid import digest
from qcar_env.validation import known, shown, whole

if TYPE_CHECKING:
    from qcar_env.agents.train import Progress

INSTALL = "pip install 'qcar_env[cluster]'"
SEARCHES = ("random", "tpe")  # Optuna's samplers
OF_RECIPE = ("cars", "velocity_gain")  # what may vary besides an algorithm's settings
HELD = 60.0  # [s] that a lost trial's process has to end before the trial goes on elsewhere
TRIES = 10**6  # points of a sweep at most

Tell = Callable[["Row"], None]
Execute = Callable[[Sequence["Trial"], Path, Tell], None]


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What is swept.

    Parameters
    ----------
    algorithms, tasks : tuple of str
        Of `qcar_env.agents.recipes`; every pair that has a recipe.
    seeds : tuple of int
        Each setting is trained with each of them.
    settings : mapping of str to str
        What varies: names of settings (``gamma``, ``learning_rate.0``, ``cars``) to ranges
        ``0.9..0.99``, ``1e-4..1e-2:log``, or choices ``32,64,128``. A setting that an algorithm
        does not have varies for the others alone.
    points : int
        Settings drawn for each algorithm and task in which something varies.
    steps : int, optional
        Environment steps of a training instead of the recipe's.
    search : {"random", "tpe"}
        Optuna's sampler: all points at once, or from round to round nearer to the best.
    search_seed : int
        Of the sampler.
    round_points : int
        Points of a round of ``tpe``, for each algorithm and task.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of range.
    """

    algorithms: tuple[str, ...] = ("ppo",)
    tasks: tuple[str, ...] = ("paper",)
    seeds: tuple[int, ...] = (0,)
    settings: Mapping[str, str] = field(default_factory=dict[str, str])
    points: int = 16
    steps: int | None = None
    search: str = "random"
    search_seed: int = 0
    round_points: int = 8

    def __post_init__(self) -> None:
        """Check names and numbers, ranges included."""
        for each in self.algorithms:
            known("algorithm", each, ALGORITHMS)
        for each in self.tasks:
            known("track", each, TASKS)
        for each in self.seeds:
            whole("seed", each, least=0)
        whole("points", self.points, most=TRIES)
        whole("round-points", self.round_points)
        whole("search-seed", self.search_seed, least=0, most=2**32 - 1)
        known("search", self.search, SEARCHES)
        if self.steps is not None:
            whole("steps", self.steps, most=10**12)
        for name in ("algorithms", "tasks", "seeds"):
            given = tuple(dict.fromkeys(getattr(self, name)))
            if not given:
                raise ValueError(f"{name} must not be empty; give at least one")
            object.__setattr__(self, name, given)
        if not self.pairs:
            raise ValueError(
                f"no recipe is for {', '.join(self.algorithms)} on {', '.join(self.tasks)}. "
                f"Known: {', '.join(RECIPES)}"
            )
        names = {name for pair in self.pairs for name in variable(recipe(*pair))}
        for name in self.settings:
            known("setting", name, names)
        for pair in self.pairs:
            self.ranges(*pair)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Algorithms and tasks that have a recipe."""
        given = product(self.algorithms, self.tasks)
        return tuple(pair for pair in given if "-".join(pair) in RECIPES)

    def ranges(self, algorithm: str, task: str) -> dict[str, Range]:
        """Return what varies for an algorithm and a task."""
        there = variable(recipe(algorithm, task))
        return {
            name: Range.read(name, text, there[name])
            for name, text in self.settings.items()
            if name in there
        }

    @property
    def trials(self) -> int:
        """Trainings, at most: points that are drawn twice are trained once."""
        return len(self.seeds) * sum(
            self.points if self.ranges(*pair) else 1 for pair in self.pairs
        )


@dataclass(frozen=True, kw_only=True)
class Range:
    """What a setting is drawn from: one of `choices`, or between `low` and `high`."""

    choices: tuple[float, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False  # numbers are whole

    @classmethod
    def read(cls, name: str, text: str, like: float) -> Range:
        """Return the range that a text names, of numbers `like` the recipe's own.

        Raises
        ------
        ValueError
            If it names none.
        """
        kind = int if isinstance(like, int) else float
        span, colon, scale = text.partition(":")
        try:
            low, dots, high = span.partition("..")
            if dots:
                found = cls(low=kind(low), high=kind(high), log=bool(colon), whole=kind is int)
                right = found.low < found.high and (not colon or (scale == "log" and found.low > 0))
            else:
                found = cls(choices=tuple(map(kind, span.split(","))), whole=kind is int)
                right = not colon
            right = right and all(map(math.isfinite, (found.low, found.high, *found.choices)))
        except (ValueError, OverflowError):
            right = False
        if not right:
            raise ValueError(
                f"setting {name} must be {'whole' if kind is int else 'finite'} numbers LOW..HIGH, "
                f"LOW..HIGH:log with LOW above 0, or A,B,C, got {shown(text)}"
            )
        return found


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One training of a sweep."""

    algorithm: str
    task: str
    point: int  # number of the settings, for its algorithm and task
    settings: tuple[tuple[str, float], ...]  # that are not the recipe's
    seed: int
    steps: int | None  # None: the recipe's

    @property
    def recipe(self) -> Recipe:
        """The recipe with its settings.

        Raises
        ------
        ValueError
            If one of them is out of range.
        """
        found = recipe(self.algorithm, self.task)
        if self.steps is not None:
            found = dataclasses.replace(found, steps=self.steps)
        for name, value in self.settings:
            found = _replaced(found, name, value)
        return found

    @property
    def name(self) -> str:
        """Name of its run folder."""
        config = digest([self.settings, self.steps])
        return f"{self.algorithm}-{self.task}-{config}-seed{self.seed}"


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a trial has come to: a row of table.csv. Amplitudes are of the validation set."""

    algorithm: str
    task: str
    point: int
    settings: str  # as JSON
    seed: int
    run: str  # folder in runs/
    status: str  # done, stopped (early), or failed
    steps: int  # environment steps that it was trained
    rho: float  # mean over the force limits; of a stopped one the last live evaluation [-]
    x1: float  # largest amplitudes [m]
    x2: float
    error: str = ""  # in a line


class Search:
    """Optuna's draws for each algorithm and task of a sweep."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._left = {pair: sweep.points if sweep.ranges(*pair) else 1 for pair in sweep.pairs}
        self._studies: dict[tuple[str, str], Any] = {}
        self._asked: list[tuple[tuple[str, str], Any, list[Trial]]] = []
        varied = [pair for pair in sweep.pairs if sweep.ranges(*pair)]
        if varied:
            check_searchable()
            import optuna

            optuna.logging.set_verbosity(optuna.logging.WARNING)
            kinds = {"random": optuna.samplers.RandomSampler, "tpe": optuna.samplers.TPESampler}
            for i, pair in enumerate(varied):
                sampler = kinds[sweep.search](seed=(sweep.search_seed + i) % 2**32)
                self._studies[pair] = optuna.create_study(sampler=sampler)

    def ask(self) -> list[Trial]:
        """Return the trials of the next round; none when all have been."""
        sweep = self._sweep
        self._asked = []
        for pair, left in self._left.items():
            count = left if sweep.search == "random" else min(left, sweep.round_points)
            for point in range(sweep.points - left, sweep.points - left + count):
                drawn, settings = None, ()
                if pair in self._studies:
                    ranges = sweep.ranges(*pair)
                    drawn = self._studies[pair].ask(
                        {name: _distribution(each) for name, each in ranges.items()}
                    )
                    settings = tuple((name, drawn.params[name]) for name in ranges)
                trials = [
                    Trial(
                        algorithm=pair[0],
                        task=pair[1],
                        point=point if drawn else 0,
                        settings=settings,
                        seed=seed,
                        steps=sweep.steps,
                    )
                    for seed in sweep.seeds
                ]
                self._asked.append((pair, drawn, trials))
            self._left[pair] = left - count
        return [trial for *_, trials in self._asked for trial in trials]

    def tell(self, rows: Mapping[str, Row]) -> None:
        """Take the results of the round, by run; of a setting it is the mean over its seeds."""
        for pair, drawn, trials in self._asked:
            if drawn is None:
                continue
            value = float(np.mean([rows[each.name].rho for each in trials]))
            if math.isfinite(value):
                self._studies[pair].tell(drawn, value)
            else:
                self._studies[pair].tell(drawn, state=_failed_state())


def check_searchable() -> None:
    """Raise ValueError, with what to install, where Optuna is absent."""
    if importlib.util.find_spec("optuna") is None:
        raise ValueError(
            f"Optuna, which draws the settings, is not installed; {INSTALL}, or let nothing vary "
            "but algorithm, track and seed"
        )


def variable(of: Recipe) -> dict[str, float]:
    """Return what of a recipe may vary, with its own numbers."""
    found: dict[str, float] = {name: getattr(of, name) for name in OF_RECIPE}
    for each in dataclasses.fields(of.settings):
        value = getattr(of.settings, each.name)
        if isinstance(value, tuple):
            found |= {f"{each.name}.{i}": part for i, part in enumerate(value)}
        else:
            found[each.name] = value
    return found


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


def _replaced(found: Recipe, name: str, value: float) -> Recipe:
    head, _, index = name.partition(".")
    if head in OF_RECIPE:
        return dataclasses.replace(found, **{head: value})
    new: Any = value
    if index:
        old = getattr(found.settings, head)
        new = (*old[: int(index)], value, *old[int(index) + 1 :])
    return dataclasses.replace(found, settings=dataclasses.replace(found.settings, **{head: new}))


def _distribution(of: Range) -> Any:
    import optuna

    if of.choices:
        return optuna.distributions.CategoricalDistribution(of.choices)
    if of.whole:
        return optuna.distributions.IntDistribution(int(of.low), int(of.high), log=of.log)
    return optuna.distributions.FloatDistribution(of.low, of.high, log=of.log)


def _failed_state() -> Any:
    import optuna

    return optuna.trial.TrialState.FAIL


def _plain(content: Any) -> Any:
    return json.loads(json.dumps(content))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value  # JSON has no nan (storage.write_json)
