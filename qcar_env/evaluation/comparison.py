"""Compare policies in one scenario at one force limit, in true steady state.

Of a linear car on a harmonic road the paper's Table 1 and the optimum stand beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.analysis.optimum import Optimum, period_optimum
from qcar_env.analysis.paper.table1 import Cell, table1
from qcar_env.control.law import Law
from qcar_env.evaluation import storage, tables
from qcar_env.evaluation.bounds import linear_plant
from qcar_env.evaluation.entry import Entry
from qcar_env.evaluation.outcome import Outcome, outcome
from qcar_env.evaluation.policy import shown_to
from qcar_env.evaluation.rollouts import Rollout, rollout
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.files import as_record

PERIODS = 5  # at the end of an episode on a harmonic road, over which amplitudes are taken
OTHERS = ("time_histories.png", "time_histories.pdf", "report.html")  # that results may have
START = "at rest, phase 0; nothing is drawn, so there is no seed"


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Several policies in one scenario."""

    scenario: Scenario  # with the force limit used
    duration: float  # simulated time from rest [s]
    outcomes: tuple[Outcome, ...]
    rollouts: Mapping[str, Rollout]  # by policy
    laws: Mapping[str, Law]  # by policy, of those that are laws
    learned: tuple[str, ...] = ()  # which policies are
    table1: tuple[Cell, ...] = ()  # the paper's, in continuous time; see `linear_plant`
    optimum: Optimum | None = None  # likewise


