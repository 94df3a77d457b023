"""Who enters the benchmark: baselines with published and tuned gains, shipped agents, yours."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from baselines import catalogue
from qcar_env.envs.task import Observe
from qcar_env.evaluation.benchmark import may_enter
from qcar_env.evaluation.onnx_policy import OnnxPolicy
from qcar_env.evaluation.tracks import TRACKS, Track
from qcar_env.scenarios import Scenario
from qcar_env.validation import known

# Policies whose plan is made for one known road: where the road is drawn they do not enter.
PLANNED = ("mpc",)

Kind = Literal["published", "tuned", "learned", "yours"]


@dataclass(frozen=True, kw_only=True)
class Contestant:
    """A policy that enters, as words: worker processes make the policy itself."""

    name: str  # in the table
    kind: Kind
    spec: str  # name of the baseline or agent, or what the user gave

    def tracks(self, tracks: Sequence[Track]) -> tuple[tuple[Track, float], ...]:
        """Return the tracks and force limits that this contestant enters."""
        return tuple(
            (track, scale)
            for track in tracks
            for scale in track.force_scales
            if self._enters(track, scale)
        )

    def make(self, track: Track, force_scale: float) -> Made:
        """Make the policy for one track and force limit."""
        scenario = track.at(force_scale)
        if self.kind == "published":
            policy = catalogue.make(self.spec, scenario)
        elif self.kind == "tuned":
            policy = catalogue.make_tuned(
                self.spec, tuned_on(self.spec, track, force_scale), force_scale, scenario
            )
        elif self.kind == "learned":
            policy = _agent(self.spec)
        else:
            policy = user_policy(self.spec, scenario)
        reads: Observe = getattr(policy, "reads", track.observe)
        limit = bool(getattr(policy, "observe_limit", False))
        return Made(policy=policy, reads=reads, observe_limit=limit)

    def _enters(self, track: Track, force_scale: float) -> bool:
        if self.kind == "published":
            planned = self.spec in PLANNED and track.nominal.randomisation is not None
            return not planned and may_enter(catalogue.describe(self.spec)["reads"], track)
        if self.kind == "tuned":
            reads = catalogue.describe(self.spec)["reads"]
            return may_enter(reads, track) and bool(tuned_on(self.spec, track, force_scale))
        if self.kind == "learned":
            agent = _agent(self.spec)
            home = agent.recipe.get("track", track.name)
            home = home["name"] if isinstance(home, dict) else home
            same = _scenario_of(home, track) == track.scenario
            return (
                same
                and may_enter(agent.reads, track)
                and _contains(agent.force_scales, force_scale)
            )
        return True


@dataclass(frozen=True, kw_only=True)
class Made:
    """A policy and what it must be shown."""

    policy: Any
    reads: Observe
    observe_limit: bool


def baselines(names: Sequence[str] | None = None) -> tuple[Contestant, ...]:
    """Return the scripted contestants.

    Parameters
    ----------
    names : sequence of str, optional
        Which baselines; all if left out.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    chosen = catalogue.everything() if names is None else tuple(dict.fromkeys(names))
    for name in chosen:
        known("baseline", name, catalogue.everything())
    published = [
        Contestant(name=name, kind="published", spec=name)
        for name in chosen
        if name not in catalogue.WITHOUT_PUBLISHED
    ]
    with_gains = {entry[0] for entry in catalogue.tuned()}
    tuned = [
        Contestant(name=f"{name} (tuned)", kind="tuned", spec=name)
        for name in chosen
        if name in with_gains
    ]
    return (*published, *tuned)


def agents() -> tuple[Contestant, ...]:
    """Return the shipped agents; none where there are none, or where onnxruntime is absent."""
    try:
        load = importlib.import_module("agents.load")
        importlib.import_module("onnxruntime")
    except ImportError:
        return ()
    return tuple(Contestant(name=name, kind="learned", spec=name) for name in load.names())


def yours(spec: str) -> Contestant:
    """Return the contestant of ``--policy``: ``module:object``, a file or a folder.

    Raises
    ------
    ValueError
        If `spec` has neither form, or what it names cannot be loaded or is no policy.
    """
    path = Path(spec)
    if path.suffix == ".onnx" or path.is_dir():
        if not path.exists():
            raise ValueError(f"no file {spec}; give the path of an ONNX file, or module:object")
        _loaded(path)
        name = path.stem if path.suffix and path.stem != "policy" else path.resolve().name
        name = path.resolve().parent.name if path.stem == "policy" and path.suffix else name
        return Contestant(name=name, kind="yours", spec=str(path.resolve()))
    module, colon, attribute = spec.partition(":")
    if not colon or not module or not attribute:
        raise ValueError(
            f"--policy must be module:object or the path of an ONNX file, got {spec!r}; "
            "for instance my_policy:policy"
        )
    _imported(spec)
    return Contestant(name=spec, kind="yours", spec=spec)


def user_policy(spec: str, scenario: Scenario) -> Any:
    """Load a user's policy.

    Parameters
    ----------
    spec : str
        ``module:object``, the path of an ONNX file, or a run folder of ``scripts/train.py``. The
        object is a policy, or makes one from the scenario with its force limit.
    scenario : Scenario
        What it will act in.

    Raises
    ------
    ValueError
        If there is no such module or object, or it is no policy.
    """
    path = Path(spec)
    if path.suffix == ".onnx" or path.is_dir():
        return _loaded(path)
    found = _imported(spec)
    if isinstance(found, type) or not hasattr(found, "predict"):
        found = found(scenario)
    if not hasattr(found, "predict"):
        raise ValueError(f"{spec!r} made {type(found).__name__}, which has no predict")
    return found


def tuned_on(name: str, track: Track, force_scale: float) -> str:
    """Return the track whose gains serve `track` at a force limit; empty if there are none."""
    for baseline, home, scale in catalogue.tuned():
        if baseline == name and _contains((scale,), force_scale):
            if _scenario_of(home, track) == track.scenario:
                return home
    return ""


def _scenario_of(name: str, default: Track) -> str:
    return TRACKS[name].scenario if name in TRACKS else default.scenario


def _contains(scales: Sequence[float], scale: float) -> bool:
    return any(abs(each - scale) < 1e-9 for each in scales)


def _loaded(path: Path) -> Any:
    """Return the policy of an ONNX file or a run folder."""
    try:
        return OnnxPolicy(path) if path.suffix == ".onnx" else _agent(str(path))
    except RuntimeError as error:  # onnxruntime is not installed
        raise ValueError(f"no policy {path}: {error}") from error


def _imported(spec: str) -> Any:
    """Return the object of ``module:object``: a policy, or what makes one."""
    module, _, attribute = spec.partition(":")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except Exception as error:  # the module is the user's: whatever it raises
        raise ValueError(
            f"no policy {spec!r}: {type(error).__name__}: {error}; "
            "give module:object as Python imports it from this folder"
        ) from error
    if not callable(found) and not hasattr(found, "predict"):
        raise ValueError(
            f"{spec!r} is no policy: it has no predict, and cannot be called to make one; "
            "give an object that has or can"
        )
    return found


def _agent(spec: str) -> Any:
    return importlib.import_module("agents.load").load(spec)
