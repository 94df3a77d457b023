"""Profiles from a table as text: the first line names the columns and their units.

    distance [m], left [mm], right [mm]
    0.00, 12.1, 11.9
    0.25, 12.4, 11.7

A comma, a semicolon or a tabulator stands between the cells, whichever the first line has. Numbers
have decimal points. Blank lines, and lines that begin with `#`, are passed over.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from qcar_env.roads.samples import UNITS, Samples, chosen, metres
from qcar_env.validation import shown

DISTANCE = "distance"
HEADER = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\]]*)\]")
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
EXAMPLE = "distance [m], height [mm]"


def read_csv(
    path: Path, *, channel: str | None = None, longest_gap: float | None = None
) -> Samples:
    """Return a profile of a table.

    Parameters
    ----------
    path : Path
        The file, in UTF-8.
    channel : str, optional
        Name of the column of heights, without unit; the only one needs no name.
    longest_gap : float, optional
        As of `Samples` [m].

    Raises
    ------
    ValueError
        If the first line or a number cannot be read, or as `Samples`; the line is named.
    """
    rows = _rows(path)
    first = next(rows, None)
    if first is None:
        raise ValueError(f"{path} must hold samples, got an empty file; give a table of them")
    number, header = first
    columns = [_column(cell, f"in line {number} of {path}") for cell in header]
    names = [name for name, _ in columns]
    if [name.lower() for name in names].count(DISTANCE) != 1 or len(names) < 2:
        raise ValueError(
            f"one column must be named {DISTANCE!r} and another one be heights, got {names} in "
            f"line {number} of {path}; write a first line like: {EXAMPLE}"
        )
    at_distance = [name.lower() for name in names].index(DISTANCE)
    others = [i for i in range(len(names)) if i != at_distance]
    at_height = others[chosen(channel, [names[i] for i in others], path)]
    lines: list[int] = []
    values: list[tuple[float, float]] = []
    for line, row in rows:
        place = f"in line {line} of {path}"
        if len(row) != len(names):
            raise ValueError(
                f"a line must have {len(names)} cells, got {len(row)} {place}: "
                f"{shown(', '.join(row))}; write one number per column, with decimal points"
            )
        lines.append(line)
        values.append(
            (
                columns[at_distance][1] * _number(names[at_distance], row[at_distance], place),
                columns[at_height][1] * _number(names[at_height], row[at_height], place),
            )
        )
    table = np.array(values, dtype=np.float64).reshape(-1, 2)
    return Samples(
        path=path,
        distances=table[:, 0],
        heights=table[:, 1],
        place="line",
        numbers=lines,
        longest_gap=longest_gap,
    )


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the cells of each line that holds any; the header first."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path} must be text in UTF-8, got the byte {error.object[error.start]:#04x} at "
            f"{error.start}; save it as text in UTF-8"
        ) from None
    lines = text.split("\n")
    kept = (i for i, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#")
    between = ""
    for number in kept:
        line = lines[number - 1]
        between = between or next((each for each in ";\t" if each in line), ",")
        try:
            (row,) = csv.reader([line], delimiter=between, skipinitialspace=True, strict=True)
        except csv.Error as error:
            raise ValueError(
                f"line {number} of {path} must be cells with {between!r} between them, got "
                f"{shown(line)} ({error}); take quotation marks out"
            ) from None
        yield number, [cell.strip() for cell in row]


def _column(cell: str, place: str) -> tuple[str, float]:
    """Return the name of a column and its unit in metres."""
    found = HEADER.fullmatch(cell)
    if not found:
        raise ValueError(
            f"the first line must name each column and its unit in brackets, got {shown(cell)} "
            f"{place}; write a first line like: {EXAMPLE} (units: {', '.join(UNITS)})"
        )
    return found["name"], metres(found["unit"], found["name"], place)


def _number(name: str, cell: str, place: str) -> float:
    """Return the number in a cell."""
    remedy = "write a number"
    if not cell:
        remedy = "fill the gap in, or take the line out and give longest_gap"
    elif DECIMAL_COMMA.fullmatch(cell):
        remedy = "write a decimal point"
    try:
        value = math.nan if "_" in cell else float(cell)  # Python reads 1_0 as 10
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {shown(cell)} {place}; {remedy}")
    return value
