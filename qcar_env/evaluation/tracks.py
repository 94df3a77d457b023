"""Tracks: what a policy is scored on, frozen and under a version.

A track fixes the scenario, the force limits, what a policy is shown, the starts or draws, and how
long a crossing lasts. Each has three disjoint sets of episodes:

- ``training``: what gains are tuned and agents trained on, endless;
- ``validation``: what chooses among candidates (seeds, checkpoints, gains);
- ``held-out``: what is reported, and nothing else ever sees.

A change of any number raises the track's version.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs import task
from qcar_env.scenarios import SCENARIOS, Randomisation, Scenario, scenario as find_scenario, vary
from qcar_env.validation import known, positive, shown, store, whole

Array = NDArray[np.float64]
Split = Literal["training", "validation", "held-out"]
SPLITS: tuple[Split, ...] = ("training", "validation", "held-out")

# First words of the seed of each set, so that no two sets share a draw.
_SPLIT_WORD: Mapping[str, int] = MappingProxyType({"training": 1, "validation": 2, "held-out": 3})


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One crossing: a scenario that no longer varies, and how it begins."""

    nominal: Scenario  # whose amplitudes scale the observation
    scenario: Scenario  # as drawn, with the track's force limit
    force_scale: float  # force limit over the scenario's own [-]
    state: tuple[float, float, float, float]  # x1, x2 [m], v1, v2 [m/s] at the start
    phase: float  # of the road at the start [rad]
    factors: task.Factors = task.UNVARIED  # what `nominal` was multiplied by, see `vary`


@dataclass(frozen=True, kw_only=True)
class Track:
    """A frozen definition of what policies are compared on.

    Parameters
    ----------
    name : str
        Name, as in `TRACKS`.
    version : int
        Raised with every change of a number below.
    title : str
        One line for people.
    scenario : str
        Preset of `qcar_env.SCENARIOS`.
    force_scales : tuple of float
        Force limits over the scenario's own [-].
    observe : {"full", "feedback"}
        Most that a policy may be shown.
    episodes : int
        Crossings in the validation and in the held-out set, at each force limit.
    duration : float
        Length of a crossing [s].
    periods : int
        Whole periods at its end over which amplitudes are taken.
    seed : int
        Seed of the sets.
    metrics : tuple of str
        What is reported, the first one ranks.

    Raises
    ------
    ValueError
        If a name is unknown or a number out of range.
    """

    name: str
    version: int
    title: str
    scenario: str
    force_scales: tuple[float, ...]
    observe: task.Observe = "full"
    episodes: int = 8
    duration: float = 60.0
    periods: int = 20
    seed: int = 3046
    metrics: tuple[str, ...] = (
        "rho",
        "x1",
        "x2",
        "percentage_error_x1",
        "percentage_error_x2",
        "reduction_db_x1",
        "reduction_db_x2",
        "peak_force_1",
        "peak_force_2",
        "rms_force_1",
        "rms_force_2",
        "settling_time",
    )

    def __post_init__(self) -> None:
        """Check names and numbers."""
        if not isinstance(self.force_scales, (tuple, list)):
            raise ValueError(
                f"force_scales must be a tuple of numbers, got {shown(self.force_scales)}; "
                "give (1.0,) for one limit"
            )
        store(
            self,
            version=whole("version", self.version),
            episodes=whole("episodes", self.episodes),
            periods=whole("periods", self.periods),
            duration=positive("duration", self.duration, "s"),
            scenario=known("scenario", self.scenario, SCENARIOS),
            observe=known("observe", self.observe, task.OBSERVE),
            force_scales=tuple(positive("force scale", scale) for scale in self.force_scales),
        )

    @property
    def nominal(self) -> Scenario:
        """The scenario that the draws vary."""
        return find_scenario(self.scenario)

    def at(self, force_scale: float) -> Scenario:
        """Return the nominal scenario with the force limit scaled [-], as an environment has it."""
        return dataclasses.replace(
            self.nominal.with_force_scale(force_scale), duration=self.duration
        )


def episodes(
    track: Track,
    split: Split = "held-out",
    *,
    force_scale: float,
    seed: int | None = None,
    count: int | None = None,
) -> tuple[Episode, ...]:
    """Return the episodes of a set at one force limit.

    Parameters
    ----------
    track : Track
        The track.
    split : {"training", "validation", "held-out"}
        Which set.
    force_scale : float
        Force limit over the scenario's own [-]. The draws are the same at every limit.
    seed : int, optional
        Another seed than the track's, to see how far the result hangs on the draw.
    count : int, optional
        Another number than the track's.

    Returns
    -------
    tuple of Episode
        The first one of a track that does not vary starts from rest at phase 0. Where the
        scenario varies, all start from rest, at drawn phases, and the factors form a Latin
        hypercube: with n episodes each factor takes one value in each n-th of its range.

    Raises
    ------
    ValueError
        If the set or a number is not valid.
    """
    known("split", split, SPLITS)
    n = track.episodes if count is None else whole("count", count)
    nominal = track.at(force_scale)
    words = [_SPLIT_WORD[split], track.seed if seed is None else whole("seed", seed, least=0)]
    rng = np.random.default_rng(words)
    if nominal.randomisation is None:
        states, phases = task.draw_start(rng, nominal, n)
        states[0], phases[0] = 0.0, 0.0
        factors = [task.UNVARIED] * n
    else:
        phases = 2.0 * np.pi * rng.random(n)
        states = np.zeros((n, 4))
        factors = [task.Factors(*row) for row in _hypercube(rng, nominal.randomisation, n)]
    return tuple(
        Episode(
            nominal=nominal,
            scenario=vary(nominal, *each),
            force_scale=force_scale,
            state=(float(x[0]), float(x[1]), float(x[2]), float(x[3])),
            phase=float(phase),
            factors=each,
        )
        for each, x, phase in zip(factors, states, phases, strict=True)
    )


def _hypercube(rng: np.random.Generator, ranges: Randomisation, n: int) -> list[list[float]]:
    low, high = np.array(dataclasses.astuple(ranges), dtype=np.float64).T
    cell = np.argsort(rng.random((n, len(low))), axis=0)
    share = (cell + rng.random((n, len(low)))) / n
    return (low + (high - low) * share).tolist()


_TRACKS = (
    Track(
        name="paper",
        version=1,
        title="The paper's worst case at CNVC's own peak force",
        scenario="paper",
        force_scales=(1.0,),
    ),
    Track(
        name="budget",
        version=1,
        title="The paper's worst case as the force limit shrinks",
        scenario="paper",
        force_scales=(1.0, 0.75, 0.5, 0.25, 0.1),
    ),
    Track(
        name="feedback",
        version=1,
        title="The same, seeing the state alone: neither road nor external force",
        scenario="paper",
        force_scales=(1.0, 0.75, 0.5, 0.25, 0.1),
        observe="feedback",
    ),
    Track(
        name="randomised",
        version=1,
        title="Height, force, speed and masses drawn; a held-out set that nothing was tuned on",
        scenario="paper-randomised",
        force_scales=(1.0, 0.5, 0.25),
        episodes=48,
        duration=40.0,  # the transient is at 2e-4 of its size, far below the differences
    ),
)

TRACKS: Mapping[str, Track] = MappingProxyType({each.name: each for each in _TRACKS})


def track(name: str | Track) -> Track:
    """Return the track called `name`; a `Track` is returned as it is.

    Raises
    ------
    ValueError
        If there is no such track; the message gives the nearest name and the list.
    """
    if isinstance(name, Track):
        return name
    return TRACKS[known("track", name, TRACKS)]
