"""Policy search by CMA-ES: whole episodes, no gradient (`qcar_env.agents.trainer`).

Each candidate's gains drive cars of their own, all in one fleet, to steady state; a candidate's
value is the mean over the episodes of ``max_i(a_i / A_i)``, as the benchmark scores it. N.
Hansen's ``cma`` does the search, `qcar_env.engine.cars.Cars.drive` the driving.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cma
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from qcar_env.agents.networks import LawNet, Schedule, space
from qcar_env.agents.recipes import Recipe, SearchSettings
from qcar_env.agents.trainer import Hook
from qcar_env.engine.held_law import linear_law
from qcar_env.envs.episode import observed
from qcar_env.evaluation.robustness import beside, loss_beside
from qcar_env.evaluation.rollouts import fleet
from qcar_env.evaluation.tracks import Episode, episodes

Array = NDArray[np.float64]
WINDOW = 2.5  # [s] at the end of an episode over which amplitudes are taken: 20 periods
GENERATIONS_A_HOOK = 5
SETTLE_EVERY = 10  # generations that begin where one law has settled


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One search of the training."""

    limit: int  # index of the force limit, in rising order
    refine: bool  # whether each node of road and force has gains of its own
    generations: int
    sigma: float


def share(value: Any, nodes: Any, i: Any) -> Any:
    """Return the share of node `i` at a value: hat functions, constant outside."""
    last = len(nodes) - 1
    held = min(max(value, nodes[0]), nodes[last])
    up = 1.0 if i == 0 else (held - nodes[i - 1]) / (nodes[i] - nodes[i - 1])
    down = 1.0 if i == last else (nodes[i + 1] - held) / (nodes[i + 1] - nodes[i])
    return max(0.0, min(up, down, 1.0))


def scheduled_law(seen: Any, gains: Any, nodes: Any, action: Any) -> None:
    """Write the action of a law with gains (j, m, 8) at the `nodes` of road and force.

    The force's nodes are the fastest (see `qcar_env.agents.networks.LawNet`).
    """
    roads, forces = nodes
    road = math.sqrt(seen[4] * seen[4] + seen[5] * seen[5])
    force = math.sqrt(seen[6] * seen[6] + seen[7] * seen[7])
    for a in range(action.shape[0]):
        action[a] = 0.0
    for i in range(len(roads)):
        for j in range(len(forces)):
            weight = share(road, roads, i) * share(force, forces, j)
            if weight > 0.0:
                for a in range(action.shape[0]):
                    command = 0.0
                    for q in range(gains.shape[2]):
                        command += gains[i * len(forces) + j, a, q] * seen[q]
                    action[a] += weight * command
    for a in range(action.shape[0]):
        action[a] = min(max(action[a], -1.0), 1.0)


