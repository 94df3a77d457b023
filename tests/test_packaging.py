"""What is shipped, and the versions it is tested with."""

import subprocess
import sys
from pathlib import Path
from shutil import copy, copytree, ignore_patterns
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
FOLDERS = PYPROJECT["tool"]["setuptools"]["package-dir"]  # by the name of the package
# `make test` installs the other extras, so no version of these has been tested.
UNTESTED_EXTRAS = {"cluster", "peers"}
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
