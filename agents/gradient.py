"""The analytic gradient: the crossing is differentiated through, behind `agents.trainer`.

The simulator is the torch form of the same equations: the maps that `agents.crossing` makes of
them, as torch tensors. The loss is the mean over cars and intervals of a soft maximum over the
masses of a_i / A_i; cars go on from where the last horizon left them, so that they live on the
motion that the policy itself makes, and a share of them begins anew.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from agents import crossing
from agents.networks import LawNet, Schedule
from agents.recipes import GradientSettings, Recipe
from agents.trainer import Hook, annealed
from agents.training_env import (
    generator_state,
    set_generator_state,
    space,
    training_plants,
)
from qcar_env.envs import task

FAR = 3.0  # [-] relative amplitude from which a car begins anew: beyond it episodes end


class GradientTrainer:
    """Trains a law with a small network by backpropagation through time.

    Parameters
    ----------
    recipe : Recipe
        Algorithm ``gradient``.
    seed : int
        Of network, cars and starts.
    """

    def __init__(self, recipe: Recipe, seed: int) -> None:
        settings = recipe.settings
        if not isinstance(settings, GradientSettings):
            raise ValueError(f"recipe {recipe.name!r} is not for the analytic gradient")
        torch.manual_seed(seed)
        self.recipe = recipe
        self._settings = settings
        self._rng = np.random.default_rng([seed, 30])
        self._nominal = recipe.track.nominal
        self._pool = training_plants(recipe.track, recipe.force_scales, seed)
        self._net = LawNet(
            space(recipe.track.observe, recipe.observe_limit),
            recipe.features,
            recipe.hidden,
            2,
            schedule=Schedule(limits=tuple(sorted(recipe.force_scales))),
        )
        with torch.no_grad():
            start = float(np.arcsinh(recipe.velocity_gain))
            self._net.gains[..., 0, 2] = self._net.gains[..., 1, 3] = -start
        self._adam = torch.optim.Adam(self._net.parameters(), lr=settings.learning_rate[0])
        self._index = self._rng.integers(len(self._pool), size=recipe.cars)
        self._z = torch.zeros(recipe.cars, crossing.SIZE)
        self._begin(np.arange(recipe.cars))
        self._done = 0

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._done

    def actor(self) -> nn.Module:
        """Return the policy so far."""
        return self._net

    def learn(self, hook: Hook) -> None:
        """Train (see `agents.trainer.Trainer`)."""
        while self._done < self.recipe.steps:
            if not hook():
                return
            self._iterate()
        hook()

    def snapshot(self) -> dict[str, Any]:
        """Return network, optimiser, cars and generators."""
        return {
            "net": copy.deepcopy(self._net.state_dict()),
            "optimiser": copy.deepcopy(self._adam.state_dict()),
            "z": self._z.clone(),
            "index": torch.tensor(self._index),
            "steps": self._done,
            "torch_generator": torch.get_rng_state(),
            "generator": generator_state(self._rng),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self._net.load_state_dict(snapshot["net"])
        self._adam.load_state_dict(snapshot["optimiser"])
        self._z = snapshot["z"].clone()
        self._index = snapshot["index"].numpy().copy()
        self._done = snapshot["steps"]
        torch.set_rng_state(snapshot["torch_generator"])
        set_generator_state(self._rng, snapshot["generator"])

    def _iterate(self) -> None:
        settings, recipe = self._settings, self.recipe
        cars = self._pool.pick(self._index)
        Z, U, O = (  # noqa: E741
            torch.as_tensor(each, dtype=torch.float32) for each in (cars.Z, cars.U, cars.O)
        )
        joint = torch.cat([Z, U], dim=1)
        limit = torch.as_tensor(cars.limit, dtype=torch.float32)[:, None]
        size = task.observation_size(recipe.track.observe, False)
        own = torch.as_tensor(self._own(), dtype=torch.float32)
        z = self._z
        loss = torch.zeros(())
        for _ in range(settings.horizon):
            seen = torch.bmm(z[:, None], O[:, :, :size])[:, 0]
            shown = torch.cat([seen, limit], dim=1) if recipe.observe_limit else seen
            a = self._leaky(self._net.command(shown))
            z = torch.bmm(torch.cat([z, a], dim=1)[:, None], joint)[:, 0]
            now = torch.bmm(z[:, None], O[:, :, :4])[:, 0]
            loss = loss + self._loss(now, own)
        loss = loss / settings.horizon
        self._adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self._net.parameters(), settings.max_grad_norm)
        for group in self._adam.param_groups:
            group["lr"] = annealed(settings.learning_rate, self._done / recipe.steps)
        self._adam.step()
        self._z = z.detach()
        self._done += settings.horizon * recipe.cars
        far = (now.detach().abs().amax(dim=1) > FAR).numpy()
        anew = np.flatnonzero((self._rng.random(recipe.cars) < settings.restart) | far)
        if len(anew):
            self._begin(anew)

    def _loss(self, now: Tensor, own: Tensor) -> Tensor:
        """Return the mean soft maximum of the masses' relative amplitudes."""
        squares = now[:, 0:2] * now[:, 0:2] + now[:, 2:4] * now[:, 2:4]
        a = torch.sqrt(squares + 1e-10) * own
        held = a.detach()
        scale = self._settings.temperature * held.amax(dim=1, keepdim=True)
        weight = torch.softmax(held / scale, dim=1)
        return torch.mean(torch.sum(weight * a, dim=1))

    def _own(self) -> Any:
        """Return reference over own uncontrolled amplitudes of the cars, shape (n, 2)."""
        nominal = np.array(self._nominal.reference_amplitudes)
        return nominal / self._pool.own[self._index]

    def _leaky(self, u: Tensor) -> Tensor:
        """Return the clipped command, with a slope outside for the gradient alone."""
        clipped = torch.clamp(u, -1.0, 1.0)
        outside = u - clipped
        return clipped + self._settings.leak * (outside - outside.detach())

    def _begin(self, which: Any) -> None:
        state, phase = task.draw_start(self._rng, self._nominal, len(which))
        self._index[which] = self._rng.integers(len(self._pool), size=len(which))
        self._z[torch.as_tensor(which)] = torch.as_tensor(
            crossing.start(state, phase), dtype=torch.float32
        )
