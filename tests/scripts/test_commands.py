"""What every command refuses: in one line, with status 2, before any work, writing nothing."""

import importlib
from pathlib import Path

import pytest

from scripts import command as commands

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
            "error: --out must be a folder that can be written",
        ),
        ("learning_report", ["--seeds", "-1"], "error: seed must be at least 0, got -1; give 0 or"),
        ("throughput", ["--threads", "0"], "throughput: threads must be at least 1, got 0; give 1"),
        ("train", ["--out", "taken"], "error: --out must be a folder that can be written to, got"),
        ("train", ["--out", "full"], "error: full is not empty; resume it with --resume, replace"),
        ("train", ["--seeds", "1", "-1"], "error: seed must be at least 0, got -1; give 0 or more"),
        (
            "train",
            ["--seeds", "0", "1", "--out", "new"],
            "error: --out must be the folder of one ru",
        ),
        (
            "train",
            ["--target-db", "nan"],
            "error: target-db must be finite, got nan dB; give a fin",
        ),
        ("train", ["--publish"], "error: there is an agent ppo-paper in "),
        ("train", ["--resume", "taken"], "error: taken is no run folder (NotADirectoryError: "),
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
    if command == "tune" and "--out" not in arguments:
        arguments = [*arguments, "--out", "new.json"]
    assert importlib.import_module(f"scripts.{command}").main(arguments) == 2
    printed, said = capsys.readouterr()
    assert said.startswith(message)
    assert said.count("\n") == 1
    assert printed == ""
    assert sorted(tmp_path.rglob("*")) == before


def test_a_default_says_what_an_option_takes():
    options = {
        "count": (3, "whole number"),
        "many": ((1.0, 2.0), "numbers"),
        "switch": (False, "on or off"),
        "out": (Path("here"), "folder"),
        "limit": (float, "number without default"),
        "vs": (("none",), "names, or none at all", {"nargs": "*"}),
    }
    made = commands.parser("", options)
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
