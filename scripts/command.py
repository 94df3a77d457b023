"""What all commands share: options as a table, what is refused, and progress."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

# Flag: its default, or the type of what has none; its help; what argparse is told besides. A
# default of False makes a switch, a tuple takes several values.
Options = Mapping[str, tuple[Any, str | None] | tuple[Any, str | None, dict[str, Any]]]


def parser(description: str, options: Options) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    made = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for flag, (default, words, *more) in options.items():
        given: dict[str, Any] = {"default": default}
        if default is False:
            given["action"] = "store_true"
        elif isinstance(default, type):
            given = {"type": default}
        elif isinstance(default, tuple):
            given |= {"nargs": "+", "type": type(default[0]) if default else str}
        else:
            given["type"] = Path if isinstance(default, Path) else type(default)
        made.add_argument(f"--{flag}", help=words, **(given | (more[0] if more else {})))
    return made


def main(
    name: str,
    description: str,
    options: Options,
    work: Callable[[argparse.Namespace], int | None],
    *errors: type[Exception],
) -> Callable[[Sequence[str] | None], int]:
    """Return a command: it does its work, and returns 2 after a line on what is refused.

    What a disk refuses and too little memory are told in a line too. Ctrl-C ends it with 130, after
    the words of the ``KeyboardInterrupt``, if there are any.

    Parameters
    ----------
    name : str
        Before the refusal.
    description, options
        See `parser`.
    work : callable
        Takes the arguments, and returns the exit status, or None for 0.
    *errors : type
        Raised by what is refused, besides ValueError.
    """

    def run(argv: Sequence[str] | None = None) -> int:
        arguments = parser(description, options).parse_args(argv)
        try:
            return work(arguments) or 0
        except (ValueError, *errors) as error:
            return _refused(name, str(error))
        except OSError as error:
            where = "" if error.filename is None else f": {error.filename}"
            return _refused(name, f"{error.strerror or error}{where}")
        except MemoryError as error:
            return _refused(name, f"not enough memory ({error}); ask for less")
        except KeyboardInterrupt as interrupt:
            print(f"\n{name}: interrupted. {interrupt}".rstrip(), file=sys.stderr)
            return 130

    return run


def _refused(name: str, why: str) -> int:
    print(f"{name}: {why}", file=sys.stderr)
    return 2


def say(text: str) -> None:
    """Say on the error stream what is being done, so that results can be piped."""
    print(f"... {text}", file=sys.stderr, flush=True)


def left(spent: float, done: int, total: int) -> float:
    """Return the time that the rest will take, if it goes on like this [s]."""
    return spent / done * (total - done)
