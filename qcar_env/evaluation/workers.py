"""Tasks in processes of their own: one that dies takes no other with it, and none outlives us.

`concurrent.futures` loses every task when one worker dies, and leaves its workers alive when the
process that started them is killed. A worker is killed as soon as there is nothing more for it to
do, since what a task left running in it could keep it for ever.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, cast

Task = Callable[[], Any]
GRACE = 5.0  # [s] that a worker which has closed its end has to say how it ended
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
        A worker that had done another task before may have died of that one, so that the task is
        tried once more in a fresh one.
    """
    todo = deque(enumerate(tasks))
    workers: dict[Any, tuple[SpawnProcess, int, bool]] = {}  # by our end of the pipe to each

    def begin(pipe: Any, process: SpawnProcess, *, fresh: bool) -> None:
        """Give a worker the next task, or end it where there is none."""
        if not todo:
            _end(pipe, process)
            return
        index, task = todo.popleft()
        workers[pipe] = process, index, fresh
        with contextlib.suppress(ConnectionError):  # it is dead, which reading will tell
            pipe.send_bytes(_packed(task))

    try:
        for _ in range(min(jobs, len(todo))):
            begin(*_worker(), fresh=True)
        while workers:
            for pipe in cast("list[Any]", wait(list(workers))):
                process, index, fresh = workers.pop(pipe)
                try:
                    result, error = pickle.loads(pipe.recv_bytes())
                except (EOFError, ConnectionError):
                    process.join(GRACE)
                    died = WorkerDiedError(f"its process ended with {process.exitcode}")
                    _end(pipe, process)
                    if not fresh:
                        todo.appendleft((index, tasks[index]))
                    if todo:
                        begin(*_worker(), fresh=True)
                    if fresh:
                        yield index, None, died
                else:
                    begin(pipe, process, fresh=False)
                    yield index, result, error
    finally:
        for pipe, (process, *_) in workers.items():
            _end(pipe, process)


def one_by_one(tasks: Sequence[Task]) -> list[tuple[Any, BaseException | None]]:
    """Run tasks one after another as a task of their own; what one raises stays with it."""
    found: list[tuple[Any, BaseException | None]] = []
    for task in tasks:
        try:
            found.append((task(), None))
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            found.append((None, portable(error)))
    return found


def portable(error: BaseException) -> BaseException:
    """Return an error that can be read in another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("".join(traceback.format_exception_only(error)).strip())
    return error


def _worker() -> tuple[Any, SpawnProcess]:
    """Start a worker; return our end of the pipe to it, and its process."""
    mine, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
    with _undisturbed():
        process.start()
    theirs.close()  # the worker's end is then the only one, so that its death can be read
    return mine, process


def _end(pipe: Any, process: SpawnProcess) -> None:
    process.kill()  # a policy may have made it deaf to gentler words
    process.join()
    pipe.close()


@contextlib.contextmanager
def _undisturbed() -> Generator[None, None, None]:
    """Start a process that a terminal's Ctrl-C does not reach even while it imports."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # which starting would do, and it unblocks signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _packed(task: Task) -> bytes:
    """Return a task as bytes; one that cannot be pickled as one that raises why."""
    try:
        return pickle.dumps(task)
    except Exception as error:
        return pickle.dumps(partial(_raise, portable(error)))


def _raise(error: BaseException) -> None:
    raise error


def _work(tasks: Connection) -> None:
    """Do tasks until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all; who started us acts
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            task = tasks.recv_bytes()
            try:
                found = pickle.dumps((pickle.loads(task)(), None))
            except BaseException as error:
                found = pickle.dumps((None, portable(error)))
            tasks.send_bytes(found)


def _end_with_parent() -> None:
    """End this process, whatever it is doing, when the one that started it is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
