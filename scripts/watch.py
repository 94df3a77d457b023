"""Watch policies drive side by side, on the screen or in a file.

    qcar watch --policy cnvc --vs none
    qcar watch --policy cnvc --vs none lnvc --out results/watch/three.gif
    qcar watch --policy runs/sac-paper-seed0 --vs none cnvc

All cars meet the same road from the same start. By default they swing as without control, and the
policies begin to act after half a second.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from qcar_env import agents, baselines
from qcar_env.commands import command
from qcar_env.evaluation.entry import Entry, entry_of
from qcar_env.scenarios import scenario as find_scenario
from qcar_env.validation import known

if TYPE_CHECKING:
    from qcar_env.plots.film import Film


def policies() -> dict[str, Entry]:
    """Return the baselines and the shipped agents by name; tuned ones are called lnvc-tuned."""
    found = (*baselines.entries(), *agents.entries())
    return {each.name.replace(" (tuned)", "-tuned"): each for each in found}


OPTIONS: command.Options = {
    "policy": (
        "cnvc",
        f"who drives: {', '.join(policies())}, or a run folder of `qcar train` (default: cnvc)",
    ),
    "vs": (("none",), "beside whom (default: none)", {"nargs": "*", "metavar": "POLICY"}),
    "scenario": ("paper", f"what is crossed: {command.SCENARIO} (default: paper)"),
    "force-scale": (1.0, "force limit over the scenario's [-]"),
    "duration": (float, "simulated time [s] (default: the scenario's)"),
    "start": (
        str,
        "begin in the steady motion without control, or at rest (default: steady on an "
        "endless road)",
        {"choices": ("steady", "rest")},
    ),
    "wait": (
        float,
        "time before the policies act [s] (default: 0.5 on an endless road, else 0)",
    ),
    "slow": (4.0, "slow motion: film over real time [-] (default: 4)"),
    "fps": (25.0, "frames a second (default: 25)"),
    "size": (
        (640, 480),
        "of each car's frame [px] (default: 640 480)",
        {"nargs": 2, "metavar": ("WIDTH", "HEIGHT")},
    ),
    "out": (
        Path,
        "file ending in .mp4 or .gif (default: the screen; without a display a file in "
        "results/watch)",
    ),
}


def run(arguments: argparse.Namespace) -> None:
    """Show or write the film."""
    from qcar_env.plots.film import show, write

    film = film_of(arguments)
    out = arguments.out
    if out is None and not _has_display():
        names = "-vs-".join(Path(each).name for each in (arguments.policy, *arguments.vs))
        out = Path("results/watch") / f"{names}.mp4"
    if out is None:
        show(film)
        return
    write(film, out, _progress)
    print(
        f"written to {out}: {film.length / film.rate:.1f} s, "
        f"{film.slow:g} times slower than real time, {out.stat().st_size / 1e6:.1f} MB"
    )


def film_of(arguments: argparse.Namespace) -> Film:
    """Return the film that is asked for."""
    from qcar_env.plots.film import Film

    there = policies()
    entries: list[Entry] = []
    for name in (arguments.policy, *arguments.vs):
        mine = name not in there and Path(name).is_dir()
        entries.append(entry_of(name) if mine else there[known("policy", name, there)])
    scenario = find_scenario(arguments.scenario)
    harmonic = scenario.excitation.harmonic
    width, height = arguments.size
    return Film(
        entries=tuple(entries),
        scenario=scenario,
        force_scale=arguments.force_scale,
        duration=scenario.duration if arguments.duration is None else arguments.duration,
        start=arguments.start or ("steady" if harmonic else "rest"),
        wait=(0.5 if harmonic else 0.0) if arguments.wait is None else arguments.wait,
        slow=arguments.slow,
        fps=arguments.fps,
        size=(width, height),
    )


def _has_display() -> bool:
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _progress(number: int, length: int) -> None:
    if sys.stderr.isatty() and (number % 20 == 0 or number == length):
        end = "\n" if number == length else ""
        print(f"\r... frame {number} of {length}", end=end, file=sys.stderr, flush=True)


# a RuntimeError: what a policy needs is absent
main = command.main("watch", __doc__, OPTIONS, run, RuntimeError)

if __name__ == "__main__":
    raise SystemExit(main())
