"""Tasks on a Ray cluster, as `workers.each_done` runs them in processes of this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import pickle
import socket
from collections import deque
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import Any

from qcar_env.evaluation.workers import Task, WorkerDiedError, portable

INSTALL = "pip install 'qcar_env[cluster]'"
LARGE = 100_000  # [B] of an argument that goes to the object store once: Ray inlines smaller ones
AHEAD = 3  # tasks submitted for each core: enough that none waits for this process
REACHED = 5.0  # [s] that a cluster has to answer; Ray itself would try for minutes
RETRIES = 3  # of a task whose worker or machine was lost


def check_installed() -> None:
    """Raise ValueError, with what to install, where Ray is absent."""
    if importlib.util.find_spec("ray") is None:
        raise ValueError(
            f"Ray is not installed; {INSTALL}, or work on this machine alone with a process pool"
        )


@contextlib.contextmanager
def cluster(address: str | None = None, cores: int | None = None) -> Generator[None, None, None]:
    """Join a Ray cluster until the block ends; one that runs already is used and left.

    Parameters
    ----------
    address : str, optional
        ``host:port`` of the head, ``auto`` for the one on this machine, or ``ray://host:port``;
        a local cluster is started if left out.
    cores : int, optional
        Of a local cluster; all if left out.

    Raises
    ------
    ValueError
        If Ray is not installed, or no cluster answers at the address.
    """
    check_installed()
    import ray  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

    if address is not None:
        _check_answers(address)
    if ray.is_initialized():
        yield
        return
    given: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if address is None:
        # a host on which a cluster runs names it in RAY_ADDRESS; only --address joins it
        given |= {"address": "local", "num_cpus": cores, "include_dashboard": False}
    else:
        given["address"] = address
    try:
        ray.init(**given)
    except (ConnectionError, RuntimeError) as error:
        raise ValueError(
            f"no Ray cluster answers at {address!r} ({error}); start one with `ray start --head`, "
            "or leave out --address for a local one"
        ) from error
    try:
        yield
    finally:
        ray.shutdown()


def cores() -> int:
    """Return the cores of the cluster that has been joined."""
    import ray  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

    return max(1, int(ray.cluster_resources().get("CPU", 1)))


def each_done(
    tasks: Sequence[Task],
) -> Generator[tuple[int, Any, BaseException | None], None, None]:
    """Run tasks on the cluster that has been joined, and yield each as it is done.

    A task is a `functools.partial`; those of its arguments that are large go to the object store,
    once for all tasks that hold the same object. A task whose machine is lost begins again on
    another.

    Parameters
    ----------
    tasks : sequence of callable
        As in `qcar_env.evaluation.workers.each_done`, which says as well what is yielded.
    """
    import ray  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]
    from ray.exceptions import (  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]
        RayError,
    )

    remote: Any = ray.remote(max_retries=RETRIES)(_call)
    stored: dict[int, Any] = {}
    todo = deque(enumerate(tasks))
    running: dict[Any, int] = {}
    try:
        while todo or running:
            while todo and len(running) < AHEAD * cores():
                index, task = todo.popleft()
                whole = task if isinstance(task, partial) else partial(task)
                try:
                    args = [_reference(each, stored, ray.put) for each in whole.args]
                    words = {k: _reference(v, stored, ray.put) for k, v in whole.keywords.items()}
                    running[remote.remote(whole.func, *args, **words)] = index
                except Exception as error:  # it cannot be pickled
                    yield index, None, error
            # a cluster may grow meanwhile, so look again after a while
            ready, _ = ray.wait(list(running), num_returns=1, timeout=10.0)
            for each in ready:
                index = running.pop(each)
                try:
                    result, error = pickle.loads(ray.get(each))
                except RayError as lost:
                    last = str(lost).strip().splitlines()[-1]  # before it stands a trace
                    result, error = None, WorkerDiedError(f"{type(lost).__name__}: {last}")
                yield index, result, error
    finally:
        for each in running:
            ray.cancel(each, force=True)


def _call(function: Callable[..., Any], *args: Any, **words: Any) -> bytes:
    """Do a task on a worker; return its result and its error as bytes."""
    try:
        return pickle.dumps((function(*args, **words), None))
    except BaseException as error:
        return pickle.dumps((None, portable(error)))


def _reference(value: Any, stored: dict[int, Any], put: Callable[[Any], Any]) -> Any:
    """Return a large argument as a reference, which Ray resolves at the worker."""
    if id(value) not in stored:
        stored[id(value)] = put(value) if len(pickle.dumps(value)) > LARGE else value
    return stored[id(value)]


def _check_answers(address: str) -> None:
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return  # auto, local: Ray tells at once
    try:
        socket.create_connection((host, int(port)), timeout=REACHED).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ValueError(
            f"no Ray cluster answers at {address!r} within {REACHED:g} s ({error}); give "
            "host:port of its head, or leave out --address for a local one"
        ) from error
