"""Pieces of a page that are read off the code, so that they cannot be outdated.

In a page the two lines

    ```{fact} scenarios
    ```

are replaced by the Markdown that the function `scenarios` returns, before the page is parsed.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import json
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from baselines import catalogue
from qcar_env.control import LAWS
from qcar_env.envs import task
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.physics.car import UNITS
from qcar_env.physics.linear import modes
from qcar_env.scenarios import SCENARIOS, Scenario

ROOT = Path(__file__).parents[2]


def environment() -> str:
    """Return the environment's class docstring, which is Markdown."""
    text = inspect.cleandoc(QuarterCarHumpEnv.__doc__ or "")
    # Two backquotes are how Sphinx writes code, and mean the same here.
    return re.sub(r"(?<!`)``(?!`)", "`", text)


def observations() -> str:
    """Return what one unit of each observation is in the named scenarios."""
    units = ("m", "m", "m/s", "m/s", "m", "m/s", "m/s²", "m/s³")
    rows = []
    for scenario in SCENARIOS.values():
        scales = task.scales(scenario)
        road, force = scenario.road, scenario.force
        ones = (
            1.0 / scales.x1,
            1.0 / scales.x2,
            1.0 / scales.v1,
            1.0 / scales.v2,
            road.h,
            road.h * road.omega,
            force.f,
            force.f * force.Omega,
        )
        rows.append([f"`{scenario.name}`", *(f"{one:.4g}" if one else "-" for one in ones)])
    names = ("x1", "x2", "v1", "v2", "y", "y'", "F", "F'")
    header = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    return _table(["scenario", *header], rows)


def actions() -> str:
    """Return what action 1 is in the named scenarios."""
    rows = []
    for scenario in SCENARIOS.values():
        actuator = scenario.actuator
        places = ("wheel", "body") if actuator.size == 2 else ("between wheel and body",)
        for number, (place, limit) in enumerate(zip(places, actuator.limit, strict=True)):
            unit = actuator.unit.replace("^2", "²")
            rows.append([f"`{scenario.name}`", str(number), place, f"{limit:g} {unit}"])
    return _table(["scenario", "entry", "where", "force at action 1"], rows)


def laws() -> str:
    """Return the laws with their published gains, each with its own docstring."""
    parts = []
    for key, law in LAWS.items():
        published = law()
        doc = inspect.getdoc(inspect.getmodule(law)) or ""
        title = (inspect.getdoc(law) or "").splitlines()[0].rstrip(".")
        parts.append(f"## {published.name}: {title[0].lower()}{title[1:]}")
        formula = re.search(r"((?:^    .+\n?)+)", doc, re.MULTILINE)
        if formula:
            parts.append(f"```text\n{inspect.cleandoc(formula[1])}\n```")
        gains = dataclasses.asdict(published)
        listed = ", ".join(f"`{name}` = {value:g}" for name, value in gains.items())
        parts.append(f"Name `{key}`. Published gains: {listed or 'none'}.")
        notes = _section(inspect.getdoc(law) or "", "Notes")
        if notes:
            parts.append(notes.replace("``", "`"))
        parts.append(f"Reference: [`{law.__module__}`](api/{law.__module__}.md).")
    return "\n\n".join(parts)


def scenarios() -> str:
    """Return every named scenario with its parameters, units and source."""
    parts = []
    for each in SCENARIOS.values():
        parts.append(f"## `{each.name}`")
        parts.append(f"{each.title}. Source: {each.source}.")
        parts.append(_table(["what", "symbol", "value", "unit"], _parameters(each)))
    return "\n\n".join(parts)


