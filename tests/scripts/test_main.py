"""The command line `qcar`: it lists every command, imports one, and says what is missing."""

import importlib.metadata
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from qcar_env.commands import command
from qcar_env.commands.main import COMMANDS, main

ROOT = Path(__file__).parents[2]
OWN = """
from qcar_env.scenarios import scenario
mine = scenario("mathworks-hump")
number = 3
def made():
    return mine
def fails():
    raise OSError("no disk")
"""


def modules():
    return {each.module or name for name, each in COMMANDS.items()}


def test_every_command_has_its_name_in_the_table():
    files = {path.stem for path in (ROOT / "scripts").glob("*.py")}
    assert modules() == files - {"__init__", "command", "main"}


def test_make_has_every_command():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name in COMMANDS:
        rule = re.search(rf"^{name}:.*##.*\n\t(.*)$", makefile, re.MULTILINE)
        assert rule, name
        assert rule[1].startswith("$(QCAR) $@")


def test_help_lists_every_command_in_a_line_with_its_extras(capsys):
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, each in COMMANDS.items():
        (line,) = [line for line in lines if line.startswith(f"  {name} ")]
        assert each.title in line
        assert f"[{', '.join(each.needs) or 'none'}" in line


def test_the_extras_are_those_of_the_package():
    extras = set(importlib.metadata.metadata("qcar_env").get_all("Provides-Extra"))
    for each in COMMANDS.values():
        assert extras.issuperset((*each.needs, *each.more))


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.split()[1] == importlib.metadata.version("qcar_env")


def test_an_unknown_command_is_refused_in_a_line(capsys):
    assert main(["comprae"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("qcar: unknown command 'comprae'; did you mean 'compare'?")
    assert said.count("\n") == 1


def without(monkeypatch, *packages):
    """Let these packages seem not to be installed, and all others seem so."""
    monkeypatch.setattr("qcar_env.commands.main._installed", lambda name: name not in packages)


@pytest.mark.parametrize(
    ("name", "package", "extra"),
    [
        ("compare", "matplotlib", "plots"),
        ("report", "plotly", "report"),
        ("watch", "pygame", "render"),
        ("train", "torch", "train"),
        ("learning-report", "torch", "train"),
        ("train", "onnxruntime", "run"),
    ],
)
def test_a_command_says_which_extra_it_lacks(name, package, extra, tmp_path, monkeypatch, capsys):
    without(monkeypatch, package)
    monkeypatch.chdir(tmp_path)
    assert main([name]) == 2
    printed, said = capsys.readouterr()
    assert said == f'{name}: needs {package}, not installed; pip install "qcar_env[{extra}]"\n'
    assert printed == ""
    assert not list(tmp_path.iterdir())


def test_agents_that_are_left_out_are_told(tmp_path, monkeypatch, capsys):
    without(monkeypatch, "onnxruntime")
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "--out", "a" * 300]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0] == '... without the shipped agents, which need pip install "qcar_env[run]"'


BLOCKED = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[1].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from qcar_env.commands.main import main
sys.exit(main(sys.argv[2:]))
"""


def blocked(packages, *words):
    """Run `qcar` where an import of these packages fails."""
    return subprocess.run(
        [sys.executable, "-c", BLOCKED, ",".join(packages), *words], capture_output=True, text=True
    )


def test_help_needs_none_of_the_extras():
    heavy = ("torch", "stable_baselines3", "matplotlib", "plotly", "pygame", "numba")
    found = blocked(heavy, "--help")
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_needs_no_torch(name):
    found = blocked(("torch", "stable_baselines3", "sb3_contrib", "cma"), name, "--help")
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith(f"usage: qcar {COMMANDS[name].module or name}".replace("_", "-"))


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with a scenario of one's own, as the current one."""
    (tmp_path / "own_scenario.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    sys.modules.pop("own_scenario", None)


def test_a_scenario_of_ones_own_is_compared(own, capsys):
    given = ["--laws", "none", "--duration", "1"]
    assert main(["compare", "--scenario", "own_scenario:made", *given, "--out", "one"]) == 0
    assert main(["compare", "--scenario", "mathworks-hump", *given, "--out", "two"]) == 0
    assert (own / "one" / "table.csv").read_bytes() == (own / "two" / "table.csv").read_bytes()


@pytest.mark.parametrize("name", [name for name in COMMANDS if name in ("compare", "watch")])
@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("papre", "did you mean 'paper'?"),
        ("papre", "or give a TOML or JSON file, or module:object"),
        ("nowhere.toml", "nowhere.toml: "),
        ("nowhere:mine", "no scenario 'nowhere:mine': ModuleNotFoundError"),
        ("own_scenario:nothing", "no scenario 'own_scenario:nothing': AttributeError"),
        ("own_scenario:number", "'own_scenario:number' is no scenario, but 3; give a Scenario"),
        ("own_scenario:fails", "no scenario 'own_scenario:fails': OSError: no disk; give a Sc"),
    ],
)
def test_what_names_no_scenario_is_refused_in_a_line(name, spec, words, own, capsys):
    assert main([name, "--scenario", spec]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_takes_a_scenario_takes_all_of_its_forms(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "1000")
    with pytest.raises(SystemExit):
        main([name, "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert ("--scenario" in shown) == (command.SCENARIO in shown)


@pytest.mark.parametrize("module", sorted(modules()))
def test_a_command_runs_as_a_file_as_well(module, monkeypatch, capsys):
    """It did nothing, without a word."""
    monkeypatch.setattr(sys, "argv", [f"scripts/{module}.py", "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(ROOT / "scripts" / f"{module}.py"), run_name="__main__")
    assert end.value.code in (0, None)
    assert capsys.readouterr().out.startswith("usage: qcar ")
