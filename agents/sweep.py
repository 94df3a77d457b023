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
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from qcar_env.agents.recipes import ALGORITHMS, RECIPES, TASKS, Recipe, recipe
from qcar_env.evaluation.grid import digest
from qcar_env.validation import known, shown, whole

INSTALL = "pip install 'qcar_env[cluster]'"
SEARCHES = ("random", "tpe")  # Optuna's samplers
OF_RECIPE = ("cars", "velocity_gain")  # what may vary besides an algorithm's settings
TRIES = 10**6  # points of a sweep at most


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
