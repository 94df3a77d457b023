"""Load a trained agent: by name, or from a run folder. Needs onnxruntime, not torch.

from agents.load import load
policy = load("sac-paper")
action, _ = policy.predict(observation)
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.task import Observe
from qcar_env.evaluation.onnx_policy import OnnxPolicy
from qcar_env.validation import known

PRETRAINED = Path(__file__).parent / "pretrained"


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
        self.recipe = _recipe(folder)
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
        """Return the actions, and no memory (see `qcar_env.evaluation.policy.Policy`).

        Parameters
        ----------
        observation : ndarray (n, k) or (k,)
            As the environment gives them with ``observe=agent.reads`` and
            ``observe_limit=agent.observe_limit``; an agent that reads the state takes a full
            observation too.
        state, episode_start, deterministic
            Without effect: the policy has no memory and does not draw.

        Returns
        -------
        actions : ndarray (n, m) or (m,) float32
            Force over its limit.
        state : None

        Raises
        ------
        ValueError
            If the observation has the wrong size.
        """
        return self._policy.predict(observation)


def names() -> tuple[str, ...]:
    """Return the names of the agents that are shipped."""
    return tuple(sorted(each.parent.name for each in PRETRAINED.glob("*/policy.onnx")))


def load(agent: str | Path) -> Agent:
    """Load a trained agent.

    Parameters
    ----------
    agent : str or Path
        A name, such as ``sac-paper`` (see `names`), or a folder with ``policy.onnx`` and
        ``recipe.json``: a run folder of ``scripts/train.py``.

    Returns
    -------
    Agent

    Raises
    ------
    ValueError
        If there is no such agent (the message lists those that there are), or its files are
        damaged.
    """
    if not isinstance(agent, (str, Path)):
        raise ValueError(
            f"agent must be a name or a folder, got {agent!r}; give a run folder or one of: "
            f"{', '.join(names())}"
        )
    folder = Path(agent)
    if isinstance(agent, str) and not folder.is_dir():
        if folder.parent != Path("."):
            raise ValueError(
                f"no folder {agent}; give a run folder or one of: {', '.join(names())}"
            )
        return Agent(PRETRAINED / known("agent", agent, names()))
    return Agent(folder)


def _recipe(folder: Path) -> dict[str, Any]:
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
