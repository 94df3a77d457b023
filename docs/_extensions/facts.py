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
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from qcar_env.baselines import catalogue, classical
from qcar_env.commands.main import COMMANDS
from qcar_env.control import LAWS
from qcar_env.envs.episode import FULL
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.comfort import WORDS
from qcar_env.evaluation.ride import MEASURES
from qcar_env.evaluation.tracks import TRACKS
from qcar_env.parts.part import Part, units
from qcar_env.physics.linear import modes
from qcar_env.physics.signals import SIGNALS, signal
from qcar_env.scenarios import SCENARIOS, Scenario
from qcar_env.scenarios.presets import ACTUATORS, CARS, HUMPS, SENSORS

ROOT = Path(__file__).parents[2]

TITLES = {  # of the coefficients of the paper's car
    "omega1": "wheel, body held",
    "omega2": "body, wheel held",
    "b1": "damping of the wheel",
    "b2": "damping of the body",
    "E1": "spring coupling on the wheel",
    "E2": "damper coupling on the wheel",
    "E3": "spring coupling on the body",
    "mu1": "tyre stiffness per wheel mass",
    "mu2": "tyre damping per wheel mass",
}


def environment() -> str:
    """Return the environment's class docstring, which is Markdown."""
    text = inspect.cleandoc(QuarterCarHumpEnv.__doc__ or "")
    # Two backquotes are how Sphinx writes code, and mean the same here.
    return re.sub(r"(?<!`)``(?!`)", "`", text)


def observations() -> str:
    """Return what one unit of each observation is in the named scenarios."""
    rows = []
    for scenario in SCENARIOS.values():
        ones = [scenario.reference.scale(signal(name), scenario) for name in FULL]
        rows.append([f"`{scenario.name}`", *(f"{one:.4g}" if one else "-" for one in ones)])
    header = [f"{name} [{_raised(SIGNALS[name].unit)}]" for name in FULL]
    return _table(["scenario", *header], rows)


def signals() -> str:
    """Return the table of signals."""
    rows = []
    for each in SIGNALS.values():
        cars = "with masses" if each.needs_masses else "all"
        rows.append([f"`{each.name}`", each.title, _raised(each.unit), cars])
    return _table(["name", "what", "unit", "cars"], rows)


def measures() -> str:
    """Return the measures of a ride."""
    rows = [[f"`{name}`", each.title, _raised(each.unit)] for name, each in MEASURES.items()]
    return _table(["name", "what", "unit"], rows)


def words() -> str:
    """Return what ISO 2631-1 calls a weighted root mean square."""
    rows = [
        [word, f"{low:g}", f"{high:g}" if high < float("inf") else ""]
        for word, (low, high) in WORDS.items()
    ]
    return _table(["annex C", "from [m/s²]", "to [m/s²]"], rows)


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


def presets() -> str:
    """Return the tables of cars, humps, actuators and sensors that have names."""
    cars = []
    for name, each in CARS.items():
        car = each.car
        damper = f"{car.damper.c:.5g}" if hasattr(car.damper, "c") else "table"
        numbers = (car.m2, car.m1, car.spring.k, car.tyre.k, car.tyre.c)
        m2, m1, k2, k1, c1 = (f"{number:.6g}" for number in numbers)
        load = f"{each.loads['laden']:g}"
        cars.append([f"`{name}`", each.title, m2, load, m1, k2, damper, k1, c1, each.source])
    units = ("m2 [kg]", "laden [kg]", "m1 [kg]", "k2 [N/m]", "c2 [N s/m]", "k1 [N/m]", "c1 [N s/m]")
    humps = [
        [f"`{name}`", each.title, f"{3.6 * each.speed:.3g} km/h", each.source]
        for name, each in HUMPS.items()
    ]
    equipment = [[f"`{name}`", text] for name, (text, _) in (*ACTUATORS.items(), *SENSORS.items())]
    return "\n\n".join(
        [
            _table(["car", "what", *units, "source"], cars),
            _table(["hump", "what", "made for", "source"], humps),
            _table(["actuator or sensors", "what"], equipment),
        ]
    )


def controllers() -> str:
    """Return the table of the controllers of real cars."""
    rows = []
    for name, each in classical.CLASSICAL.items():
        gains = ", ".join(
            f"`{gain}` = {'by the car' if value is None else f'{value:g}'}"
            for gain, value in each.gains.items()
        )
        acts = {None: "either", True: "damper", False: "actuator"}[each.valve]
        rows.append([f"`{name}`", each.title, acts, each.needs, gains or "none"])
    return _table(["name", "what", "acts through", "reads, designed on", "gains"], rows)


