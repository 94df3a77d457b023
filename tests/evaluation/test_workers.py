"""Worker processes: what they return, how they die, and that none is left behind."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from qcar_env.evaluation.workers import WorkerDiedError, each_done


class OddError(Exception):
    """It cannot be made from its message."""

    def __init__(self, a, b):
        super().__init__(f"{a} and {b}")


def oddly():
    raise OddError(1, 2)


def forever(path):
    Path(path).write_text(str(os.getpid()), encoding="utf-8")
    while True:
        pass


@pytest.mark.parametrize("jobs", [1, 2, 100])
def test_every_task_is_done_once_and_keeps_its_index(jobs):
    tasks = [partial(pow, 2, k) for k in range(7)]
    found = {index: (result, error) for index, result, error in each_done(tasks, jobs)}
    assert found == {k: (2**k, None) for k in range(7)}
    assert list(each_done([], jobs)) == []


def test_a_worker_that_dies_takes_no_other_task_with_it():
    tasks = [
        partial(pow, 2, 3),
        partial(os._exit, 0),
        partial(sys.exit, 0),
        partial(os.kill, os.getpid(), 0),
        oddly,
        partial(eval, "lambda: 0"),  # returns what cannot be pickled
        partial(int, "x"),
        partial(pow, 2, 4),
    ]
    found = {index: (result, error) for index, result, error in each_done(tasks, 2)}
    assert found[0] == (8, None)
    assert found[7] == (16, None)
    assert isinstance(found[1][1], WorkerDiedError)
    assert str(found[1][1]) == "its process ended with 0"
    assert isinstance(found[2][1], SystemExit)
    assert "OddError: 1 and 2" in str(found[4][1])
    assert "pickle" in str(found[5][1])
    assert isinstance(found[6][1], ValueError)


def dies_later(path):
    """Be done with the task, and end the process when the next one has begun."""

    def end():
        pid_in(path)
        os._exit(7)

    threading.Thread(target=end, daemon=True).start()


def once(path):
    """Say that the task has begun, and take long enough to be killed, the first time."""
    first = not path.exists()
    path.write_text(str(os.getpid()), encoding="utf-8")
    if first:
        time.sleep(60)
    return os.getpid()


def test_what_a_task_leaves_behind_does_not_lose_the_next_tasks_result(tmp_path):
    path = tmp_path / "begun"
    tasks = [partial(dies_later, path), partial(once, path)]
    found = {index: (result, error) for index, result, error in each_done(tasks, 1)}
    assert found[0] == (None, None)
    assert found[1] == (int(path.read_text(encoding="utf-8")), None)


def stays():
    threading.Thread(target=time.sleep, args=(600.0,)).start()
    return 8


def deaf(path):
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    forever(path)


def test_a_thread_that_a_task_leaves_running_keeps_nobody_waiting():
    begin = time.monotonic()
    assert list(each_done([stays], 1)) == [(0, 8, None)]
    assert time.monotonic() - begin < 60.0


def test_a_task_that_cannot_be_sent_fails_alone():
    tasks = [lambda: 0, partial(pow, 2, 3)]
    found = {index: (result, error) for index, result, error in each_done(tasks, 1)}
    assert "lambda" in str(found[0][1])
    assert found[1] == (8, None)


class Unreadable:
    """It cannot be made again from what is sent."""

    def __reduce__(self):
        return int, ("x",)

    def __call__(self):
        raise AssertionError("it was never sent")


def test_a_task_that_cannot_be_read_by_its_worker_fails_alone(capfd):
    found = {index: (result, error) for index, result, error in each_done([Unreadable(), int], 1)}
    assert isinstance(found[0][1], ValueError)
    assert found[1] == (0, None)
    assert capfd.readouterr().err == ""


def alive(pid):
    """Say whether a process runs; one that has ended and waits to be read does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").split()[2] != "Z"
    except FileNotFoundError:
        return False


def gone(pid, within=20.0):
    end = time.monotonic() + within
    while alive(pid) and time.monotonic() < end:
        time.sleep(0.05)
    return not alive(pid)


def pid_in(path, within=60.0):
    end = time.monotonic() + within
    while time.monotonic() < end:
        with contextlib.suppress(FileNotFoundError, ValueError):
            return int(path.read_text(encoding="utf-8"))
        time.sleep(0.05)
    raise AssertionError(f"no worker wrote {path}")


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")


@needs_proc
def test_workers_end_when_nobody_wants_their_results(tmp_path):
    tasks = [partial(pow, 2, 3), partial(forever, tmp_path / "a"), partial(forever, tmp_path / "b")]
    done = each_done(tasks, 3)
    assert next(done)[:2] == (0, 8)
    pids = [pid_in(tmp_path / name) for name in "ab"]
    done.close()
    assert all(map(gone, pids))


@needs_proc
def test_a_worker_that_ignores_sigterm_ends_too(tmp_path):
    done = each_done([partial(pow, 2, 3), partial(deaf, tmp_path / "a")], 2)
    next(done)
    pid = pid_in(tmp_path / "a")
    done.close()
    assert gone(pid)


@needs_proc
def test_a_terminals_interrupt_does_not_reach_a_worker_that_still_imports(tmp_path):
    """It is sent to every process of the group, and who started the worker answers it."""
    script = f"""
        import os, time
        from functools import partial
        from qcar_env.evaluation.workers import each_done

        if __name__ != "__main__":  # a worker imports this file
            with open("{tmp_path}/importing", "w") as file:
                file.write(str(os.getpid()))
            time.sleep(1.0)
        else:
            print(list(each_done([partial(pow, 2, 3)], 1)))
    """
    path = tmp_path / "start.py"
    path.write_text(textwrap.dedent(script), encoding="utf-8")
    given = dict(os.environ, PYTHONPATH=str(Path(__file__).parents[2]))
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, path], env=given, **piped) as process:
        os.kill(pid_in(tmp_path / "importing"), signal.SIGINT)
        printed, said = process.communicate(timeout=30)
    assert said == ""
    assert printed == "[(0, 8, None)]\n"


@needs_proc
@pytest.mark.parametrize("by", ["SIGTERM", "SIGKILL", "SIGINT"])
def test_workers_end_with_who_started_them(tmp_path, by):
    script = f"""
        import signal
        from functools import partial
        from tests.evaluation.test_workers import forever
        from qcar_env.evaluation.workers import each_done

        if __name__ == "__main__":
            signal.signal(signal.SIGINT, signal.default_int_handler)
            list(each_done([partial(forever, "{tmp_path}/a"), partial(forever, "{tmp_path}/b")], 2))
    """
    path = tmp_path / "start.py"
    path.write_text(textwrap.dedent(script), encoding="utf-8")
    root = Path(__file__).parents[2]
    given = dict(os.environ, PYTHONPATH=str(root))
    with subprocess.Popen([sys.executable, path], env=given, stderr=subprocess.DEVNULL) as process:
        pids = [pid_in(tmp_path / name) for name in "ab"]
        process.send_signal(getattr(signal, by))
        process.wait(timeout=30)
    assert all(map(gone, pids))
