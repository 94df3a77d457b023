"""Compare the paper's control laws: its Table 1, and all of them at the same force limit.

python scripts/compare.py
python scripts/compare.py --laws none cnvc lnvc --gains lnvc:G1=40,G2=40
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from baselines import catalogue
from qcar_env.analysis.optimum import Optimum, period_optimum
from qcar_env.analysis.paper.table1 import Cell, table1
from qcar_env.control.law import Law
from qcar_env.evaluation import storage
from qcar_env.evaluation.comparison import Outcome, outcome
from qcar_env.evaluation.rollouts import Rollout, rollout
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.plots import time_history
from qcar_env.plots.style import journal
from qcar_env.scenarios import SCENARIOS, Scenario, scenario as find_scenario
from qcar_env.validation import finite, known, positive
from scripts import contestants

STEADY = 60.0  # [s] from rest; the paper's slow mode has a time constant of 4.8 s
START = "at rest, phase 0; nothing is drawn, so there is no seed"
SHOWN = 10.0  # [s] of the time histories in the figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run the comparison and write its results; return the exit status."""
    arguments = _parse(argv)
    try:
        compare(
            scenario=arguments.scenario,
            laws=arguments.laws,
            gains=_gains(arguments.gains),
            force_limit=arguments.force_limit,
            duration=arguments.duration,
            out=arguments.out,
            report=arguments.report,
        )
    except (ValueError, OSError, RuntimeError) as error:  # the last: what MPC needs is absent
        print(f"compare: {error}", file=sys.stderr)
        return 2
    return 0


def compare(
    *,
    scenario: str,
    laws: Sequence[str],
    gains: dict[str, dict[str, float]],
    force_limit: Sequence[float] | None,
    duration: float | None,
    out: Path,
    report: bool = False,
) -> None:
    """Print both tables and write `table.csv`, `result.json` and the figure to `out`."""
    if report:
        _check_report()
    base = find_scenario(scenario)
    if force_limit is not None:
        actuator = dataclasses.replace(base.actuator, limit=tuple(force_limit))
        base = dataclasses.replace(base, actuator=actuator)
    harmonic = base.road.profile == "harmonic"
    length = STEADY if harmonic else base.duration
    if duration is not None:
        length = positive("duration", duration, "s")
    storage.check_folder(out)
    policies = {name: catalogue.make(name, base, **gains.get(name, {})) for name in laws}
    for name in gains:
        known("law with gains", name, policies)

    cells: tuple[Cell, ...] = ()
    if harmonic:
        _progress(
            "Table 1: simulating in continuous time (the first time, compiling: half a minute)"
        )
        cells = table1(base, duration=length)
        _print_table1(cells)

    rollouts: dict[str, Rollout] = {}
    for count, (name, policy) in enumerate(policies.items(), start=1):
        _progress(f"rolling out {name} ({count} of {len(policies)})")
        rollouts[name] = rollout(policy, base, duration=length)
    outcomes = [outcome(name, each, base.reference_amplitudes) for name, each in rollouts.items()]
    agents = _agents(base, length) if harmonic and force_limit is None else {}
    learned = [outcome(name, each, base.reference_amplitudes) for name, each in agents.items()]
    best = period_optimum(base) if harmonic else None
    _print_outcomes(base, [*outcomes, *learned], best, length)
    _write(out, base, length, cells, [*outcomes, *learned], best, gains, tuple(rollouts))
    _draw(out, base, {**rollouts, **agents}, [*outcomes, *learned], learned)
    if report:
        _progress("writing the report")
        laws = {name: policy.law for name, policy in policies.items() if hasattr(policy, "law")}
        _write_report(out, base, length, cells, outcomes, rollouts, laws)


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scenario",
        default="paper",
        help=f"what is crossed: {', '.join(SCENARIOS)} (default: paper)",
    )
    parser.add_argument(
        "--laws",
        nargs="+",
        default=list(catalogue.names()),
        metavar="LAW",
        help=f"laws to compare (default: {' '.join(catalogue.names())})",
    )
    parser.add_argument(
        "--gains",
        nargs="+",
        default=[],
        metavar="LAW:GAIN=VALUE,...",
        help="gains that replace the published ones, in the unit of the law, such as "
        "cnvc:G1=0.5,G2=0.5 [s/m^2]",
    )
    parser.add_argument(
        "--force-limit",
        nargs="+",
        type=float,
        metavar="LIMIT",
        help="actuator limits instead of the scenario's: wheel and body [m/s^2], or one force [N]",
    )
    parser.add_argument(
        "--duration",
        type=float,
        help=f"simulated time from rest [s] (default: {STEADY:g} on an endless road)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/compare"),
        help="folder for table.csv, result.json and the figure (default: results/compare)",
    )
    parser.add_argument(
        "--report",
        action="store_true",
        help="write report.html as well, an interactive page that opens offline",
    )
    return parser.parse_args(argv)


