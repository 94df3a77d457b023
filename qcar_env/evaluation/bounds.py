"""The optimum of the episodes of a track: what no policy can pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from qcar_env.analysis.optimum import episode_optimum, period_optimum
from qcar_env.evaluation.tracks import Episode, Split, Track, episodes
from qcar_env.parts.part import Nothing
from qcar_env.scenarios import Scenario

OPTIMUM_SAMPLES = 64  # forces in a period of the linear program


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The optimum of one episode: between `lower` and `upper` lies the best of any force."""

    lower: float  # certified: no force within the limit leaves less [-]
    upper: float  # reached by the found force, at every instant [-]
    held: float | None = None  # reached by forces held over the control interval [-]


@lru_cache(maxsize=4096)
def optimum(scenario: Scenario, *, held: bool = False) -> Bound:
    """Return the optimum of a harmonic episode (see `qcar_env.analysis.optimum`).

    Parameters
    ----------
    scenario : Scenario
        The episode.
    held : bool
        Whether to solve as well for forces held as the environment holds them: what is left for a
        policy at that rate. It is a larger program, over many periods.
    """
    found = period_optimum(scenario, samples=OPTIMUM_SAMPLES)
    at_rate = period_optimum(scenario, dt=scenario.dt, inside=4).upper if held else None
    return Bound(lower=found.bound, upper=found.upper, held=at_rate)


def optimum_of(
    track: Track, force_scale: float, *, split: Split = "held-out", seed: int | None = None
) -> tuple[Bound, ...]:
    """Return the optimum of every episode of a set, in its order (arguments: `score`).

    Where the episodes are all alike, that of held forces comes with it. On a road that is not
    harmonic it is that of the whole episode, of forces held over the control interval and at the
    instants that policies see. Of a plant that is not linear none is known: the result is empty.
    """
    if not linear_plant(track.nominal):
        return ()
    batch = episodes(track, split, force_scale=force_scale, seed=seed)
    if track.periods is None:
        return tuple(map(_of_episode, batch))
    same = not track.nominal.randomisation
    return tuple(optimum(each.scenario, held=same) for each in batch)


def linear_plant(scenario: Scenario) -> bool:
    """Return whether a scenario's optimum is a linear program: car and actuator are linear."""
    actuator = scenario.actuator
    at_once = actuator.State is Nothing and not actuator.delay
    return scenario.car.linear and actuator.linear and at_once


def _of_episode(episode: Episode) -> Bound:
    start = 0.0
    if episode.scenario.excitation.harmonic:
        start = episode.phase / episode.scenario.excitation.omega
    dt = episode.scenario.dt  # the start itself is nobody's doing, and not measured
    found = episode_optimum(episode.scenario, state=episode.state, start=start, after=dt)
    return Bound(lower=found.bound, upper=found.upper)
