"""What every command refuses: in one line, with status 2, before any work, writing nothing."""

import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from qcar_env.agents.load import PRETRAINED
from qcar_env.commands import command as commands
from qcar_env.commands.main import COMMANDS
from qcar_env.evaluation import storage

LEARNING = ("train", "learning_report")  # commands that need torch


@pytest.mark.parametrize(
    ("command", "arguments", "message"),
    [
        ("benchmark", ["--out", "taken"], "benchmark: --out must be a folder that can be written"),
        ("calibrate", ["--out", "taken"], "calibrate: --out must be a folder that can be written"),
        ("calibrate", ["--omegas", "0"], "calibrate: omega must be positive, got 0 rad/s; give a"),
        ("calibrate", ["--omegas", "50", "nan"], "calibrate: omega must be finite, got nan rad/s"),
        ("compare", ["--out", "taken/new"], "compare: --out must be a folder that can be written"),
        ("fidelity", ["--out", "taken/new.md"], "fidelity: --out must be a folder that can be wri"),
        (
            "fidelity",
            ["--out", "."],
            "fidelity: --out must be a file, got the folder .; give a name",
        ),
        ("figures", ["--out", "taken"], "figures: --out must be a folder that can be written to"),
        (
            "learning_report",
            ["--out", "taken"],
            "learning-report: --out must be a folder that can be written",
        ),
        (
            "learning_report",
            ["--seeds", "-1"],
            "learning-report: seed must be at least 0, got -1; give 0 or",
        ),
        ("throughput", ["--threads", "0"], "throughput: threads must be at least 1, got 0; give 1"),
        ("throughput", ["--threads", str(10**8)], "throughput: threads must be at most 1024, got"),
        ("train", ["--steps", str(10**23)], "train: steps must be at most 1000000000000, got 1000"),
        ("train", ["--out", "taken"], "train: --out must be a folder that can be written to, got"),
        ("train", ["--out", "full"], "train: full is not empty; resume it with --resume, replace"),
        ("train", ["--seeds", "1", "-1"], "train: seed must be at least 0, got -1; give 0 or more"),
        (
            "train",
            ["--seeds", "0", "1", "--out", "new"],
            "train: --out must be the folder of one ru",
        ),
        (
            "train",
            ["--target-db", "nan"],
            "train: target-db must be finite, got nan dB; give a fin",
        ),
        ("train", ["--publish", str(PRETRAINED)], "train: there is an agent ppo-paper in "),
        ("train", ["--resume", "taken"], "train: taken is no run folder (NotADirectoryError: "),
        ("tune", ["--out", "."], "tune: --out must be a file, got the folder .; give a name in it"),
        (
            "tune",
            ["--out", "taken/new.json"],
            "tune: --out must be a folder that can be written to",
        ),
        ("tune", ["--out", "taken"], "tune: taken holds no tuned gains (JSONDecodeError: "),
        ("tune", ["--out", "other.json"], "tune: other.json holds no tuned gains (TypeError: "),
        ("tune", ["--seed", "-1"], "tune: seed must be at least 0, got -1; give 0 or more"),
        (
            "tune",
            ["--population", "4"],
            "tune: population must be at least 5, got 4; give 5 or more",
        ),
        ("tune", ["--force-scale", "1", "0"], "tune: force scale must be positive, got 0; give a"),
        ("watch", ["--out", "taken/film.gif"], "watch: --out must be a folder that can be written"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_what_cannot_be_is_refused_before_any_work(
    command, arguments, message, tmp_path, monkeypatch, capsys
):
    if command in LEARNING:
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    (tmp_path / "other.json").write_text("3", encoding="utf-8")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    before = sorted(tmp_path.rglob("*"))
    assert importlib.import_module(f"qcar_env.commands.{command}").main(arguments) == 2
    printed, said = capsys.readouterr()
    assert said.startswith(message)
    assert said.count("\n") == 1
    assert printed == ""
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (OSError(28, "No space left on device", "here"), 2, "No space left on device: here"),
        (OSError(28, "No space left on device"), 2, "No space left on device"),
        (OSError("half a message"), 2, "half a message"),
        (MemoryError("5.8 TiB"), 2, "not enough memory (5.8 TiB); ask for less"),
        (ValueError("no"), 2, "no"),
        (KeyboardInterrupt(), 130, "interrupted."),
        (KeyboardInterrupt("go on with: it"), 130, "interrupted. go on with: it"),
    ],
)
def test_what_ends_a_command_is_told_in_a_line(error, status, said, capsys):
    def work(arguments):
        raise error

    assert commands.main("it", "", {}, work)([]) == status
    assert capsys.readouterr().err.strip() == f"it: {said}"


def test_words_of_many_lines_are_told_in_one(capsys):
    def work(arguments):
        raise OSError("broken pipe\n\n  the program said:\n  much")

    assert commands.main("it", "", {}, work)([]) == 2
    assert capsys.readouterr().err == "it: broken pipe the program said: much\n"


@pytest.mark.parametrize(
    ("number", "status", "said"),
    [(signal.SIGINT, 130, "it: interrupted."), (signal.SIGTERM, 143, "it: terminated.")],
)
def test_a_command_that_is_told_to_end_leaves_no_half_written_file(
    number, status, said, tmp_path, capsys
):
    def work(arguments):
        with storage.replacing(tmp_path / "film.gif") as path:
            path.write_bytes(b"half")
            os.kill(os.getpid(), number)
            raise AssertionError("it went on")

    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job's
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert commands.main("it", "", {}, work)([]) == status
        assert signal.getsignal(signal.SIGTERM) == before
        assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, ignored)
    assert capsys.readouterr().err.strip() == said
    assert not list(tmp_path.iterdir())


