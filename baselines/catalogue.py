"""The scripted policies by name, with their published and their tuned gains."""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from qcar_env.control import LAWS
from qcar_env.control.lqr import Weights
from qcar_env.control.skyhook import Groundhook, Hybrid, Skyhook
from qcar_env.evaluation.entry import Entry, content
from qcar_env.evaluation.policy import Policy
from qcar_env.evaluation.tracks import TRACKS, Track
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import finite, known, positive

from .actuation import check_two
from .internal_model_policy import InternalModelPolicy
from .law_policy import LawPolicy
from .linear_policy import LinearPolicy, lqr_feedforward_policy, lqr_policy
from .mpc_policy import MPCPolicy

STORE = Path(__file__).with_name("tuned.json")

# Laws as policies: the paper's six, and the classical dampers.
LAW_POLICIES: Mapping[str, Any] = MappingProxyType(
    {**LAWS, "skyhook": Skyhook, "groundhook": Groundhook, "hybrid": Hybrid}
)

# Entries of the gain matrices: k of the state, w of road and external force; the first figure is
# the actuator, the second the entry of the observation.
MATRIX_GAINS = tuple(f"{letter}{i}{j}" for letter in "kw" for i in (1, 2) for j in (1, 2, 3, 4))


def velocity(scenario: Scenario, G1: float = 100.0, G2: float = 100.0) -> LawPolicy:
    """High-gain saturated velocity feedback: LNVC with gains [1/s] that mostly saturate."""
    policy = LawPolicy(LAWS["lnvc"](G1=G1, G2=G2), scenario)
    policy.name = "velocity feedback"
    return policy


def lqr(
    scenario: Scenario, q1: float = 1.0, q2: float = 1.0, r1: float = 1e-3, r2: float = 1e-3
) -> LinearPolicy:
    """Linear-quadratic regulator; weights of motion and force [-]."""
    return lqr_policy(scenario, Weights(q1=q1, q2=q2, r1=r1, r2=r2))


def lqr_feedforward(
    scenario: Scenario, q1: float = 1.0, q2: float = 1.0, r1: float = 1e-3, r2: float = 1e-3
) -> LinearPolicy:
    """Return the regulator that also cancels the road and the force that it reads."""
    return lqr_feedforward_policy(scenario, Weights(q1=q1, q2=q2, r1=r1, r2=r2))


def lqr_model(
    scenario: Scenario,
    q1: float = 1.0,
    q2: float = 1.0,
    r1: float = 1e-3,
    r2: float = 1e-3,
    drift: float = 1.0,
) -> InternalModelPolicy:
    """Return the regulator with an internal model of the sinusoid, from the state alone."""
    return InternalModelPolicy(scenario, Weights(q1=q1, q2=q2, r1=r1, r2=r2), drift=drift)


def mpc(scenario: Scenario) -> MPCPolicy:
    """Model predictive control with preview of the road."""
    return MPCPolicy(scenario)


def state(scenario: Scenario, **gains: float) -> LinearPolicy:
    """Saturated linear feedback of the whole state: eight gains, scaled units."""
    check_two(scenario, "state feedback", "lqr")
    return LinearPolicy(_matrix(MATRIX_GAINS[:8], gains).reshape(2, 4), "state feedback")


def linear(scenario: Scenario, **gains: float) -> LinearPolicy:
    """Saturated linear feedback of state, road and external force: sixteen gains, scaled units."""
    check_two(scenario, "linear feedback", "lqr")
    found = _matrix(MATRIX_GAINS, gains)
    return LinearPolicy(
        np.hstack([found[:8].reshape(2, 4), found[8:].reshape(2, 4)]), "linear, full information"
    )


class Design(NamedTuple):
    """A policy that is designed, not a law of the paper's form."""

    make: Callable[..., Any]
    title: str
    reads: Literal["full", "feedback"]
    needs: str  # beside its gains: what it reads at each sample, and what it was designed on


STATE = "state"
NOW = "state, road and force now"

# Policies beyond the laws. `state` and `linear` have no published gains: they are tuned.
DESIGNED: Mapping[str, Design] = MappingProxyType(
    {
        "velocity": Design(velocity, "velocity feedback", "feedback", STATE),
        "lqr": Design(lqr, "LQR", "feedback", "state; designed on the car"),
        "lqr-feedforward": Design(
            lqr_feedforward,
            "LQR + feedforward",
            "full",
            f"{NOW}; designed on car and forcing frequency",
        ),
        "lqr-model": Design(
            lqr_model,
            "LQR + internal model",
            "feedback",
            "state; designed on car and forcing frequency",
        ),
        "mpc": Design(
            mpc,
            "MPC",
            "full",
            f"{NOW}, continued over 60 ms of preview; designed on the car and planned for the one "
            "road and force",
        ),
        "state": Design(state, "state feedback", "feedback", STATE),
        "linear": Design(linear, "linear, full information", "full", NOW),
    }
)
WITHOUT_PUBLISHED = ("state", "linear")
PLANNED = ("mpc",)  # for one known road: where the road is drawn they do not enter


def names() -> tuple[str, ...]:
    """Return the names of the paper's laws."""
    return tuple(LAWS)


def everything() -> tuple[str, ...]:
    """Return the names of all baselines, those without published gains included."""
    return (*LAW_POLICIES, *DESIGNED)


def make(name: str, scenario: str | Scenario = "paper", **gains: float) -> Any:
    """Make a baseline.

    Parameters
    ----------
    name : str
        One of `everything`.
    scenario : str or Scenario
        What it will act in.
    **gains : float
        Gains and filter parameters, as the law's class names them; the published ones otherwise.

    Returns
    -------
    Policy
        With `name` and `reads`, which says what it must be shown.

    Raises
    ------
    ValueError
        If name or gain is unknown (the nearest name is given), or a gain is out of range.
    """
    known("baseline", name, everything())
    found = find_scenario(scenario)
    for gain in gains:
        known(f"gain of {name}", gain, gain_names(name))
    if name in LAW_POLICIES:
        return LawPolicy(LAW_POLICIES[name](**gains), found)
    return DESIGNED[name].make(found, **gains)