def _gains(given: Sequence[str]) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for each in given:
        law, colon, rest = each.partition(":")
        pairs = [pair.partition("=") for pair in rest.split(",")]
        if not colon or not all(equals for _, equals, _ in pairs):
            raise ValueError(f"gains must look like cnvc:G1=0.5,G2=0.5, got {each!r}")
        values = {name: finite(f"gain {name}", _number(value)) for name, _, value in pairs}
        found[law] = found.get(law, {}) | values
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"a gain must be a number, got {text!r}") from None


def _print_table1(cells: Sequence[Cell]) -> None:
    print("Table 1 of the paper: the law acts at every instant, forces are not limited\n")
    rows = [["law", "G", "mass", "no control [m]", "controlled [m]", "difference [m]"]]
    rows[0] += ["error [%]", "paper [%]", "ratio / paper's"]
    for cell in cells:
        rows.append(
            [
                cell.law,
                f"{cell.gain:g}",
                f"x{cell.mass}",
                f"{cell.uncontrolled:.3f}",
                f"{cell.controlled:.4f}",
                f"{cell.absolute_error:.3f}",
                f"{cell.percentage_error:.0f}",
                f"{cell.printed:g}",
                f"{cell.agreement:.2f}",
            ]
        )
    _print_rows(rows, left=3)
    print("\nerror: (no control - controlled) / controlled, as the paper defines it")
    print("ratio: no control / controlled, ours over the paper's\n")


def _print_outcomes(
    scenario: Scenario, outcomes: Sequence[Outcome], best: Optimum | None, duration: float
) -> None:
    limits = " and ".join(f"{value:g}" for value in scenario.actuator.limit)
    unit = scenario.actuator.unit
    print(
        f"Scenario {scenario.name}: the law acts every {scenario.dt * 1e3:g} ms, every force is "
        f"limited to {limits} {unit}, {duration:g} s from rest\n"
    )
    rows = [["policy", "x1 [m]", "x2 [m]", "rho", "error x1 [%]", "error x2 [%]"]]
    rows[0] += ["x1 [dB]", "x2 [dB]", f"peak force [{unit}]", f"RMS force [{unit}]"]
    for each in outcomes:
        rows.append(
            [
                each.policy + (" (left the travel limit)" if each.terminated else ""),
                *(f"{value:.4f}" for value in each.amplitudes),
                f"{each.rho:.4f}",
                *(f"{round(value) + 0:d}" for value in each.percentage_errors),
                *(f"{round(-value, 1) + 0.0:.1f}" for value in each.reductions),
                " / ".join(f"{value:.1f}" for value in each.peak_force),
                " / ".join(f"{value:.1f}" for value in each.rms_force),
            ]
        )
    if best is not None:
        peaks, means = np.max(np.abs(best.u), axis=0), np.sqrt(np.mean(best.u**2, axis=0))
        rows.append(
            [
                "optimum",
                *(f"{value:.4f}" for value in best.amplitudes),
                f"{best.upper:.4f}",
                *[""] * 4,
                " / ".join(f"{value:.1f}" for value in peaks),
                " / ".join(f"{value:.1f}" for value in means),
            ]
        )
    _print_rows(rows, left=1)
    print("\nrho: the larger of x1 and x2 over no control's; dB: relative to no control")
    print("forces: wheel / body" if len(scenario.actuator.limit) == 2 else "force: on the body")
    if best is not None:
        print(
            f"optimum: no force within the limits, of any shape, leaves less than rho = "
            f"{best.bound:.4f}; the one listed is known in advance, policies act on what they see"
        )
        print("make benchmark scores every policy at every limit, with intervals")
    print()


def _agents(scenario: Scenario, duration: float) -> dict[str, Rollout]:
    """Roll out the shipped agents that were trained for this scenario and limit."""
    home = next((each for each in TRACKS.values() if each.scenario == scenario.name), None)
    found: dict[str, Rollout] = {}
    if home is None:
        return found
    for each in contestants.agents():
        if not any(scale == 1.0 for _, scale in each.tracks((home,))):
            continue
        made = each.make(home, 1.0)
        if made.observe_limit:
            continue  # one rollout shows no limit; the benchmark does
        _progress(f"rolling out {each.name}")
        found[each.name] = rollout(made.policy, scenario, duration=duration, observe=made.reads)
    return found


