"""What is shipped, and the versions it is tested with."""

import os
import re
import subprocess
import sys
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution, requires
from pathlib import Path
from shutil import copy, copytree, ignore_patterns
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from qcar_env.agents import load
from qcar_env.scenarios import files, scenario

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
FOLDERS = PYPROJECT["tool"]["setuptools"]["package-dir"]  # by the name of the package
# `make test` installs the other extras, so no version of these has been tested.
UNTESTED_EXTRAS = {"peers"}
PYTHONS = ["3.10", "3.11", "3.12", "3.13"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> ZipFile:
    """Build the wheel from a copy, with the setuptools installed here."""
    source = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        copy(ROOT / name, source)
    for folder in FOLDERS.values():
        copytree(ROOT / folder, source / folder, ignore=ignore_patterns("__pycache__"))
    build = "import setuptools.build_meta as b; print(b.build_wheel('.'))"
    report = subprocess.run(
        [sys.executable, "-c", build], cwd=source, capture_output=True, text=True
    )
    assert report.returncode == 0, report.stderr
    return ZipFile(source / report.stdout.splitlines()[-1])


def test_the_wheel_holds_qcar_env_alone(wheel: ZipFile):
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert tops == {"qcar_env", f"qcar_env-{PROJECT['version']}.dist-info"}


def test_the_wheel_holds_every_module_and_every_file_that_they_read(wheel: ZipFile):
    wanted = {
        f"{name.replace('.', '/')}/{path.relative_to(ROOT / folder).as_posix()}"
        for name, folder in FOLDERS.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and path.parent.name != "__pycache__"
    }
    held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert held == wanted


def test_the_wheel_carries_the_licence(wheel: ZipFile):
    assert any(name.endswith("/licenses/LICENSE") for name in wheel.namelist())


def needed(package: str, extras: frozenset[str]) -> Iterator[Distribution]:
    """Give the installed packages that one needs, and what those need; some more than once."""
    for requirement in map(Requirement, requires(package) or ()):
        where = [{"extra": extra} for extra in extras or ("",)]
        if requirement.marker is None or any(map(requirement.marker.evaluate, where)):
            yield distribution(requirement.name)
            yield from needed(requirement.name, frozenset(requirement.extras))


def fresh(folder: Path, wheel: ZipFile, *extras: str) -> Path:
    """Make a virtual environment of the wheel and what its extras bring, without a network."""
    venv.create(folder, with_pip=True)
    python = folder / "bin" / "python"
    install = ("-m", "pip", "install", "-q", "--no-index", "--no-deps", str(wheel.filename))
    subprocess.run([python, *install], check=True)
    (site,) = folder.glob("lib/*/site-packages")
    for each in needed(PROJECT["name"], frozenset(extras)):
        for top in {path.parts[0] for path in each.files or ()} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(str(each.locate_file(top)))
    return folder / "bin"


def run(program: Path, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a program of an environment outside any checkout."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return subprocess.run([program, *words], cwd=cwd, env=plain, capture_output=True, text=True)


@pytest.fixture
def work(tmp_path: Path) -> Path:
    (tmp_path / "work").mkdir()
    return tmp_path / "work"


@pytest.mark.slow
def test_without_extras_the_wheel_has_laws_and_help(wheel: ZipFile, tmp_path: Path, work: Path):
    programs = fresh(tmp_path / "environment", wheel)
    code = (
        "from qcar_env.baselines import catalogue; from qcar_env.agents import load; "
        "print(catalogue.make('cnvc', 'paper').name, *load.names())"
    )
    found = run(programs / "python", "-c", code, cwd=work)
    assert found.stdout.split() == ["CNVC", *load.names()], found.stderr
    assert "compare" in run(programs / "qcar", "--help", cwd=work).stdout
    refused = run(programs / "qcar", "compare", cwd=work)
    assert refused.returncode == 2
    assert refused.stderr == (
        'compare: needs matplotlib, not installed; pip install "qcar_env[plots]"\n'
    )
    assert not list(work.iterdir())


WORDS = {  # commands, with a file that each makes
    "compare --scenario mine.toml --laws none": "results/compare/table.csv",
    "report --laws none cnvc --duration 2": "results/compare/report.html",
    "watch --policy ppo-paper --duration 0.2 --size 320 240": "results/watch/*.mp4",
    "benchmark --policy my_policy:Bang --tracks paper --baselines cnvc --jobs 2": (
        "results/benchmark/leaderboard.md"
    ),
}


@pytest.mark.slow
def test_with_extras_the_wheel_does_what_the_readme_says(
    wheel: ZipFile, tmp_path: Path, work: Path
):
    """In one test, since an environment compiles its kernels only once."""
    extras = ("plots", "run", "mpc", "render", "report", "headroom")
    programs = fresh(tmp_path / "environment", wheel, *extras)
    (home,) = programs.parent.glob("lib/*/site-packages/qcar_env")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    found = run(programs / "python", "-W", "error", "-c", "\n".join(blocks), cwd=work)
    assert found.returncode == 0, found.stderr
    (bang,) = [each for each in blocks if "class Bang" in each]
    (work / "my_policy.py").write_text(bang, encoding="utf-8")
    files.write(scenario("mathworks-hump"), work / "mine.toml")
    for words, made in WORDS.items():
        found = run(programs / "qcar", *words.split(), cwd=work)
        assert found.returncode == 0, found.stderr
        assert list(work.glob(made)), words
    there = {path for path in home.rglob("*") if path.is_file()}
    new = there - {home.parent / name for name in wheel.namelist()}
    assert {path.parent.name for path in new} <= {"__pycache__"}  # of Python and numba


def requirements() -> list[Requirement]:
    extras = PROJECT["optional-dependencies"]
    tested = [line for extra in extras.keys() - UNTESTED_EXTRAS for line in extras[extra]]
    parsed = [Requirement(line) for line in [*PROJECT["dependencies"], *tested]]
    return [one for one in parsed if one.name != PROJECT["name"]]


def pins(python: str) -> dict[str, str]:
    """Give the version of each package that constraints.txt allows on a Python."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    versions: dict[str, str] = {}
    for pin in (Requirement(line) for line in lines if not line.startswith("#")):
        if pin.marker is None or pin.marker.evaluate({"python_version": python}):
            (specifier,) = pin.specifier
            assert specifier.operator == "=="
            assert canonicalize_name(pin.name) not in versions, f"{pin.name} has two versions"
            versions[canonicalize_name(pin.name)] = specifier.version
    return versions


@pytest.mark.parametrize("python", PYTHONS)
def test_constraints_hold_a_version_that_pyproject_allows(python: str):
    versions = pins(python)
    for needed in requirements():
        if needed.marker is None or needed.marker.evaluate({"python_version": python}):
            version = versions.get(canonicalize_name(needed.name))
            assert version is not None, f"constraints.txt has no {needed.name}"
            assert needed.specifier.contains(version), f"{needed} excludes {version}"


@pytest.mark.parametrize("python", ["3.9", *PYTHONS, "3.14"])
def test_the_supported_pythons_are_the_classified_ones(python: str):
    allowed = Requirement(f"python{PROJECT['requires-python']}").specifier.contains(python)
    classified = f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    assert allowed == classified == (python in PYTHONS)


def test_the_citation_names_this_version():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {PROJECT['version']}" in citation