def gain_names(name: str) -> tuple[str, ...]:
    """Return the names of a baseline's gains (errors: `describe`)."""
    known("baseline", name, everything())
    if name in LAW_POLICIES:
        return tuple(field.name for field in dataclasses.fields(LAW_POLICIES[name]))
    if name in WITHOUT_PUBLISHED:
        return MATRIX_GAINS[:8] if name == "state" else MATRIX_GAINS
    return tuple(inspect.signature(DESIGNED[name].make).parameters)[1:]


def describe(name: str) -> dict[str, Any]:
    """Return what a baseline reads and needs, and its published gains.

    Returns
    -------
    dict
        `name`; `reads`, ``"feedback"`` or ``"full"``; `needs`, in words; `gains`.

    Raises
    ------
    ValueError
        If the name is unknown; the message gives the nearest one.
    """
    known("baseline", name, everything())
    if name in LAW_POLICIES:
        law = LAW_POLICIES[name]()
        gains = dataclasses.asdict(law)
        return {"name": law.name, "reads": LawPolicy.reads, "needs": STATE, "gains": gains}
    design = DESIGNED[name]
    gains = {
        key: parameter.default
        for key, parameter in inspect.signature(design.make).parameters.items()
        if parameter.default is not inspect.Parameter.empty
    }
    return {"name": design.title, "reads": design.reads, "needs": design.needs, "gains": gains}


@lru_cache(maxsize=1)
def _stored() -> dict[tuple[str, str, float], dict[str, Any]]:
    if not STORE.exists():
        return {}
    found = json.loads(STORE.read_text(encoding="utf-8"))
    return {(each["baseline"], each["track"], each["force_scale"]): each for each in found}


def tuned() -> tuple[tuple[str, str, float], ...]:
    """Return what has tuned gains: baseline, track and force limit over the scenario's own [-]."""
    return tuple(sorted(_stored()))


def stored(name: str, track: str, force_scale: float) -> dict[str, Any]:
    """Return all that is stored with tuned gains (arguments and errors: `make_tuned`)."""
    known("baseline", name, everything())
    known("track", track, TRACKS)
    key = (name, track, positive("force_scale", force_scale))
    if key not in _stored():
        there = sorted({entry[0] for entry in _stored() if entry[1:] == key[1:]})
        raise ValueError(
            f"no tuned gains of {name!r} for track {track!r} at force scale {force_scale:g}; "
            f"there are {', '.join(there) or 'none'}; make them with qcar tune"
        )
    return _stored()[key]


def make_tuned(name: str, track: str, force_scale: float, scenario: Scenario) -> Policy:
    """Make a baseline with the gains that were tuned for a track at one force limit.

    Parameters
    ----------
    name : str
        The baseline.
    track : str
        Track on whose training set it was tuned.
    force_scale : float
        Force limit over the scenario's own [-].
    scenario : Scenario
        What it will act in, with that limit.

    Raises
    ------
    ValueError
        If there are no such gains; the message lists what there is.
    """
    return make(name, scenario, **stored(name, track, force_scale)["gains"])


def entry(name: str, **gains: float) -> Entry:
    """Return a baseline as an entry, with its published gains where none are given.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    found = describe(name)
    return Entry(
        name=name,
        kind="published",
        title=found["name"],
        make=partial(_make_published, name, gains),
        reads=found["reads"],
        needs=found["needs"],
    )


def entries(names: Sequence[str] | None = None) -> tuple[Entry, ...]:
    """Return the baselines as entries: with published gains, then with tuned ones.

    Parameters
    ----------
    names : sequence of str, optional
        Which baselines; all if left out.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    chosen = [entry(name) for name in dict.fromkeys(everything() if names is None else names)]
    with_gains = {name for name, _, _ in tuned()}
    return (
        *(each for each in chosen if each.name not in WITHOUT_PUBLISHED),
        *(
            dataclasses.replace(
                each,
                name=f"{each.name} (tuned)",
                kind="tuned",
                title=f"{each.title}, tuned",
                make=partial(_make_tuned, each.name),
                source=content(STORE),
            )
            for each in chosen
            if each.name in with_gains
        ),
    )


def _make_published(
    name: str, gains: Mapping[str, float], scenario: Scenario, track: Track | None, scale: float
) -> Policy | None:
    if name in PLANNED and track is not None and scenario.randomisation:
        return None
    return make(name, scenario, **gains)


def _make_tuned(name: str, scenario: Scenario, track: Track | None, scale: float) -> Policy | None:
    """Take the gains of the first track with the scenario; outside tracks those of `budget`."""
    homes = [home for baseline, home, at in tuned() if baseline == name and abs(at - scale) < 1e-9]
    if track is None:
        home = min(homes, key=lambda home: home != "budget", default="budget")
        return make_tuned(name, home, scale, scenario)
    for home in homes:
        if TRACKS[home].scenario == track.scenario:
            return make_tuned(name, home, scale, scenario)
    return None


def _matrix(expected: tuple[str, ...], gains: Mapping[str, float]) -> Any:
    missing = [name for name in expected if name not in gains]
    if missing:
        raise ValueError(
            f"a gain matrix needs all of {expected[0]} ... {expected[-1]}, missing "
            f"{', '.join(missing)}; take tuned gains with make_tuned"
        )
    return np.array([finite(f"gain {name}", gains[name]) for name in expected])
