"""What part of PPO's training time the environment takes."""

from __future__ import annotations

import time
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper

from agents.vec_env import QuarterCarHumpVecEnv


class Timed(VecEnvWrapper):
    """A batch of cars that notes how long its steps take."""

    seconds = 0.0  # [s] in all steps
    _began = 0.0

    def reset(self) -> Any:
        """Reset the batch."""
        return self.venv.reset()

    def step_async(self, actions: Any) -> None:
        """Begin a step, and its time."""
        self._began = time.perf_counter()
        self.venv.step_async(actions)

    def step_wait(self) -> Any:
        """End a step, and its time."""
        found = self.venv.step_wait()
        self.seconds += time.perf_counter() - self._began
        return found


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
    env = Timed(QuarterCarHumpVecEnv(cars))
    model = PPO("MlpPolicy", env, n_steps=intervals, batch_size=batch, seed=0, device="cpu")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more of them wait for each other where the processor is shared
    try:
        model.learn(cars * intervals)  # compiles, and fills what is made once
        env.seconds = 0.0
        began = time.perf_counter()
        model.learn(updates * cars * intervals)
        return env.seconds / (time.perf_counter() - began)
    finally:
        torch.set_num_threads(threads)
