"""What part of PPO's training time the environment takes."""

from __future__ import annotations

import time
from typing import Any

import torch
from stable_baselines3 import PPO

from qcar_env.agents.vec_env import QuarterCarHumpVecEnv


def environment_share(
    *, cars: int = 64, intervals: int = 256, batch: int = 1024, updates: int = 3
) -> float:
    """Train with Stable-Baselines3's PPO and time the environment, both on one thread.

    Parameters
    ----------
    cars : int
        Cars in the batch.
    intervals : int
        Control intervals of each car between updates of the policy.
    batch : int
        Size of a minibatch; all else are the defaults of the library.
    updates : int
        Updates of the policy.

    Returns
    -------
    float
        Time in the environment's steps over the time of the training [-].
    """
    env: Any = QuarterCarHumpVecEnv(cars)
    step, spent = env.step, 0.0

    def timed(actions: Any) -> Any:
        nonlocal spent
        began = time.perf_counter()
        found = step(actions)
        spent += time.perf_counter() - began
        return found

    env.step = timed
    model = PPO("MlpPolicy", env, n_steps=intervals, batch_size=batch, seed=0, device="cpu")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more of them wait for each other where the processor is shared
    try:
        model.learn(cars * intervals)  # compiles, and fills what is made once
        spent = 0.0
        began = time.perf_counter()
        model.learn(updates * cars * intervals)
        return spent / (time.perf_counter() - began)
    finally:
        torch.set_num_threads(threads)
