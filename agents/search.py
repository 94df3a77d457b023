"""Policy search by CMA-ES: whole crossings, no gradient, behind the interface of `agents.trainer`.

Each candidate's gains drive their own cars from rest to true steady state; its value is the mean
over the crossings of ``max_i(a_i / A_i)``, as the benchmark scores it. N. Hansen's ``cma`` does the
search.
"""

from __future__ import annotations

import math
from typing import Any

import cma
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents import crossing
from agents.networks import LawNet
from agents.recipes import Recipe, SearchSettings
from agents.trainer import Hook
from agents.training_env import space
from qcar_env.evaluation.tracks import episodes

Array = NDArray[np.float64]
WINDOW = 2.5  # [s] at the end of a crossing over which amplitudes are taken: 20 periods
GENERATIONS_A_HOOK = 5


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
    at the largest limit, and each further one begins at the law found before it.
    """

    def __init__(self, recipe: Recipe, seed: int) -> None:
        settings = recipe.settings
        if not isinstance(settings, SearchSettings):
            raise ValueError(f"recipe {recipe.name!r} is not for CMA-ES")
        torch.manual_seed(seed)
        self.recipe = recipe
        self._settings = settings
        self._seed = seed
        self._stages = sorted(recipe.force_scales, reverse=True)
        self._net = LawNet(
            space(recipe.track.observe, recipe.observe_limit),
            recipe.features,
            (),
            2,
            limits=recipe.force_scales,
        )
        with torch.no_grad():
            self._net.gains[:, 0, 2] = self._net.gains[:, 1, 3] = -settings.velocity_gain
        self._told: list[list[float]] = []
        count = max(1, recipe.cars)
        steps = round(settings.crossing / recipe.track.nominal.dt)
        self._per_generation = settings.population * count * steps
        self._generations = max(1, recipe.steps // (self._per_generation * len(self._stages)))
        self._begin(0)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return len(self._told) * self._per_generation

    def actor(self) -> nn.Module:
        """Return the law at the search's own guess of the best, which is calmer than a draw."""
        self._keep()
        return self._net

    def learn(self, hook: Hook) -> None:
        """Search (see `agents.trainer.Trainer`)."""
        while len(self._told) < self._generations * len(self._stages):
            if len(self._told) % GENERATIONS_A_HOOK == 0 and not hook():
                return
            candidates = self._search.ask()
            self._tell(candidates, self.evaluate(np.array(candidates)).tolist())
        hook()

    def snapshot(self) -> dict[str, Any]:
        """Return the values told so far: with the seed they are the whole search."""
        return {"told": torch.tensor(self._told, dtype=torch.float64)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Repeat the search up to a snapshot, without its crossings."""
        for values in snapshot["told"].tolist():
            self._tell(self._search.ask(), values)

    def evaluate(self, candidates: Array) -> Array:
        """Return the value of each candidate, shape (k,), of parameters (k, p)."""
        k, n = len(candidates), len(self._plants)
        gains = np.sinh(candidates).reshape(k, 2, -1)
        size = gains.shape[2]
        # The command is a row on z: observation and gains combine, so an interval is two products.
        law = np.matmul(self._plants.O[:, None, :, :size], np.swapaxes(gains, 1, 2)[None])
        joint = np.concatenate([self._plants.Z, self._plants.U], axis=1)  # (n, 10, 8)
        z = np.repeat(self._z[:, None, :], k, axis=1)  # (n, k, 8): cars with one map together
        steps = round(self._settings.crossing / self._plants.dt)
        window = math.ceil(WINDOW / self._plants.dt)
        peak = np.zeros((n, k, 2))
        for step in range(steps):
            a = np.clip(np.matmul(z[:, :, None, :], law)[:, :, 0], -1.0, 1.0)
            z = np.matmul(np.concatenate([z, a], axis=2), joint)
            if step >= steps - window:
                np.maximum(peak, np.abs(z[:, :, :2]), out=peak)
        relative = peak / self._plants.own[:, None, :]
        value = relative.max(axis=2) + self._settings.least_weight * relative.min(axis=2)
        return value.mean(axis=0)

    def _tell(self, candidates: Any, values: list[float]) -> None:
        self._search.tell(candidates, values)
        self._told.append(values)
        stage, within = divmod(len(self._told), self._generations)
        if within == 0 and stage < len(self._stages):
            self._keep()
            self._begin(stage)

    def _node(self) -> int:
        return sorted(self._stages).index(self._stages[self._stage])

    def _keep(self) -> None:
        """Write the law of the running stage into the policy, and into the stages to come."""
        found: Any = self._search.result.xfavorite
        law = torch.as_tensor(np.asarray(found), dtype=torch.float32)
        with torch.no_grad():
            for node in range(self._node() + 1):
                self._net.gains[node] = law.reshape(self._net.gains.shape[1:])

    def _begin(self, stage: int) -> None:
        self._stage = stage
        recipe, settings = self.recipe, self._settings
        drawn = episodes(
            recipe.track,
            "training",
            force_scale=self._stages[stage],
            seed=self._seed,
            count=recipe.cars,
        )
        self._plants, self._z = crossing.of_track(drawn, recipe.track.nominal)
        start = self._net.gains[self._node()].detach().numpy().astype(np.float64)
        self._search = cma.CMAEvolutionStrategy(
            start.ravel(),
            settings.sigma,
            {
                "seed": self._seed + 1,
                "popsize": settings.population,
                "bounds": [-settings.bound, settings.bound],
                "verbose": -9,
            },
        )
