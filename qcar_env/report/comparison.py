"""The report of `qcar compare`: several policies in one scenario at one force limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.optimum import period_optimum
from qcar_env.analysis.paper.forced_car import from_scenario, stack, sweep
from qcar_env.analysis.paper.table1 import Cell
from qcar_env.control.law import Law
from qcar_env.evaluation import storage
from qcar_env.evaluation.bounds import linear_plant
from qcar_env.evaluation.comparison import START, Comparison
from qcar_env.evaluation.outcome import Outcome
from qcar_env.physics.car import PaperCar
from qcar_env.plots.style import line
from qcar_env.report.content import (
    Chart,
    Report,
    Table,
    curve,
    history,
    number,
    parameters,
    raised,
    words,
)
from qcar_env.report.page import write
from qcar_env.scenarios import Scenario

SCALES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # of the limit, for the optimum
RESPONSE = (0.82, 1.18, 181)  # forcing frequency over the scenario's: from, to, number of points
HARMONICS = 3  # of the response; the third is all that the cubic law adds to 0.1 %


def page(path: Path, found: Comparison) -> Path:
    """Write the report of a comparison to an .html file, and return where."""
    provenance = {
        "command": storage.command(),
        "start": START,
        "gains": "; ".join(str(law) for law in found.laws.values()),
        "versions": storage.made_with(),
        "numbers": "table.csv and result.json beside this file",
    }
    return write(path, comparison(found, provenance))


def comparison(found: Comparison, provenance: Mapping[str, str]) -> Report:
    """Collect the report of a comparison, with what is needed to make it again."""
    scenario, outcomes = found.scenario, found.outcomes
    unit = scenario.actuator.unit
    limits = " and ".join(f"{value:g}" for value in scenario.actuator.limit)
    tables = [_leaderboard(outcomes, unit)]
    if found.table1:
        tables.append(_paper_table(found.table1))
    charts: list[Chart] = []
    optimum = None
    if scenario.excitation.harmonic and linear_plant(scenario):
        frontier, optimum = _frontier(scenario, outcomes)
        charts.append(frontier)
        charts += _responses(scenario, found.laws)
    return Report(
        title=f"Comparison in the scenario {scenario.name}",
        lead=(
            f"{scenario.title}. Every policy acts each {scenario.dt * 1e3:g} ms with at most "
            f"{limits} {raised(unit)}, {found.duration:g} s from rest."
        ),
        findings=_findings(outcomes, optimum),
        tables=tuple(tables),
        charts=tuple(charts),
        histories=tuple(history(name, each) for name, each in found.rollouts.items()),
        force_unit=unit,
        parameters=parameters(scenario),
        provenance=provenance,
        shown=tuple(line(name).label for name in _first_shown(found)),
    )


def _leaderboard(outcomes: Sequence[Outcome], unit: str) -> Table:
    forces = ("wheel", "body") if len(outcomes[0].peak_force) == 2 else ("",)
    largest = "largest displacement of the {}, last five periods"
    papers = "the paper's (vA1 - vA2) / vA2"
    columns = [
        *words("policy"),
        number("rho", "", 3, "the larger of the two amplitudes over those without control"),
        number("x1", "m", note=largest.format("wheel")),
        number("x2", "m", note=largest.format("body")),
        *(number(each, "dB", 3, "relative to no control") for each in ("x1", "x2")),
        *(number(f"error {each}", "%", 3, papers) for each in ("x1", "x2")),
        *(
            number(f"{kind} force {each}".strip(), raised(unit), 3)
            for kind in ("peak", "RMS")
            for each in forces
        ),
    ]
    ranked = sorted(outcomes, key=lambda each: each.rho)
    rows = [
        (
            line(each.policy).label + (" (left the travel limit)" if each.terminated else ""),
            each.rho,
            *each.amplitudes,
            *(_zero(-value, 0.01) for value in each.reductions),
            *(_zero(value, 0.1) for value in each.percentage_errors),
            *each.peak_force,
            *each.rms_force,
        )
        for each in ranked
    ]
    return Table(
        title="Leaderboard",
        note="Press a column's head to sort by it. rho: 1 is no control, 0 is stillness.",
        columns=tuple(columns),
        rows=tuple(rows),
        colours=tuple(line(each.policy).color for each in ranked),
    )


def _paper_table(cells: Sequence[Cell]) -> Table:
    return Table(
        title="Table 1 of the paper",
        note="The law acts at every instant and its force is not limited. Error: (no control - "
        "controlled) / controlled. The last column is the ratio of no control to controlled, ours "
        "over the paper's.",
        columns=(
            *words("law"),
            number("G", digits=2),
            *words("mass"),
            number("no control", "m"),
            number("controlled", "m"),
            number("error", "%"),
            number("the paper's error", "%"),
            number("agreement", digits=3),
        ),
        rows=tuple(
            (
                *(cell.law, cell.gain, f"x{cell.mass}", cell.uncontrolled, cell.controlled),
                *(cell.percentage_error, cell.printed, cell.agreement),
            )
            for cell in cells
        ),
        colours=tuple(line(cell.law).color for cell in cells),
    )


def _frontier(scenario: Scenario, outcomes: Sequence[Outcome]) -> tuple[Chart, float]:
    """Return the policies over the force that they used, above what any force can reach."""
    best = [period_optimum(scenario.with_force_scale(scale)).rho for scale in SCALES]
    x, y = 100.0 * np.array((0.0, *SCALES)), (1.0, *best)
    label = "optimum: no policy can be below"
    curves = [curve(line("optimum"), x, y, label=label, mode="lines+markers")]
    for each in outcomes:
        shares = zip(each.peak_force, scenario.actuator.limit, strict=True)
        used = 100.0 * max(peak / limit for peak, limit in shares)
        style = line(each.policy)
        curves.append(curve(style, [used], [each.rho], mode="markers", dash="solid"))
    chart = Chart(
        title="Amplitude against force",
        note="The dashed line is the least vibration that any force within so much of the limit "
        "can leave, a linear program; rho is the larger of the two amplitudes over those without "
        "control. A policy stands where the largest share of the limits that "
        "it used puts it.",
        x_label="peak force over the limit [%]",
        y_label="rho [-]",
        curves=tuple(curves),
    )
    return chart, best[-1]


def _responses(scenario: Scenario, laws: Mapping[str, Law]) -> list[Chart]:
    """Return amplitude against forcing frequency, laws in continuous time without a limit."""
    forcing, force = scenario.excitation.omega, scenario.force
    of_paper = isinstance(scenario.car, PaperCar) and scenario.actuator.size == 2
    if not of_paper or (force.f and force.Omega != forcing):
        return []
    low, high, count = RESPONSE
    omega = forcing * np.linspace(low, high, count)
    found = {}
    for name, law in laws.items():
        cars = stack(list(sweep(from_scenario(scenario, law), "omega", omega)))
        motions = balance(cars, harmonics=HARMONICS)
        found[name] = np.where(motions.converged, motions.peaks[:2], np.nan)
    return [
        Chart(
            title=f"Response curves, {mass}",
            note="Steady amplitude against the frequency of road and external force together; the "
            "law acts at every instant without a limit. Harmonic balance with three harmonics."
            if row == 0
            else "",
            x_label="omega = Omega [rad/s]",
            y_label=f"amplitude of x{row + 1}, {mass} [m]",
            logarithmic=True,
            curves=tuple(
                curve(line(name), omega, amplitudes[row]) for name, amplitudes in found.items()
            ),
        )
        for row, mass in enumerate(("wheel", "body"))
    ]


def _findings(outcomes: Sequence[Outcome], optimum: float | None) -> tuple[str, ...]:
    ranked = sorted((each for each in outcomes if not each.terminated), key=lambda each: each.rho)
    if not ranked:
        return ("Every policy left the travel limit.",)
    best = ranked[0]
    found = [
        f"{line(best.policy).label} leaves the least vibration: the wheel moves by "
        f"{best.amplitudes[0]:.3g} m instead of {best.uncontrolled[0]:.3g} m, the body by "
        f"{best.amplitudes[1]:.3g} m instead of {best.uncontrolled[1]:.3g} m (rho = "
        f"{best.rho:.3g})."
    ]
    if optimum is not None:
        found.append(
            f"No force within the limit, of any shape, reaches a rho below {optimum:.2g}."
            if optimum > 1e-3
            else "A force within the limit could stop the motion but for a thousandth or less."
        )
    gentle = min(ranked, key=lambda each: max(each.peak_force) if each.rho < 0.999 else np.inf)
    if gentle is not best and gentle.rho < 0.999:
        small, large = (" / ".join(f"{v:.3g}" for v in e.peak_force) for e in (gentle, best))
        found.append(
            f"The policies use very different forces: {line(gentle.policy).label} "
            f"peaks at {small}, {line(best.policy).label} at {large}."
        )
    return tuple(found)


def _zero(value: float, least: float) -> float:
    """Return 0 for what is too small to be told from it."""
    return 0.0 if abs(value) < least else value


def _first_shown(found: Comparison) -> list[str]:
    """No control, the best policy and the two best laws: more curves than that hide one another."""
    ranked = [each.policy for each in sorted(found.outcomes, key=lambda each: each.rho)]
    best = [name for name in ranked if name != "none"]
    laws = [name for name in best[1:] if name not in found.learned]
    return [*(["none"] if "none" in ranked else []), *best[:1], *laws[:2]]
