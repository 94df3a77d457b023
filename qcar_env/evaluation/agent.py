"""Policies from files: a bare ONNX file, and a trained agent, a folder with one and its recipe.

Both need onnxruntime, and onnx to see what is in a file, not torch.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import FEEDBACK_SIZE, FULL_SIZE, OBSERVE, Observe, observed


class OnnxPolicy:
    """A network with one input (n, k) and the actions (n, m) as its first output.

    Parameters
    ----------
    path : Path
        The file. It holds no code, so a file from elsewhere is safe to load.

    Raises
    ------
    ValueError
        If the file is absent or no policy, or its input has no size that an observation has.
    RuntimeError
        If onnxruntime or onnx is not installed.

    Notes
    -----
    The number of inputs says what the policy reads: 4 the state, 8 also road and external force,
    5 and 9 the same with the force limit.
    """

    def __init__(self, path: Path) -> None:
        try:
            runtime, onnx = map(importlib.import_module, ("onnxruntime", "onnx"))
        except ImportError:
            raise RuntimeError(
                "an ONNX policy needs onnxruntime and onnx: pip install 'qcar_env[run]'"
            ) from None
        if not path.is_file():
            raise ValueError(f"no file {path}; give the path of an ONNX file")
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1  # a small net is slower on two
        options.log_severity_level = 3
        content = path.read_bytes()
        try:
            model = onnx.load_model_from_string(content)
        except Exception as error:  # protobuf has two parsers, each with its own
            raise _damaged(path, error) from error
        _check_plain(path, model)
        try:
            self._session: Any = runtime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has no common class of its own
            raise _damaged(path, error) from error
        self._input = self._session.get_inputs()[0]
        sizes = {
            len(observed(observe, limit)): (observe, limit)
            for observe in OBSERVE
            for limit in (False, True)
        }
        size = self._input.shape[-1]
        if size not in sizes:
            raise ValueError(
                f"{path} must take an observation of {', '.join(map(str, sorted(sizes)))} entries, "
                f"got {size}"
            )
        self.name = path.stem if path.stem != "policy" else path.parent.name
        self.size = int(size)
        self.reads, self.observe_limit = sizes[size]

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], None]:
        """Return the actions (see `qcar_env.evaluation.policy.Policy`); nothing is remembered.

        A policy that reads the state takes a full observation too, whose first entries it is.

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), or has the wrong size.
        """
        try:
            seen = np.asarray(observation, dtype=np.float32)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"observation of {self.name} must be numbers (n, k) or (k,), got "
                f"{type(observation).__name__} ({error}); give what the environment returns"
            ) from None
        size = seen.shape[-1] if seen.ndim else 0
        wider = self.size == FEEDBACK_SIZE and size >= FULL_SIZE
        if seen.ndim not in (1, 2) or (size != self.size and not wider):
            raise ValueError(
                f"observation of {self.name} must have {self.size} entries, got shape "
                f"{seen.shape}; "
                f"make the environment with observe={self.reads!r}, "
                f"observe_limit={self.observe_limit}"
            )
        batch = np.ascontiguousarray(seen.reshape(-1, size)[:, : self.size])
        action = np.asarray(self._session.run(None, {self._input.name: batch})[0])
        size = -1 if action.size else action.shape[-1]
        return action.reshape(*seen.shape[:-1], size), None


def _damaged(path: Path, error: Exception) -> ValueError:
    return ValueError(
        f"{path} is not an ONNX policy, it may be cut off ({type(error).__name__}); "
        "export it again or fetch the file again"
    )


def _check_plain(path: Path, model: Any) -> None:
    """Refuse a network that can run for ever, or reads other files."""
    for part in _parts(model):
        kind = part.DESCRIPTOR.name
        if kind == "NodeProto" and part.op_type == "Loop":
            raise ValueError(
                f"{path} must be a network without a Loop, which could run for ever; export it "
                "unrolled"
            )
        if kind == "TensorProto" and (part.data_location or part.external_data):
            raise ValueError(
                f"{path} must hold its own weights, but they are in another file; save it with "
                "them: onnx.save(onnx.load(path), path, save_as_external_data=False)"
            )


def _parts(message: Any) -> Iterator[Any]:
    """Yield a message of protobuf and all that it is made of, whatever holds it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for each in (value,) if hasattr(value, "ListFields") else value:
                yield from _parts(each)


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
        If onnxruntime or onnx is not installed.
    """

    def __init__(self, folder: Path) -> None:
        self.recipe = read_recipe(folder)
        if not (folder / "policy.onnx").is_file():
            raise ValueError(
                f"no policy.onnx in {folder}: the training has not ended; resume it with "
                f"qcar train --resume {folder}"
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
