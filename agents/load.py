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

from qcar_env.envs.task import FULL_SIZE, Observe
from qcar_env.physics.validation import known

PRETRAINED = Path(__file__).parent / "pretrained"


class OnnxPolicy:
    """A trained policy with the `predict` of Stable-Baselines3.

    Parameters
    ----------
    folder : Path
        Holds ``policy.onnx`` and ``recipe.json``.

    Raises
    ------
    ValueError
        If a file is absent, cut off or not what its name says.
    """

    def __init__(self, folder: Path) -> None:
        import onnxruntime  # only those who load an agent need it

        self.recipe = _recipe(folder)
        self.name: str = self.recipe["name"]
        self.observe: Observe = self.recipe["observe"]
        self.reads: Observe = self.observe
        self.observe_limit: bool = self.recipe["observe_limit"]
        self.force_scales: tuple[float, ...] = tuple(self.recipe["force_scales"])
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # a net this small is slower on two
        options.log_severity_level = 3
        path = folder / "policy.onnx"
        try:
            self._session = onnxruntime.InferenceSession(
                path.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except FileNotFoundError:
            raise ValueError(
                f"no policy.onnx in {folder}: the training has not ended; resume it with "
                f"scripts/train.py --resume {folder}"
            ) from None
        except Exception as error:
            raise ValueError(
                f"{path} is not a policy, it may be cut off ({type(error).__name__}); "
                "export it again or fetch the file again"
            ) from error
        self.size: int = self._session.get_inputs()[0].shape[1]

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the actions, and no memory.

        Parameters
        ----------
        observation : ndarray (n, k) or (k,)
            As the environment gives them with ``observe=policy.observe`` and
            ``observe_limit=policy.observe_limit``. A policy for ``feedback`` reads the first four
            entries of a full observation.
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
        seen = np.asarray(observation, dtype=np.float32)
        size = seen.shape[-1] if seen.ndim else 0
        if seen.ndim not in (1, 2) or (size != self.size and not self._contains(size)):
            raise ValueError(
                f"observation of {self.name} must have {self.size} entries, got shape "
                f"{seen.shape}; make the environment with observe={self.observe!r}, "
                f"observe_limit={self.observe_limit}"
            )
        batch = seen.reshape(-1, size)[:, : self.size]
        action = self._session.run(None, {"observation": np.ascontiguousarray(batch)})[0]
        return action.reshape(*seen.shape[:-1], -1), None

    def _contains(self, size: int) -> bool:
        """Return whether the first entries of an observation of `size` are what is read."""
        return not self.observe_limit and self.size < size and size >= FULL_SIZE


def names() -> tuple[str, ...]:
    """Return the names of the agents that are shipped."""
    return tuple(sorted(each.parent.name for each in PRETRAINED.glob("*/policy.onnx")))


def load(agent: str | Path) -> OnnxPolicy:
    """Load a trained agent.

    Parameters
    ----------
    agent : str or Path
        A name, such as ``sac-paper`` (see `names`), or a folder with ``policy.onnx`` and
        ``recipe.json``: a run folder of ``scripts/train.py``.

    Returns
    -------
    OnnxPolicy

    Raises
    ------
    ValueError
        If there is no such agent (the message lists those that there are), or its files are
        damaged.
    """
    folder = Path(agent)
    if isinstance(agent, str) and not folder.is_dir():
        if folder.parent != Path("."):
            raise ValueError(
                f"no folder {agent}; give a run folder or one of: {', '.join(names())}"
            )
        return OnnxPolicy(PRETRAINED / known("agent", agent, names()))
    return OnnxPolicy(folder)


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
