"""Tune the gains of a baseline: a global search on a training set, all candidates in one batch.

Every candidate of a generation drives every training episode at once, through the fleet
(`qcar_env.evaluation.rollouts`). Episodes that would start from rest start on the optimal steady
motion, which good gains keep and bad ones leave; the others start from a drawn motion, so that
gains with a second steady motion are seen. Where nothing varies, those count only as far as they
end elsewhere, and some drive a little slower or faster, for a margin
(`qcar_env.evaluation.robustness`). What is reported starts elsewhere and runs longer.

Search: differential evolution, R. Storn, K. Price, Journal of Global Optimization 11, 1997, as in
`scipy.optimize`.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from qcar_env.analysis.optimum import period_optimum
from qcar_env.control import lqr
from qcar_env.control.lqr import Weights
from qcar_env.evaluation import storage
from qcar_env.evaluation.entry import may_enter
from qcar_env.evaluation.robustness import beside, loss_beside
from qcar_env.evaluation.rollouts import rollouts
from qcar_env.evaluation.tracks import Episode, Split, Track, episodes
from qcar_env.scenarios import Scenario
from qcar_env.validation import known, whole

from . import catalogue
from .law_policy import LawPolicy
from .linear_policy import LinearPolicy, ahead, sampled_plant

Array = NDArray[np.float64]

DURATION = 15.0  # [s] of a training episode: three time constants of the slow mode
VARIED_DURATION = 25.0  # [s] where scenarios vary, and drawn starts count like the others
PERIODS = 20  # whole periods at its end over which the amplitude is taken
STARTS = 8  # training episodes where nothing varies: one on the optimum, the others drawn
BESIDE = 4  # and of those at other speeds
ELSEWHERE = 0.1  # [-] of rho above that on the optimum, from which a start has ended elsewhere
VARIED = 64  # training episodes where scenarios vary; to 8 of them, 16 gains fit too well
LEAST_POPULATION = 5  # candidates in a generation, scipy's
SETTLED = 60.0  # [s] from rest, of the validation that chooses between the searches


@dataclass(frozen=True, kw_only=True)
class Search:
    """What is searched for one baseline.

    Parameters
    ----------
    names : tuple of str
        Gains, as `catalogue.make` takes them.
    low, high : tuple of float
        Box of the search coordinates.
    scale : {"log", "linear", "sinh"}
        Gain of a coordinate c: ``10^c``, ``c`` or ``sinh(c)``.
    generations : int
        At most.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    scale: tuple[str, ...]
    generations: int = 40

    def gains(self, coordinates: Sequence[float]) -> dict[str, float]:
        """Return the gains of a point."""
        decode: dict[str, Callable[[float], float]] = {
            "log": lambda c: 10.0**c,
            "linear": lambda c: c,
            "sinh": lambda c: float(np.sinh(c)),
        }
        return {
            name: float(decode[scale](c))
            for name, scale, c in zip(self.names, self.scale, coordinates, strict=True)
        }


def search_of(*entries: tuple[str, float, float, str], generations: int = 40) -> Search:
    """Return the search of gains, each with the ends of its coordinate and its scale."""
    names, low, high, scale = zip(*entries, strict=True)
    return Search(names=names, low=low, high=high, scale=scale, generations=generations)


_MATRIX = 5.5  # sinh(5.5) = 122: a hundredth of the amplitude may ask for the whole force

SEARCHES: Mapping[str, Search] = MappingProxyType(
    {
        "cnvc": search_of(("G1", -2.0, 2.5, "log"), ("G2", -2.0, 2.5, "log")),
        "lnvc": search_of(("G1", -1.0, 3.0, "log"), ("G2", -1.0, 3.0, "log")),
        "ppf": search_of(("G1", 0.0, 3.4, "log"), ("G2", 0.0, 3.4, "log")),
        "ndf": search_of(("G1", -1.0, 3.0, "log"), ("G2", -1.0, 3.0, "log")),
        "pd": search_of(
            ("p1", -2500.0, 5000.0, "linear"),
            ("p2", -2500.0, 5000.0, "linear"),
            ("d1", -1.0, 3.0, "log"),
            ("d2", -1.0, 3.0, "log"),
            generations=60,
        ),
        "skyhook": search_of(("G", -1.0, 3.0, "log"), generations=15),
        "groundhook": search_of(("G", -1.0, 3.0, "log"), generations=15),
        "lqr": search_of(
            ("q2", -3.0, 3.0, "log"), ("r1", -7.0, 2.0, "log"), ("r2", -7.0, 2.0, "log")
        ),
        "lqr-feedforward": search_of(
            ("q2", -3.0, 3.0, "log"), ("r1", -7.0, 2.0, "log"), ("r2", -7.0, 2.0, "log")
        ),
        # Its forces are those of the feedforward in steady motion, and so are its best weights.
        "lqr-model": search_of(
            ("q2", -3.0, 3.0, "log"), ("r1", -7.0, 2.0, "log"), ("r2", -7.0, 2.0, "log")
        ),
        "state": search_of(
            *((name, -_MATRIX, _MATRIX, "sinh") for name in catalogue.MATRIX_GAINS[:8]),
            generations=100,
        ),
        "linear": search_of(
            *((name, -_MATRIX, _MATRIX, "sinh") for name in catalogue.MATRIX_GAINS),
            generations=150,
        ),
    }
)


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """Gains that a search found, and how."""

    baseline: str
    track: str
    track_version: int
    force_scale: float
    gains: dict[str, float]
    training_rho: float  # what was searched on: mean over training episodes [-]
    validation_rho: float  # mean over the validation episodes, settled [-]
    evaluations: int  # candidates tried
    seed: int
    command: str

    @property
    def key(self) -> tuple[str, str, float]:
        """What they are the gains of: baseline, track and force limit."""
        return self.baseline, self.track, self.force_scale


