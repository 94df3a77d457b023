"""Docstrings of the library as reStructuredText: equations stay as they stand, bars are bars."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_LITERAL = re.compile(r"(``.+?``|`[^`]+`)")


def prepare(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Change the lines of a docstring in place."""
    if any(line.startswith("## ") for line in lines):  # a page in Markdown
        end = lines.index("") if "" in lines else len(lines)
        lines[:] = [*lines[:end], "", "Its page is :doc:`/environment`.", ""]
        return
    if what == "module":
        _equations(lines)
    literal = False
    for number, line in enumerate(lines):
        if literal and line.strip() and not line.startswith(" "):
            literal = False
        if not literal:
            parts = _LITERAL.split(line)
            parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
            lines[number] = "".join(parts)
        if line.rstrip().endswith("::"):
            literal = True


def _equations(lines: list[str]) -> None:
    """Keep the line breaks of an indented block, and of a block of numbered equations."""
    out: list[str] = []
    block = False
    for number, line in enumerate(lines):
        before = lines[number - 1] if number else ""
        indented = line.startswith("    ") and not line.lstrip().startswith(("-", "*", ">>>"))
        equation = re.match(r"\(\d+\)  ", line) is not None
        starts = (indented or equation) and not before.strip() and not block
        if starts and number and not _last_text(out).endswith("::"):
            out += ["::", ""]
            block = True
        elif line.strip() and not indented and not equation:
            if block and before.strip():
                out += [""]
            block = False
        out.append("    " + line if equation and block else line)
    lines[:] = out


def _last_text(lines: list[str]) -> str:
    return next((line.rstrip() for line in reversed(lines) if line.strip()), "")


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so before the sections of a docstring are read."""
    app.connect("autodoc-process-docstring", prepare, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
