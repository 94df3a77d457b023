"""What all commands share: options as a table, how they end, and progress."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

from qcar_env.scenarios import SCENARIOS

# Flag: its default, or the type of what has none; its help; what argparse is told besides. A
# default of False makes a switch, a tuple takes several values.
Options = Mapping[str, tuple[Any, str | None] | tuple[Any, str | None, dict[str, Any]]]


# The same in every command that takes a scenario.
SCENARIO = f"a preset ({', '.join(SCENARIOS)}), a TOML or JSON file, or module:object"


def parser(name: str, description: str, options: Options) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    made = argparse.ArgumentParser(
        prog=f"qcar {name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
    the words of the ``KeyboardInterrupt``, if there are any; a termination likewise with 143.

    Parameters
    ----------
    name : str
        As `qcar` knows it; it stands before the refusal.
    description, options
        See `parser`.
    work : callable
        Takes the arguments, and returns the exit status, or None for 0.
    *errors : type
        Raised by what is refused, besides ValueError.
    """

    def run(argv: Sequence[str] | None = None) -> int:
        arguments = parser(name, description, options).parse_args(argv)
        told: list[int] = []
        try:
            with _unwinding(told):
                status = work(arguments) or 0
                sys.stdout.flush()  # what it refuses is told here, not after the end
                return status
        except (ValueError, *errors) as error:
            return ended(name, str(error), 2)
        except OSError as error:
            where = "" if error.filename is None else f": {error.filename}"
            return ended(name, f"{error.strerror or error}{where}", 2)
        except MemoryError as error:
            return ended(name, f"not enough memory ({error}); ask for less", 2)
        except KeyboardInterrupt as interrupt:
            number = told[-1] if told else signal.SIGINT
            how = "terminated" if number == signal.SIGTERM else "interrupted"
            print(file=sys.stderr)  # after a progress bar, or ^C
            return ended(name, f"{how}. {interrupt}", 128 + number)

    return run


@contextlib.contextmanager
def _unwinding(told: list[int]) -> Generator[None, None, None]:
    """Let Ctrl-C and a termination raise KeyboardInterrupt, so that nothing half-written stays.

    A signal that is ignored, as Ctrl-C is by what a shell runs in the background, still is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # no other may say what a signal does
        return

    def unwind(number: int, frame: Any) -> None:
        told.append(number)
        raise KeyboardInterrupt

    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    heard = {each: was for each, was in before.items() if was not in (signal.SIG_IGN, None)}
    for each in heard:
        signal.signal(each, unwind)
    try:
        yield
    finally:
        for each, was in heard.items():
            signal.signal(each, was)


def ended(name: str, why: str, status: int) -> int:
    """Say in one line why a command ends, and return its status."""
    try:
        sys.stdout.flush()
    except OSError:  # what is left to print cannot be, so nothing tries again at the exit
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
    print(f"{name}: {' '.join(why.split())}", file=sys.stderr)
    return status


def say(text: str) -> None:
    """Say on the error stream what is being done, so that results can be piped."""
    print(f"... {text}", file=sys.stderr, flush=True)


def left(spent: float, done: int, total: int) -> float:
    """Return the time that the rest will take, if it goes on like this [s]."""
    return spent / done * (total - done)


@contextlib.contextmanager
def quitting() -> Generator[None, None, None]:
    """Let Ctrl-C end this process with a line, while modules are imported, which takes seconds."""
    before = signal.getsignal(signal.SIGINT)
    if (
        before is not signal.default_int_handler
        or threading.current_thread() is not threading.main_thread()
    ):
        yield
        return
    signal.signal(signal.SIGINT, _quit)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _quit(number: int, frame: Any) -> None:
    print("interrupted.", file=sys.stderr, flush=True)
    os._exit(128 + number)  # nothing is begun, and an exception here may be lost in an import