def tune(
    baseline: str,
    track: Track,
    force_scale: float,
    *,
    seed: int = 0,
    population: int = 48,
    command: str = "",
) -> Tuned:
    """Search the gains of one baseline at one force limit.

    Parameters
    ----------
    baseline : str
        One of `SEARCHES`.
    track : Track
        Its training set is searched on, its validation set is scored on.
    force_scale : float
        Force limit over the scenario's own [-].
    seed : int
        Seed of the search.
    population : int
        Candidates in a generation.
    command : str
        Command line that is stored with the gains.

    Returns
    -------
    Tuned

    Raises
    ------
    ValueError
        If the baseline has nothing to search or a number is out of range.
    """
    search = SEARCHES[known("baseline to tune", baseline, SEARCHES)]
    whole("population", population, least=LEAST_POPULATION)
    whole("seed", seed, least=0)
    varies = bool(track.nominal.randomisation)
    nominal = track.at(force_scale)
    starts = VARIED if varies else STARTS
    drawn = episodes(track, "training", force_scale=force_scale, count=starts)
    training = [each if any(each.state) else _on_optimum(each) for each in drawn]
    if track.periods is not None and not varies:
        training += beside(drawn[:BESIDE])
    count = len(training)
    periods, length = _measured(track, VARIED_DURATION if varies else DURATION)
    window = _window(training, periods)
    evaluations = 0

    def mean_rho(points: Array) -> Array:
        nonlocal evaluations
        columns = points.reshape(len(search.names), -1)
        candidates = columns.shape[1]
        evaluations += candidates
        policy = _candidates(baseline, [search.gains(c) for c in columns.T], nominal, count)
        rolled = rollouts(
            policy, training * candidates, duration=length, observe=policy.reads, last=window
        )
        rho = rolled.rho(periods).reshape(candidates, count)
        if varies or periods is None:
            return rho.mean(axis=1)
        steady, others, margin = rho[:, :1], rho[:, 1:starts], rho[:, starts:]
        elsewhere = np.maximum(others - steady - ELSEWHERE, 0.0).mean(axis=1)
        return steady[:, 0] + elsewhere + loss_beside(margin)

    low, high = np.array(search.low), np.array(search.high)
    rng = np.random.default_rng(seed)
    first = low + (high - low) * rng.random((population, len(low)))
    good = _good_starts(baseline, nominal, population // 3, rng)
    if len(good):
        first[: len(good)] = np.clip(good, low, high)
    found = differential_evolution(
        mean_rho,
        list(zip(low, high, strict=True)),
        init=first,
        maxiter=search.generations,
        mutation=(0.4, 0.9),
        recombination=0.8,
        tol=1e-4,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=np.random.default_rng(seed + 1),
    )
    gains = search.gains(found.x)
    return Tuned(
        baseline=baseline,
        track=track.name,
        track_version=track.version,
        force_scale=force_scale,
        gains=gains,
        training_rho=float(found.fun),
        validation_rho=validate(baseline, gains, track, force_scale),
        evaluations=evaluations,
        seed=seed,
        command=command,
    )


def validate(baseline: str, gains: Mapping[str, float], track: Track, force_scale: float) -> float:
    """Return the mean rho over the validation set, settled from rest [-]."""
    policy = catalogue.make(baseline, track.at(force_scale), **gains)
    return _settled_rho(policy, track, force_scale, "validation")


def _settled_rho(policy: Any, track: Track, force_scale: float, split: Split) -> float:
    cases = episodes(track, split, force_scale=force_scale)
    periods, length = _measured(track, SETTLED)
    rolled = rollouts(policy, cases, duration=length, observe=policy.reads)
    return float(np.mean(rolled.rho(periods)))


def _measured(track: Track, settled: float) -> tuple[int | None, float | None]:
    """Return which periods are measured, and after how long [s]; without any, the whole of it."""
    return (None, None) if track.periods is None else (PERIODS, settled)


def load(path: Path = catalogue.STORE) -> tuple[Tuned, ...]:
    """Return the stored gains; empty if there is no such file.

    Raises
    ------
    ValueError
        If the file holds something else.
    """
    if not path.exists():
        return ()
    try:
        return tuple(Tuned(**each) for each in json.loads(path.read_text(encoding="utf-8")))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{path} holds no tuned gains ({type(error).__name__}: {error}); restore it, or give "
            "another file"
        ) from None


