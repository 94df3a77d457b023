"""Tasks in processes of their own: one that dies takes no other with it, and none outlives us.

`concurrent.futures` loses every task when one worker dies, and leaves its workers alive when the
process that started them is killed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, cast

Task = Callable[[], Any]
_SPAWN = multiprocessing.get_context("spawn")


class WorkerDiedError(RuntimeError):
    """A worker ended before its task did."""


def each_done(
    tasks: Sequence[Task], jobs: int
) -> Generator[tuple[int, Any, BaseException | None], None, None]:
    """Run tasks in worker processes, and yield each as it is done.

    Parameters
    ----------
    tasks : sequence of callable
        Without arguments; they, their results and their errors can be pickled. They begin in order.
    jobs : int
        Worker processes, no more than there are tasks.

    Yields
    ------
    index : int
        Which task.
    result : object
        What it returned; None if it raised.
    error : BaseException or None
        What it raised, ``SystemExit`` too; `WorkerDiedError` if its worker ended without a word.
    """
    todo = deque(enumerate(tasks))
    workers: dict[Any, tuple[SpawnProcess, int]] = {}  # by our end of the pipe to each

    def begin(pipe: Any, process: SpawnProcess) -> None:
        """Give a worker the next task, or let it end where there is none."""
        if not todo:
            pipe.close()
            process.join()
            return
        index, task = todo.popleft()
        workers[pipe] = process, index
        with contextlib.suppress(ConnectionError):  # it is dead, which reading will tell
            pipe.send(task)

    try:
        for _ in range(min(jobs, len(todo))):
            begin(*_worker())
        while workers:
            for pipe in cast("list[Any]", wait(list(workers))):
                process, index = workers.pop(pipe)
                result, error = None, None
                try:
                    result, error = pickle.loads(pipe.recv_bytes())
                except (EOFError, ConnectionError):
                    process.join()
                    pipe.close()
                    error = WorkerDiedError(f"its process ended with {process.exitcode}")
                    if todo:
                        begin(*_worker())
                else:
                    begin(pipe, process)
                yield index, result, error
    finally:
        for process, _ in workers.values():
            process.terminate()
        for pipe, (process, _) in workers.items():
            process.join()
            pipe.close()


def _worker() -> tuple[Any, SpawnProcess]:
    """Start a worker; return our end of the pipe to it, and its process."""
    mine, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
    process.start()
    theirs.close()  # the worker's end is then the only one, so that its death can be read
    return mine, process


def _work(tasks: Connection) -> None:
    """Do tasks until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; who started us acts
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            task = tasks.recv()
            try:
                found = pickle.dumps((task(), None))
            except BaseException as error:
                found = pickle.dumps((None, _portable(error)))
            tasks.send_bytes(found)


def _portable(error: BaseException) -> BaseException:
    """Return an error that can be read in another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with_parent() -> None:
    """End this process, whatever it is doing, when the one that started it is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
