"""Ship the best of several seeds: chosen on the validation set, reported on the held-out one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qcar_env.agents.recipes import RECIPES
from qcar_env.agents.scoring import score_all
from qcar_env.evaluation.agent import Agent
from qcar_env.evaluation.storage import write_json
from qcar_env.validation import known

LARGEST = 1_000_000  # bytes of a shipped file
FILES = ("policy.onnx", "recipe.json", "command.txt", "versions.json")


def check_unpublished(name: str, into: Path, *, force: bool = False) -> None:
    """Raise ValueError where there is an agent of this name and `force` is not given."""
    if (into / name).exists() and not force:
        raise ValueError(f"there is an agent {name} in {into}; replace it with --force")


def publish(folders: Sequence[Path], into: Path, *, force: bool = False) -> Path:
    """Copy the best of several runs of one recipe, with the results of all of them.

    Parameters
    ----------
    folders : sequence of Path
        Run folders of one recipe with different seeds.
    into : Path
        Where the agent's folder is made.
    force : bool
        Replace an agent of this name.

    Returns
    -------
    Path
        The agent's folder.

    Raises
    ------
    ValueError
        If the folders are not finished runs of one recipe, a file is too large, or there is an
        agent of this name and `force` is not given.
    """
    policies = [Agent(folder) for folder in folders]
    names = {each.name for each in policies}
    if len(names) != 1:
        raise ValueError(f"runs must be of one recipe, got {', '.join(sorted(names)) or 'none'}")
    name = names.pop()
    recipe = RECIPES[known("recipe", name, RECIPES)]
    out = into / name
    check_unpublished(name, into, force=force)
    for folder in folders:
        size = (folder / "policy.onnx").stat().st_size
        if size > LARGEST:
            raise ValueError(f"{folder}/policy.onnx must be below {LARGEST} bytes, got {size}")
    seeds: list[dict[str, Any]] = []
    for folder, policy in zip(folders, policies, strict=True):
        run = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        seeds.append({**run, "held_out": score_all(policy, recipe, "held-out")})
    worth = [np.mean([each["rho"] for each in run["validation"].values()]) for run in seeds]
    best = int(np.argmin(worth))
    out.mkdir(parents=True, exist_ok=True)
    for file in FILES:
        shutil.copyfile(folders[best] / file, out / file)
    write_json(
        out / "result.json",
        {
            "name": name,
            "shipped_seed": seeds[best]["seed"],
            "chosen_by": "least mean rho on the track's validation set",
            "track": {"name": recipe.track.name, "version": recipe.track.version},
            "held_out": seeds[best]["held_out"],
            "median_held_out_rho": {
                scale: float(np.median([run["held_out"][scale]["rho"] for run in seeds]))
                for scale in seeds[best]["held_out"]
            },
            "seeds": seeds,
        },
    )
    return out
