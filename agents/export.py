"""Export of a trained policy to ONNX: raw observation in, action out, scaling inside."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import nn

from qcar_env.evaluation.storage import replacing

CHECKED = 10_000  # observations on which the export is compared with the original
TOLERANCE = 1e-5  # [-] largest difference of an action


def export(actor: nn.Module, observation_size: int, path: Path) -> None:
    """Write an actor as ONNX.

    Parameters
    ----------
    actor : torch.nn.Module
        Raw observations (n, k) to actions (n, m).
    observation_size : int
        k.
    path : Path
        The file, written whole or not at all. Weights lie inside.
    """
    example = torch.zeros(2, observation_size)
    quiet = logging.getLogger("torch.onnx")
    level = quiet.level
    quiet.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")  # the exporter's own deprecations
            program: Any = torch.onnx.export(
                actor.eval(),
                (example,),
                dynamo=True,
                dynamic_shapes=({0: torch.export.Dim("cars")},),
                input_names=["observation"],
                output_names=["action"],
                verbose=False,
            )
        with replacing(path) as temporary:
            onnx.save(without_origin(program.model_proto), str(temporary))
    finally:
        quiet.setLevel(level)


def without_origin(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return `model` without the exporter's notes, which hold stack traces and paths."""
    plain = onnx.ModelProto()
    plain.CopyFrom(model)
    graph = plain.graph
    for part in (plain, graph, *graph.node, *graph.value_info, *graph.input, *graph.output):
        del part.metadata_props[:]
    for node in graph.node:
        node.doc_string = ""
    return plain


def largest_difference(actor: nn.Module, path: Path, observation_size: int, seed: int = 0) -> float:
    """Return the largest difference of actions between an actor and its export [-].

    Half of the `CHECKED` observations are of order one, half ten to a thousand times smaller,
    where a policy that removes vibration spends its time.
    """
    import onnxruntime

    rng = np.random.default_rng(seed)
    seen = rng.standard_normal((CHECKED, observation_size))
    seen[::2, :4] *= 10.0 ** rng.uniform(-3.0, -1.0, (len(seen[::2]), 1))
    if observation_size % 4 == 1:
        seen[:, -1] = rng.uniform(0.1, 1.0, CHECKED)
    batch = seen.astype(np.float32)
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    exported = session.run(None, {"observation": batch})[0]
    with torch.no_grad():
        original = actor(torch.as_tensor(batch)).numpy()
    return float(np.max(np.abs(exported - original)))


def export_checked(actor: nn.Module, observation_size: int, path: Path) -> None:
    """Write an actor as ONNX and compare the two.

    Raises
    ------
    RuntimeError
        If they differ by more than `TOLERANCE`; the file is removed.
    """
    export(actor, observation_size, path)
    found = largest_difference(actor, path, observation_size)
    if not found <= TOLERANCE:
        path.unlink()
        raise RuntimeError(
            f"the exported policy differs by {found:.2g} from the original, more than "
            f"{TOLERANCE:g}; do the weights hold numbers that are not finite, or gains above 1e4?"
        )
