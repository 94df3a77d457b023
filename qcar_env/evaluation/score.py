"""Score one policy on one track at one force limit: a row of numbers for each episode."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.evaluation import metrics
from qcar_env.evaluation.batch_rollouts import (
    BatchRollout,
    batch_rollout,
    steady_amplitudes,
    window_steps,
)
from qcar_env.evaluation.entry import may_enter, shown_to
from qcar_env.evaluation.policy import Policy
from qcar_env.evaluation.tracks import Split, Track, episodes

Array = NDArray[np.float64]

SHOWN_PERIODS = 6  # periods at the end of the first episode that are kept for the figures
FACTORS = ("height", "force", "frequency", "load", "wheel_mass")  # that a draw multiplies


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a policy did in one episode. Forces are those of wheel and body, or one in newtons."""

    policy: str
    kind: str  # published, tuned, learned, yours, or optimum
    reads: str  # full or feedback
    track: str
    version: int
    force_scale: float  # [-]
    episode: int
    height: float  # factors of the draw [-]
    force: float
    frequency: float
    load: float
    wheel_mass: float
    rho: float  # max_i(a_i / A_i) [-]
    x1: float  # steady amplitudes [m]
    x2: float
    percentage_error_x1: float  # the paper's [%]
    percentage_error_x2: float
    reduction_db_x1: float  # [dB]
    reduction_db_x2: float
    peak_force_1: float  # over the last periods [m/s^2] or [N]
    peak_force_2: float
    rms_force_1: float
    rms_force_2: float
    settling_time: float  # of the larger relative envelope [s]
    terminated: bool  # left the travel limits


@dataclass(frozen=True, kw_only=True)
class History:
    """The last periods of a policy's first episode."""

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
        What acts; what it is shown, it says itself (`qcar_env.evaluation.entry.shown_to`).
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

    Returns
    -------
    Scores

    Raises
    ------
    ValueError
        If the policy reads more than the track shows, or acts wrongly (see `batch_rollout`).
    """
    reads, observe_limit = shown_to(policy, track.observe)
    if not may_enter(reads, track):
        raise ValueError(
            f"track {track.name!r} shows the state alone, policy {name!r} reads {reads!r}; "
            "enter it in another track"
        )
    batch = episodes(track, split, force_scale=force_scale, seed=seed)
    rollout = batch_rollout(
        policy, batch, duration=track.duration, observe=reads, observe_limit=observe_limit
    )
    amplitudes = steady_amplitudes(rollout, track.periods)
    names = {"policy": name, "kind": kind, "reads": reads, "force_scale": force_scale}
    rows = tuple(_row(rollout, j, amplitudes[j], track, names) for j in range(len(batch)))
    shown = window_steps(batch[0], SHOWN_PERIODS)
    return Scores(
        rows=rows,
        history=History(
            t=rollout.t[-shown:], x=rollout.x[-shown:, 0], force=rollout.force[-shown:, 0]
        ),
    )


def for_track(scores: Scores, track: Track) -> Scores:
    """Return scores under the name of another track with the same episodes."""
    rows = tuple(
        dataclasses.replace(row, track=track.name, version=track.version) for row in scores.rows
    )
    return dataclasses.replace(scores, rows=rows)


def _row(
    rollout: BatchRollout, j: int, amplitudes: Array, track: Track, names: dict[str, Any]
) -> Row:
    episode = rollout.episodes[j]
    factors: dict[str, Any] = {key: float(getattr(episode.factors, key)) for key in FACTORS}
    x1, x2 = (float(value) for value in amplitudes)
    a1, a2 = episode.scenario.reference_amplitudes
    window = window_steps(episode, track.periods)
    force = rollout.force[-window:, j]
    peaks = np.abs(force).max(axis=0)
    rms = np.sqrt(np.mean(force * force, axis=0))
    omega = episode.scenario.reference_frequency
    x = rollout.x[:, j]
    envelope = np.maximum(
        np.hypot(x[:, 0], x[:, 2] / omega) / a1, np.hypot(x[:, 1], x[:, 3] / omega) / a2
    )
    return Row(
        **(names | factors),
        track=track.name,
        version=track.version,
        episode=j,
        rho=max(x1 / a1, x2 / a2),
        x1=x1,
        x2=x2,
        percentage_error_x1=metrics.percentage_error(a1, x1),
        percentage_error_x2=metrics.percentage_error(a2, x2),
        reduction_db_x1=metrics.reduction_db(a1, x1),
        reduction_db_x2=metrics.reduction_db(a2, x2),
        peak_force_1=float(peaks[0]),
        peak_force_2=float(peaks[-1]),
        rms_force_1=float(rms[0]),
        rms_force_2=float(rms[-1]),
        settling_time=metrics.settling_time(rollout.t, envelope),
        terminated=bool(rollout.terminated[j]),
    )