def _parameters(scenario: Scenario) -> list[list[str]]:
    rows: list[list[str]] = []
    for path, part in (("car", scenario.car), ("road", scenario.road)):
        rows.append([path, type(part).__name__, "", ""])
        rows += _numbers(part, path)
    rows.append(["speed", "`speed`", f"{scenario.speed:.5g}", "m/s"])
    if scenario.excitation.turning and scenario.excitation.omega:
        omega = f"{scenario.excitation.omega:.5g}"
        rows.append(["frequency of the road at that speed", "`omega`", omega, "rad/s"])
    if scenario.force.f:
        rows.append(["external force", "`force.f`", f"{scenario.force.f:g}", "m/s²"])
        rows.append(["its frequency", "`force.Omega`", f"{scenario.force.Omega:g}", "rad/s"])
    rows.append(["actuator", type(scenario.actuator).__name__, "", ""])
    places = ("wheel", "body") if scenario.actuator.size == 2 else ("between the masses",)
    for i, place in enumerate(places):
        limit, unit = scenario.actuator.limit[i], _raised(scenario.actuator.unit)
        rows.append([f"force limit, {place}", f"`actuator.limit.{i}`", f"{limit:g}", unit])
    if scenario.car.linear:
        for number, mode in enumerate(modes(scenario.car), start=1):
            shown = f"{mode.frequency:.4g} rad/s, damping ratio {mode.damping_ratio:.3g}"
            rows.append([f"mode {number}", "", shown, ""])
    for name, value in zip(("A1", "A2"), scenario.reference_amplitudes, strict=True):
        mass = "wheel" if name == "A1" else "body"
        rows.append([f"amplitude without control, {mass}", f"`{name}`", f"{value:.4g}", "m"])
    rows.append(["control interval", "`dt`", f"{scenario.dt * 1e3:g}", "ms"])
    rows.append(["RK4 steps in it", "`substeps`", str(scenario.substeps), ""])
    rows.append(["episode", "`duration`", f"{scenario.duration:g}", "s"])
    for each in scenario.randomisation:
        changed = ", ".join(
            f"`{path}`" + ("" if power == 1.0 else f" to the power {power:g}")
            for path, power in each.numbers.items()
        )
        drawn = ", ".join(f"{key} {value:g}" for key, value in dataclasses.asdict(each.by).items())
        rows.append(["drawn as a factor", changed, f"{type(each.by).__name__}: {drawn}", ""])
    return rows


def _numbers(part: Part, path: str) -> list[list[str]]:
    """Return the rows of a part's numbers, and of its own parts, by their paths."""
    rows: list[list[str]] = []
    unit = units(type(part))
    for field in dataclasses.fields(part):
        value, where = getattr(part, field.name), f"{path}.{field.name}"
        if isinstance(value, Part):
            rows.append([field.name, type(value).__name__, "", ""])
            rows += _numbers(value, where)
        elif field.name in unit:
            what = TITLES.get(field.name, field.metadata["title"]) if path == "car" else ""
            what = what or field.metadata["title"] or field.name
            rows.append([what, f"`{where}`", f"{value:.5g}", _raised(unit[field.name])])
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
    return _table(["track", "what", "force limits", "shown", "episodes", "each"], rows)


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
    """Return the table of `qcar throughput`: of the machine that builds, or of the one kept."""
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
    """Return the commands with what they do and the extras that they need."""
    rows = [
        [f"`qcar {name}`", each.title, ", ".join(each.needs) or "none", ", ".join(each.more)]
        for name, each in COMMANDS.items()
    ]
    return _table(["command", "what it does", "extras", "also"], rows)


def targets() -> str:
    """Return the targets of the Makefile that are no command of `qcar`."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    found = re.findall(r"^([a-z-]+):.*?## (.*)$", text, re.MULTILINE)
    rows = [[f"`make {name}`", what] for name, what in found if name not in COMMANDS]
    return _table(["target", "what it does"], rows)


FACTS: dict[str, Callable[[], str]] = {
    each.__name__: each
    for each in (
        actions,
        agents,
        baselines,
        commands,
        controllers,
        environment,
        equations,
        laws,
        layers,
        measures,
        observations,
        presets,
        scenarios,
        signals,
        targets,
        throughput,
        tracks,
        versions,
        words,
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
    return unit.replace("^1.75", "¹·⁷⁵").replace("^2", "²").replace("^3", "³")


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