class Runs:
    """A fleet in which laws drive the episodes of a track, each law all of them.

    Parameters
    ----------
    drawn : sequence of Episode
        Of one set at one force limit.
    laws : int
        How many laws.
    observe : str
        What they see.
    """

    def __init__(self, drawn: Sequence[Episode], laws: int, observe: Any) -> None:
        self.cars, nominal = fleet(list(drawn) * laws, observed(observe))
        self._shape = (laws, len(drawn), -1)
        self._uniforms = np.zeros((len(drawn), self.cars.uniforms.shape[1]))
        for row, each in zip(self._uniforms, drawn, strict=True):
            row[: len(each.uniforms)] = each.uniforms
        self.start = np.array([(*each.state, each.phase) for each in drawn])
        self.own = np.array([each.scenario.reference_amplitudes for each in drawn])
        self._dt = nominal.dt

    def drive(
        self, gains: Array, duration: float, nodes: tuple[tuple[float, ...], tuple[float, ...]]
    ) -> Array:
        """Drive from `start`; return the largest |x1|, |x2| at the end, (laws, n, 2) [m].

        Parameters
        ----------
        gains : ndarray (laws, j, m, k)
            Gains at the nodes.
        duration : float
            Length of an episode [s].
        nodes : tuple
            Of road and force (see `qcar_env.agents.networks.Schedule`).
        """
        laws = len(gains)
        scheduled = gains.shape[1] > 1
        seen = self.cars.reset(
            np.ones(self.cars.n, dtype=bool),
            np.tile(self.start, (laws, 1)),
            np.tile(self._uniforms, (laws, 1)),
        )
        intervals = round(duration / self._dt)
        peak = self.cars.drive(
            scheduled_law if scheduled else linear_law,
            gains if scheduled else np.ascontiguousarray(gains[:, 0]),
            seen,
            intervals=intervals,
            window=min(math.ceil(WINDOW / self._dt), intervals // 2),
            shared=tuple(np.array(each) for each in nodes),
        )
        return peak.reshape(self._shape)

    @property
    def now(self) -> Array:
        """Where the cars stand: states and phases that another run can begin with, (n, 5)."""
        elapsed = self.cars.clock("elapsed") * self._dt * self.cars.driven("omega")[0]
        return np.column_stack([self.cars.states, self.cars.phases + elapsed])


class SearchTrainer:
    """Searches the gains of a linear law, one force limit after another.

    Parameters
    ----------
    recipe : Recipe
        Algorithm ``cma``.
    seed : int
        Of the search and of the episodes drawn.

    Notes
    -----
    With several limits each has gains of its own (see `qcar_env.agents.networks.LawNet`): the
    search begins at the largest limit, and each further one begins at the law found before it.
    Where the law has nodes of road and force too, one law for all of them is searched first, and
    then refined.

    An episode from rest needs 40 s to be steady. Where there are many, candidates begin where the
    search's own guess has settled (`SearchSettings.settle`): they differ from it by little, and a
    few seconds tell which is better.
    """

    def __init__(self, recipe: Recipe, seed: int) -> None:
        settings = recipe.settings
        if not isinstance(settings, SearchSettings):
            raise ValueError(f"recipe {recipe.name!r} is not for CMA-ES")
        torch.manual_seed(seed)
        self.recipe = recipe
        self._settings = settings
        self._seed = seed
        limits = sorted(recipe.force_scales)
        self._limits = limits
        self._schedule = Schedule(
            limits=tuple(limits), roads=settings.road_nodes, forces=settings.force_nodes
        )
        self._net = LawNet(
            space(recipe.track.observe, recipe.observe_limit),
            recipe.features,
            (),
            recipe.scenario.actuator.size,
            schedule=self._schedule,
        )
        self._net.begin_at_velocity_feedback(settings.velocity_gain)
        self._stages = [
            Stage(limit=limit, refine=refine, generations=generations, sigma=sigma)
            for limit in reversed(range(len(limits)))
            for refine, generations, sigma in (
                (False, settings.generations, settings.sigma),
                (True, settings.refine_generations, settings.refine_sigma),
            )
            if generations
        ]
        self._told: list[list[float]] = []
        self._begin(0)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return len(self._told) * self.recipe.cars * self._settings.steps_a_generation(self._dt)

    @property
    def _dt(self) -> float:
        return self.recipe.track.nominal.dt

    def actor(self) -> nn.Module:
        """Return the law at the search's own guess of the best, which is calmer than a draw."""
        self._keep()
        return self._net

    def learn(self, hook: Hook) -> None:
        """Search (see `qcar_env.agents.trainer.Trainer`)."""
        generations = sum(stage.generations for stage in self._stages)
        while len(self._told) < generations and self.steps < self.recipe.steps:
            if len(self._told) % GENERATIONS_A_HOOK == 0 and not hook():
                return
            self._settle()
            candidates = self._search.ask()
            self._tell(candidates, self.evaluate(np.array(candidates)).tolist())
        hook()

    def snapshot(self) -> dict[str, Any]:
        """Return the values told so far: with the seed they are the whole search."""
        return {"told": [torch.tensor(values, dtype=torch.float64) for values in self._told]}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Repeat the search up to a snapshot, without driving again."""
        for values in snapshot["told"]:
            if self._within % SETTLE_EVERY == 0:
                self._settled = self._guess()
            self._tell(self._search.ask(), values.tolist())
        self._runs.start = self._from(self._settled)

    def evaluate(self, candidates: Array) -> Array:
        """Return the value of each candidate, shape (k,), of parameters (k, p)."""
        runs = self._runs
        peak = self._drive(runs, candidates, self._settings.length)
        relative = peak / runs.own
        rho, other = relative.max(axis=2), relative.min(axis=2)
        value = rho[:, : self._counted] + self._settings.least_weight * other[:, : self._counted]
        return value.mean(axis=1) + (loss_beside(rho[:, self._counted :]) if self._margin else 0.0)

    def _drive(self, runs: Runs, candidates: Array, duration: float) -> Array:
        schedule = self._schedule if self._stage.refine else Schedule()
        shape = (len(candidates), schedule.nodes, *self._net.gains.shape[2:])
        gains = np.sinh(candidates).reshape(shape)
        return runs.drive(gains, duration, (schedule.roads, schedule.forces))

    def _settle(self) -> None:
        """Let the cars settle under the search's guess, where runs begin there."""
        if self._settings.settle and self._within % SETTLE_EVERY == 0:
            self._settled = self._guess()
            self._runs.start = self._from(self._settled)

    def _from(self, guess: Array | None) -> Array:
        alone = Runs(self._drawn, 1, self.recipe.track.observe)
        if guess is None or not self._settings.settle:
            return alone.start
        self._drive(alone, guess[np.newaxis], self._settings.settle)
        return alone.now

    def _guess(self) -> Array:
        found: Any = self._search.result.xfavorite
        return np.array(found, dtype=np.float64)

    def _tell(self, candidates: Any, values: list[float]) -> None:
        self._search.tell(candidates, values)
        self._told.append(values)
        self._within += 1
        if self._within == self._stage.generations and self._number + 1 < len(self._stages):
            self._keep()
            self._begin(self._number + 1)

    def _keep(self) -> None:
        """Write the law of the running stage into the policy, and into the stages to come."""
        law = torch.as_tensor(self._guess(), dtype=torch.float32)
        own = self._net.gains[0].shape  # (J, m, size)
        with torch.no_grad():
            for limit in range(self._stage.limit + 1):
                if self._stage.refine:
                    self._net.gains[limit] = law.reshape(own)
                else:
                    self._net.gains[limit] = law.reshape(own[1:]).expand(own)

    def _begin(self, number: int) -> None:
        self._number, self._within = number, 0
        stage = self._stage = self._stages[number]
        recipe, settings = self.recipe, self._settings
        # A quarter of the cars is there for the margin, where no draw brings other speeds.
        self._margin = 0 if recipe.track.nominal.randomisation else recipe.cars // 4
        self._counted = recipe.cars - self._margin
        drawn = episodes(
            recipe.track,
            "training",
            force_scale=self._limits[stage.limit],
            seed=self._seed,
            count=self._counted,
        )
        self._drawn = (*drawn, *beside(drawn[: self._margin]))
        self._runs = Runs(self._drawn, settings.population, recipe.track.observe)
        self._settled: Array | None = None
        here = self._net.gains[stage.limit].detach().numpy().astype(np.float64)
        self._search = cma.CMAEvolutionStrategy(
            (here if stage.refine else here[0]).ravel(),
            stage.sigma,
            {
                "seed": self._seed + 1,
                "popsize": settings.population,
                "bounds": [-settings.bound, settings.bound],
                "verbose": -9,
            },
        )
