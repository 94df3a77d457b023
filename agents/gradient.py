"""The analytic gradient: the motion is differentiated through, behind `qcar_env.agents.trainer`.

The simulator is the plant itself: the functions that the engine compiles run on torch tensors as
they stand. Of a linear plant the map over a control interval is read off them, by applying them to
unit vectors, and one product does for sixteen stages. The loss is the mean over cars and intervals
of a soft maximum over the masses of a_i / A_i; cars go on from where the last horizon left them, so
that they live on the motion that the policy itself makes, and a share of them begins anew.
"""

from __future__ import annotations

import copy
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from qcar_env.agents.networks import LawNet, Schedule, space
from qcar_env.agents.recipes import GradientSettings, Recipe
from qcar_env.agents.trainer import (
    Hook,
    annealed,
    arrays,
    generator_state,
    set_generator_state,
    tensors,
)
from qcar_env.engine.cars import Cars
from qcar_env.engine.random import streams
from qcar_env.engine.stepping import compose
from qcar_env.engine.storage import NOTHING_GIVEN
from qcar_env.envs.episode import OBSERVATION_LIMIT, Settings
from qcar_env.physics import tree
from qcar_env.physics.motion import Input, turning_step
from qcar_env.physics.plant import plant_functions
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.signals import Moment
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.plan import Plan

FAR = 3.0  # [-] relative amplitude from which a car begins anew: beyond it episodes end


