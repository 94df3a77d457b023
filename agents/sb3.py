"""PPO, SAC and TD3 of Stable-Baselines3 behind the interface of `qcar_env.agents.trainer`."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn

from qcar_env.agents.networks import (
    BentActorCriticPolicy,
    BentSACPolicy,
    Deterministic,
    Features,
)
from qcar_env.agents.recipes import OffPolicySettings, PPOSettings, Recipe
from qcar_env.agents.trainer import (
    Hook,
    annealed,
    arrays,
    generator_state,
    set_generator_state,
    tensors,
)
from qcar_env.agents.vec_env import QuarterCarHumpVecEnv

BUFFER_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class SB3Trainer:
    """Trains with Stable-Baselines3.

    Parameters
    ----------
    recipe : Recipe
        Algorithm ``ppo``, ``sac`` or ``td3``.
    seed : int
        Of starts, networks and exploration.
    tensorboard : str, optional
        Folder for TensorBoard.
    """

    def __init__(self, recipe: Recipe, seed: int, tensorboard: str | None = None) -> None:
        self.recipe = recipe
        self.env = QuarterCarHumpVecEnv(
            recipe.cars,
            staggered=True,  # or all episodes would end in the same step
            scenario=recipe.scenario,
            observe=recipe.track.observe,
            observe_limit=recipe.observe_limit,
            reward=recipe.reward,
        )
        self.model = _model(recipe, self.env, seed, tensorboard)
        self.env.seed(seed * recipe.cars)  # no car of another seed has the same episodes
        if recipe.velocity_gain:
            _begin_at_velocity_feedback(self.model, recipe)
        self._average: nn.Module | None = None
        if isinstance(recipe.settings, OffPolicySettings):
            self._average = copy.deepcopy(Deterministic(self.model.policy)).requires_grad_(False)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return int(self.model.num_timesteps)

    def actor(self) -> nn.Module:
        """Return the mean action; off policy, that of the actor's running average."""
        return Deterministic(self.model.policy) if self._average is None else self._average

    def learn(self, hook: Hook) -> None:
        """Train (see `qcar_env.agents.trainer.Trainer`)."""
        left = self.recipe.steps - self.steps
        if left <= 0:
            return
        with contextlib.suppress(_Stop):
            self.model.learn(
                left,
                callback=_Between(hook, self.recipe, self._follow),
                reset_num_timesteps=self.steps == 0,
            )

    def _follow(self) -> None:
        """Let the average follow the actor."""
        settings = self.recipe.settings
        if self._average is None or not isinstance(settings, OffPolicySettings):
            return
        iterations = self.steps / self.recipe.cars
        keep = min(settings.average, iterations / (iterations + 10.0))  # the beginning counts less
        now = Deterministic(self.model.policy)
        for mean, each in zip(self._average.parameters(), now.parameters(), strict=True):
            mean.lerp_(each.detach(), 1.0 - keep)

    def snapshot(self) -> dict[str, Any]:
        """Return networks, optimisers, cars, generators and, off policy, the replay buffer."""
        model = self.model
        found: dict[str, Any] = {
            "policy": copy.deepcopy(model.policy.state_dict()),
            "optimisers": [copy.deepcopy(each.state_dict()) for each in _optimisers(model)],
            "steps": self.steps,
            "updates": int(model._n_updates),
            "last_observation": torch.tensor(model._last_obs),
            "last_starts": torch.tensor(model._last_episode_starts),
            "env": tensors(self.env.snapshot()),
            "torch_generator": torch.get_rng_state(),
            "numpy_generator": _numpy_state(),
            "action_generator": generator_state(model.action_space.np_random),
        }
        if self._average is not None:
            found["average"] = copy.deepcopy(self._average.state_dict())
        if isinstance(model, (SAC, TD3)):
            buffer = model.replay_buffer
            assert buffer is not None
            end = buffer.buffer_size if buffer.full else buffer.pos
            found["buffer"] = {
                name: torch.tensor(getattr(buffer, name)[:end]) for name in BUFFER_ARRAYS
            }
            found["buffer_at"] = [int(buffer.pos), int(buffer.full)]
            if isinstance(model, SAC) and model.log_ent_coef is not None:
                found["log_ent_coef"] = model.log_ent_coef.detach().clone()
        return found

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        model = self.model
        model.policy.load_state_dict(snapshot["policy"])
        for each, state in zip(_optimisers(model), snapshot["optimisers"], strict=True):
            each.load_state_dict(state)
        model.num_timesteps = snapshot["steps"]
        model._n_updates = snapshot["updates"]
        model._last_obs = snapshot["last_observation"].numpy().copy()
        model._last_episode_starts = snapshot["last_starts"].numpy().copy()
        self.env.restore(arrays(snapshot["env"]))
        if self._average is not None:
            self._average.load_state_dict(snapshot["average"])
        if isinstance(model, (SAC, TD3)):
            buffer = model.replay_buffer
            assert buffer is not None
            for name, values in snapshot["buffer"].items():
                getattr(buffer, name)[: len(values)] = values.numpy()
            buffer.pos, full = snapshot["buffer_at"]
            buffer.full = bool(full)
            if "log_ent_coef" in snapshot and isinstance(model, SAC):
                assert model.log_ent_coef is not None
                model.log_ent_coef.data.copy_(snapshot["log_ent_coef"])
        torch.set_rng_state(snapshot["torch_generator"])
        _set_numpy_state(snapshot["numpy_generator"])
        set_generator_state(model.action_space.np_random, snapshot["action_generator"])


