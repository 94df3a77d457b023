"""Worker processes: what they return, how they die, and that none is left behind."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
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
