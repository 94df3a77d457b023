"""Compiled code on disk: what one process has compiled serves another, and nothing else does."""

import os
import subprocess
import sys

import pytest

MADE = """
import math
from qcar_env.engine.compile import compiled_apart, kernel


def make(n):
    @compiled_apart
    def inner(x):  # too long for the compiler to put it into its caller
        t = 0.0
        for i in range(x):
            t += math.sin(t + i) * math.cos(t - i) + math.exp(-t * t) + math.sin(2.0 * t + i)
            for j in range(i):
                t += math.sin(t + j) * math.cos(t - j) + math.exp(-t * t) + math.atan2(t + j, t)
        return 0.0 * t + n

    @kernel
    def outer(x):
        return inner(x) + inner(x + 1) + inner(x + 2) + inner(x + 3)

    return outer
"""


def test_functions_compiled_by_two_processes_are_told_apart_by_a_third(tmp_path):
    """They have one name: closures of the same function, the first that each process compiles."""
    (tmp_path / "made.py").write_text(MADE)
    paths = [str(tmp_path), os.getcwd()]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(paths)}
    show = "f = make({0}); print(f(0), sum(f.stats.cache_hits.values()))"

    def run(*numbers):
        lines = ["from made import make", *(show.format(n) for n in numbers)]
        command = [sys.executable, "-c", "\n".join(lines)]
        return subprocess.run(command, env=env, check=True, capture_output=True, text=True).stdout

    assert run(1) == "4.0 0\n"
    assert run(2) == "8.0 0\n"
    assert run(1, 2) == "4.0 1\n8.0 1\n"


HINTED = """
from qcar_env.engine.compile import align_stack, compiled, disjoint, kernel, widen


def make(n):
    @compiled
    def inner(x):
        align_stack()
        widen()
        disjoint()
        return x + n

    @kernel
    def outer(x):
        return inner(x)

    return outer
"""


def test_what_gives_hints_to_the_compiler_is_found_again(tmp_path):
    """Each process compiled the steps of cars anew, for 8 s."""
    (tmp_path / "made.py").write_text(HINTED)
    assert python(tmp_path, *SHOW).stdout == "1 0\n"
    assert python(tmp_path, *SHOW).stdout == "1 1\n"


def python(tmp_path, *lines, **settings):
    """Run lines in a process of its own that keeps compiled code in `tmp_path`."""
    paths = [str(tmp_path), os.getcwd()]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.run(
        [sys.executable, "-c", "\n".join(lines)],
        env={**env, **settings},
        capture_output=True,
        text=True,
        check=False,
    )


SHOW = ("from made import make", "f = make(1)", "print(f(0), sum(f.stats.cache_hits.values()))")


@pytest.mark.parametrize(
    ("ending", "damage"),
    [("*.nbi", b""), ("*.nbi", b"cno_such_module\nThing\n."), ("*.nbc", b"no pickle")],
)
def test_damaged_code_on_disk_is_made_anew(tmp_path, ending, damage):
    (tmp_path / "made.py").write_text(MADE)
    assert python(tmp_path, *SHOW).stdout == "4.0 0\n"
    for file in tmp_path.rglob(ending):
        file.write_bytes(damage)
    assert python(tmp_path, *SHOW).stdout == "4.0 0\n"
    assert python(tmp_path, *SHOW).stdout == "4.0 1\n"


def test_where_nothing_can_be_written_code_is_compiled_all_the_same(tmp_path):
    (tmp_path / "made.py").write_text(MADE)
    nowhere = "/proc/no/such/folder"  # not even for the superuser
    lines = (
        "from numba.core import caching",
        "caching.CacheImpl._locator_classes = []",
        *SHOW,
    )
    assert python(tmp_path, *lines).stdout == "4.0 0\n"
    assert python(tmp_path, *SHOW, NUMBA_CACHE_DIR=nowhere, HOME=nowhere).stdout == "4.0 0\n"


def test_a_compiler_that_is_switched_off_is_named(tmp_path):
    (tmp_path / "made.py").write_text(MADE)
    said = python(tmp_path, *SHOW, NUMBA_DISABLE_JIT="1").stderr
    assert "RuntimeError: the engine is compiled code, but NUMBA_DISABLE_JIT is set" in said
