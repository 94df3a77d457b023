"""The command line `qcar`: every command by its name.

qcar --help
qcar compare --help
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import qcar_env
from qcar_env.commands import command
from qcar_env.validation import known


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command as `qcar --help` shows it.

    Parameters
    ----------
    title : str
        What it does, in a line.
    needs : tuple of str
        Extras without which it cannot work.
    more : tuple of str
        Extras that add to what it does.
    module : str
        The file beside this one, without ``.py``; the command's name if left out.
    flags : tuple of str
        Given before those of the user.
    """

    title: str
    needs: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    module: str = ""
    flags: tuple[str, ...] = ()


COMMANDS = {
    "compare": Command(
        title="compare control laws and agents in one scenario",
        needs=("plots",),
        more=("run", "mpc", "report"),
    ),
    "report": Command(
        title="the same with an interactive page (compare --report)",
        needs=("plots", "report"),
        more=("run", "mpc"),
        module="compare",
        flags=("--report",),
    ),
    "watch": Command(
        title="watch policies drive side by side, or film them",
        needs=("plots", "render"),
        more=("run", "mpc"),
    ),
    "benchmark": Command(
        title="score every policy on every track, beside the optimum",
        needs=("plots",),
        more=("run", "mpc", "report"),
    ),
    "train": Command(title="train an agent", needs=("plots", "train", "run")),
    "sweep": Command(
        title="train over settings and seeds, on this machine or a cluster",
        needs=("train", "run"),
        more=("cluster",),
    ),
    "learning-report": Command(
        title="how agents learn: amplitude against training time",
        needs=("plots", "train", "run"),
        module="learning_report",
    ),
    "tune": Command(title="tune the gains of the scripted policies"),
    "figures": Command(title="the paper's Figures 3 to 14 and Table 1", needs=("plots",)),
    "fidelity": Command(title="every number and claim of the paper beside ours"),
    "calibrate": Command(title="repeat the calibration on the paper's Table 1"),
    "throughput": Command(
        title="measure environment steps per second", more=("plots", "train", "peers")
    ),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, and return its status; 2 after a line on what is refused or missing."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        print(overview())
        return 0
    if words[0] == "--version":
        print(f"qcar_env {qcar_env.__version__}")
        return 0
    name, *rest = words
    try:
        chosen = COMMANDS[known("command", name, COMMANDS)]
    except ValueError as error:
        return command.ended("qcar", str(error), 2)
    helping = not {"-h", "--help"}.isdisjoint(rest)
    if not helping and (lacking := missing(chosen.needs)):
        return command.ended(name, _install(lacking), 2)
    if not helping and "run" in chosen.more and missing(("run",)):
        command.say(f"without the shipped agents, which need {_pip(('run',))}")
    os.environ.setdefault("MPLBACKEND", "Agg")  # figures go into files
    try:
        with command.quitting():
            module = importlib.import_module(f"qcar_env.commands.{chosen.module or name}")
    except ModuleNotFoundError:
        if lacking := missing(chosen.needs):
            return command.ended(name, _install(lacking), 2)
        raise
    return module.main([*chosen.flags, *rest])


def overview() -> str:
    """Return what `qcar --help` prints."""
    lines = ["usage: qcar COMMAND [FLAGS]", "", "commands, with the extras that each needs:"]
    for name, each in COMMANDS.items():
        extras = ", ".join(each.needs) or "none"
        extras += f"; also {', '.join(each.more)}" if each.more else ""
        lines.append(f"  {name:16} {each.title} [{extras}]")
    example = _pip(("plots", "run"))
    return "\n".join(
        [*lines, "", f"Extras are installed by {example}; `qcar COMMAND --help` has the flags."]
    )


def missing(extras: Sequence[str]) -> dict[str, list[str]]:
    """Return the packages that are not installed, by the extra that brings them."""
    lines = importlib.metadata.requires("qcar_env") or []
    found: dict[str, list[str]] = {}
    for line in lines:
        package = re.split(r"[^\w.-]", line, maxsplit=1)[0]
        extra = re.search(r"""extra\s*==\s*["']([\w-]+)["']""", line)
        if extra and extra[1] in extras and not _installed(package):
            found.setdefault(extra[1], []).append(package)
    return found


def _installed(package: str) -> bool:
    try:
        importlib.metadata.distribution(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _install(lacking: dict[str, list[str]]) -> str:
    packages = ", ".join(dict.fromkeys(each for some in lacking.values() for each in some))
    return f"needs {packages}, not installed; {_pip(tuple(lacking))}"


def _pip(extras: Sequence[str]) -> str:
    return f'pip install "qcar_env[{",".join(extras)}]"'


if __name__ == "__main__":
    sys.exit(main())
