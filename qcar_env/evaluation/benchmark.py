"""Score one policy on one track at one force limit: a row of numbers for each crossing."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.optimum import period_optimum
from qcar_env.envs import task
from qcar_env.evaluation import metrics
from qcar_env.evaluation.batch_rollouts import (
    BatchRollout,
    batch_rollout,
    steady_amplitudes,
    window_steps,
)
from qcar_env.evaluation.policy import Policy
from qcar_env.evaluation.statistics import Interval, bootstrap, improvement_interval, iqm
from qcar_env.evaluation.tracks import Split, Track, episodes
from qcar_env.scenarios import Scenario
from qcar_env.validation import known

Array = NDArray[np.float64]

ALIKE = 0.01  # [-] relative difference of rho that no driver would feel
OPTIMUM_SAMPLES = 64  # forces in a period of the linear program
SHOWN_PERIODS = 6  # periods at the end of the first crossing that are kept for the figures


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a policy did in one crossing. Forces are those of wheel and body, or one in newtons."""

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
    """The last periods of a policy's first crossing."""

    t: Array  # (k,) [s]
    x: Array  # (k, 4) [m, m, m/s, m/s]
    force: Array  # (k, m) [m/s^2] or [N]; held from the sample before


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Rows of all crossings, and a history to draw."""

    rows: tuple[Row, ...]
    history: History


def may_enter(reads: task.Observe, track: Track) -> bool:
    """Return whether a policy reads no more than a track shows.

    Raises
    ------
    ValueError
        If `reads` is neither ``"full"`` nor ``"feedback"``.
    """
    known("reads", reads, task.OBSERVE)
    return reads == "feedback" or track.observe == "full"


def score(
    policy: Policy,
    track: Track,
    force_scale: float,
    *,
    name: str,
    kind: str,
    reads: task.Observe,
    observe_limit: bool = False,
    split: Split = "held-out",
    seed: int | None = None,
) -> Scores:
    """Run a policy over a set of crossings and measure it.

    Parameters
    ----------
    policy : Policy
        What acts.
    track : Track
        The track.
    force_scale : float
        Force limit over the scenario's own [-].
    name, kind : str
        What stands in the table.
    reads : {"full", "feedback"}
        What the policy is shown.
    observe_limit : bool
        Whether it is shown the force limit as well.
    split : {"training", "validation", "held-out"}
        Which set of crossings.
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
    if not may_enter(reads, track):
        raise ValueError(
            f"track {track.name!r} shows the state alone, policy {name!r} reads {reads!r}; "
            "enter it in another track"
        )
    cases = episodes(track, split, force_scale=force_scale, seed=seed)
    rollout = batch_rollout(
        policy, cases, duration=track.duration, observe=reads, observe_limit=observe_limit
    )
    rows = tuple(
        _row(rollout, j, track, force_scale, name=name, kind=kind, reads=reads)
        for j in range(len(cases))
    )
    shown = window_steps(cases[0], SHOWN_PERIODS)
    return Scores(
        rows=rows,
        history=History(
            t=rollout.t[-shown:], x=rollout.x[-shown:, 0], force=rollout.force[-shown:, 0]
        ),
    )


def for_track(scores: Scores, track: Track) -> Scores:
    """Return scores under the name of another track with the same crossings."""
    rows = tuple(
        dataclasses.replace(row, track=track.name, version=track.version) for row in scores.rows
    )
    return dataclasses.replace(scores, rows=rows)


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The optimum of one crossing: between `lower` and `upper` lies the best of any force."""

    lower: float  # certified: no force within the limit leaves less [-]
    upper: float  # reached by the found force [-]
    held: float | None = None  # least of forces held over the control interval, at the samples [-]


@lru_cache(maxsize=4096)
def optimum(scenario: Scenario, *, held: bool = False) -> Bound:
    """Return the optimum of a harmonic crossing (see `qcar_env.analysis.optimum`).

    Parameters
    ----------
    scenario : Scenario
        The crossing.
    held : bool
        Whether to solve as well for forces held as the environment holds them: what is left for a
        policy at that rate. It is a larger program, over many periods.
    """
    found = period_optimum(scenario, samples=OPTIMUM_SAMPLES)
    at_rate = period_optimum(scenario, dt=scenario.dt, inside=1).value if held else None
    return Bound(lower=found.bound, upper=found.upper, held=at_rate)


def optimum_of(
    track: Track, force_scale: float, *, split: Split = "held-out", seed: int | None = None
) -> tuple[Bound, ...]:
    """Return the optimum of every crossing of a set, in its order (arguments: `score`).

    Where the crossings are all alike, that of held forces comes with it.
    """
    cases = episodes(track, split, force_scale=force_scale, seed=seed)
    same = track.nominal.randomisation is None
    return tuple(optimum(each.scenario, held=same) for each in cases)


@dataclass(frozen=True, kw_only=True)
class Standing:
    """A policy's place at one force limit of a track."""

    policy: str
    kind: str
    reads: str
    track: str
    force_scale: float
    rho: Interval  # interquartile mean over the crossings [-]
    optimum: float  # the same of the lower bounds [-]
    improvement: Interval | None  # probability of a lower rho than the reference's [-]
    terminated: int  # crossings that left the travel limits

    @property
    def over_optimum(self) -> float:
        """``rho / optimum`` [-]; infinite where the optimum is stillness."""
        return self.rho.value / self.optimum if self.optimum > 1e-4 else np.inf