def test_an_interrupt_that_is_ignored_stays_so():
    def work(arguments):
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        assert commands.main("it", "", {}, work)([]) == 0
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("command", COMMANDS)
def test_an_interrupt_while_a_command_imports_is_told_in_a_line(command, tmp_path):
    text = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(30)\n"
    for name in ("numba", "torch", "matplotlib"):  # whichever it imports first
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    run = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from qcar_env.commands.main import main; sys.exit(main(sys.argv[1:]))"
    )
    found = subprocess.run(
        [sys.executable, "-c", run, command],
        cwd=tmp_path,
        env=dict(os.environ, PYTHONPATH=str(tmp_path)),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert found.stderr == "interrupted.\n"
    assert found.returncode == 130


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_output_that_nobody_takes_is_told_in_a_line():
    """It was told by the interpreter, after the end, with status 120."""
    run = (
        "from qcar_env.commands import command; "
        "raise SystemExit(command.main('it', '', {}, lambda arguments: print('done'))([]))"
    )
    buffered = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        found = subprocess.run(
            [sys.executable, "-c", run],
            env=buffered,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert (found.returncode, found.stderr) == (2, "it: No space left on device\n")


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("benchmark", ["--no-agents", "--baselines", "cnvc", "--tracks", "paper", "--jobs", "1"]),
        ("compare", ["--laws", "none", "cnvc", "--duration", "2"]),
        ("figures", ["--only", "4", "--quick"]),
        ("train", ["--algo", "cma", "--steps", "1000", "--quiet"]),
        ("watch", ["--duration", "1", "--policy", "cnvc", "--out", "film.gif"]),
    ],
)
def test_a_file_that_grows_beyond_what_is_allowed_is_told_in_a_line(
    command, arguments, tmp_path, monkeypatch, capsys
):
    """A full disk is the same to a program: its writes are refused."""
    resource = pytest.importorskip("resource")
    if command in LEARNING:
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    allowed = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, allowed[1]))
    try:
        status = importlib.import_module(f"qcar_env.commands.{command}").main(arguments)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, allowed)
    assert status == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "File too large" in said
    assert not [each for each in tmp_path.rglob("result.json") if each.stat().st_size]


@pytest.mark.parametrize(
    ("command", "name"),
    [("benchmark", ""), ("compare", ""), ("figures", ""), ("train", ""), ("watch", ".gif")],
)
def test_a_name_too_long_for_a_file_is_refused_before_the_work(
    command, name, tmp_path, monkeypatch, capsys
):
    if command in LEARNING:
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    out = "a" * 300 + name
    assert importlib.import_module(f"qcar_env.commands.{command}").main(["--out", out]) == 2
    said = capsys.readouterr().err
    assert "--out must have names of at most 240 bytes" in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_default_says_what_an_option_takes():
    options = {
        "count": (3, "whole number"),
        "many": ((1.0, 2.0), "numbers"),
        "switch": (False, "on or off"),
        "out": (Path("here"), "folder"),
        "limit": (float, "number without default"),
        "vs": (("none",), "names, or none at all", {"nargs": "*"}),
    }
    made = commands.parser("it", "", options)
    found = vars(made.parse_args([]))
    assert found == {
        "count": 3, "many": (1.0, 2.0), "switch": False, "out": Path("here"), "limit": None,
        "vs": ("none",),
    }  # fmt: skip
    given = "--count 4 --many 5 --switch --out there --limit 1e-3 --vs"
    found = vars(made.parse_args(given.split()))
    assert found == {
        "count": 4, "many": [5.0], "switch": True, "out": Path("there"), "limit": 1e-3, "vs": [],
    }  # fmt: skip
