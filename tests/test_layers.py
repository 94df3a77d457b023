"""The import contracts of pyproject.toml hold, and each of them can fail."""

import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS = PYPROJECT["tool"]["setuptools"]["package-dir"]  # by the name of the package


def lint_imports(checkout: Path) -> subprocess.CompletedProcess[str]:
    """Run the contracts on packages that lie below one folder, as a wheel has them."""
    command = "from importlinter.cli import lint_imports; exit(lint_imports(no_cache=True))"
    return subprocess.run(
        [sys.executable, "-c", command],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout), "COLUMNS": "200", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
    )


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of the packages at the places of their names."""
    for name, folder in FOLDERS.items():
        shutil.copytree(
            ROOT / folder,
            tmp_path / name.replace(".", "/"),
            ignore=shutil.ignore_patterns("__pycache__"),
        )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_imports_go_down_only(checkout: Path):
    report = lint_imports(checkout)
    assert report.returncode == 0, report.stdout + report.stderr


@pytest.mark.parametrize(("name", "folder"), FOLDERS.items())
def test_the_installed_packages_are_those_of_this_checkout(name: str, folder: str):
    # an editable install of another checkout gives a mixture of both
    assert Path(import_module(name).__file__ or "").parent == ROOT / folder


def test_every_folder_of_the_library_is_a_package():
    # the contracts overlook a folder of modules that is none
    folders = {
        module.parent for folder in FOLDERS.values() for module in (ROOT / folder).rglob("*.py")
    }
    assert [folder for folder in folders if not (folder / "__init__.py").exists()] == []


@pytest.mark.parametrize(
    ("module", "line", "contract"),
    [
        ("qcar_env/physics/rk4.py", "import qcar_env.control", "Imports go down"),
        ("qcar_env/physics/rk4.py", "from qcar_env import scenarios", "Imports go down"),
        ("qcar_env/control/cnvc.py", "import qcar_env.scenarios", "Imports go down"),
        ("qcar_env/analysis/newton.py", "import qcar_env.analysis.paper.table1", "The paper's"),
        ("qcar_env/unplaced.py", "import math", "Imports go down"),
        ("qcar_env/control/cnvc.py", "import torch", "Only agents"),
        ("qcar_env/scenarios/scenario.py", "from stable_baselines3 import PPO", "Only agents"),
        ("qcar_env/physics/car.py", "import matplotlib.pyplot", "Only plots"),
        ("qcar_env/evaluation/grid.py", "import ray", "Only the files that go to a cluster"),
        ("qcar_env/agents/train.py", "import submitit", "Only the files that go to a cluster"),
        ("qcar_env/control/cnvc.py", "import pygame", "Only rendering"),
        (
            "qcar_env/control/cnvc.py",
            "from gymnasium import spaces",
            "Only envs",
        ),
        ("qcar_env/baselines/catalogue.py", "import torch", "Only agents"),
        ("qcar_env/commands/tune.py", "import torch", "Only agents"),
        (
            "qcar_env/baselines/catalogue.py",
            "import qcar_env.commands.compare",
            "Imports go down",
        ),
        ("qcar_env/baselines/catalogue.py", "from qcar_env import agents", "Imports go down"),
        ("qcar_env/agents/recipes.py", "from ..baselines import tune", "Imports go down"),
        ("qcar_env/report/page.py", "from qcar_env import baselines", "Imports go down"),
        ("qcar_env/__init__.py", "import qcar_env.baselines", "Whoever imports"),
        ("qcar_env/__init__.py", "from qcar_env.agents.load import load", "Whoever imports"),
        # an import inside a function counts
        ("qcar_env/physics/rk4.py", "def late():\n    import torch", "Only agents"),
    ],
)
def test_an_import_upwards_breaks_its_contract(
    checkout: Path, module: str, line: str, contract: str
):
    with (checkout / module).open("a", encoding="utf-8") as file:
        file.write(f"\n\n{line}\n")
    report = lint_imports(checkout)
    assert report.returncode == 1, report.stdout + report.stderr
    broken = [row for row in report.stdout.splitlines() if " BROKEN" in row]
    assert len(broken) == 1, report.stdout
    assert broken[0].startswith(contract)
