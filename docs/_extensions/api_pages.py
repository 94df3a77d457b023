"""One reference page for each module of the library, and for those of its policies.

They are written before the build reads the pages. Modules that train agents need torch, which the
documentation is built without: of `qcar_env.agents` there is what loads them.
"""

from __future__ import annotations

import ast
from pathlib import Path

from sphinx.application import Sphinx


def write_pages(app: Sphinx) -> None:
    """Write `api/index.md` and a page for each module; leave equal files alone."""
    root = Path(app.srcdir).parent
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    pages: dict[str, str] = {}
    sections: dict[str, list[tuple[str, str]]] = {}
    places = {path: path.relative_to(root) for path in (root / "qcar_env").rglob("*.py")}
    for path in (*(root / "baselines").glob("*.py"), root / "agents" / "load.py"):
        places[path] = Path("qcar_env") / path.relative_to(root)
    for path, place in sorted(places.items(), key=lambda each: each[1]):
        text = path.read_text(encoding="utf-8")
        summary = (ast.get_docstring(ast.parse(text)) or "").split("\n", 1)[0]
        parts = place.with_suffix("").parts
        if parts[-1] == "__init__":
            continue
        name = ".".join(parts)
        section = parts[1] if len(parts) > 2 else "checks"
        sections.setdefault(section, []).append((name, summary))
        pages[name] = (
            f"# `{name}`\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :show-inheritance:\n```\n"
        )
    index = ["# Reference", "", "Every module of the library, from its docstrings.", ""]
    for section, modules in sections.items():
        index += [f"## {section}", "", "| module | what |", "|---|---|"]
        index += [f"| [`{name}`]({name}.md) | {summary} |" for name, summary in modules]
        index += [""]
    entries = [f"{name.removeprefix('qcar_env.')} <{name}>" for name in sorted(pages)]
    index += ["```{toctree}", ":hidden:", ":maxdepth: 1", "", *entries, "```", ""]
    pages["index"] = "\n".join(index)
    for stale in set(folder.glob("*.md")) - {folder / f"{name}.md" for name in pages}:
        stale.unlink()
    for name, text in pages.items():
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so when the build begins."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
