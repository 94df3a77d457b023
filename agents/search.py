"""Policy search by CMA-ES: whole crossings, no gradient, behind the interface of `agents.trainer`.

Each candidate's gains drive their own cars to steady state; its value is the mean over the
crossings of ``max_i(a_i / A_i)``, as the benchmark scores it. N. Hansen's ``cma`` does the search,
`agents.law_crossings` drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cma
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents import crossing
from agents.law_crossings import cross
from agents.networks import LawNet, Schedule
from agents.recipes import Recipe, SearchSettings
from agents.trainer import Hook
from agents.training_env import space
from qcar_env.evaluation.tracks import episodes

Array = NDArray[np.float64]
WINDOW = 2.5  # [s] at the end of a crossing over which amplitudes are taken: 20 periods
GENERATIONS_A_HOOK = 5
SETTLE_EVERY = 10  # generations that begin where one law has settled


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One search of the training."""

    limit: int  # index of the force limit, in rising order
    refine: bool  # whether each node of road and force has gains of its own
    generations: int
    sigma: float


class SearchTrainer:
    """Searches the gains of a linear law, one force limit after another.

    Parameters
    ----------
    recipe : Recipe
        Algorithm ``cma``.
    seed : int
        Of the search and of the crossings drawn.

    Notes
    -----
    With several limits each has gains of its own (see `agents.networks.LawNet`): the search begins
    at the largest limit, and each further one begins at the law found before it. Where the law has
    nodes of road and force too, one law for all of them is searched first, and then refined.

    A crossing from rest needs 40 s to be steady. Where many cars cross, candidates begin where the
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
            2,
            schedule=self._schedule,
        )
        with torch.no_grad():
            self._net.gains[..., 0, 2] = self._net.gains[..., 1, 3] = -settings.velocity_gain
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
        """Search (see `agents.trainer.Trainer`)."""
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
        """Repeat the search up to a snapshot, without its crossings."""
        for values in snapshot["told"]:
            if self._within % SETTLE_EVERY == 0:
                self._settled = self._guess()
            self._tell(self._search.ask(), values.tolist())
        self._start = self._from(self._settled)

    def evaluate(self, candidates: Array) -> Array:
        """Return the value of each candidate, shape (k,), of parameters (k, p)."""
        peak, _ = self._cross(candidates, self._start, self._settings.crossing)
        relative = peak / self._plants.own
        value = relative.max(axis=2) + self._settings.least_weight * relative.min(axis=2)
        return value.mean(axis=1)

    def _cross(self, candidates: Array, z: Array, duration: float) -> tuple[Array, Array]:
        refine = self._stage.refine
        nodes = self._schedule.nodes if refine else 1
        gains = np.sinh(candidates).reshape(len(candidates), nodes, 2, -1)
        steps = round(duration / self._dt)
        return cross(
            gains,
            self._plants,
            z,
            steps=steps,
            window=min(math.ceil(WINDOW / self._dt), steps // 2),
            road_nodes=self._schedule.roads if refine else (1.0,),
            force_nodes=self._schedule.forces if refine else (1.0,),
        )

    def _settle(self) -> None:
        """Let the cars settle under the search's guess, where crossings begin there."""
        if self._settings.settle and self._within % SETTLE_EVERY == 0:
            self._settled = self._guess()
            self._start = self._from(self._settled)

    def _from(self, guess: Array | None) -> Array:
        if guess is None or not self._settings.settle:
            return self._z
        return self._cross(guess[np.newaxis], self._z, self._settings.settle)[1][0]

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
        drawn = episodes(
            recipe.track,
            "training",
            force_scale=self._limits[stage.limit],
            seed=self._seed,
            count=recipe.cars,
        )
        self._plants, self._z = crossing.of_track(drawn, recipe.track.nominal)
        self._start = self._z
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
