"""Give each line of the source pages an address: `_modules/qcar_env/scenarios.html#line-84`."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_SOURCE = re.compile(r"(<pre>)(.*?)(</pre>)", re.DOTALL)
# Lines that Sphinx puts between those of the source, around what the reference describes; one
# follows the end of each.
_ADDED = re.compile(r'<div class="viewcode-block"|<a class="viewcode-back"')


def number_lines(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any
) -> None:
    """Begin every line of a source page with its address."""
    if page.startswith("_modules/") and "body" in context:
        context["body"] = _SOURCE.sub(_number, context["body"], count=1)


def _number(found: re.Match[str]) -> str:
    numbered: list[str] = []
    number = 0
    before = "</div>"  # the page begins with an empty line, too
    for line in found[2].split("\n"):
        added = _ADDED.match(line) or before.endswith("</div>")
        before = line
        if added:
            numbered.append(line)
        else:
            number += 1
            numbered.append(f'<span class="source-line" id="line-{number}"></span>{line}')
    return found[1] + "\n".join(numbered) + found[3]


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so when pages are written."""
    app.connect("html-page-context", number_lines)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
