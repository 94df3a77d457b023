"""Steady amplitudes of a policy on a track, for live evaluation, validation and reports.

The episodes are those of `qcar_env.evaluation.tracks`; they end in true steady state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.agents.recipes import Recipe
from qcar_env.control import CNVC, LNVC
from qcar_env.evaluation import bounds
from qcar_env.evaluation.policy import Policy
from qcar_env.evaluation.rollouts import rollouts
from qcar_env.evaluation.tracks import Episode, Split, Track, episodes
from qcar_env.physics.state import State
from qcar_env.scenarios import Scenario
from qcar_env.validation import known, positive

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a policy leaves of the vibration."""

    amplitudes: Array  # (n, 2) largest |x1|, |x2| over the last periods of each episode [m]
    relative: Array  # (n, 2) the same over the episode's own uncontrolled amplitudes [-]

    @property
    def rho(self) -> Array:
        """``max_i(a_i / A_i)`` of each episode, shape (n,) [-]."""
        return np.max(self.relative, axis=1)


def run(
    policy: Policy,
    track: Track,
    drawn: Sequence[Episode],
    *,
    observe_limit: bool = False,
    duration: float | None = None,
) -> Score:
    """Score a policy on episodes of a track.

    Parameters
    ----------
    policy : Policy
        What acts; it is shown what the track allows, and the limit if `observe_limit`.
    track : Track
        The track.
    drawn : sequence of Episode
        Which, from `qcar_env.evaluation.tracks.episodes`.
    observe_limit : bool
        Whether the policy reads the force limit.
    duration : float, optional
        Length of an episode [s]; the track's if left out. Below 40 s the slow mode still moves.

    Raises
    ------
    ValueError
        See `qcar_env.evaluation.rollouts.rollouts`.
    """
    length = track.duration if duration is None else positive("duration", duration, "s")
    found = rollouts(
        policy, drawn, duration=length, observe=track.observe, observe_limit=observe_limit
    )
    periods = track.periods
    if periods is not None:  # a live evaluation may be too short for all of them
        slowest = min(each.scenario.excitation.omega for each in drawn)
        periods = max(1, min(periods, int(length * slowest / (2.0 * math.pi))))
    peak = np.array([found[j].amplitudes(periods) for j in range(len(found))])
    own = np.array([each.scenario.reference_amplitudes for each in drawn])
    return Score(amplitudes=peak, relative=peak / own)


def optimum(scenario: Scenario) -> float:
    """Return the lower bound on rho of a scenario, of any force within its limit [-]."""
    return max(0.0, bounds.optimum(scenario).lower)


def score_all(policy: Policy, recipe: Recipe, split: Split) -> dict[str, dict[str, float]]:
    """Score a policy at each of a recipe's force limits.

    Returns
    -------
    dict
        By force limit: mean and largest `rho`, largest amplitudes `x1`, `x2` [m], and the mean
        `optimum` of the same episodes.
    """
    found: dict[str, dict[str, float]] = {}
    for scale in recipe.force_scales:
        drawn = episodes(recipe.track, split, force_scale=scale)
        each = run(policy, recipe.track, drawn, observe_limit=recipe.observe_limit)
        found[f"{scale:g}"] = {
            "rho": float(np.mean(each.rho)),
            "rho_largest": float(np.max(each.rho)),
            "x1": float(np.max(each.amplitudes[:, 0])),
            "x2": float(np.max(each.amplitudes[:, 1])),
            "optimum": float(np.mean([optimum(one.scenario) for one in drawn])),
        }
    return found


@dataclass(frozen=True, kw_only=True)
class VelocityPolicy:
    """CNVC or saturated linear velocity feedback, to compare with.

    Parameters
    ----------
    law : CNVC or LNVC
        The law with its gains.
    scenario : Scenario
        Nominal scenario at force limit 1: gives units and limits.
    force_scale : float
        Force limit over the scenario's own [-].
    """

    law: CNVC | LNVC
    scenario: Scenario
    force_scale: float = 1.0

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Return the law's force over its limit, clipped."""
        scales = self._scales
        seen = np.asarray(observation, dtype=np.float64)[:, :4].T
        x = State(*(z * scales[name] for z, name in zip(seen, State._fields, strict=True)))
        force = np.stack(self.law.command(x, None, self.law.numbers), axis=1)
        limits = self.force_scale * np.array(self.scenario.actuator.limit)
        return np.clip(force / limits, -1.0, 1.0).astype(np.float32), None

    @cached_property
    def _scales(self) -> Mapping[str, float]:
        return self.scenario.reference.scales


def reference(
    name: str, track: Track, force_scale: float, drawn: Sequence[Episode] | None = None
) -> Score:
    """Score a law to compare with: ``cnvc`` (published gain 1.2) or ``velocity`` (gain 100).

    Parameters
    ----------
    name : {"cnvc", "velocity"}
        Which law. High-gain saturated velocity feedback is the strongest law with two gains.
    track : Track
        The track.
    force_scale : float
        Force limit over the scenario's own [-].
    drawn : sequence of Episode, optional
        The episodes; one from rest if left out.
    """
    laws = {"cnvc": CNVC(G1=1.2, G2=1.2), "velocity": LNVC(G1=100.0, G2=100.0)}
    law = laws[known("law", name, laws)]
    if drawn is None:
        drawn = episodes(track, "validation", force_scale=force_scale, count=1)
    return run(
        VelocityPolicy(law=law, scenario=track.nominal, force_scale=force_scale), track, drawn
    )
