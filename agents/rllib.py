"""The environment for RLlib: `register` on driver and workers, PPO on the native vector one.

    from qcar_env.agents import rllib
    algorithm = rllib.ppo(scenario="paper", cars=64).build_algo()
    algorithm.train()

RLlib's workers do not see Gymnasium's registry; what they see is what `register` hands to Ray. The
cars of a worker are one `QuarterCarHumpVectorEnv`, not so many environments in Python.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.validation import whole

NAME = "QuarterCarHump"


def make(config: Mapping[str, Any]) -> QuarterCarHumpEnv | QuarterCarHumpVectorEnv:
    """Return the environment; the vector one where RLlib says how many cars.

    Parameters
    ----------
    config : mapping
        Arguments of `QuarterCarHumpEnv`, and ``num_envs`` for the vector one.
    """
    given = dict(config)
    cars = given.pop("num_envs", None)
    return QuarterCarHumpEnv(**given) if cars is None else QuarterCarHumpVectorEnv(cars, **given)


def register() -> str:
    """Register the environment with Ray for all workers, and return its name."""
    register_env(NAME, make)
    return NAME


def ppo(*, cars: int = 64, workers: int = 0, **environment: Any) -> PPOConfig:
    """Return RLlib's PPO on the native vector environment.

    Parameters
    ----------
    cars : int
        Of each worker.
    workers : int
        Processes that drive cars, besides the one that learns; with 0 that one drives as well.
    **environment
        Arguments of `QuarterCarHumpEnv`.
    """
    whole("cars", cars)
    whole("workers", workers, least=0)
    return (
        PPOConfig()
        .environment(register(), env_config=environment)
        .env_runners(
            num_env_runners=workers,
            num_envs_per_env_runner=cars,
            gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
        )
        # as the recipe of `ppo-paper` (agents.recipes), which says why
        .training(gamma=0.93, lambda_=0.9, lr=1e-3, num_epochs=5, minibatch_size=512)
    )