class Motion:
    """Cars of a fleet in torch: what drives on is ``z``, state and phasors in one row for each.

    Parameters
    ----------
    scenario : Scenario
        What they draw their episodes from.
    plan : Plan
        The same for a fleet.
    n, seed : int
        How many, and of their draws.

    Raises
    ------
    ValueError
        If the road has kinks or is read from samples, or torch cannot run a part or signal.
    """

    def __init__(self, scenario: Scenario, plan: Plan, n: int, seed: int) -> None:
        made = plan.composition
        if made.road.pieces is None or not scenario.excitation.harmonic:
            raise ValueError(
                "the analytic gradient needs an endless sine as its road, got "
                f"{type(scenario.road).__name__}; train with ppo, sac or cma"
            )
        self._scenario = scenario
        kernels = compose(made, False)
        self._like = kernels.moving.trees["state"], kernels.moving.trees["phasors"]
        self._kind: Any = made.actuator
        self._check(plan, kernels.fixed.trees["driven"])
        self.cars = Cars(n, plan)
        self.cars.seed(np.arange(n), streams(range(seed * n, seed * n + n)))
        self._rate = plant_functions(made.car, made.actuator).rate
        self._step, self._substeps = step_fractions(plan.dt / plan.substeps), plan.substeps
        self._linear = scenario.car.linear and scenario.actuator.linear
        self.own = torch.zeros(n, 2)  # uncontrolled amplitudes of each car's episode [m]
        self.z = torch.zeros(n, len(tree.flat(self._like)))
        self.begin(np.arange(n))

    def begin(self, which: Any) -> None:
        """Begin episodes of the cars in `which`."""
        self.cars.begin(which, NOTHING_GIVEN, np.empty((self.cars.n, self.cars.size), np.float32))
        drawn = [self._scenario.drawn(self.cars.uniforms[i].tolist()) for i in which]
        self.own[which] = torch.tensor([each.reference_amplitudes for each in drawn])
        begun = tree.flat((self.cars.entries("state"), self.cars.entries("phasors")))
        self.z[which] = torch.tensor(np.array(begun).T[which], dtype=torch.float32)
        self._prepare()

    def snapshot(self) -> dict[str, Any]:
        """Return all that moves."""
        return {"cars": tensors(self.cars.snapshot()), "z": self.z.clone(), "own": self.own.clone()}

    def restore(self, kept: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self.cars.restore(arrays(kept["cars"]))
        self.z, self.own = kept["z"].clone(), kept["own"].clone()
        self._prepare()

    def advance(self, z: Tensor, action: Tensor) -> Tensor:
        """Return z after a control interval under an action within [-1, 1], (n, m)."""
        if self._linear:
            return torch.bmm(torch.cat([z, action], dim=1)[:, None], self._map)[:, 0]
        return torch.stack(self._interval(z.unbind(1), action.unbind(1), self._driven), dim=1)

    def seen(self, z: Tensor, action: Tensor) -> Tensor:
        """Return the observation, shape (n, k), while an action is held."""
        x, w = tree.unflat(self._like, z.unbind(1))
        command = self._kind.command(action.unbind(1), self._driven.actuator)
        found = self.cars.kernels.entries(x, w, command, self._driven, self._read)
        limit = OBSERVATION_LIMIT
        return torch.clamp(torch.stack(torch.broadcast_tensors(*found), dim=1), -limit, limit)

    def _interval(self, z: Any, action: Any, fixed: Any) -> tuple[Tensor, ...]:
        x, w = tree.unflat(self._like, z)
        command = self._kind.command(action, fixed.actuator)
        for _ in range(self._substeps):
            x, w = turning_step(self._rate, x, w, fixed.turning, self._step, command, fixed)
        return tree.flat((x, w))

    def _prepare(self) -> None:
        """Take what the episodes fix, and of a linear plant the maps (n, k + m, k)."""
        driven, read = (
            tree.unflat(found, [torch.tensor(each) for each in tree.flat(found)])
            for found in (self.cars.entries("driven"), self.cars.entries("read"))
        )
        if self._linear:
            k, m = self.z.shape[1], self.cars.actions
            unit = torch.eye(k + m, dtype=torch.float64)[:, :, None]
            columns = self._interval(unit[:k], unit[k:], driven)
            wide = torch.stack(torch.broadcast_tensors(*columns, driven.speed)[:-1])
            self._map = wide.permute(2, 1, 0).float().contiguous()
        self._driven, self._read = (
            tree.unflat(each, [number.float() for number in tree.flat(each)])
            for each in (driven, read)
        )

    def _check(self, plan: Plan, numbers: Any) -> None:
        """Refuse by name what torch cannot run."""
        some = torch.full((2,), 0.1, requires_grad=True)
        (x, _), fixed = (
            tree.unflat(like, [some] * len(tree.flat(like))) for like in (self._like, numbers)
        )
        car, kind = plan.composition.car, self._kind
        command = (some,) * kind.size
        input = Input(car.road_input(some, some, fixed.car), some)
        now = Moment(x.car, x.car, *(some,) * (len(Moment._fields) - 2))
        tried: list[tuple[str, Any]] = [
            (
                f"car {type(self._scenario.car).__name__}",
                lambda: car.rate(x.car, input, some, some, fixed.car),
            ),
            (
                f"actuator {kind.__name__}",
                lambda: (
                    kind.force(
                        x.memory, kind.command(command, fixed.actuator), some, fixed.actuator
                    ),
                    kind.State._fields and kind.rate(x.memory, command, some, fixed.actuator),
                ),
            ),
            *(
                (f"signal {each.name!r}", partial(each.reading, now, fixed))
                for each in plan.observed
            ),
        ]
        for name, run in tried:
            try:
                run()
            except Exception as error:  # whatever a function of one's own may raise
                raise ValueError(
                    f"the analytic gradient cannot differentiate {name} ({error}); write it with "
                    "+ - * /, comparisons and the functions of qcar_env.parts.part, or train with "
                    "ppo, sac or cma"
                ) from error


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
        scenario, track = recipe.scenario, recipe.track
        shown = Settings(track.observe, recipe.observe_limit, "amplitudes", None, None)
        self._cars = Motion(scenario, shown.plan(scenario, 1.0), recipe.cars, seed)
        self._nominal = torch.tensor(scenario.reference_amplitudes)
        self._net = LawNet(
            space(recipe.track.observe, recipe.observe_limit),
            recipe.features,
            recipe.hidden,
            scenario.actuator.size,
            schedule=Schedule(limits=tuple(sorted(recipe.force_scales))),
        )
        self._net.begin_at_velocity_feedback(float(np.arcsinh(recipe.velocity_gain)))
        self._adam = torch.optim.Adam(self._net.parameters(), lr=settings.learning_rate[0])
        self._held = torch.zeros(recipe.cars, scenario.actuator.size)  # last action
        self._done = 0

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self._done

    def actor(self) -> nn.Module:
        """Return the policy so far."""
        return self._net

    def learn(self, hook: Hook) -> None:
        """Train (see `qcar_env.agents.trainer.Trainer`)."""
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
            "cars": self._cars.snapshot(),
            "held": self._held.clone(),
            "steps": self._done,
            "torch_generator": torch.get_rng_state(),
            "generator": generator_state(self._rng),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self._net.load_state_dict(snapshot["net"])
        self._adam.load_state_dict(snapshot["optimiser"])
        self._cars.restore(snapshot["cars"])
        self._held = snapshot["held"].clone()
        self._done = snapshot["steps"]
        torch.set_rng_state(snapshot["torch_generator"])
        set_generator_state(self._rng, snapshot["generator"])

    def _iterate(self) -> None:
        settings, recipe, cars = self._settings, self.recipe, self._cars
        own = self._nominal / cars.own
        z, a = cars.z, self._held
        now = cars.seen(z, a)
        loss = torch.zeros(())
        for _ in range(settings.horizon):
            a = self._leaky(self._net.command(now))
            z = cars.advance(z, a)
            now = cars.seen(z, a)
            loss = loss + self._loss(now, own)
        loss = loss / settings.horizon
        self._adam.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self._net.parameters(), settings.max_grad_norm)
        if not torch.isfinite(norm):
            raise ValueError(
                f"the gradient must be finite, got {float(norm)} after {self._done} steps; give a "
                "lower learning rate"
            )
        for group in self._adam.param_groups:
            group["lr"] = annealed(settings.learning_rate, self._done / recipe.steps)
        self._adam.step()
        cars.z, self._held = z.detach(), a.detach()
        self._done += settings.horizon * recipe.cars
        far = (now[:, :4].detach().abs().amax(dim=1) > FAR).numpy()
        anew = np.flatnonzero((self._rng.random(recipe.cars) < settings.restart) | far)
        if len(anew):
            cars.begin(anew)
            self._held[anew] = 0.0

    def _loss(self, now: Tensor, own: Tensor) -> Tensor:
        """Return the mean soft maximum of the masses' relative amplitudes."""
        squares = now[:, 0:2] * now[:, 0:2] + now[:, 2:4] * now[:, 2:4]
        a = torch.sqrt(squares + 1e-10) * own
        held = a.detach()
        scale = self._settings.temperature * held.amax(dim=1, keepdim=True)
        weight = torch.softmax(held / scale, dim=1)
        return torch.mean(torch.sum(weight * a, dim=1))

    def _leaky(self, u: Tensor) -> Tensor:
        """Return the clipped command, with a slope outside for the gradient alone."""
        clipped = torch.clamp(u, -1.0, 1.0)
        outside = u - clipped
        return clipped + self._settings.leak * (outside - outside.detach())
