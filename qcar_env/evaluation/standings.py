"""Rank policies by their rows, and say in sentences what was found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_env.evaluation.score import Row
from qcar_env.evaluation.statistics import (
    Interval,
    bootstrap,
    cvar,
    improvement_interval,
    mean,
)
from qcar_env.validation import whole

ALIKE = 0.01  # [-] relative difference of rho that no driver would feel


@dataclass(frozen=True, kw_only=True)
class Standing:
    """A policy's place at one force limit of a track."""

    policy: str
    kind: str
    reads: str
    track: str
    force_scale: float
    rho: Interval  # mean over the episodes [-]
    cvar: float  # mean of the worst 5 % of them [-]
    worst: float  # [-]
    above: float  # share of them that end above no control, by more than `ALIKE` [-]
    settling: float  # median of their settling times [s]
    optimum: float  # mean of the lower bounds [-]; not a number where none is known
    improvement: Interval | None  # probability of a lower rho than the reference's [-]
    terminated: int  # episodes that left the travel limits

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

    Raises
    ------
    ValueError
        If the seed is no whole number of at least 0.
    """
    whole("seed", seed, least=0)
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
                    rho=bootstrap([values], mean, rng),
                    cvar=float(cvar(values)),
                    worst=max(values),
                    above=float(np.mean(np.array(values) > 1.0 + ALIKE)),
                    settling=float(np.median([row.settling_time for row in each])),
                    optimum=float(mean(bounds[key])) if bounds[key] else float("nan"),
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
            continue  # the same episodes
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
    if np.isnan(standing.optimum):
        return f"{value}, where no optimum is known"
    if standing.optimum <= 1e-4:
        return f"{value}, where the optimum is stillness"
    return f"{value}, {100.0 * (standing.over_optimum - 1.0):.1f} % above the optimum"
