"""Compare the paper's control laws: its Table 1, and all of them at the same force limit.

qcar compare
qcar compare --laws none cnvc lnvc --gains lnvc:G1=40,G2=40
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from qcar_env import agents, report
from qcar_env.baselines import catalogue
from qcar_env.commands import command
from qcar_env.evaluation import comparison, storage
from qcar_env.evaluation.entry import Entry
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import finite, known, positive

STEADY = 60.0  # [s] from rest; the paper's slow mode has a time constant of 4.8 s


OPTIONS: command.Options = {
    "scenario": ("paper", f"what is crossed: {command.SCENARIO} (default: paper)"),
    "laws": (
        catalogue.names(),
        f"laws to compare (default: {' '.join(catalogue.names())})",
        {"metavar": "LAW"},
    ),
    "gains": (
        (),
        "gains that replace the published ones, in the unit of the law, such as "
        "cnvc:G1=0.5,G2=0.5 [s/m^2]",
        {"metavar": "LAW:GAIN=VALUE,..."},
    ),
    "force-limit": (
        float,
        "actuator limits instead of the scenario's: wheel and body [m/s^2], or one force [N]",
        {"nargs": "+", "metavar": "LIMIT"},
    ),
    "duration": (
        float,
        f"simulated time from rest [s] (default: {STEADY:g} where road or force has no end)",
    ),
    "out": (
        Path("results/compare"),
        "folder for table.csv, result.json and the figure (default: results/compare)",
    ),
    "report": (False, "write report.html as well, an interactive page that opens offline"),
}


def run(arguments: argparse.Namespace) -> None:
    """Run the comparison and write its results."""
    from qcar_env.plots import time_history
    from qcar_env.plots.style import journal, save

    out, laws = arguments.out, arguments.laws
    if arguments.report:
        report.check_installed()
    base = find_scenario(arguments.scenario)
    if arguments.force_limit is not None:
        actuator = dataclasses.replace(base.actuator, limit=tuple(arguments.force_limit))
        base = dataclasses.replace(base, actuator=actuator)
    endless = base.excitation.harmonic or base.force.f != 0.0
    length = STEADY if endless else base.duration
    if arguments.duration is not None:
        length = positive("duration", arguments.duration, "s")
    storage.check_folder(out, "table.csv", "result.json", *comparison.OTHERS)
    gains = _gains(arguments.gains)
    entries = [catalogue.entry(name, **gains.get(name, {})) for name in dict.fromkeys(laws)]
    for name in gains:
        known("law with gains", name, laws)
    if arguments.force_limit is None:
        entries += _agents(base)
    found = comparison.compare(base, entries, duration=length, say=command.say)
    print(comparison.text(found))
    used = {each: {**catalogue.describe(each)["gains"], **gains.get(each, {})} for each in laws}
    with storage.held(out, wait=60.0):
        comparison.write(out, found, used)
        print(f"written to {out}: table.csv, result.json")
        with journal():
            figure = time_history.comparison(found)
            if figure is not None:
                save(figure, out / "time_histories")
                print(f"written to {out}: time_histories.png, time_histories.pdf")
        if arguments.report:
            from qcar_env.report.comparison import page

            command.say("writing the report")
            print(f"report: {page(out / 'report.html', found)}")


def _agents(scenario: Scenario) -> list[Entry]:
    """Return the shipped agents that were trained for this scenario and limit."""
    home = next((each for each in TRACKS.values() if each.scenario == scenario.name), None)
    if home is None:
        return []
    return [each for each in agents.entries() if each.make(scenario, home, 1.0) is not None]


def _gains(given: Sequence[str]) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for each in given:
        law, colon, rest = each.partition(":")
        pairs = [pair.partition("=") for pair in rest.split(",")]
        if not colon or not all(equals for _, equals, _ in pairs):
            raise ValueError(f"gains must look like cnvc:G1=0.5,G2=0.5, got {each!r}")
        for name, _, value in pairs:
            try:
                number = float(value)
            except ValueError:
                raise ValueError(f"a gain must be a number, got {value!r}") from None
            found.setdefault(law, {})[name] = finite(f"gain {name}", number)
    return found


# a RuntimeError: what MPC needs is absent
main = command.main("compare", __doc__, OPTIONS, run, RuntimeError)

if __name__ == "__main__":
    raise SystemExit(main())
