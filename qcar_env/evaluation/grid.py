"""Grids: many cells, each a pure function of its configuration and seed, a file for each.

A cell's file is called after the hash of its configuration and its seed, is written whole or not at
all, and a cell that has one is not run again: a killed grid goes on, several machines may fill one
folder, and what they have found is merged by reading it. Cells go to the workers in chunks, so that
a task lasts seconds and its way to a worker, milliseconds, does not count.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from qcar_env.evaluation import storage
from qcar_env.evaluation.workers import Task, one_by_one

# Of a task: a core steps 10^6 car intervals under a law in a second or two (docs/performance.md).
INTERVALS = 3_000_000
Executor = Callable[[Sequence[Task]], Generator[tuple[int, Any, BaseException | None], None, None]]
Progress = Callable[[int, int], None]  # cells done, of how many


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell of a grid.

    Parameters
    ----------
    config : mapping
        All that the result hangs on but the seed, as JSON holds it.
    seed : int or None
        Of what is drawn; None for a seed that is part of the configuration.
    work : callable
        Without arguments; returns what JSON holds. It can be pickled.
    intervals : int
        Control intervals of all cars that it takes, for chunks of even length.
    """

    config: Mapping[str, Any]
    seed: int | None
    work: Task
    intervals: int

    @property
    def key(self) -> str:
        """Name of its file: hash of the configuration and seed."""
        return f"{digest(self.config)}-{'own' if self.seed is None else self.seed}"


def digest(config: Any) -> str:
    """Return a short hash of what JSON holds (64 bits: 10^6 cells share one with chance 3e-8)."""
    text = json.dumps(config, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def run(
    cells: Sequence[Cell],
    folder: Path,
    execute: Executor,
    *,
    intervals: int = INTERVALS,
    progress: Progress = lambda done, total: None,
) -> dict[str, BaseException]:
    """Run the cells that have no file yet, and write one for each.

    Parameters
    ----------
    cells : sequence of Cell
        Which.
    folder : Path
        Of their files; the workers need not see it.
    execute : callable
        Runs tasks: `qcar_env.evaluation.ray_workers.each_done`, or one of its kind with the number
        of workers filled in.
    intervals : int
        Control intervals of a task; a larger cell is a task by itself.
    progress : callable
        Called after each task.

    Returns
    -------
    dict of str to BaseException
        What failed, by key: no file is written, so that another run tries again.
    """
    distinct = {each.key: each for each in cells}
    todo = [each for key, each in distinct.items() if read(folder, key) is None]
    done = len(distinct) - len(todo)
    progress(done, len(distinct))
    failed: dict[str, BaseException] = {}
    parts = chunks(todo, intervals)
    tasks: list[Task] = [partial(one_by_one, [each.work for each in part]) for part in parts]
    with closing(execute(tasks)) as finished:
        for index, results, error in finished:
            part = parts[index]
            for cell, (result, wrong) in zip(
                part, results or [(None, error)] * len(part), strict=True
            ):
                try:
                    if wrong is not None:
                        raise wrong
                    storage.write_text(_path(folder, cell.key), json.dumps({"result": result}))
                except KeyboardInterrupt:
                    raise
                except BaseException as reason:  # its own, or the disk's; the others go on
                    failed[cell.key] = reason
            done += len(part)
            progress(done, len(distinct))
    return failed


def read(folder: Path, key: str) -> Any:
    """Return the result of a cell, or None where it has none or a damaged file."""
    try:
        return json.loads(_path(folder, key).read_text(encoding="utf-8"))["result"]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def chunks(cells: Sequence[Cell], intervals: int) -> list[list[Cell]]:
    """Return cells in their order, in groups of at most so many control intervals."""
    found: list[list[Cell]] = []
    room = 0
    for each in cells:
        if each.intervals > room or not found:
            found.append([])
            room = intervals
        found[-1].append(each)
        room -= each.intervals
    return found


def _path(folder: Path, key: str) -> Path:
    return folder / key[:2] / f"{key}.json"  # 256 folders: 10^6 files in one are slow to list