class _Stop(Exception):  # noqa: N818 - not an error
    """Ends SB3's loop between two iterations, where all is whole; its own way is a step later."""


class _Between(BaseCallback):
    """Calls the hook between iterations and moves PPO's exploration along its schedule."""

    def __init__(self, hook: Hook, recipe: Recipe, follow: Callable[[], None]) -> None:
        super().__init__()
        self._hook = hook
        self._recipe = recipe
        self._follow = follow

    def _on_rollout_start(self) -> None:
        if not self._hook():
            raise _Stop
        settings = self._recipe.settings
        if isinstance(settings, PPOSettings):
            first, last = (math.log(value) for value in settings.std)
            progress = self.num_timesteps / self._recipe.steps
            policy: Any = self.model.policy
            with torch.no_grad():
                policy.log_std.fill_(annealed((first, last), progress))

    def _on_rollout_end(self) -> None:
        self._follow()

    def _on_step(self) -> bool:
        return True


def _model(
    recipe: Recipe, env: QuarterCarHumpVecEnv, seed: int, tensorboard: str | None
) -> BaseAlgorithm:
    features: dict[str, Any] = dict(
        features_extractor_class=Features,
        features_extractor_kwargs=dict(features=recipe.features),
        net_arch=list(recipe.hidden),
        activation_fn=nn.Tanh,
    )
    common: dict[str, Any] = dict(seed=seed, device="cpu", tensorboard_log=tensorboard)
    settings = recipe.settings
    if isinstance(settings, PPOSettings):
        model = PPO(
            BentActorCriticPolicy,
            env,
            n_steps=settings.n_steps,
            batch_size=settings.batch,
            n_epochs=settings.epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            learning_rate=_linear(settings.learning_rate),
            clip_range=settings.clip_range,
            max_grad_norm=settings.max_grad_norm,
            policy_kwargs=dict(
                **features,
                log_std_init=math.log(settings.std[0]),
                optimizer_kwargs=dict(fused=True),
            ),
            **common,
        )
        model.policy.log_std.requires_grad_(False)
        return model
    if not isinstance(settings, OffPolicySettings):
        raise ValueError(f"recipe {recipe.name!r} is not for Stable-Baselines3")
    off_policy: dict[str, Any] = dict(
        batch_size=settings.batch,
        gradient_steps=settings.gradient_steps,
        train_freq=1,
        gamma=settings.gamma,
        tau=settings.tau,
        learning_rate=_linear(settings.learning_rate),
        buffer_size=min(settings.buffer, recipe.steps),
        learning_starts=settings.learning_starts,
        **common,
    )
    if recipe.algorithm == "td3":
        actions = env.action_space.shape[0]  # type: ignore[index]
        noise = NormalActionNoise(np.zeros(actions), np.full(actions, settings.noise))
        return TD3(
            "MlpPolicy",
            env,
            action_noise=VectorizedActionNoise(noise, recipe.cars),
            policy_kwargs=features,
            **off_policy,
        )
    return SAC(
        BentSACPolicy,
        env,
        ent_coef="auto_0.1",
        target_entropy=settings.target_entropy,
        policy_kwargs=features,
        **off_policy,
    )


def _begin_at_velocity_feedback(model: BaseAlgorithm, recipe: Recipe) -> None:
    """Let the direct path begin as ``-gain`` times each own velocity: features 2 and 3 are 2 v."""
    if not isinstance(model, OnPolicyAlgorithm):
        raise ValueError(f"recipe {recipe.name!r}: only PPO can begin at velocity feedback")
    policy: Any = model.policy
    with torch.no_grad():
        for mass in (0, 1):
            policy.action_net.weight[mass, recipe.hidden[-1] + 2 + mass] = (
                -0.5 * recipe.velocity_gain
            )


def _linear(ends: tuple[float, float]) -> Any:
    return lambda remaining: annealed(ends, 1.0 - remaining)


def _optimisers(model: BaseAlgorithm) -> list[torch.optim.Optimizer]:
    if isinstance(model, (SAC, TD3)):
        found = [model.actor.optimizer, model.critic.optimizer]
        if isinstance(model, SAC) and model.ent_coef_optimizer is not None:
            found.append(model.ent_coef_optimizer)
        return found
    policy: Any = model.policy
    return [policy.optimizer]


def _numpy_state() -> dict[str, Any]:
    kind, keys, at, has_gauss, cached = np.random.get_state()  # noqa: NPY002 - SB3 draws from it
    return {
        "kind": str(kind),
        "keys": torch.as_tensor(np.asarray(keys, dtype=np.int64)),
        "at": int(at),
        "has_gauss": int(has_gauss),
        "cached": float(cached),
    }


def _set_numpy_state(state: dict[str, Any]) -> None:
    np.random.set_state(  # noqa: NPY002 - SB3 draws from it
        (
            state["kind"],
            state["keys"].numpy().astype(np.uint32),
            state["at"],
            state["has_gauss"],
            state["cached"],
        )
    )
