"""Run entries on tracks, beside the optimum that none can pass.

Over 400 lines: a run on this machine and the same as a grid share what an entry does and what is
made of it, and must agree to the last bit.
"""

from __future__ import annotations

import dataclasses
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.envs.episode import observed
from qcar_env.evaluation import grid, storage
from qcar_env.evaluation.bounds import Bound, optimum_of
from qcar_env.evaluation.entry import Entry, may_enter
from qcar_env.evaluation.policy import shown_to
from qcar_env.evaluation.score import History, Row, Scores, for_track, score
from qcar_env.evaluation.standings import Standing, findings, standings
from qcar_env.evaluation.tracks import Track
from qcar_env.evaluation.workers import Task, each_done
from qcar_env.physics.signals import Signal
from qcar_env.scenarios.files import as_record
from qcar_env.validation import whole

SLOWEST = ("mpc",)  # started first, so that no core waits for them at the end

Unit = tuple[str, float]  # name of a track, force limit over the scenario's own [-]
Progress = Callable[[str, int, int, float], None]  # name, done, of how many, seconds spent


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A policy that did not run to the end."""

    policy: str
    track: str
    force_scale: float
    error: str  # one line
    details: str  # where

    def __str__(self) -> str:
        """Return all but the details in a line."""
        return f"{self.policy} failed on {self.track} x{self.force_scale:g}: {self.error}"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The whole benchmark: standings, figures, tables and pages are made from it."""

    tracks: tuple[Track, ...]
    seed: int | None  # of the episodes; None: the tracks' own
    rows: tuple[Row, ...]
    histories: dict[tuple[str, str, float], History]  # by policy, track and force limit
    bounds: dict[Unit, tuple[Bound, ...]]
    failures: tuple[Failure, ...]

    @property
    def cases(self) -> tuple[Track, ...]:
        """The tracks whose policies were made for another (see `robustness`)."""
        return tuple(each for each in self.tracks if each.made_for is not None)

    @property
    def homes(self) -> tuple[Track, ...]:
        """The other tracks."""
        return tuple(each for each in self.tracks if each.made_for is None)

    @property
    def findings(self) -> tuple[str, ...]:
        """What the standings on `homes` show, in sentences."""
        names = {each.name for each in self.homes}
        return findings(each for each in self.standings if each.track in names)

    def by_case(self) -> dict[str, list[float]]:
        """Return the mean rho of each policy in each of `cases` [-]; nan where it did not run."""
        found: dict[str, list[float]] = {}
        for i, case in enumerate(self.cases):
            for each in self.ranked(case.name, case.force_scales[0]):
                found.setdefault(each.policy, [float("nan")] * len(self.cases))[i] = each.rho.value
        return dict(sorted(found.items(), key=lambda pair: max(pair[1])))

    @cached_property
    def standings(self) -> tuple[Standing, ...]:
        """Policies ranked, best first within each track and force limit."""
        lower = {unit: [bound.lower for bound in each] for unit, each in self.bounds.items()}
        return standings(self.rows, lower, seed=self.seed or 0)

    def ranked(self, track: str, force_scale: float) -> list[Standing]:
        """Return the standings at one force limit of a track, best first."""
        here = (track, force_scale)
        return [each for each in self.standings if (each.track, each.force_scale) == here]

    def best_learned(self, track: str, force_scale: float) -> Standing | None:
        """Return the best of the learned policies there, if any entered."""
        there = self.ranked(track, force_scale)
        return next((each for each in there if each.kind == "learned"), None)

    def by_policy(self, track: str, force_scale: float) -> dict[str, list[float]]:
        """Return rho of every episode there [-], by policy."""
        found: dict[str, list[float]] = {}
        for row in self.rows:
            if (row.track, row.force_scale) == (track, force_scale):
                found.setdefault(row.policy, []).append(row.rho)
        return found


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What one entry brought home."""

    scores: dict[Unit, Scores]
    failures: tuple[Failure, ...]


def run(
    tracks: Sequence[Track],
    entries: Sequence[Entry],
    *,
    seed: int | None = None,
    jobs: int = 1,
    progress: Progress = lambda name, done, total, spent: None,
) -> Outcome:
    """Score entries on tracks.

    Parameters
    ----------
    tracks : sequence of Track
        Where.
    entries : sequence of Entry
        Who enters.
    seed : int, optional
        Another seed of the episodes than the tracks'.
    jobs : int
        Worker processes; with 1 everything runs in this one.
    progress : callable, optional
        Called after each entry.

    Returns
    -------
    Outcome
        A policy that fails somewhere is listed in `failures`; what it did elsewhere counts.

    Raises
    ------
    ValueError
        If two entries have one name, or a number is out of range.
    """
    whole("jobs", jobs)
    _check(entries, seed)
    order = sorted(entries, key=lambda each: each.name not in SLOWEST)
    distinct = _distinct(tracks)
    begin = time.monotonic()
    parts: dict[str, _Part] = {}

    def keep(entry: Entry, part: _Part) -> None:
        parts[entry.name] = part
        progress(entry.name, len(parts), len(order), time.monotonic() - begin)

    if jobs == 1:
        found = [optimum_of(*unit, seed=seed) for unit in distinct.values()]
        for each in order:
            keep(each, _enter(each, tracks, seed))
    else:
        # The optimum goes in among the first: alone at the end it would keep all waiting.
        first, units = sum(each.name in SLOWEST for each in order), list(distinct.values())
        tasks: list[Task] = [partial(_enter, each, tracks, seed) for each in order]
        tasks[first:first] = [partial(optimum_of, *unit, seed=seed) for unit in units]
        optima: dict[int, tuple[Bound, ...]] = {}
        with closing(each_done(tasks, jobs)) as done:
            for index, part, error in done:
                if first <= index < first + len(units):
                    # an error: whatever ended that worker, policies that have run stay counted
                    optima[index] = tasks[index]() if error else part
                else:
                    each = order[index if index < first else index - len(units)]
                    # an error: the worker itself died
                    keep(each, _all_failed(each, tracks, error) if error else part)
        found = [optima[index] for index in sorted(optima)]
    return _outcome(tracks, entries, seed, parts, dict(zip(distinct, found, strict=True)))


def run_grid(
    tracks: Sequence[Track],
    entries: Sequence[Entry],
    folder: Path,
    execute: grid.Executor | None,
    *,
    seeds: Sequence[int | None] = (None,),
    progress: grid.Progress = lambda done, total: None,
) -> tuple[Outcome, ...]:
    """Score entries on tracks as a grid: tracks x entries x seeds, a file for each cell.

    Parameters
    ----------
    tracks, entries
        See `run`, whose result is the same to the last bit.
    folder : Path
        Of the cells' files; what is there is not run again (see `qcar_env.evaluation.grid`).
    execute : callable or None
        Runs tasks, on a cluster for instance; with None nothing is run, and what the folder holds
        is merged.
    seeds : sequence of int or None
        Of the episodes; None: the tracks' own.
    progress : callable, optional
        Called after each task.

    Returns
    -------
    tuple of Outcome
        One for each seed. Cells without a result are listed in `Outcome.failures`.

    Raises
    ------
    ValueError
        If two entries have one name, or a seed is out of range.
    """
    for seed in seeds:
        _check(entries, seed)
    cells = {seed: _cells(tracks, entries, seed) for seed in seeds}
    failed: dict[str, BaseException] = {}
    if execute is not None:
        everything = [cell for each in cells.values() for cell, *_ in each]
        failed = grid.run(everything, folder, execute, progress=progress)
    return tuple(
        _merged(tracks, entries, folder, seed, each, failed) for seed, each in cells.items()
    )


_Place = tuple[grid.Cell, Entry | None, list[Unit]]  # None: the optimum


def _cells(tracks: Sequence[Track], entries: Sequence[Entry], seed: int | None) -> list[_Place]:
    """Return a cell for each entry and each set of episodes, with the units that it counts for."""
    alike: dict[tuple[Track, float], list[Track]] = {}
    for track, scale in _units(tracks):
        alike.setdefault((_alike(track), scale), []).append(track)
    made_with = storage.versions()
    slow = [each for each in entries if each.name in SLOWEST]
    found: list[_Place] = []
    for entry in (*slow, None, *(each for each in entries if each not in slow)):
        for (key, scale), members in alike.items():
            here = [dataclasses.replace(each, force_scales=(scale,)) for each in members]
            work: Task = partial(_bounds, here[0], scale, seed)
            if entry is not None:
                work = partial(_scores, entry, here, seed)
            config = {
                "policy": "" if entry is None else entry.name,
                "kind": "optimum" if entry is None else entry.kind,
                "reads": None if entry is None else as_record(entry.reads),
                "source": "" if entry is None else entry.source,
                "tracks": [as_record(each) for each in here],
                "versions": made_with,
            }
            intervals = key.episodes * round(key.duration / key.nominal.dt)
            cell = grid.Cell(config=config, seed=seed, work=work, intervals=intervals)
            found.append((cell, entry, [(each.name, scale) for each in members]))
    return found


def _scores(entry: Entry, tracks: Sequence[Track], seed: int | None) -> list[dict[str, Any]]:
    """Return the scores of an entry on tracks with the same episodes, as JSON holds them."""
    part = _enter(entry, tracks, seed)
    if part.failures:
        raise FailedError(part.failures)
    return [
        {
            "track": name,
            "force_scale": scale,
            "rows": [dataclasses.asdict(row) for row in each.rows],
            "history": {
                field.name: getattr(each.history, field.name).tolist()
                for field in dataclasses.fields(each.history)
            },
        }
        for (name, scale), each in part.scores.items()
    ]


def _bounds(track: Track, scale: float, seed: int | None) -> list[dict[str, Any]]:
    return [dataclasses.asdict(each) for each in optimum_of(track, scale, seed=seed)]


class FailedError(RuntimeError):
    """An entry did not run to the end."""

    def __init__(self, failures: tuple[Failure, ...]) -> None:
        super().__init__(failures)
        self.failures = failures


def _merged(
    tracks: Sequence[Track],
    entries: Sequence[Entry],
    folder: Path,
    seed: int | None,
    cells: Sequence[_Place],
    failed: Mapping[str, BaseException],
) -> Outcome:
    """Return what the cells of a seed hold."""
    scores: dict[str, dict[Unit, Scores]] = {each.name: {} for each in entries}
    failures: dict[str, list[Failure]] = {each.name: [] for each in entries}
    bounds: dict[Unit, tuple[Bound, ...]] = {}
    missing = FileNotFoundError(f"no result in {folder}; run the grid again")
    for cell, entry, units in cells:
        found = grid.read(folder, cell.key)
        if entry is None:
            # without a file it is found here: the standings need it
            track = next(each for each in tracks if each.name == units[0][0])
            found = _bounds(track, units[0][1], seed) if found is None else found
            bounds |= dict.fromkeys(units, tuple(Bound(**each) for each in found))
        elif found is None:
            error = failed.get(cell.key, missing)
            failures[entry.name] += (
                error.failures
                if isinstance(error, FailedError)
                else [_failure(entry.name, *unit, error) for unit in units]
            )
        else:
            for each in found:
                scores[entry.name][(each["track"], each["force_scale"])] = Scores(
                    rows=tuple(Row(**row) for row in each["rows"]),
                    history=History(
                        **{name: np.array(value) for name, value in each["history"].items()}
                    ),
                )
    units = [(each.name, scale) for each, scale in _units(tracks)]
    parts = {
        name: _Part(
            scores={unit: found[unit] for unit in units if unit in found},
            failures=tuple(
                sorted(failures[name], key=lambda each: units.index((each.track, each.force_scale)))
            ),
        )
        for name, found in scores.items()
    }
    distinct = {(_alike(each), scale): bounds[(each.name, scale)] for each, scale in _units(tracks)}
    return _outcome(tracks, entries, seed, parts, distinct)


def _check(entries: Sequence[Entry], seed: int | None) -> None:
    if seed is not None:
        whole("seed", seed, least=0)
    names = [each.name for each in entries]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two policies are called {name!r}; rename yours")


def _outcome(
    tracks: Sequence[Track],
    entries: Sequence[Entry],
    seed: int | None,
    parts: Mapping[str, _Part],
    bounds: Mapping[tuple[Track, float], tuple[Bound, ...]],
) -> Outcome:
    """Put together what the entries brought home; `bounds` are by `_distinct`."""
    inside = {each.name: parts[each.name] for each in entries}
    return Outcome(
        tracks=tuple(tracks),
        seed=seed,
        rows=tuple(
            row for part in inside.values() for each in part.scores.values() for row in each.rows
        ),
        histories={
            (name, *unit): each.history
            for name, part in inside.items()
            for unit, each in part.scores.items()
        },
        bounds={
            (each.name, scale): bounds[(_alike(each), scale)] for each, scale in _units(tracks)
        },
        failures=tuple(failure for part in inside.values() for failure in part.failures),
    )


def _enter(entry: Entry, tracks: Sequence[Track], seed: int | None) -> _Part:
    """Run one entry over its tracks; every error stays with its own track and limit."""
    scores: dict[Unit, Scores] = {}
    failures: list[Failure] = []
    done: dict[tuple[Track, float, tuple[Signal, ...]], Scores] = {}
    for track, scale in _units(tracks):
        if entry.reads is not None and not may_enter(entry.reads, track):
            continue
        try:
            policy = entry.make(track.home.at(scale), track.home, scale)
            if policy is None:
                continue
            reads, limit = shown_to(policy, track.observe)
            if not may_enter(reads, track):
                continue
            key = (_alike(track), scale, observed(reads, limit))
            if key not in done:  # tracks that show the same episodes are run once
                done[key] = score(policy, track, scale, name=entry.name, kind=entry.kind, seed=seed)
            scores[(track.name, scale)] = for_track(done[key], track)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # not even SystemExit of a policy ends the benchmark
            failures.append(_failure(entry.name, track.name, scale, error))
    return _Part(scores=scores, failures=tuple(failures))


def _all_failed(entry: Entry, tracks: Sequence[Track], error: BaseException) -> _Part:
    return _Part(
        scores={},
        failures=tuple(
            _failure(entry.name, each.name, scale, error) for each, scale in _units(tracks)
        ),
    )


def _failure(policy: str, track: str, scale: float, error: BaseException) -> Failure:
    try:
        text = " ".join(str(error).split()) or "no message"
    except Exception:  # the error is the policy's own
        text = "its message cannot be read"
    return Failure(
        policy=policy,
        track=track,
        force_scale=scale,
        error=f"{type(error).__name__}: {text}",
        details="".join(traceback.format_exception(error)[-3:]),
    )


def _units(tracks: Sequence[Track]) -> list[tuple[Track, float]]:
    return [(each, scale) for each in tracks for scale in each.force_scales]


def _distinct(tracks: Sequence[Track]) -> Mapping[tuple[Track, float], tuple[Track, float]]:
    """Return tracks and limits without those that have the episodes of one before."""
    found: dict[tuple[Track, float], tuple[Track, float]] = {}
    for each, scale in _units(tracks):
        found.setdefault((_alike(each), scale), (each, scale))
    return found


def _alike(track: Track) -> Track:
    """Return what a track's episodes hang on: two tracks with the same are run once."""
    return dataclasses.replace(
        track, name="", version=1, title="", observe="full", force_scales=(), metrics=()
    )