def _parameters(scenario: Scenario) -> list[list[str]]:
    car, road, force, actuator = (
        scenario.car,
        scenario.road,
        scenario.force,
        scenario.actuator,
    )
    rows = []
    names = {
        "omega1": "wheel, body held",
        "omega2": "body, wheel held",
        "b1": "damping of the wheel",
        "b2": "damping of the body",
        "E1": "spring coupling on the wheel",
        "E2": "damper coupling on the wheel",
        "E3": "spring coupling on the body",
        "mu1": "tyre stiffness per wheel mass",
        "mu2": "tyre damping per wheel mass",
        "m1": "mass of the wheel",
        "m2": "mass of the body",
    }
    for name, unit in UNITS.items():
        value = getattr(car, name)
        if value is not None:
            rows.append([names[name], f"`{name}`", f"{value:.5g}", _raised(unit)])
    rows.append(["road", "", road.profile, ""])
    rows.append(["height of the hump", "`h`", f"{road.h:g}", "m"])
    if road.omega:
        rows.append(["its frequency", "`omega`", f"{road.omega:.5g}", "rad/s"])
    if math.isfinite(road.duration) and road.profile != "harmonic":
        rows.append(["time over a hump", "", f"{road.duration:.4g}", "s"])
    if road.start:
        rows.append(["first hump at", "", f"{road.start:g}", "s"])
    if force.f:
        rows.append(["external force", "`f`", f"{force.f:g}", "m/s²"])
        rows.append(["its frequency", "`Omega`", f"{force.Omega:g}", "rad/s"])
    places = ("wheel", "body") if actuator.size == 2 else ("between the masses",)
    for place, limit in zip(places, actuator.limit, strict=True):
        rows.append([f"force limit, {place}", "", f"{limit:g}", _raised(actuator.unit)])
    for number, mode in enumerate(modes(car), start=1):
        rows.append(
            [
                f"mode {number}",
                "",
                f"{mode.frequency:.4g} rad/s, damping ratio {mode.damping_ratio:.3g}",
                "",
            ]
        )
    for name, value in zip(("A1", "A2"), scenario.reference_amplitudes, strict=True):
        mass = "wheel" if name == "A1" else "body"
        rows.append([f"amplitude without control, {mass}", f"`{name}`", f"{value:.4g}", "m"])
    rows.append(["control interval", "`dt`", f"{scenario.dt * 1e3:g}", "ms"])
    rows.append(["RK4 steps in it", "`substeps`", str(scenario.substeps), ""])
    rows.append(["episode", "`duration`", f"{scenario.duration:g}", "s"])
    if scenario.randomisation is not None:
        for field in dataclasses.fields(scenario.randomisation):
            low, high = getattr(scenario.randomisation, field.name)
            if high > low:
                rows.append([f"drawn: {field.name}", "", f"{low:g} to {high:g} times", ""])
    return rows


def equations() -> str:
    """Return every statement of the library that bears an equation's number, with its address."""
    mark = re.compile(r"\s*(\((\d+)\)(?:(?: to |[-, ]+)\((\d+)\))*)")
    found: list[tuple[int, str]] = []
    for path in sorted((ROOT / "qcar_env").rglob("*.py")):
        module = path.relative_to(ROOT).with_suffix("").as_posix()
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        for number, line in enumerate(text.splitlines(), start=1):
            code, hash_, comment = line.partition("#")
            if not hash_ or not code.strip() or not (match := mark.match(comment)):
                continue
            address = f"_modules/{module}.html#line-{number}"
            shown = textwrap.shorten(_statement(tree, number, code), 110, placeholder=" ...")
            place = f'<a href="{address}">{module.split("/", 1)[1]}.py, {number}</a>'
            found.append((int(match[2]), f"| {match[1]} | `{shown}` | {place} |"))
    rows = [row for _, row in sorted(found, key=lambda each: each[0])]
    return "\n".join(["| equation | statement | file, line |", "|---|---|---|", *rows])


def _statement(tree: ast.Module, line: int, code: str) -> str:
    """Return the statement that ends on a line, or the line itself where none does."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Assign, ast.Return, ast.AnnAssign)) and node.end_lineno == line:
            return ast.unparse(node).replace("|", "\\|")
    return code.strip().replace("|", "\\|")


def tracks() -> str:
    """Return the benchmark's tracks."""
    rows = []
    for each in TRACKS.values():
        limits = ", ".join(f"{scale:g}" for scale in each.force_scales)
        rows.append(
            [
                f"`{each.name}`",
                f"{each.title} (version {each.version})",
                limits,
                each.observe,
                str(each.episodes),
                f"{each.duration:g} s",
            ]
        )
    return _table(["track", "what", "force limits", "shown", "crossings", "each"], rows)


