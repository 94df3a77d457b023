"""What the documentation says works: code runs, commands parse, links lead somewhere."""

from __future__ import annotations

import argparse
import contextlib
import html
import inspect
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from qcar_env.commands.main import COMMANDS, main as qcar
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.vector import QuarterCarHumpVectorEnv

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
PAGES = sorted(
    page
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"))
    if page.name != "CHANGELOG.md"
)
SHELL = ("sh", "bash", "")
FENCE = re.compile(r"^ *```\{?([\w-]*)\}?[^\n]*\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
SHORT = 300  # [steps] longest training in a test


def blocks(text: str) -> list[tuple[str, str]]:
    """Return language and content of every fenced block."""
    return [(language, content) for language, content in FENCE.findall(text)]


def commands(text: str) -> list[str]:
    """Return the commands of the shell blocks, continued lines joined, comments left out."""
    found: list[str] = []
    for language, content in blocks(text):
        if language in SHELL:
            for line in content.replace("\\\n", " ").splitlines():
                command = line.split("  #")[0].strip()
                if command and not command.startswith("#"):
                    found.append(command)
    return found


def prose(tutorial: Path) -> str:
    """Return the text of a tutorial's comments, in which its fenced blocks stand."""
    text = tutorial.read_text(encoding="utf-8")
    return "\n".join(re.findall(r"^# ?(.*)$", text, re.MULTILINE))


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.fixture
def short_training(monkeypatch):
    """Let `learn` end early: the tests of the agents train in earnest."""
    on = pytest.importorskip("stable_baselines3.common.on_policy_algorithm").OnPolicyAlgorithm
    off = pytest.importorskip("stable_baselines3.common.off_policy_algorithm").OffPolicyAlgorithm
    for kind in (on, off):

        def learn(self, total_timesteps, *args, _learn=kind.learn, **options):
            return _learn(self, min(total_timesteps, SHORT), *args, **options)

        monkeypatch.setattr(kind, "learn", learn)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_python_of_a_page_runs(page, tmp_path, monkeypatch, short_training):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    with mpl.rc_context({"backend": "agg"}):
        for number, (language, content) in enumerate(blocks(page.read_text(encoding="utf-8"))):
            if language == "python":
                code = compile(inspect.cleandoc(content), f"{page.name}, block {number}", "exec")
                exec(code, names)


def test_the_python_of_the_environments_docstring_runs():
    names: dict[str, object] = {}
    found = [code for language, code in blocks(QuarterCarHumpEnv.__doc__) if language == "python"]
    assert found
    for code in found:
        exec(inspect.cleandoc(code), names)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_commands_of_a_page_exist_and_take_their_flags(page, monkeypatch):
    for command in commands(page.read_text(encoding="utf-8")):
        check(command, monkeypatch)


def check(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    words = shlex.split(command)
    if words[0] == "make":
        check_make(words[1:], monkeypatch)
    elif words[0] == "qcar":
        check_qcar(words[1:], monkeypatch)
    elif words[0].endswith("python") and words[1].startswith("docs/tutorials/"):
        assert ROOT / words[1] in TUTORIALS
    elif "pip" in words[:3]:
        extras = re.findall(r"\[([\w,]+)\]", command)
        known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
        for extra in ",".join(extras).split(",") if extras else []:
            assert extra in known["project"]["optional-dependencies"], command
    else:
        raise AssertionError(f"what is {command!r}? show it in another kind of block, or test it")


def check_make(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    arguments = dict(word.split("=", 1) for word in words if "=" in word)
    for target in (word for word in words if "=" not in word):
        rule = re.search(rf"^{target}:(.*)$", makefile, re.MULTILINE)
        assert rule, f"make {target}"
        if target in COMMANDS:
            check_qcar([target, *shlex.split(arguments.get("ARGS", ""))], monkeypatch)


class ParsedError(Exception):
    """The arguments were understood."""


def check_qcar(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    parse = argparse.ArgumentParser.parse_args

    def parse_and_stop(self, args=None, namespace=None):
        parse(self, args, namespace)
        raise ParsedError

    with monkeypatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", parse_and_stop)
        if "--help" in words[1:]:
            with pytest.raises(SystemExit) as left, contextlib.redirect_stdout(None):
                qcar(words)
            assert left.value.code == 0
        elif words == ["--help"]:
            assert qcar(words) == 0
        else:
            with pytest.raises(ParsedError):
                qcar(words)


def test_single_precision_departs_by_what_the_page_on_performance_says():
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    stated = re.search(r"precision by (\S+) to (\S+) of its amplitudes", page)
    envs = [QuarterCarHumpVectorEnv(64, precision=each) for each in ("double", "single")]
    rng, furthest = np.random.default_rng(0), 0.0
    for each in envs:
        each.reset(seed=1)
    for _ in range(999):
        action = rng.uniform(-1.0, 1.0, (64, 2)).astype(np.float32)
        double, single = (each.step(action)[0][:, :4].astype(float) for each in envs)
        furthest = max(furthest, np.abs(double - single).max())
    assert float(stated[1]) < furthest < float(stated[2])


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=name_of)
def test_a_tutorial_runs_in_its_short_form(tutorial, tmp_path):
    subprocess.run(
        [sys.executable, "-W", "error", str(tutorial), "--short"],
        check=True,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
        stdout=subprocess.DEVNULL,
        timeout=300,
    )


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=name_of)
def test_the_blocks_in_the_text_of_a_tutorial_are_code(tutorial, monkeypatch):
    text = prose(tutorial)
    for number, (language, content) in enumerate(blocks(text)):
        if language == "python":
            compile(content, f"{tutorial.name}, block {number}", "exec")
    for command in commands(text):
        check(command, monkeypatch)


def test_every_tutorial_is_listed():
    index = (ROOT / "docs" / "tutorials" / "index.md").read_text(encoding="utf-8")
    listed = re.search(r"```\{toctree\}(.*?)```", index, re.DOTALL)[1].split()
    assert sorted(each.stem for each in TUTORIALS) == sorted(
        word for word in listed if not word.startswith(":") and not word.isdigit()
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built as `make docs` does: a warning is an error."""
    out = tmp_path_factory.mktemp("site")
    build = subprocess.run(
        [
            *(sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", "-b", "html"),
            *("-d", str(out / "trees"), str(ROOT / "docs"), str(out / "html")),
        ],
        capture_output=True,
        text=True,
    )
    assert build.returncode == 0, build.stderr
    return out / "html"


@pytest.mark.slow
def test_every_link_within_the_site_leads_somewhere(site):
    pages = {
        page.relative_to(site).as_posix(): page.read_text(encoding="utf-8")
        for page in site.rglob("*.html")
    }
    ids = {name: set(re.findall(r'\bid="([^"]+)"', text)) for name, text in pages.items()}
    broken = []
    for name, text in pages.items():
        for link in re.findall(r'href="([^"]+)"', text):
            address, _, anchor = html.unescape(link).partition("#")
            if re.match(r"[a-z]+:", address) or "?" in address:
                continue
            target = os.path.normpath(Path(name).parent / address) if address else name
            if not (site / target).exists():
                broken.append((name, link))
            elif anchor and target in ids and anchor not in ids[target]:
                broken.append((name, link))
    assert not broken


@pytest.mark.slow
def test_the_links_of_equations_lead_to_their_lines(site):
    text = (site / "model.html").read_text(encoding="utf-8")
    links = re.findall(r'href="_modules/(qcar_env/\S+?)\.html#line-(\d+)"', text)
    assert len(links) > 5
    for module, number in links:
        lines = (ROOT / f"{module}.py").read_text(encoding="utf-8").splitlines()
        assert re.search(r"# \(\d+\)", lines[int(number) - 1])
        source = (site / "_modules" / f"{module}.html").read_text(encoding="utf-8")
        shown = re.split(r'<span class="source-line" id="line-\d+"></span>', source)[int(number)]
        plain = html.unescape(re.sub(r"<[^>]+>", "", shown)).splitlines()[0]
        assert plain.strip() == lines[int(number) - 1].strip()


@pytest.mark.slow
def test_facts_stand_in_the_site_as_they_are_in_the_code(site):
    from qcar_env.scenarios import SCENARIOS
    from qcar_env.scenarios.presets import CARS, HUMPS

    scenarios = (site / "scenarios.html").read_text(encoding="utf-8")
    environment = (site / "environment.html").read_text(encoding="utf-8")
    for name, each in SCENARIOS.items():
        assert f">{name}<" in scenarios
        assert html.escape(each.source, quote=False)[:40] in scenarios
        assert f"{each.actuator.limit[0]:g} " in environment
    for name, each in {**CARS, **HUMPS}.items():
        assert f">{name}<" in scenarios
        assert html.escape(each.source, quote=False)[:40] in scenarios
    assert "{fact}" not in scenarios + environment
    assert "<math" in (site / "model.html").read_text(encoding="utf-8")
