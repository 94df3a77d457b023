"""What a report holds: tables, time histories, charts, and where they come from.

These records know nothing of HTML; `qcar_env.report.page` writes them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.evaluation.rollouts import Rollout
from qcar_env.parts.part import UNLIMITED, Part
from qcar_env.physics.linear import modes
from qcar_env.plots.style import Line, line
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]
Cell = str | float | None
Mode = Literal["lines", "markers", "lines+markers"]

DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
FIRST = 3.0  # [s] of a time history that is kept sample by sample
PERIODS = 5  # at its end that are, too
MOST_ENTRIES = 8  # of a table of numbers that are listed


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a table."""

    title: str
    unit: str = ""  # shown beside the title
    digits: int = 4  # significant ones of a number
    numeric: bool = True
    exact: bool = False  # as few digits as the number needs, for parameters
    note: str = ""  # explains it, on hover and for screen readers


def words(*titles: str, note: str = "") -> list[Column]:
    """Return columns of text."""
    return [Column(title=each, numeric=False, note=note) for each in titles]


def number(title: str, unit: str = "", digits: int = 4, note: str = "") -> Column:
    """Return a column of numbers."""
    return Column(title=title, unit=unit, digits=digits, note=note)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table that its reader can sort."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    colours: tuple[str, ...] = ()  # one for each row: that of its policy


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A curve or a cloud of points."""

    label: str
    x: Array  # (k,)
    y: Array  # (k,)
    colour: str  # #rrggbb
    dash: str = "solid"
    mode: Mode = "lines"
    low: Array | None = None  # (k,) lower end of an interval around y
    high: Array | None = None  # (k,) its upper end


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Axes with curves."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    note: str = ""
    logarithmic: bool = False  # y axis
    logarithmic_x: bool = False


@dataclass(frozen=True, kw_only=True)
class History:
    """The motion of one car under one policy, thinned for a page.

    The beginning and the last periods are kept sample by sample; between them the largest and the
    smallest displacement of each period, which is all that a screen shows of it.
    """

    label: str
    colour: str  # #rrggbb
    dash: str
    group: str  # which histories are shown together, such as a force limit
    dt: float  # [s]
    first: Array  # (k, 4 + m) x1, x2, v1, v2, forces from the start
    last: Array  # (j, 4 + m) the same at the end
    last_start: float  # time of its first row [s]
    middles: Array  # (p,) time of each period [s]
    low: Array  # (p, 2) smallest x1, x2 of each period [m]
    high: Array  # (p, 2) largest x1, x2 of each period [m]


@dataclass(frozen=True, kw_only=True)
class Report:
    """A whole report."""

    title: str
    lead: str  # what was compared, in two sentences
    findings: tuple[str, ...]  # what came out, one sentence each
    tables: tuple[Table, ...]
    charts: tuple[Chart, ...]
    histories: tuple[History, ...]
    force_unit: str
    parameters: Table
    provenance: Mapping[str, str]
    shown: tuple[str, ...] = field(default=())  # labels of the histories shown at first
    parts: tuple[str, ...] = ("first", "whole", "last")  # of the histories that are there


def dashes(style: Line) -> str:
    """Return how a line is dashed in the words of plotly."""
    if isinstance(style.linestyle, str):
        return DASHES[style.linestyle]
    # plotly's dashes are in pixels, matplotlib's in line widths of about a pixel and a half.
    return ",".join(f"{round(1.6 * part)}px" for part in style.linestyle[1])


def curve(
    style: Line, x: ArrayLike, y: ArrayLike, *, label: str = "", dash: str = "", **more: Any
) -> Curve:
    """Return a curve in a style, with its label and dash if none are given."""
    return Curve(
        **more,
        label=label or style.label,
        dash=dash or dashes(style),
        x=np.asarray(x, dtype=np.float64),
        y=np.asarray(y, dtype=np.float64),
        colour=style.color,
    )


def history(law: str, rollout: Rollout) -> History:
    """Thin the rollout of a law for a page."""
    return thinned(
        rollout.t,
        np.column_stack([rollout.x1, rollout.x2, rollout.v1, rollout.v2]),
        rollout.force,
        line(law),
        period=2.0 * np.pi / rollout.scenario.reference_frequency,
    )


def thinned(
    t: Array,
    x: Array,
    force: Array,
    style: Line,
    *,
    period: float,
    group: str = "",
    first: float = FIRST,
) -> History:
    """Thin time histories for a page.

    Parameters
    ----------
    t : ndarray (k,)
        Evenly spaced times [s].
    x : ndarray (k, 4)
        States [m, m, m/s, m/s].
    force : ndarray (k, m)
        Force held until each time [m/s^2] or [N].
    style : Line
        Label, colour and line.
    period : float
        Of the motion [s].
    group : str
        See `History`.
    first : float
        What is kept of the beginning, sample by sample [s].
    """
    dt = float(t[1] - t[0]) if len(t) > 1 else float(t[0])  # one interval from the start on
    everything = np.column_stack([x, force])
    per_period = max(2, round(period / dt))
    whole = max(1, len(t) // per_period)
    blocks = everything[: whole * per_period, :2].reshape(whole, -1, 2)
    last = min(len(t), PERIODS * per_period + 1)
    return History(
        label=style.label,
        colour=style.color,
        dash=dashes(style),
        group=group,
        dt=dt,
        first=everything[: round(first / dt)],
        last=everything[-last:],
        last_start=float(t[-last]),
        middles=t[: whole * per_period].reshape(whole, -1).mean(axis=1),
        low=blocks.min(axis=1),
        high=blocks.max(axis=1),
    )


def parameters(scenario: Scenario) -> Table:
    """Return every parameter of a scenario with its symbol and unit."""
    car, force, actuator = scenario.car, scenario.force, scenario.actuator
    rows: list[tuple[Cell, ...]] = [*_numbers(car), ("road", "", type(scenario.road).__name__, "")]
    rows += _numbers(scenario.road)
    rows.append(("speed", "", scenario.speed, "m/s"))
    if scenario.excitation.turning and scenario.excitation.omega:
        rows.append(("frequency of the road", "omega", scenario.excitation.omega, "rad/s"))
    if force.f:
        rows.append(("external force on the body", "f", force.f, "m/s²"))
        rows.append(("its frequency", "Omega", force.Omega, "rad/s"))
    rows.append(("actuator", "", type(actuator).__name__, ""))
    rows += _numbers(actuator)
    for count, mode in enumerate(modes(car) if car.linear else (), start=1):
        rows.append((f"mode {count}, frequency", "", mode.frequency, "rad/s"))
        rows.append((f"mode {count}, damping ratio", "", mode.damping_ratio, ""))
    for symbol, mass, value in zip(
        ("A1", "A2"), ("wheel", "body"), scenario.reference_amplitudes, strict=True
    ):
        rows.append((f"amplitude without control, {mass}", symbol, value, "m"))
    rows += [
        ("control interval", "dt", scenario.dt, "s"),
        ("RK4 steps in it", "substeps", scenario.substeps, ""),
        ("episode", "duration", scenario.duration, "s"),
        ("travel that ends it", "travel_limit", scenario.travel_limit, "A"),
    ]
    for each in scenario.randomisation:
        numbers = " ".join(f"{value:g}" for value in each.by.row[1:])
        rows.append((f"drawn: {', '.join(each.numbers)}", type(each.by).__name__, numbers, ""))
    return Table(
        title=f"Scenario {scenario.name}",
        note=f"{scenario.title}. Source: {scenario.source}.",
        columns=(
            *words("what", "symbol"),
            Column(title="value", digits=5, exact=True),
            *words("unit"),
        ),
        rows=tuple(rows),
    )


PAPER_WORDS: Mapping[str, str] = {  # the paper's letters say nothing by themselves
    "omega1": "frequency of the wheel, body held",
    "omega2": "frequency of the body, wheel held",
    "b1": "damping of the wheel",
    "b2": "damping of the body",
    "E1": "spring coupling on the wheel",
    "E2": "damper coupling on the wheel",
    "E3": "spring coupling on the body",
    "mu1": "tyre stiffness per wheel mass",
    "mu2": "tyre damping per wheel mass",
}


def _numbers(part: Any, home: str = "") -> Iterator[tuple[Cell, ...]]:
    """Yield a row for each number of a part, and of the parts that it is made of."""
    for each in dataclasses.fields(part):
        value, unit = getattr(part, each.name), each.metadata.get("unit", "")
        if isinstance(value, Part):
            yield each.name, "", type(value).__name__, ""
            yield from _numbers(value, f"{home}{each.name}.")
        elif isinstance(value, tuple):
            title = each.metadata.get("title", "")
            for count, entry in enumerate(value[:MOST_ENTRIES], start=1):
                yield f"{title} {count}", home + each.name, entry, raised(unit)
        elif isinstance(value, float) and value < UNLIMITED:
            title = each.metadata.get("title") or PAPER_WORDS.get(each.name, each.name)
            yield title, home + each.name, value, raised(unit.replace("-", ""))


def raised(unit: str) -> str:
    """Return a unit with its powers raised."""
    return unit.replace("^2", "²").replace("^3", "³")
