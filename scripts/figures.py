"""Make the paper's Figures 3 to 14 and Table 1 from the library, and four figures of our own.

python scripts/figures.py
python scripts/figures.py --only 4 14 accuracy --quick
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from qcar_env.analysis.paper.forced_car import from_scenario
from qcar_env.analysis.paper.table1 import table1
from qcar_env.evaluation import storage
from qcar_env.plots.paper import FIGURES, Subject
from qcar_env.plots.style import journal, save
from qcar_env.scenarios import Scenario, scenario
from qcar_env.validation import known

TABLE = "table1"
NAMES = (*FIGURES, TABLE)


def main(argv: Sequence[str] | None = None) -> int:
    """Make the figures that are asked for and return the exit status."""
    arguments = _parse(argv)
    out = arguments.out
    try:
        storage.check_folder(out)
        names = arguments.only or NAMES
        for name in names:
            known("figure", name, NAMES)
        preset = scenario(arguments.preset)
        subject = Subject(car=from_scenario(preset), quick=arguments.quick)
    except ValueError as error:
        print(f"figures: {error}", file=sys.stderr)
        return 2
    captions: dict[str, str] = {}
    begin = time.perf_counter()
    for index, name in enumerate(names):
        before = time.perf_counter()
        if name == TABLE:
            captions[name] = _table(preset, out)
        else:
            with journal():
                figure, captions[name] = FIGURES[name](subject)
                stem = f"figure-{int(name):02d}" if name.isdigit() else f"figure-{name}"
                save(figure, out / stem)
        now = time.perf_counter()
        left = (now - begin) / (index + 1) * (len(names) - index - 1)
        print(f"{name:>10}  {now - before:6.1f} s   about {left:4.0f} s left", flush=True)
    _write_captions(
        {name: f"{text} Parameters: {subject.parameters}." for name, text in captions.items()}, out
    )
    print(f"{len(names)} written to {out} in {time.perf_counter() - begin:.0f} s")
    return 0


def _table(preset: Scenario, out: Path) -> str:
    cells = table1(preset)
    header = ["law", "gain", "mass", "absolute error [m]", "percentage error [%]", "paper [%]"]
    storage.write_csv(
        out / "table1.csv",
        [
            dict(
                zip(
                    header,
                    (
                        cell.law, f"{cell.gain:g}", f"x{cell.mass}", f"{cell.absolute_error:.3f}",
                        f"{cell.percentage_error:.0f}", f"{cell.printed:g}",
                    ),
                    strict=True,
                )
            )
            for cell in cells
        ],
    )  # fmt: skip
    worst = max(abs(cell.agreement - 1.0) for cell in cells)
    return (
        "Table 1: absolute error vA1 - vA2 and percentage error (vA1 - vA2)/vA2 of the amplitudes "
        "without (vA1) and with control (vA2), after 60 s from rest, beside the paper's. The "
        f"ratios vA1/vA2 agree within {100 * worst:.0f} %; the parameters were calibrated on them."
    )


def _write_captions(captions: Mapping[str, str], out: Path) -> None:
    """Add the captions to those of earlier runs, in the order of the figures."""
    path = out / "captions.md"
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


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", metavar="NAME",
        help=f"figures to make, of {', '.join(NAMES)}; all if left out",
    )  # fmt: skip
    parser.add_argument(
        "--preset", default="paper",
        help="scenario whose car and forcing are used; it must have an endless harmonic road",
    )  # fmt: skip
    parser.add_argument(
        "--quick", action="store_true", help="fewer points and panels, to look at the layout"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/figures"), help="folder to write to"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
