"""Policy search by CMA-ES: whole crossings, no gradient, behind the interface of `agents.trainer`.

Each candidate's gains drive their own cars from rest to true steady state; its value is the mean
over the crossings of ``max_i(a_i / A_i)``, as the benchmark scores it, relative to the optimum
where several force limits count. N. Hansen's ``cma`` does the search.
"""

from __future__ import annotations

import math
from typing import Any

import cma
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from agents import crossing, scoring
from agents.networks import LawNet
from agents.recipes import Recipe, SearchSettings
from agents.trainer import Hook
from agents.training_env import space
from qcar_env.envs import task
from qcar_env.evaluation.tracks import episodes

Array = NDArray[np.float64]
WINDOW = 2.5  # [s] at the end of a crossing over which amplitudes are taken: 20 periods
EASY = 0.01  # [-] rho below which limits count alike: there the force suffices
GENERATIONS_A_HOOK = 5


class SearchTrainer:
    """Searches the gains of a linear law.

    Parameters
    ----------
    recipe : Recipe
        Algorithm ``cma``.
    seed : int
        Of the search and of the crossings drawn.
    """

    def __init__(self, recipe: Recipe, seed: int) -> None:
        settings = recipe.settings
        if not isinstance(settings, SearchSettings):
            raise ValueError(f"recipe {recipe.name!r} is not for CMA-ES")
        torch.manual_seed(seed)
        self.recipe = recipe
        self._settings = settings
        self._net = LawNet(
            space(recipe.track.observe, recipe.observe_limit), recipe.features, (), 2
        )
        drawn = training_episodes(recipe, seed)
        self._plants, self._z = crossing.of_track(drawn, recipe.track.nominal)
        self._own = np.array([each.scenario.reference_amplitudes for each in drawn])
        self._weight = np.array([1.0 / max(scoring.optimum(each.scenario), EASY) for each in drawn])
        self._weight /= np.mean(self._weight)
        if len(recipe.force_scales) == 1:
            self._weight[:] = 1.0
        self._per_generation = (
            settings.population * len(drawn) * round(settings.crossing / self._plants.dt)
        )
        self._told: list[list[float]] = []
        self._seed = seed
        self._search = self._new_search()

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return len(self._told) * self._per_generation

    def actor(self) -> nn.Module:
        """Return the law at the search's mean, which is calmer than its best draw."""
        mean: Any = self._search.result.xfavorite
        vector_to_parameters(
            torch.as_tensor(np.asarray(mean), dtype=torch.float32), self._net.parameters()
        )
        return self._net

    def learn(self, hook: Hook) -> None:
        """Search (see `agents.trainer.Trainer`)."""
        while self.steps < self.recipe.steps and not self._search.stop():
            if len(self._told) % GENERATIONS_A_HOOK == 0 and not hook():
                return
            candidates = self._search.ask()
            values = self.evaluate(np.array(candidates)).tolist()
            self._search.tell(candidates, values)
            self._told.append(values)
        hook()

    def snapshot(self) -> dict[str, Any]:
        """Return the values told so far: with the seed they are the whole search."""
        return {"told": torch.tensor(self._told, dtype=torch.float64), "seed": self._seed}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Repeat the search up to a snapshot, without its crossings."""
        self._seed = snapshot["seed"]
        self._search = self._new_search()
        self._told = []
        for values in snapshot["told"].tolist():
            self._search.tell(self._search.ask(), values)
            self._told.append(values)

    def evaluate(self, candidates: Array) -> Array:
        """Return the value of each candidate, shape (k,), of parameters (k, p)."""
        k, n = len(candidates), len(self._plants)
        gains = np.sinh(candidates).reshape(k, 2, -1)
        recipe = self.recipe
        size = task.observation_size(recipe.track.observe, False)
        # Command as a row on z: observation O and gains K combine, so a step is two products.
        O = self._plants.O[None, :, :, :size]  # noqa: E741  (1, n, 8, size)
        K = np.swapaxes(gains, 1, 2)[:, None]  # (k, 1, inputs, 2)
        if recipe.observe_limit:
            K = K[:, :, :size] + K[:, :, size:] / self._plants.limit[None, :, None, None]
        law = np.swapaxes(np.matmul(O, K), 0, 1).reshape(n, k, crossing.SIZE, 2)
        Z, U = self._plants.Z, self._plants.U
        z = np.repeat(self._z[:, None, :], k, axis=1)  # (n, k, 8): cars with one map together
        steps = round(self._settings.crossing / self._plants.dt)
        window = math.ceil(WINDOW / self._plants.dt)
        peak = np.zeros((n, k, 2))
        joint = np.concatenate([Z, U], axis=1)  # (n, 10, 8)
        for step in range(steps):
            a = np.clip(np.matmul(z[:, :, None, :], law)[:, :, 0], -1.0, 1.0)
            z = np.matmul(np.concatenate([z, a], axis=2), joint)
            if step >= steps - window:
                np.maximum(peak, np.abs(z[:, :, :2]), out=peak)
        relative = peak / self._own[:, None, :]
        value = relative.max(axis=2) + self._settings.least_weight * relative.min(axis=2)
        return self._weight @ value / n

    def _new_search(self) -> Any:
        settings = self._settings
        start = np.zeros(tuple(self._net.gains.shape))
        start[0, 2] = start[1, 3] = -settings.velocity_gain
        return cma.CMAEvolutionStrategy(
            start.ravel(),
            settings.sigma,
            {
                "seed": self._seed + 1,
                "popsize": settings.population,
                "bounds": [-settings.bound, settings.bound],
                "verbose": -9,
            },
        )

    def parameters(self) -> Array:
        """Return the parameters of the law so far."""
        return parameters_to_vector(self._net.parameters()).detach().numpy().astype(np.float64)


def training_episodes(recipe: Recipe, seed: int) -> list[Any]:
    """Return the crossings of a search: the recipe's number, over all its force limits."""
    scales = recipe.force_scales
    count = max(1, recipe.cars // len(scales))
    return [
        each
        for scale in scales
        for each in episodes(recipe.track, "training", force_scale=scale, seed=seed, count=count)
    ]
