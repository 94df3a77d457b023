"""Tables as text: Markdown, and columns for a terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from qcar_env.analysis.paper.table1 import Cell


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]], right: str = "") -> list[str]:
    """Return the lines of a Markdown table.

    Parameters
    ----------
    header : sequence of str
        Titles of the columns.
    rows : iterable of sequence of str
        Cells; a bar in one is escaped.
    right : str
        A letter for each column, ``r`` where it is set to the right; all to the left if empty.
    """
    rule = "".join("--:|" if right[i : i + 1] == "r" else "---|" for i in range(len(header)))
    return [_line(header), "|" + rule, *map(_line, rows)]


def plain(text: str) -> str:
    """Return text for Markdown in which nothing is a comment, a tag, a link or code."""
    return re.sub(r"[\\`*\[\]<&|$]", r"\\\g<0>", text)


def columns(rows: Sequence[Sequence[str]], left: int) -> str:
    """Return rows in aligned columns, the first row underlined, the first `left` to the left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines: list[str] = []
    for number, row in enumerate(rows):
        cells = [
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
        if number == 0:
            lines.append("  ".join("-" * width for width in widths))
    return "\n".join(lines)


def table1_row(cell: Cell) -> tuple[str, ...]:
    """Return a cell of the paper's Table 1 as text.

    Law, gain and mass; amplitude without and with control and their difference [m]; percentage
    error, ours and the paper's; ratio of the amplitudes, ours over the paper's.
    """
    return (
        cell.law, f"{cell.gain:g}", f"x{cell.mass}", f"{cell.uncontrolled:.3f}",
        f"{cell.controlled:.4f}", f"{cell.absolute_error:.3f}", f"{cell.percentage_error:.0f}",
        f"{cell.printed:g}", f"{cell.agreement:.2f}",
    )  # fmt: skip


def _line(cells: Sequence[str]) -> str:
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in map(_escaped, cells))


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")
