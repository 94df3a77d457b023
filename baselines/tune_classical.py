"""Tune a controller of real cars: a global search of its gains on scenarios of one's own.

What is searched for is the least mean, over the scenarios, of the root mean square of acceleration,
travel and tyre deflection over what is acceptable of them: the measure that the designed
controllers are designed by, so that those of a few gains are compared with them at their best.

Search: differential evolution, as in `qcar_env.baselines.tune`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from qcar_env.control.preview import WEIGHTED, Acceptable
from qcar_env.evaluation.rollouts import rollout
from qcar_env.scenarios import Scenario
from qcar_env.validation import known, whole

from . import classical
from .actuation import is_valve
from .tune import LEAST_POPULATION, Search, search_of

CLASSICAL_SEARCHES: Mapping[str, Search] = MappingProxyType(
    {
        "passive": search_of(("stiffness", -2e4, 2e4, "linear"), ("damping", -3e3, 5e3, "linear")),
        "skyhook": search_of(("c_sky", 2.0, 4.5, "log")),
        "pid": search_of(("Kp", 2.0, 4.5, "log"), ("Ki", 1.0, 4.5, "log"), ("Kd", 0.0, 3.0, "log")),
        "sh-add": search_of(("crossover", -1.0, 1.5, "log")),
        "mix-1": search_of(("crossover", -1.0, 1.5, "log")),
        "hybrid-linear": search_of(("c_hook", 2.0, 4.5, "log"), ("share", 0.0, 1.0, "linear")),
    }
)
DAMPER = search_of(("damping", 0.0, 5e3, "linear"))  # of "passive", where there is no spring
REFUSED = 1e3  # [-] chosen here: the measure of a candidate whose car leaves its limits


@dataclass(frozen=True, kw_only=True)
class TunedClassical:
    """Gains that a search found, and how."""

    name: str
    gains: dict[str, float]
    measure: float  # what was searched for, with them [-]
    default: float  # and with the stated gains [-]
    evaluations: int  # candidates tried
    seed: int


def measure(
    policy: Any, scenarios: Sequence[Scenario], acceptable: Acceptable | None = None
) -> float:
    """Return the mean over scenarios of ``sqrt(mean (a2/a)^2 + (travel/d)^2 + (tyre/e)^2)`` [-].

    Parameters
    ----------
    policy : Policy or callable
        A policy, or what makes one from a scenario.
    scenarios : sequence of Scenario
        Each is driven from rest, once.
    acceptable : Acceptable, optional
        The sizes; its force does not count.
    """
    limits = Acceptable() if acceptable is None else acceptable
    size = np.array([limits.acceleration, limits.travel, limits.tyre])[:, np.newaxis]
    found: list[float] = []
    for each in scenarios:
        driver = policy if hasattr(policy, "predict") else policy(each)
        run = rollout(driver, each, observe=driver.reads, signals=WEIGHTED)
        if run.terminated:
            return REFUSED
        weighed = np.stack([run.signals[name] for name in WEIGHTED]) / size
        found.append(float(np.sqrt(np.mean(np.sum(weighed * weighed, axis=0)))))
    return float(np.mean(found))


def tune_classical(
    name: str,
    scenarios: Sequence[Scenario],
    *,
    acceptable: Acceptable | None = None,
    seed: int = 0,
    population: int = 8,
    generations: int = 20,
) -> TunedClassical:
    """Search the gains of a controller.

    Parameters
    ----------
    name : str
        One of `CLASSICAL_SEARCHES`.
    scenarios : sequence of Scenario
        What it is tuned on; compare on others.
    acceptable : Acceptable, optional
        The measure, see there.
    seed : int
        Of the search.
    population, generations : int
        Candidates in a generation for each gain, and generations at most.

    Raises
    ------
    ValueError
        If the controller has nothing to search, there is no scenario, or a number is out of range.
    """
    search = CLASSICAL_SEARCHES[known("controller to tune", name, CLASSICAL_SEARCHES)]
    whole("population", population, least=LEAST_POPULATION)
    whole("generations", generations)
    whole("seed", seed, least=0)
    if not scenarios:
        raise ValueError("scenarios must not be empty; give at least one")
    if name == "passive" and is_valve(scenarios[0]):
        search = DAMPER

    def of(gains: Mapping[str, float]) -> float:
        return measure(lambda each: classical.make(name, each, **gains), scenarios, acceptable)

    found = differential_evolution(
        lambda point: of(search.gains(point)),
        list(zip(search.low, search.high, strict=True)),
        popsize=population,
        maxiter=generations,
        tol=1e-3,
        polish=False,
        rng=np.random.default_rng(seed),
    )
    default, gains, best = of({}), search.gains(found.x), float(found.fun)
    if default < best:  # the search has not come to the stated gains
        gains, best = dict(classical.CLASSICAL[name].gains), default
    return TunedClassical(
        name=name,
        gains=gains,
        measure=best,
        default=default,
        evaluations=int(found.nfev) + 1,
        seed=seed,
    )