def _print_rows(rows: Sequence[Sequence[str]], left: int) -> None:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for number, row in enumerate(rows):
        cells = [
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())
        if number == 0:
            print("  ".join("-" * width for width in widths))


def _write(
    out: Path,
    scenario: Scenario,
    duration: float,
    cells: Sequence[Cell],
    outcomes: Sequence[Outcome],
    best: Optimum | None,
    gains: dict[str, dict[str, float]],
    laws: Sequence[str],
) -> None:
    rows = [
        {
            "policy": each.policy,
            "x1_m": each.amplitudes[0],
            "x2_m": each.amplitudes[1],
            "error_x1_percent": each.percentage_errors[0],
            "error_x2_percent": each.percentage_errors[1],
            "reduction_x1_db": each.reductions[0],
            "reduction_x2_db": each.reductions[1],
            "rho": each.rho,
            "peak_force": " ".join(f"{value:.6g}" for value in each.peak_force),
            "rms_force": " ".join(f"{value:.6g}" for value in each.rms_force),
            "terminated": each.terminated,
        }
        for each in outcomes
    ]
    storage.write_csv(out / "table.csv", rows)
    result: dict[str, Any] = {
        "command": storage.command(),
        "versions": storage.versions(),
        "scenario": dataclasses.asdict(scenario),
        "duration_s": duration,
        "start": START,
        "gains": {
            name: {**catalogue.describe(name)["gains"], **gains.get(name, {})} for name in laws
        },
        "table1": [
            {
                **dataclasses.asdict(cell),
                "absolute_error": cell.absolute_error,
                "percentage_error": cell.percentage_error,
                "agreement": cell.agreement,
            }
            for cell in cells
        ],
        "policies": rows,
        "optimum": None
        if best is None
        else {"rho": best.upper, "bound": best.bound, "amplitudes_m": best.amplitudes},
    }
    storage.write_json(out / "result.json", result)
    print(f"written to {out}: table.csv, result.json")


def _check_report() -> None:
    """Raise ValueError where what writes the report is absent."""
    for name in ("plotly", "jinja2"):
        if importlib.util.find_spec(name) is None:
            raise ValueError(f"a report needs {name}; run make report, or install qcar_env[report]")


def _write_report(
    out: Path,
    scenario: Scenario,
    duration: float,
    cells: Sequence[Cell],
    outcomes: Sequence[Outcome],
    rollouts: dict[str, Rollout],
    laws: dict[str, Law],
) -> None:
    from qcar_env.report.comparison import comparison
    from qcar_env.report.page import write

    versions = ", ".join(f"{name} {version}" for name, version in storage.versions().items())
    content = comparison(
        scenario,
        outcomes,
        rollouts,
        laws,
        table1=cells,
        duration=duration,
        provenance={
            "command": storage.command(),
            "start": START,
            "gains": "; ".join(str(law) for law in laws.values()),
            "versions": versions,
            "numbers": "table.csv and result.json beside this file",
        },
    )
    print(f"report: {write(out / 'report.html', content)}")


def _draw(
    out: Path,
    scenario: Scenario,
    rollouts: dict[str, Rollout],
    outcomes: Sequence[Outcome],
    learned: Sequence[Outcome],
) -> None:
    """Draw the policies that stayed within the travel limits.

    Of the learned ones one gets a time history: by reinforcement if there is one, and the best.
    """
    complete = [each.policy for each in outcomes if not each.terminated]
    if not complete:
        return
    first = rollouts[complete[0]]
    best = min(
        learned,
        key=lambda each: (not each.policy.startswith(("ppo", "sac")), each.rho),
        default=None,
    )
    names = [each.policy for each in learned]
    with journal():
        figure = time_history.comparison(
            first.t,
            {name: (rollouts[name].x1, rollouts[name].x2) for name in complete},
            2.0 * math.pi / scenario.reference_frequency,
            shown=min(SHOWN, float(first.t[-1])),
            panels=[
                name
                for name in complete
                if name != "none"
                and (name not in names or (best is not None and name == best.policy))
            ],
        )
        for suffix in (".png", ".pdf"):
            with storage.replacing(out / f"time_histories{suffix}") as temporary:
                figure.savefig(temporary)
    print(f"written to {out}: time_histories.png, time_histories.pdf")


def _progress(text: str) -> None:
    """Say on the error stream what is being done, so that the tables can be piped."""
    print(f"... {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    matplotlib.use("Agg")
    sys.exit(main())
