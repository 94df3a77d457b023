"""Results on disk: whole or not at all, with what is needed to make them again."""

from __future__ import annotations

import contextlib
import csv
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

PACKAGES = ("numpy", "scipy", "numba", "gymnasium", "torch", "stable-baselines3", "onnxruntime")


def check_folder(path: Path) -> None:
    """Raise ValueError where a command's folder cannot be made or written to; make nothing."""
    there = next(each for each in (path, *path.absolute().parents) if os.path.exists(each))
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise ValueError(
            f"--out must be a folder that can be written to, got {path}: {there} is none; "
            "give another"
        )


def check_file(path: Path) -> None:
    """Raise ValueError where a command's file cannot be written; make nothing."""
    check_folder(path.parent)
    if path.is_dir():
        raise ValueError(f"--out must be a file, got the folder {path}; give a name in it")


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
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path`, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write `content` as JSON; a number that is not finite becomes null, as JSON has no other."""
    write_text(path, json.dumps(_finite(content), indent=2, allow_nan=False) + "\n")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write `rows` as comma-separated values, with the keys of the first one as header.

    Raises
    ------
    ValueError
        If there is no row, or one has other keys.
    """
    if not rows:
        raise ValueError(f"rows must not be empty for {path}; give at least one")
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


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
    """Return the command line of this process, with the script as it was called."""
    return " ".join([Path(sys.executable).name, *sys.argv])


def _finite(content: Any) -> Any:
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, Mapping):
        return {str(key): _finite(value) for key, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [_finite(value) for value in content]
    return content
