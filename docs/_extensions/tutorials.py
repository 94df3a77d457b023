"""Tutorial scripts as pages: comments become text, code stays code.

A script in `docs/tutorials` is made of cells as editors know them: ``# %% [markdown]`` begins text
(comment lines), ``# %%`` code. Its docstring is for those who read the script, not for the page.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

_CELL = re.compile(r"^# %%(?P<text> \[markdown\])?[^\n]*\n", re.MULTILINE)


def page(source: str, name: str) -> str:
    """Return the MyST page of a tutorial's source."""
    marks = list(_CELL.finditer(source))
    ends = [mark.start() for mark in marks[1:]] + [len(source)]
    parts: list[str] = []
    for mark, end in zip(marks, ends, strict=True):
        cell = source[mark.end() : end].strip("\n")
        if mark["text"]:
            parts.append("\n".join(re.sub(r"^# ?", "", line) for line in cell.split("\n")))
        else:
            parts.append(f"```python\n{cell}\n```")
    parts.append(f"The whole script is `docs/tutorials/{name}`.")
    return "\n\n".join(parts) + "\n"


def write_pages(app: Sphinx) -> None:
    """Write a page beside each script; leave equal files alone."""
    for script in sorted((Path(app.srcdir) / "tutorials").glob("*.py")):
        text = page(script.read_text(encoding="utf-8"), script.name)
        target = script.with_suffix(".md")
        if not target.exists() or target.read_text(encoding="utf-8") != text:
            target.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so when the build begins."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