def store(found: Tuned, path: Path = catalogue.STORE) -> None:
    """Put gains into the file, beside what others have put there, in place of older ones."""
    with storage.held(path, wait=60.0):
        stored = {each.key: each for each in (*load(path), found)}
        order = sorted(stored, key=lambda key: (key[1], -key[2], key[0]))
        storage.write_json(path, [dataclasses.asdict(stored[key]) for key in order])


@cache
def best(track: Track, force_scale: float) -> tuple[str, float]:
    """Return the best tuned baseline with the information of a track, and its rho [-].

    The rho is the mean over the held-out set, the best one that of the same set: the harder
    comparison for what is learned. NaN if none is tuned.
    """
    scenario = track.at(force_scale)
    found = [
        (_settled_rho(policy, track, force_scale, "held-out"), each.name.removesuffix(" (tuned)"))
        for each in catalogue.entries()
        if each.kind == "tuned" and may_enter(each.reads or "full", track)
        if (policy := each.make(scenario, track, force_scale)) is not None
    ]
    rho, law = min(found, default=(float("nan"), "none"))
    return law, rho


def _on_optimum(case: Episode) -> Episode:
    """Return the episode started on its own optimal steady motion, if it has one."""
    if not case.scenario.excitation.harmonic:
        return case
    plan = period_optimum(case.scenario)
    share = (case.phase / (2.0 * np.pi)) % 1.0
    x1, x2, v1, v2 = plan.x[int(share * (len(plan.x) - 1))].tolist()
    return dataclasses.replace(case, state=(x1, x2, v1, v2))


def _window(cases: Sequence[Episode], periods: int | None) -> int | None:
    """Return how many control intervals hold the periods of every case."""
    if periods is None:
        return None
    turns = min(each.scenario.excitation.omega * each.scenario.dt for each in cases)
    return math.ceil(periods * 2.0 * np.pi / turns)


class _Matrices:
    """Saturated linear policies, one for each car (see `LinearPolicy`)."""

    def __init__(self, policies: Sequence[LinearPolicy], n: int) -> None:
        self.reads = policies[0].reads
        self._gain = np.repeat(np.array([each.gain for each in policies]), n, axis=0)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, None]:
        """Return the actions (see `qcar_env.evaluation.policy.Policy`)."""
        seen = np.asarray(observation, dtype=np.float64)[:, :, np.newaxis]
        return np.clip(np.matmul(self._gain, seen)[:, :, 0], -1.0, 1.0), None


def _candidates(
    baseline: str, gains: Sequence[dict[str, float]], nominal: Scenario, n: int
) -> LawPolicy | _Matrices:
    """Return one policy for all candidates on n episodes each, candidate by candidate."""
    if baseline in catalogue.LAW_POLICIES:
        laws = [catalogue.LAW_POLICIES[baseline](**each) for each in gains]
        columns = np.array([law.numbers for law in laws], dtype=np.float64).T
        numbers = type(laws[0].numbers)(*(np.repeat(column, n) for column in columns))
        return LawPolicy(laws[0], nominal, numbers=numbers)
    twin = "lqr-feedforward" if baseline == "lqr-model" else baseline
    return _Matrices([catalogue.make(twin, nominal, **each) for each in gains], n)


def _good_starts(baseline: str, nominal: Scenario, count: int, rng: np.random.Generator) -> Array:
    """Return points that regulators with random weights make, for the matrix searches."""
    if baseline not in ("state", "linear"):
        return np.empty((0, 0))
    plant = sampled_plant(nominal)
    found: list[Array] = []
    for _ in range(count):
        q2, r1, r2 = 10.0 ** rng.uniform((-2.0, -4.0, -4.0), (2.0, 0.0, 0.0))
        k = -lqr.regulator(plant, Weights(q2=q2, r1=r1, r2=r2))
        if baseline == "linear":
            k = np.hstack([k, rng.uniform(0.0, 1.0) * ahead(nominal)])
            found.append(np.arcsinh(np.concatenate([k[:, :4].ravel(), k[:, 4:].ravel()])))
        else:
            found.append(np.arcsinh(k.ravel()))
    return np.array(found)
