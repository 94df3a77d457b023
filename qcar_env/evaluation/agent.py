"""A trained agent: a folder with its policy and its recipe. Needs onnxruntime, not torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import Observe
from qcar_env.evaluation.onnx_policy import OnnxPolicy


class Agent:
    """A trained policy with the `predict` of Stable-Baselines3, and what is known of it.

    Parameters
    ----------
    folder : Path
        Holds ``policy.onnx`` and ``recipe.json``.

    Raises
    ------
    ValueError
        If a file is absent, cut off or not what its name says.
    RuntimeError
        If onnxruntime is not installed.
    """

    def __init__(self, folder: Path) -> None:
        self.recipe = read_recipe(folder)
        if not (folder / "policy.onnx").is_file():
            raise ValueError(
                f"no policy.onnx in {folder}: the training has not ended; resume it with "
                f"scripts/train.py --resume {folder}"
            )
        self._policy = OnnxPolicy(folder / "policy.onnx")
        self.name: str = self.recipe["name"]
        self.reads: Observe = self.recipe["observe"]
        self.observe_limit: bool = self.recipe["observe_limit"]
        self.force_scales: tuple[float, ...] = tuple(self.recipe["force_scales"])
        self.size = self._policy.size

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the actions, and no memory (see `OnnxPolicy.predict`).

        Observations are those of an environment with ``observe=agent.reads`` and
        ``observe_limit=agent.observe_limit``.
        """
        return self._policy.predict(observation)


def read_recipe(folder: Path) -> dict[str, Any]:
    """Return the recipe in an agent's folder (errors: `Agent`)."""
    path = folder / "recipe.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        missing = {"name", "observe", "observe_limit", "force_scales"} - set(found)
    except FileNotFoundError:
        raise ValueError(f"no recipe.json in {folder}; is it a run folder?") from None
    except (json.JSONDecodeError, TypeError) as error:
        raise ValueError(f"{path} is damaged: {error}; restore it") from None
    if missing:
        raise ValueError(f"{path} lacks {', '.join(sorted(missing))}; restore it")
    return found
