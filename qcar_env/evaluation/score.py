"""Score one policy on one track at one force limit: a row of numbers for each episode."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import Observe, observed
from qcar_env.evaluation import metrics
from qcar_env.evaluation.entry import may_enter
from qcar_env.evaluation.outcome import outcome
from qcar_env.evaluation.policy import Policy, shown_to
from qcar_env.evaluation.rollouts import Rollout, rollouts
from qcar_env.evaluation.tracks import Episode, Split, Track, episodes

Array = NDArray[np.float64]

SHOWN_PERIODS = 6  # periods at the end of the first episode that are kept for the figures


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a policy did in one episode. Forces are those of wheel and body, or one in newtons."""

    policy: str
    kind: str  # published, tuned, learned, yours, or optimum
    reads: str  # full, feedback, or names of signals
    track: str
    version: int
    force_scale: float  # [-]
    episode: int
    drawn: str  # what was drawn, each by the first number of the scenario that it changes
    rho: float  # max_i(a_i / A_i) [-]
    x1: float  # largest displacements of the rows that the track measures [m]
    x2: float
    percentage_error_x1: float  # the paper's [%]
    percentage_error_x2: float
    reduction_db_x1: float  # [dB]
    reduction_db_x2: float
    peak_force_1: float  # of the same rows [m/s^2] or [N]
    peak_force_2: float
    rms_force_1: float
    rms_force_2: float
    settling_time: float  # until the larger relative envelope stays near what is left [s]
    terminated: bool  # left the travel limits


@dataclass(frozen=True, kw_only=True)
class History:
    """The last periods of a policy's first episode; all of it on a road without."""

    t: Array  # (k,) [s]
    x: Array  # (k, 4) [m, m, m/s, m/s]
    force: Array  # (k, m) [m/s^2] or [N]; held from the sample before


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Rows of all episodes, and a history to draw."""

    rows: tuple[Row, ...]
    history: History


def score(
    policy: Policy,
    track: Track,
    force_scale: float,
    *,
    name: str,
    kind: str,
    split: Split = "held-out",
    seed: int | None = None,
) -> Scores:
    """Run a policy over a set of episodes and measure it.

    Parameters
    ----------
    policy : Policy
        What acts; what it is shown, it says itself (`qcar_env.evaluation.policy.shown_to`).
    track : Track
        The track.
    force_scale : float
        Force limit over the scenario's own [-].
    name, kind : str
        What stands in the table.
    split : {"training", "validation", "held-out"}
        Which set of episodes.
    seed : int, optional
        Another seed of the set than the track's.

    Raises
    ------
    ValueError
        If the policy reads more than the track shows, or acts wrongly (see `rollouts`).
    """
    reads, observe_limit = shown_to(policy, track.observe)
    if not may_enter(reads, track):
        raise ValueError(
            f"track {track.name!r} shows the state alone, policy {name!r} reads {reads!r}; "
            "enter it in another track"
        )
    batch = episodes(track, split, force_scale=force_scale, seed=seed)
    rolled = rollouts(policy, batch, observe=reads, observe_limit=observe_limit)
    names = {"policy": name, "kind": kind, "reads": _word(reads), "force_scale": force_scale}
    rows = tuple(
        _row(rolled[j], each, track, {**names, "episode": j}) for j, each in enumerate(batch)
    )
    end = slice(None)
    if track.periods is not None:
        omega = batch[0].scenario.excitation.omega
        end = metrics.last_periods(rolled.t, omega, min(SHOWN_PERIODS, track.periods))
    return Scores(
        rows=rows,
        history=History(t=rolled.t[end], x=rolled.x[end, 0], force=rolled.force[end, 0]),
    )


def _word(reads: Observe) -> str:
    return reads if isinstance(reads, str) else " ".join(each.name for each in observed(reads))


def for_track(scores: Scores, track: Track) -> Scores:
    """Return scores under the name of another track with the same episodes."""
    rows = tuple(
        dataclasses.replace(row, track=track.name, version=track.version) for row in scores.rows
    )
    return dataclasses.replace(scores, rows=rows)


def _row(rollout: Rollout, episode: Episode, track: Track, names: dict[str, Any]) -> Row:
    found = outcome(names["policy"], rollout, periods=track.periods)
    a1, a2 = found.uncontrolled
    omega = rollout.scenario.reference_frequency
    envelope = np.maximum(
        np.hypot(rollout.x1, rollout.v1 / omega) / a1, np.hypot(rollout.x2, rollout.v2 / omega) / a2
    )
    end = slice(-max(1, len(envelope) // 20), None)
    left = envelope[end if track.periods is None else rollout.window(track.periods)].max()
    settled = metrics.settling_time(rollout.t, envelope, float(left))
    return Row(
        **names,
        track=track.name,
        version=track.version,
        drawn="; ".join(f"{path} {value!r}" for path, value in episode.drawn.items()),
        **found.measures,
        settling_time=np.inf if found.terminated else settled,
        terminated=found.terminated,
    )
