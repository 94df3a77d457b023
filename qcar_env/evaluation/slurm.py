"""Tasks as a Slurm job array through submitit, as `workers.each_done` runs them here.

An array has one job for each worker, which does its share of the tasks one after another: a
scheduler takes seconds for each job, and many sites refuse arrays of short ones. Where there is no
Slurm the jobs are processes of this machine.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from qcar_env.evaluation.workers import Task, WorkerDiedError, one_by_one

INSTALL = "pip install 'qcar_env[cluster]'"


def check_installed() -> None:
    """Raise ValueError, with what to install, where submitit is absent."""
    if importlib.util.find_spec("submitit") is None:
        raise ValueError(f"submitit is not installed; {INSTALL}")


def each_done(
    tasks: Sequence[Task],
    jobs: int,
    folder: Path,
    *,
    local: bool = False,
    minutes: int = 240,
    **parameters: Any,
) -> Generator[tuple[int, Any, BaseException | None], None, None]:
    """Run tasks in a job array, and yield each when its job has ended.

    Parameters
    ----------
    tasks : sequence of callable
        As in `qcar_env.evaluation.workers.each_done`, which says as well what is yielded.
    jobs : int
        Jobs of the array, no more than there are tasks.
    folder : Path
        Of submitit's files, on a disk that all machines share.
    local : bool
        Use processes of this machine even where there is Slurm.
    minutes : int
        Time limit of a job [min].
    **parameters
        Of submitit's executor besides, such as ``slurm_partition``.
    """
    check_installed()
    import submitit  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

    if not tasks:
        return
    executor: Any = submitit.AutoExecutor(folder, cluster="local" if local else None)
    executor.update_parameters(timeout_min=minutes, cpus_per_task=1, **parameters)
    shares = [list(range(first, len(tasks), jobs)) for first in range(min(jobs, len(tasks)))]
    running: list[Any] = executor.map_array(
        one_by_one, [[tasks[index] for index in share] for share in shares]
    )
    try:
        for job in submitit.helpers.as_completed(running, poll_frequency=1.0):
            share = shares[running.index(job)]
            try:
                results = job.result()
            except Exception as error:  # it ended without a word: killed, out of time or memory
                died = WorkerDiedError(f"job {job.job_id}: {' '.join(str(error).split())[:200]}")
                results = [(None, died)] * len(share)
            for index, (result, error) in zip(share, results, strict=True):
                yield index, result, error
    finally:
        for job in running:
            if not job.done():
                job.cancel()
