"""Docstrings of the library as reStructuredText: equations stay as they stand, bars are bars."""

from __future__ import annotations

import dataclasses
import inspect
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
    """Keep the line breaks of indented blocks, numbered equations and aligned lists."""
    blocks: list[list[str]] = [[]]
    for line in lines:
        if line.strip():
            blocks[-1].append(line)
        elif blocks[-1]:
            blocks.append([])
    out: list[str] = []
    for block in filter(None, blocks):
        announced = bool(out) and _last_text(out).endswith("::")
        if not announced and _is_drawn(block):
            out += ["::", "", *("    " + line.replace("``", "") for line in block), ""]
        else:
            out += [*block, ""]
    lines[:] = out


def _is_drawn(block: list[str]) -> bool:
    """Whether a block means its line breaks."""
    if any(re.match(r"\s*(={3,}|-{3,}|- |\* |\.\. |>>>|\w+\) )", line) for line in block):
        return False
    if all(line.startswith("    ") for line in block):
        return True
    return any(re.match(r"\(\d+\)  |\S.*?\S {2,}\S", line) for line in block)


def _last_text(lines: list[str]) -> str:
    return next((line.rstrip() for line in reversed(lines) if line.strip()), "")


def fields(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """List the fields of a record whose meaning stands in comments beside them."""
    record = dataclasses.is_dataclass(obj) or hasattr(obj, "_fields")
    if what != "class" or not record or "Parameters" in lines:
        return
    try:
        source = inspect.getsource(obj)
    except (OSError, TypeError):
        return
    found = re.findall(r"^    (\w+): ([^#\n]+?)(?: = [^#\n]+?)?  # (.+)$", source, re.MULTILINE)
    if found:
        lines += ["", "Attributes", "----------"]
        for field, kind, comment in found:
            lines += [f"{field} : ``{kind}``", f"    {comment}"]
        lines += [""]


def skip(app: Sphinx, what: str, name: str, obj: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out "Alias for field number 0"."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so before the sections of a docstring are read."""
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-process-docstring", fields, priority=390)
    app.connect("autodoc-skip-member", skip)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
