"""The shipped agents, by name. Needs onnxruntime and onnx, not torch.

from qcar_env.agents.load import load
policy = load("sac-paper")
action, _ = policy.predict(observation)
"""

from __future__ import annotations

import importlib.util
from functools import partial
from pathlib import Path
from typing import Any

from qcar_env.evaluation.agent import Agent, read_recipe
from qcar_env.evaluation.entry import Entry, content
from qcar_env.evaluation.tracks import TRACKS, Track
from qcar_env.scenarios import Scenario
from qcar_env.validation import known

PRETRAINED = Path(__file__).parent / "pretrained"


def names() -> tuple[str, ...]:
    """Return the names of the agents that are shipped."""
    return tuple(sorted(each.parent.name for each in PRETRAINED.glob("*/policy.onnx")))


def load(agent: str | Path) -> Agent:
    """Load a trained agent.

    Parameters
    ----------
    agent : str or Path
        A name, such as ``sac-paper`` (see `names`), or a folder with ``policy.onnx`` and
        ``recipe.json``: a run folder of ``qcar train``.

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


def entries() -> tuple[Entry, ...]:
    """Return the shipped agents as entries; none where onnxruntime or onnx is absent."""
    if not all(map(importlib.util.find_spec, ("onnxruntime", "onnx"))):
        return ()
    return tuple(_entry(name, read_recipe(PRETRAINED / name)) for name in names())


def _entry(name: str, recipe: dict[str, Any]) -> Entry:
    seen = "state" if recipe["observe"] == "feedback" else "state, road and force now"
    return Entry(
        name=name,
        kind="learned",
        title=name,
        make=partial(_make, name),
        reads=recipe["observe"],
        needs=seen + (", force limit" if recipe["observe_limit"] else ""),
        source=content(PRETRAINED / name / "policy.onnx"),
    )


def _make(name: str, scenario: Scenario, track: Track | None, force_scale: float) -> Agent | None:
    """Return an agent, or None on a track of another scenario or at a limit beyond its own."""
    agent = load(name)
    if track is None:
        return agent
    home = agent.recipe.get("track", track.name)
    home = home["name"] if isinstance(home, dict) else home
    same = home not in TRACKS or TRACKS[home].scenario == track.scenario
    within = min(agent.force_scales) - 1e-9 <= force_scale <= max(agent.force_scales) + 1e-9
    return agent if same and within else None
