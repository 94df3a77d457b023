"""What enters an experiment: a policy with its name, what it reads, and how it is made.

Entries come from `qcar_env.baselines.entries()`, from `qcar_env.agents.entries()`, and from
`entry_of` for what is yours. They hold no policy but what makes one, so
that they can be sent to other processes.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from qcar_env.envs import episode as task
from qcar_env.evaluation.agent import Agent, OnnxPolicy
from qcar_env.evaluation.tracks import Track
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.files import imported
from qcar_env.validation import shown

Kind = Literal["published", "tuned", "learned", "yours"]
LONGEST = 120  # characters of a name, chosen here: a row of a table
SIGNS = frozenset("$<>|\\`")  # of formulas in figures, of pages, tables and code
FIRST = "=+-@"  # a spreadsheet takes what begins so for a formula
Maker = Callable[[Scenario, Track | None, float], Any]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A policy that enters experiments.

    Parameters
    ----------
    name : str
        In tables.
    kind : {"published", "tuned", "learned", "yours"}
        Where its numbers come from.
    title : str
        What it is, for people.
    make : callable
        ``make(scenario, track, force_scale)`` returns the policy for a scenario with its force
        limit, or None where it does not enter. `track` is None outside the tracks, where every
        policy enters that can be made; `force_scale` is the force limit over the scenario's
        own [-]. Of a module, so that it can be pickled.
    reads : {"full", "feedback"} or sequence of str, optional
        What it is shown; None where only the policy itself can say.
    needs : str
        All that it knows, what it was designed on included, in words.
    source : str
        Hash of the file that it is loaded from, if any: a result that is kept for another content
        is not its own.
    """

    name: str
    kind: Kind
    title: str
    make: Maker
    reads: task.Observe | None = None
    needs: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        """Check that the name can stand in tables, figures, pages and spreadsheets.

        Raises
        ------
        ValueError
            If it is no text, empty, too long, or has a sign that means something there.
        """
        given: Any = self.name
        wrong = not isinstance(given, str) or not given.isprintable() or not given.strip()
        if wrong or len(given) > LONGEST or set(given) & SIGNS or given[0] in FIRST:
            raise ValueError(
                f"name of a policy must be 1 to {LONGEST} printable characters without any of "
                f"{' '.join(sorted(SIGNS))}, and not begin with {' '.join(FIRST)}, got "
                f"{shown(given)}; rename it"
            )


def may_enter(reads: task.Observe, track: Track) -> bool:
    """Return whether a policy reads no more than a track shows.

    Raises
    ------
    ValueError
        If `reads` is neither ``"full"``, ``"feedback"`` nor names of signals.
    """
    return set(task.observed(reads)) <= set(task.observed(track.observe))


def entry_of(spec: str) -> Entry:
    """Return the entry of a policy of yours.

    Parameters
    ----------
    spec : str
        ``module:object``, the path of an ONNX file, or a run folder of ``qcar train``. The
        object is a policy, or makes one from the scenario with its force limit.

    Raises
    ------
    ValueError
        If `spec` has neither form, or what it names cannot be loaded or is no policy.
    """
    path = Path(spec)
    if path.suffix == ".onnx" or path.is_dir():
        if not path.exists():
            raise ValueError(f"no file {spec}; give the path of an ONNX file, or module:object")
        whole = path.resolve()
        name = path.stem if path.suffix else whole.name
        name = whole.parent.name if path.suffix and path.stem == "policy" else name
        reads = _loaded(path).reads
        return Entry(
            name=name,
            kind="yours",
            title=name,
            make=partial(_from_file, whole),
            reads=reads,
            source=content(whole if path.suffix else whole / "policy.onnx"),
        )
    module, colon, attribute = spec.partition(":")
    if not colon or not module or not attribute:
        raise ValueError(
            f"--policy must be module:object or the path of an ONNX file, got {spec!r}; "
            "for instance my_policy:policy"
        )
    _imported(spec)
    place = getattr(sys.modules[module], "__file__", None)
    return Entry(
        name=spec,
        kind="yours",
        title=spec,
        make=partial(_from_module, spec),
        source="" if place is None else content(Path(place)),
    )


def content(path: Path) -> str:
    """Return the hash of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _from_file(path: Path, scenario: Scenario, track: Track | None, force_scale: float) -> Any:
    return _loaded(path)


def _from_module(spec: str, scenario: Scenario, track: Track | None, force_scale: float) -> Any:
    found = _imported(spec)
    if isinstance(found, type) or not hasattr(found, "predict"):
        found = found(scenario)
    if not hasattr(found, "predict"):
        raise ValueError(f"{spec!r} made {type(found).__name__}, which has no predict")
    return found


def _loaded(path: Path) -> Agent | OnnxPolicy:
    try:
        return OnnxPolicy(path) if path.suffix == ".onnx" else Agent(path)
    except RuntimeError as error:  # onnxruntime or onnx is not installed
        raise ValueError(f"no policy {path}: {error}") from error


def _imported(spec: str) -> Any:
    """Return the object of ``module:object``: a policy, or what makes one."""
    found = imported("policy", spec)
    if not callable(found) and not hasattr(found, "predict"):
        raise ValueError(
            f"{spec!r} is no policy: it has no predict, and cannot be called to make one; "
            "give an object that has or can"
        )
    return found