def baselines() -> str:
    """Return the scripted policies with what they read."""
    rows = []
    tuned = {name for name, _, _ in catalogue.tuned()}
    for name in catalogue.everything():
        found = catalogue.describe(name)
        gains = ", ".join(
            f"{key} = {value:g}" for key, value in found["gains"].items() if value is not None
        )
        reads = "the state" if found["reads"] == "feedback" else "road and external force too"
        rows.append([f"`{name}`", gains or "-", reads, "yes" if name in tuned else "no"])
    return _table(["name", "published or designed gains", "reads", "tuned"], rows)


def agents() -> str:
    """Return the shipped agents with their results on the validation set."""
    rows = []
    for path in sorted((ROOT / "agents" / "pretrained").glob("*/recipe.json")):
        recipe = json.loads(path.read_text(encoding="utf-8"))
        limits = ", ".join(f"{scale:g}" for scale in recipe["force_scales"])
        size = path.with_name("policy.onnx").stat().st_size / 1024
        rows.append([f"`{path.parent.name}`", recipe["observe"], limits, f"{size:.0f} KiB"])
    if not rows:
        return "This version ships none; train one as above."
    return _table(["name", "reads", "force limits", "file"], rows)


def throughput() -> str:
    """Return the table of `make throughput`: of the machine that builds, or of the one kept."""
    from qcar_env.evaluation.throughput.result import table

    for path in (
        ROOT / "results" / "throughput" / "throughput.json",
        ROOT / "docs" / "_static" / "throughput.json",
    ):
        if path.exists():
            found = table(json.loads(path.read_text(encoding="utf-8")))
            return found if found.lstrip().startswith("|") else f"```text\n{found}\n```"
    return "The machine that built this page has not been measured."


def layers() -> str:
    """Return the import layers of pyproject.toml."""
    if (module := _toml()) is None:
        return ""
    config = module.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = config["tool"]["importlinter"]["contracts"]
    stacks = [each["layers"] for each in contracts if each["type"] == "layers"]
    lines = [re.sub(r"[()]", "", layer) for stack in stacks for layer in stack]
    return "```text\n" + "\n".join(lines) + "\n```"


def versions() -> str:
    """Return the versions that the tests run against."""
    wanted = ("gymnasium", "numpy", "scipy", "numba", "stable-baselines3", "torch", "onnxruntime")
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    rows = []
    for name in wanted:
        pins = re.findall(rf"^{re.escape(name)}==(\S+)", text, re.MULTILINE)
        rows.append([name, " or ".join(dict.fromkeys(pins))])
    return _table(["package", "tested version"], rows)


def commands() -> str:
    """Return the targets of the Makefile with what they do."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.findall(r"^([a-z-]+):.*?## (.*)$", text, re.MULTILINE)
    rows = [[f"`make {name}`", what] for name, what in found if _exists(name)]
    return _table(["command", "what it does"], rows)


def _exists(target: str) -> bool:
    """Whether this version has the script behind a target."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    needs = re.search(rf"^{target}: (scripts/\S+\.py)", text, re.MULTILINE)
    return needs is None or (ROOT / needs[1]).exists()


FACTS: dict[str, Callable[[], str]] = {
    each.__name__: each
    for each in (
        actions,
        agents,
        baselines,
        commands,
        environment,
        equations,
        laws,
        layers,
        observations,
        scenarios,
        throughput,
        tracks,
        versions,
    )
}


def insert(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the facts of a page."""
    source[0] = re.sub(r"^```\{fact\} (\w+)\n```$", _fact, source[0], flags=re.MULTILINE)


def _fact(found: re.Match[str]) -> str:
    if found[1] not in FACTS:
        raise ValueError(f"unknown fact {found[1]!r}; known: {', '.join(FACTS)}")
    return FACTS[found[1]]()


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _section(doc: str, title: str) -> str:
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\w+\n-+\n|\Z)", doc, re.MULTILINE | re.DOTALL)
    return found[1].strip() if found else ""


def _raised(unit: str) -> str:
    return unit.replace("^2", "²").replace("^3", "³")


def _toml() -> Any:
    for name in ("tomllib", "tomli"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so before a page is parsed."""
    app.connect("source-read", insert)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
