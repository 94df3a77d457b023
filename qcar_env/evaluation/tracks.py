"""Tracks: what a policy is scored on, frozen and under a version.

A track fixes the scenario, the force limits, what a policy is shown, the starts or draws, and how
long an episode lasts. Each has three disjoint sets of episodes:

- ``training``: what gains are tuned and agents trained on, endless;
- ``validation``: what chooses among candidates (seeds, checkpoints, gains);
- ``held-out``: what is reported, and nothing else ever sees.

A change of any number raises the track's version.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine import starts
from qcar_env.envs import episode as task
from qcar_env.scenarios import Scales, Scenario, scenario as find_scenario
from qcar_env.validation import known, positive, shown, store, whole

Array = NDArray[np.float64]
Split = Literal["training", "validation", "held-out"]
SPLITS: tuple[Split, ...] = ("training", "validation", "held-out")

# First words of the seed of each set, so that no two sets share a draw.
_SPLIT_WORD: Mapping[str, int] = MappingProxyType({"training": 1, "validation": 2, "held-out": 3})


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode: what it is drawn from, and how it begins."""

    nominal: Scenario  # which the draw changes, and whose scales the observation has
    force_scale: float  # force limit over the scenario's own [-]
    uniforms: tuple[float, ...]  # from [0, 1), at least one for each `Vary` of the scenario
    state: tuple[float, float, float, float]  # x1, x2 [m], v1, v2 [m/s] at the start
    phase: float  # of the road at the start [rad]

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario as drawn, with its force limit."""
        return self.nominal.with_force_scale(self.force_scale).drawn(self.uniforms)

    @cached_property
    def uncontrolled(self) -> tuple[float, float]:
        """Amplitudes of x1 and x2 without control [m]."""
        return self.scenario.reference_amplitudes

    @property
    def drawn(self) -> dict[str, float]:
        """What has been drawn, by the first number that it changes."""
        varied = self.nominal.randomisation
        return {
            next(iter(each.numbers)): each.by.value(u)
            for each, u in zip(varied, self.uniforms, strict=False)
        }


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
    scenario : str or Scenario
        Preset of `qcar_env.SCENARIOS`, or any other scenario.
    force_scales : tuple of float
        Force limits over the scenario's own [-].
    observe : {"full", "feedback"}
        Most that a policy may be shown.
    episodes : int
        Episodes in the validation and in the held-out set, at each force limit.
    duration : float
        Length of an episode [s].
    periods : int or None
        Whole periods at its end over which amplitudes are taken; None for the whole episode, on a
        road that is not harmonic.
    seed : int
        Seed of the sets.
    metrics : tuple of str
        What is reported, the first one ranks.
    made_for : Track, optional
        Track that the policies are made for, where it is another: they enter as they are.

    Raises
    ------
    ValueError
        If a name is unknown, a number is out of range, or periods are asked for where there are
        none.
    """

    name: str
    version: int
    title: str
    scenario: str | Scenario
    force_scales: tuple[float, ...]
    observe: Literal["full", "feedback"] = "full"
    episodes: int = 64  # what 5 % of the starts do, they miss with a chance of 4 %
    duration: float = 60.0
    periods: int | None = 20
    seed: int = 3046
    metrics: tuple[str, ...] = (
        *("rho", "x1", "x2", "percentage_error_x1", "percentage_error_x2"),
        *("reduction_db_x1", "reduction_db_x2", "peak_force_1", "peak_force_2"),
        *("rms_force_1", "rms_force_2", "settling_time"),
    )
    made_for: Track | None = None

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
            seed=whole("seed", self.seed, least=0),
            periods=None if self.periods is None else whole("periods", self.periods),
            duration=positive("duration", self.duration, "s"),
            observe=known("observe", self.observe, task.OBSERVE),
            force_scales=tuple(positive("force scale", scale) for scale in self.force_scales),
        )
        if self.periods is not None and not self.nominal.excitation.harmonic:
            raise ValueError(
                f"track {self.name!r} takes amplitudes over its last {self.periods} periods, but "
                f"the road of scenario {self.nominal.name!r} is not harmonic and has none; give "
                "periods=None for the largest of the whole episode"
            )

    @property
    def home(self) -> Track:
        """The track that policies are made for: this one, unless `made_for` says another."""
        return self if self.made_for is None else self.made_for

    @property
    def nominal(self) -> Scenario:
        """The scenario that the draws vary."""
        return find_scenario(self.scenario)

    @cached_property
    def lasting(self) -> Scenario:
        """The nominal scenario with the track's duration and its own scales."""
        nominal = self.nominal
        scales = nominal.scales or stated(nominal)
        return dataclasses.replace(nominal, duration=self.duration, scales=scales)

    def at(self, force_scale: float) -> Scenario:
        """Return the nominal scenario with the force limit scaled [-], as an environment has it."""
        return self.lasting.with_force_scale(force_scale)


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
        They start as the environment's do, from a drawn motion at a drawn phase; the first one
        from rest at phase 0. Where the scenario varies, every second one starts from rest, at a
        drawn phase, and the draws form a Latin hypercube: with n episodes each takes one value in
        each n-th of its range.

    Raises
    ------
    ValueError
        If the set or a number is not valid.
    """
    known("split", split, SPLITS)
    n = track.episodes if count is None else whole("count", count)
    nominal = track.lasting
    words = [_SPLIT_WORD[split], track.seed if seed is None else whole("seed", seed, least=0)]
    rng = np.random.default_rng(words)
    endless = float(nominal.excitation.harmonic)
    found = nominal.reference
    amplitudes = starts.Reference(*found.start, *found.frequencies, *(0.0,) * 4)
    motion = rng.random((n, starts.MOTION_DRAWS))
    phases = endless * starts.CIRCLE * motion[:, 5]
    states = np.array([starts.drawn_motion(row, 0, amplitudes) for row in motion.tolist()])
    uniforms: Array = np.zeros((n, 0))
    if nominal.randomisation:
        states[::2] = 0.0
        columns = max(starts.FIRST_DRAWS, len(nominal.randomisation))
        cell = np.argsort(rng.random((n, columns)), axis=0)
        uniforms = (cell + rng.random((n, columns))) / n
    else:
        states[0], phases[0] = 0.0, 0.0
    return tuple(
        Episode(
            nominal=nominal,
            force_scale=positive("force scale", force_scale),
            uniforms=tuple(u),
            state=(x[0], x[1], x[2], x[3]),
            phase=phase,
        )
        for u, x, phase in zip(uniforms.tolist(), states.tolist(), phases.tolist(), strict=True)
    )


def stated(scenario: Scenario) -> Scales:
    """Return the scales of a scenario, for one that differs in length or force limit."""
    found = scenario.reference
    (A1, A2), (omega1, omega2) = found.start, found.frequencies
    return Scales(A1=A1, A2=A2, omega1=omega1, omega2=omega2, others=found.scales)


_PAPER = Track(
    name="paper",
    version=2,
    title="The paper's worst case at CNVC's own peak force",
    scenario="paper",
    force_scales=(1.0,),
)
_BUDGET = dataclasses.replace(
    _PAPER,
    name="budget",
    title="The paper's worst case as the force limit shrinks",
    force_scales=(1.0, 0.75, 0.5, 0.25, 0.1),
)
_FEEDBACK = dataclasses.replace(
    _BUDGET,
    name="feedback",
    title="The same, seeing the state alone: neither road nor external force",
    observe="feedback",
)
_BETWEEN = dataclasses.replace(
    _BUDGET,
    name="between",
    title="The same at limits that nothing was tuned at",
    version=1,
    episodes=16,  # starts end alike: the spread is far below the differences
    force_scales=(0.95, 0.85, 0.675, 0.45, 0.35, 0.2, 0.13),
)
_RANDOMISED = Track(
    name="randomised",
    version=2,
    title="Height, force, speed and masses drawn; a held-out set that nothing was tuned on",
    scenario="paper-randomised",
    force_scales=(1.0, 0.5, 0.25),
    episodes=512,  # separate means that differ by a tenth
    duration=40.0,  # the transient is at 2e-4 of its size, far below the differences
)

TRACKS: Mapping[str, Track] = MappingProxyType(
    {each.name: each for each in (_PAPER, _BUDGET, _BETWEEN, _FEEDBACK, _RANDOMISED)}
)


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
