"""Results on disk: whole or not at all."""

import csv
import errno
import json
import math
import os
import re
from importlib.metadata import version

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from qcar_env.evaluation import storage

tree = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)


def without_infinities(content):
    if isinstance(content, float) and not math.isfinite(content):
        return None
    if isinstance(content, dict):
        return {key: without_infinities(value) for key, value in content.items()}
    if isinstance(content, list):
        return [without_infinities(value) for value in content]
    return content


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=tree)
def test_json_reads_back_with_null_for_what_is_not_finite(tmp_path, content):
    storage.write_json(tmp_path / "result.json", content)
    text = (tmp_path / "result.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=pytest.fail) == without_infinities(content)


def test_numpys_numbers_are_numbers(tmp_path):
    content = {"a": np.float64(0.5), "b": np.float64("nan"), "c": (1.0, 2.0)}
    storage.write_json(tmp_path / "r.json", content)
    assert json.loads((tmp_path / "r.json").read_text()) == {"a": 0.5, "b": None, "c": [1.0, 2.0]}


def test_csv_has_the_keys_as_header(tmp_path):
    rows = [{"law": "cnvc, cubic", "x1_m": 0.1}, {"law": "none", "x1_m": 1e-17}]
    storage.write_csv(tmp_path / "table.csv", rows)
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert [row["law"] for row in found] == ["cnvc, cubic", "none"]
    assert [float(row["x1_m"]) for row in found] == [0.1, 1e-17]  # every digit


def test_a_folder_is_made_where_it_is_absent(tmp_path):
    storage.write_text(tmp_path / "a" / "b" / "note.txt", "ω₁\n")
    assert (tmp_path / "a" / "b" / "note.txt").read_text(encoding="utf-8") == "ω₁\n"


def test_a_failure_leaves_the_older_file_and_nothing_else(tmp_path):
    path = tmp_path / "table.csv"
    storage.write_text(path, "old")

    def write_half():
        with storage.replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyError("interrupted")

    with pytest.raises(KeyError):
        write_half()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_told_with_the_file(tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(OSError, match=r"No space left on device: '.*/table\.csv'"):
        with storage.replacing(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert not list(tmp_path.iterdir())


def test_an_error_with_words_of_its_own_keeps_them(tmp_path):
    with pytest.raises(OSError, match=r"^no whole film$"), storage.replacing(tmp_path / "a.mp4"):
        raise OSError("no whole film")


def test_a_failure_leaves_no_file_where_there_was_none(tmp_path):
    with pytest.raises(TypeError):
        storage.write_json(tmp_path / "result.json", {"bad": object()})
    assert list(tmp_path.iterdir()) == []


def test_a_temporary_file_keeps_its_suffix(tmp_path):
    """A plotting library tells the format from the name."""
    with storage.replacing(tmp_path / "figure.png") as temporary:
        assert temporary.suffix == ".png"
        temporary.write_bytes(b"x")
    assert (tmp_path / "figure.png").read_bytes() == b"x"


def test_the_versions_are_those_installed():
    found = storage.versions()
    assert found["numpy"] == np.__version__
    assert found["gymnasium"] == version("gymnasium")
    assert {"python", "machine", "qcar_env", "scipy", "numba"} <= set(found)


def test_the_command_is_the_one_that_was_typed(monkeypatch):
    monkeypatch.setattr("sys.argv", ["mine/compare.py", "--laws", "cnvc"])
    assert re.fullmatch(r"python\S* mine/compare\.py --laws cnvc", storage.command())
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/qcar", "compare", "--laws", "cnvc"])
    assert storage.command() == "qcar compare --laws cnvc"


def test_where_nothing_can_be_written_is_said_and_nothing_is_made(tmp_path):
    taken = tmp_path / "taken"
    taken.touch()
    for folder in (taken, taken / "deeper" / "still"):
        with pytest.raises(
            ValueError, match=r"--out must be a folder .*taken is none; give another"
        ):
            storage.check_folder(folder)
    with pytest.raises(
        ValueError, match=r"--out must be a file, got the folder .*; give a name in"
    ):
        storage.check_file(tmp_path)
    storage.check_folder(tmp_path / "new" / "deeper")
    storage.check_file(tmp_path / "new" / "file.md")
    assert [each.name for each in tmp_path.iterdir()] == ["taken"]


def test_a_folder_in_a_files_place_and_a_long_name_are_refused(tmp_path):
    (tmp_path / "table.csv").mkdir()
    with pytest.raises(ValueError, match=r"no folder where a file is written, got .*table.csv; re"):
        storage.check_folder(tmp_path, "result.json", "table.csv")
    for check in (storage.check_folder, storage.check_file):
        with pytest.raises(ValueError, match="names of at most 240 bytes, got 'aaa"):
            check(tmp_path / ("a" * 300))


def test_a_link_to_nowhere_or_itself_a_long_path_and_bytes_are_refused(tmp_path):
    (tmp_path / "nowhere").symlink_to(tmp_path / "absent")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    for name, message in (
        ("nowhere", r"--out must not be a link to nowhere, got .*nowhere; remove it"),
        ("nowhere/deeper", r"--out must not be a link to nowhere, got .*nowhere; remove it"),
        ("round", r"--out must not be a link to nowhere, got .*round; remove it"),
        ("a/" * 5000, r"--out must be a path of at most 3856 bytes, got .*; give a shorter one"),
        ("\udcff", r"--out must have names that are text, got '\\udcff'; rename it"),
    ):
        with pytest.raises(ValueError, match=message):
            storage.check_folder(tmp_path / name)
    for name in ("größer", "a\u00a0b", "车"):
        storage.check_folder(tmp_path / name)


def test_a_record_stands_beside_its_own_files_alone(tmp_path, monkeypatch):
    """A process that is killed while it writes leaves no record, so that none is of another run."""
    storage.write_results(tmp_path, {"a.md": "first", "b.bin": b"1"}, {"run": 1})
    assert (tmp_path / "b.bin").read_bytes() == b"1"
    (tmp_path / "c.csv").mkdir()
    with pytest.raises(OSError, match=r"c\.csv"):
        storage.write_results(tmp_path, {"a.md": "second", "c.csv": "x"}, {"run": 2})
    assert (tmp_path / "a.md").read_text(encoding="utf-8") == "second"
    assert not (tmp_path / "result.json").exists()
    assert not [each for each in tmp_path.iterdir() if each.name.startswith(".")]


def test_what_an_older_record_had_beside_it_goes_with_it(tmp_path):
    for name in ("report.html", "figures/old.png", "figures/mine.txt", "notes.md"):
        storage.write_text(tmp_path / name, "old")
    storage.write_results(tmp_path, {"a.md": "x"}, {"run": 2}, ["report.html", "figures/*.png"])
    there = {
        each.relative_to(tmp_path).as_posix() for each in tmp_path.rglob("*") if each.is_file()
    }
    assert there == {"a.md", "result.json", "figures/mine.txt", "notes.md"}


def test_two_writers_of_one_folder_are_told_apart(tmp_path):
    with (
        storage.held(tmp_path),
        storage.held(tmp_path / "other"),
        pytest.raises(ValueError, match="is being written by another process; wait for its end"),
        storage.held(tmp_path / "other" / ".."),
    ):
        raise AssertionError("both write")
    with storage.held(tmp_path):
        assert not list(tmp_path.iterdir())


def test_a_table_without_rows_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"rows must not be empty; give at least"):
        storage.write_csv(tmp_path / "table.csv", [])
    assert not list(tmp_path.iterdir())
