"""Results on disk: whole or not at all, with what is needed to make them again."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import importlib.metadata
import io
import json
import math
import os
import platform
import sys
import tempfile
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from qcar_env.validation import shown

LONGEST_NAME = 240  # [B] of a file: what file systems take, less what a temporary name adds
LONGEST_PATH = 4096  # [B] Linux's PATH_MAX; others take less, and say so when they write
PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "torch", "stable-baselines3", "onnxruntime")


def check_folder(path: Path, *files: str) -> None:
    """Raise ValueError where a command's folder, or a file in it, cannot be made; make nothing."""
    for part in (*path.parts, *files):
        if len(os.fsencode(part)) > LONGEST_NAME:
            raise ValueError(
                f"--out must have names of at most {LONGEST_NAME} bytes, got {shown(part)}; give "
                "a shorter one"
            )
        if part != part.encode(errors="replace").decode():
            raise ValueError(f"--out must have names that are text, got {shown(part)}; rename it")
    if len(os.fsencode(path.absolute())) + LONGEST_NAME > LONGEST_PATH:
        raise ValueError(
            f"--out must be a path of at most {LONGEST_PATH - LONGEST_NAME} bytes, got "
            f"{shown(str(path))}; give a shorter one"
        )
    for each in (path, *path.parents):
        if os.path.islink(each) and not os.path.exists(each):
            raise ValueError(f"--out must not be a link to nowhere, got {each}; remove it")
    there = next(each for each in (path, *path.absolute().parents) if os.path.exists(each))
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise ValueError(
            f"--out must be a folder that can be written to, got {path}: {there} is none; "
            "give another"
        )
    for name in files:
        if (path / name).is_dir():
            raise ValueError(
                f"--out must hold no folder where a file is written, got {path / name}; remove it "
                "or give another"
            )


def check_file(path: Path) -> None:
    """Raise ValueError where a command's file cannot be written; make nothing."""
    if os.path.isdir(path):
        raise ValueError(f"--out must be a file, got the folder {path}; give a name in it")
    check_folder(path.parent, path.name)


@contextlib.contextmanager
def held(path: Path, wait: float = 0.0) -> Generator[None, None, None]:
    """Keep other processes of this user from writing to a file or folder until the block ends.

    Parameters
    ----------
    path : Path
        What is written to.
    wait : float
        How long to wait for another to end [s].

    Raises
    ------
    ValueError
        If another process still holds it.
    """
    user = getattr(os, "getuid", int)()
    name = hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:32]
    lock = FileLock(Path(tempfile.gettempdir()) / f"qcar_env-{user}-{name}.lock")
    try:
        lock.acquire(timeout=wait)
    except Timeout:
        raise ValueError(
            f"{path} is being written by another process; wait for its end, or give another --out"
        ) from None
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """Give the name of a temporary file that becomes `path` when the block ends without error.

    Parameters
    ----------
    path : Path
        The file to be written; its folder is made if it is absent. An older file stays as it is
        until the new one is complete.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(
        prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent
    )
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)  # a full disk does not say of what
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write `content` as JSON; a number that is not finite becomes null, as JSON has no other."""
    write_text(path, json.dumps(_finite(content), indent=2, allow_nan=False) + "\n")


def write_results(
    folder: Path,
    files: Mapping[str, str | bytes],
    result: Mapping[str, Any],
    others: Sequence[str] = (),
) -> None:
    """Write files by name, and a record as result.json.

    The record is removed first and written last: where there is one, all files beside it are its
    own, even if a process was killed here.

    Parameters
    ----------
    folder : Path
        Where; it is made if it is absent.
    files : mapping of str to str or bytes
        Contents by name.
    result : mapping
        The record.
    others : sequence of str
        Patterns of what else an older record may have beside it, which is removed with it: what is
        written after this one, or only sometimes.
    """
    (folder / "result.json").unlink(missing_ok=True)
    for each in [path for pattern in others for path in folder.glob(pattern)]:
        each.unlink()
    for name, content in files.items():
        with replacing(folder / name) as temporary:
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
    write_json(folder / "result.json", result)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write `rows` to `path` (see `as_csv`), whole or not at all."""
    write_text(path, as_csv(rows))


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return `rows` as comma-separated values, with the keys of the first one as header.

    Raises
    ------
    ValueError
        If there is no row, or one has other keys.
    """
    if not rows:
        raise ValueError("rows must not be empty; give at least one")
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def versions() -> dict[str, str]:
    """Return the versions of Python, this library and the packages that decide results."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in ("qcar_env", *PACKAGES):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def made_with() -> str:
    """Return the versions in a line."""
    return ", ".join(f"{name} {version}" for name, version in versions().items())


def command() -> str:
    """Return the command line of this process: `qcar`, or the script as it was called."""
    if Path(sys.argv[0]).stem == "qcar":
        return " ".join(["qcar", *sys.argv[1:]])
    return " ".join([Path(sys.executable).name, *sys.argv])


def _finite(content: Any) -> Any:
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, Mapping):
        return {str(key): _finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [_finite(value) for value in content]
    return content