def compare(
    scenario: Scenario,
    entries: Sequence[Entry],
    *,
    duration: float,
    say: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Run one episode of each entry from rest, and evaluate its end.

    Parameters
    ----------
    scenario : Scenario
        What they act in, with its force limit.
    entries : sequence of Entry
        Who enters. A policy that sees the force limit does not: an episode alone shows none.
    duration : float
        Simulated time [s].
    say : callable, optional
        Told what is being done.

    Raises
    ------
    ValueError
        If a policy cannot be made, or the episode is too short to have become steady.
    """
    harmonic = scenario.excitation.harmonic
    made = [(each, each.make(scenario, None, 1.0)) for each in entries]
    entered = [(each, policy) for each, policy in made if not shown_to(policy, "full")[1]]
    steady = harmonic and linear_plant(scenario)
    cells: tuple[Cell, ...] = ()
    if steady:
        say("Table 1: simulating in continuous time (the first time, compiling: half a minute)")
        cells = table1(scenario, duration=duration)
    rollouts: dict[str, Rollout] = {}
    for count, (each, policy) in enumerate(entered, start=1):
        say(f"rolling out {each.name} ({count} of {len(entered)})")
        reads, _ = shown_to(policy, "full")
        rollouts[each.name] = rollout(policy, scenario, duration=duration, observe=reads)
    return Comparison(
        scenario=scenario,
        duration=duration,
        outcomes=tuple(
            outcome(name, each, periods=PERIODS if harmonic else None)
            for name, each in rollouts.items()
        ),
        rollouts=rollouts,
        learned=tuple(each.name for each, _ in entered if each.kind == "learned"),
        laws={each.name: policy.law for each, policy in entered if hasattr(policy, "law")},
        table1=cells,
        optimum=period_optimum(scenario) if steady else None,
    )


def text(comparison: Comparison) -> str:
    """Return both tables for a terminal."""
    return _table1(comparison.table1) + _outcomes(comparison)


def write(folder: Path, comparison: Comparison, gains: Mapping[str, Mapping[str, float]]) -> None:
    """Write table.csv and result.json; figure and report of an older comparison go with it.

    Parameters
    ----------
    folder : Path
        Where.
    comparison : Comparison
        What was found.
    gains : mapping
        Gains of each policy that has some, for the record.
    """
    rows = [_record(each) for each in comparison.outcomes]
    best = comparison.optimum
    result: dict[str, Any] = {
        "command": storage.command(),
        "versions": storage.versions(),
        "scenario": as_record(comparison.scenario),
        "duration_s": comparison.duration,
        "start": START,
        "gains": gains,
        "table1": [
            {
                **dataclasses.asdict(cell),
                "absolute_error": cell.absolute_error,
                "percentage_error": cell.percentage_error,
                "agreement": cell.agreement,
            }
            for cell in comparison.table1
        ],
        "policies": rows,
        "optimum": best
        and {"rho": best.upper, "bound": best.bound, "amplitudes_m": best.amplitudes},
    }
    storage.write_results(folder, {"table.csv": storage.as_csv(rows)}, result, OTHERS)


def _record(found: Outcome) -> dict[str, Any]:
    return {
        "policy": found.policy,
        **dict(zip(("x1_m", "x2_m"), found.amplitudes, strict=True)),
        **dict(zip(("error_x1_percent", "error_x2_percent"), found.percentage_errors, strict=True)),
        **dict(zip(("reduction_x1_db", "reduction_x2_db"), found.reductions, strict=True)),
        "rho": found.rho,
        "peak_force": " ".join(f"{value:.6g}" for value in found.peak_force),
        "rms_force": " ".join(f"{value:.6g}" for value in found.rms_force),
        "terminated": found.terminated,
    }


def _table1(cells: Sequence[Cell]) -> str:
    if not cells:
        return ""
    header = (
        *("law", "G", "mass", "no control [m]", "controlled [m]", "difference [m]"),
        *("error [%]", "paper [%]", "ratio / paper's"),
    )
    rows = [header, *map(tables.table1_row, cells)]
    return (
        "Table 1 of the paper: the law acts at every instant, forces are not limited\n\n"
        f"{tables.columns(rows, left=3)}\n\n"
        "error: (no control - controlled) / controlled, as the paper defines it\n"
        "ratio: no control / controlled, ours over the paper's\n\n"
    )


def _outcomes(comparison: Comparison) -> str:
    scenario, best = comparison.scenario, comparison.optimum
    unit, limits = scenario.actuator.unit, scenario.actuator.limit
    header = (
        *("policy", "x1 [m]", "x2 [m]", "rho", "error x1 [%]", "error x2 [%]"),
        *("x1 [dB]", "x2 [dB]", f"peak force [{unit}]", f"RMS force [{unit}]"),
    )
    rows: list[tuple[str, ...]] = [header]
    for each in comparison.outcomes:
        left = " (left the travel limit)" if each.terminated else ""
        errors = [f"{round(value) + 0:d}" for value in each.percentage_errors]
        errors += [f"{round(-value, 1) + 0.0:.1f}" for value in each.reductions]
        forces = each.peak_force, each.rms_force
        rows.append(_row(each.policy + left, (*each.amplitudes, each.rho), errors, forces))
    if best is not None:
        forces = np.max(np.abs(best.u), axis=0), np.sqrt(np.mean(best.u**2, axis=0))
        rows.append(_row("optimum", (*best.amplitudes, best.upper), [""] * 4, forces))
    lines = [
        f"Scenario {scenario.name}: the law acts every {scenario.dt * 1e3:g} ms, every force is "
        f"limited to {' and '.join(f'{value:g}' for value in limits)} {unit}, "
        f"{comparison.duration:g} s from rest\n",
        tables.columns(rows, left=1),
        "\nrho: the larger of x1 and x2 over no control's; dB: relative to no control",
        "forces: wheel / body" if len(limits) == 2 else "force: on the body",
    ]
    if best is not None:
        lines += [
            f"optimum: no force within the limits, of any shape, leaves less than rho = "
            f"{best.bound:.4f}; the one listed is known in advance, policies act on what they see",
            "qcar benchmark scores every policy at every limit, with intervals",
        ]
    return "\n".join(lines) + "\n"


def _row(name: str, amplitudes: Any, errors: Sequence[str], forces: Any) -> tuple[str, ...]:
    return (
        name,
        *(f"{value:.4f}" for value in amplitudes),
        *errors,
        *(" / ".join(f"{value:.1f}" for value in each) for each in forces),
    )