def standings(
    rows: Sequence[Row],
    bounds: Mapping[tuple[str, float], Sequence[float]],
    *,
    reference: str = "cnvc",
    seed: int = 0,
) -> tuple[Standing, ...]:
    """Rank policies, best first within each track and force limit.

    Parameters
    ----------
    rows : sequence of Row
        All rows.
    bounds : mapping
        Lower bounds of the optimum by track and force scale.
    reference : str
        Policy that the probability of improvement is against.
    seed : int
        Seed of the bootstrap; every standing draws from its own generator, so that an added
        policy changes no other's interval.
    """
    groups: dict[tuple[str, float], dict[str, list[Row]]] = {}
    for row in rows:
        groups.setdefault((row.track, row.force_scale), {}).setdefault(row.policy, []).append(row)
    found: list[Standing] = []
    for key, policies in groups.items():
        base = [row.rho for row in policies.get(reference, [])]
        placed: list[Standing] = []
        for name, each in policies.items():
            values = [row.rho for row in each]
            rng = np.random.default_rng([seed, *name.encode(), *key[0].encode()])
            versus = improvement_interval([values], [base], rng) if base else None
            placed.append(
                Standing(
                    policy=name,
                    kind=each[0].kind,
                    reads=each[0].reads,
                    track=key[0],
                    force_scale=key[1],
                    rho=bootstrap([values], iqm, rng),
                    optimum=float(iqm(bounds[key])),
                    improvement=versus if name != reference else None,
                    terminated=sum(row.terminated for row in each),
                )
            )
        found += sorted(placed, key=lambda standing: (standing.rho.value, standing.policy))
    return tuple(found)


def findings(found: Iterable[Standing]) -> tuple[str, ...]:
    """Say in sentences what the standings show, whatever it is.

    Returns
    -------
    tuple of str
        For each track and force limit: how the best tuned linear velocity feedback stands against
        CNVC, which policy is best among the scripted and the learned, and how far from the optimum.
    """
    by_key: dict[tuple[str, float], dict[str, Standing]] = {}
    for each in found:
        by_key.setdefault((each.track, each.force_scale), {})[each.policy] = each
    said: list[str] = []
    for (track, scale), here in by_key.items():
        if track == "paper" and ("budget", scale) in by_key:
            continue  # the same crossings
        where = f"Track {track}, force limit x {scale:g}"
        rivals = [here[name] for name in ("cnvc", "cnvc (tuned)") if name in here]
        linear = [here[name] for name in ("lnvc (tuned)", "velocity") if name in here]
        if rivals and linear:
            cubic = min(rivals, key=lambda each: each.rho.value)
            best = min(linear, key=lambda each: each.rho.value)
            said.append(f"{where}: {_versus(best, cubic)}")
        for kinds, words in (
            (("published", "tuned"), "the best scripted policy is"),
            (("learned",), "the best learned policy is"),
            (("yours",), "yours:"),
        ):
            entered = [each for each in here.values() if each.kind in kinds]
            if entered:
                top = min(entered, key=lambda each: (each.rho.value, each.policy))
                said.append(f"{where}: {words} {top.policy}, {_distance(top)}.")
    return tuple(said)


def _versus(linear: Standing, cubic: Standing) -> str:
    a, b = linear.rho, cubic.rho
    alike = abs(a.value - b.value) < ALIKE * max(a.value, b.value)
    numbers = f"(rho {a.value:.4f} against {b.value:.4f})"
    if a.high < b.low and not alike:
        return (
            f"linear velocity feedback, {linear.policy}, beats the cubic, {cubic.policy} {numbers}."
        )
    if b.high < a.low and not alike:
        return (
            f"the cubic, {cubic.policy}, beats linear velocity feedback, {linear.policy} {numbers}."
        )
    return (
        f"linear velocity feedback, {linear.policy}, and the cubic, {cubic.policy}, leave the "
        f"same, to 1 % or to the width of the intervals {numbers}."
    )


def _distance(standing: Standing) -> str:
    value = f"rho {standing.rho.value:.4f}"
    if standing.optimum <= 1e-4:
        return f"{value}, where the optimum is stillness"
    return f"{value}, {100.0 * (standing.over_optimum - 1.0):.1f} % above the optimum"


def _row(
    rollout: BatchRollout,
    j: int,
    track: Track,
    force_scale: float,
    *,
    name: str,
    kind: str,
    reads: str,
) -> Row:
    case = rollout.episodes[j]
    one = BatchRollout(
        episodes=(case,),
        t=rollout.t,
        x=rollout.x[:, j : j + 1],
        force=rollout.force[:, j : j + 1],
        terminated=rollout.terminated[j : j + 1],
    )
    x1, x2 = (float(value) for value in steady_amplitudes(one, track.periods)[0])
    a1, a2 = case.scenario.reference_amplitudes
    window = window_steps(case, track.periods)
    force = rollout.force[-window:, j]
    peaks = np.abs(force).max(axis=0)
    rms = np.sqrt(np.mean(force * force, axis=0))
    omega = case.scenario.reference_frequency
    x = rollout.x[:, j]
    envelope = np.maximum(
        np.hypot(x[:, 0], x[:, 2] / omega) / a1, np.hypot(x[:, 1], x[:, 3] / omega) / a2
    )
    return Row(
        policy=name,
        kind=kind,
        reads=reads,
        track=track.name,
        version=track.version,
        force_scale=force_scale,
        episode=j,
        **{key: float(getattr(case.factors, key)) for key in FACTORS},
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


FACTORS = ("height", "force", "frequency", "load", "wheel_mass")
