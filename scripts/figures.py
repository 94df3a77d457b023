"""Make the paper's Figures 3 to 14 and Table 1 from the library, and four figures of our own.

qcar figures
qcar figures --only 4 14 accuracy --quick
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path

from qcar_env.analysis.paper.forced_car import from_scenario
from qcar_env.analysis.paper.table1 import table1
from qcar_env.commands import command
from qcar_env.evaluation import storage, tables
from qcar_env.plots.paper import FIGURES, Subject
from qcar_env.plots.style import journal, save
from qcar_env.scenarios import Scenario, scenario
from qcar_env.validation import known

TABLE = "table1"
NAMES = (*FIGURES, TABLE)


HEADER = ("law", "gain", "mass", "absolute error [m]", "percentage error [%]", "paper [%]")
OPTIONS: command.Options = {
    "only": (
        str,
        f"figures to make, of {', '.join(NAMES)}; all if left out",
        {"nargs": "+", "metavar": "NAME"},
    ),
    "quick": (False, "fewer points and panels, to look at the layout"),
    "out": (Path("results/figures"), "folder to write to"),
}


def run(arguments: argparse.Namespace) -> None:
    """Make the figures that are asked for."""
    out = arguments.out
    storage.check_folder(out)
    names = arguments.only or NAMES
    for name in names:
        known("figure", name, NAMES)
    preset = scenario("paper")
    subject = Subject(car=from_scenario(preset), quick=arguments.quick)
    captions: dict[str, str] = {}
    begin = now = time.perf_counter()
    for count, name in enumerate(names, start=1):
        before = now
        if name == TABLE:
            text = _table(preset, out)
        else:
            with journal():
                figure, text = FIGURES[name](subject)
                stem = f"figure-{int(name):02d}" if name.isdigit() else f"figure-{name}"
                save(figure, out / stem)
        captions[name] = f"{text} Parameters: {subject.parameters}."
        now = time.perf_counter()
        left = command.left(now - begin, count, len(names))
        print(f"{name:>10}  {now - before:6.1f} s   about {left:4.0f} s left", flush=True)
    _write_captions(captions, out)
    print(f"{len(names)} written to {out} in {time.perf_counter() - begin:.0f} s")


def _table(preset: Scenario, out: Path) -> str:
    cells = table1(preset)
    rows = [tables.table1_row(each) for each in cells]
    shown = [dict(zip(HEADER, (*row[:3], *row[5:8]), strict=True)) for row in rows]
    storage.write_csv(out / "table1.csv", shown)
    worst = max(abs(cell.agreement - 1.0) for cell in cells)
    return (
        "Table 1: absolute error vA1 - vA2 and percentage error (vA1 - vA2)/vA2 of the amplitudes "
        "without (vA1) and with control (vA2), after 60 s from rest, beside the paper's. The "
        f"ratios vA1/vA2 agree within {100 * worst:.0f} %; the parameters were calibrated on them."
    )


def _write_captions(captions: Mapping[str, str], out: Path) -> None:
    """Add the captions to those of earlier runs, in the order of the figures."""
    with storage.held(out, wait=60.0):
        _merge_captions(captions, out / "captions.md")


def _merge_captions(captions: Mapping[str, str], path: Path) -> None:
    kept: dict[str, str] = {}
    if path.exists():
        for part in path.read_text(encoding="utf-8").split("\n## ")[1:]:
            title, _, text = part.partition("\n\n")
            kept[title.strip()] = text.strip()
    kept.update({_title(name): text for name, text in captions.items()})
    order = [title for title in map(_title, NAMES) if title in kept]
    parts = [f"\n## {title}\n\n{kept[title]}\n" for title in order]
    storage.write_text(path, "# Captions\n" + "".join(parts))


def _title(name: str) -> str:
    if name == TABLE:
        return "Table 1"
    return f"Figure {name}" if name.isdigit() else f"Figure: {name}"


main = command.main("figures", __doc__.splitlines()[0], OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
