"""Trajectories of the paper's scenarios as an installed version of the library makes them.

`python tests/envs/trajectories.py FILE` stores them; `tests/envs/data/trajectories_0_1_0.npz` was
made so with version 0.1.0, and `test_trajectories` compares.
"""

import hashlib
import sys
from typing import Any

import gymnasium as gym
import numpy as np

STEPS = 1200  # more than an episode of 1000 control intervals
SCENARIOS = ("paper", "paper-hump", "paper-randomised")
SEEDS = (0, 1, 2)
CARS = 5
Arrays = dict[str, np.ndarray]


def actions(observation: np.ndarray, k: int, rng: np.random.Generator) -> np.ndarray:
    """Return forces: half a second of velocity feedback, then anything, then what excites."""
    anything = rng.uniform(-1.3, 1.3, (*observation.shape[:-1], 2)).astype(np.float32)
    gain = (-40, 0, 40, 40)[(k // 100) % 4]
    return (gain * observation[..., 2:4]).astype(np.float32) if gain else anything


def scalar(name: str, observe: str, seed: int) -> Arrays:
    """Return what one environment gives."""
    env = gym.make("qcar_env:QuarterCarHump-v0", scenario=name, observe=observe).unwrapped
    rng = np.random.default_rng([7, seed])
    observation, info = env.reset(seed=seed)
    seen, rewards, ends, phases, states = [observation], [], [], [info["phase"]], []
    for k in range(STEPS):
        observation, reward, terminated, truncated, _ = env.step(actions(observation, k, rng))
        seen.append(observation)
        rewards.append(reward)
        ends.append(terminated + 2 * truncated)
        states.append(tuple(env.state))
        if terminated or truncated:
            observation, info = env.reset()
            phases.append(info["phase"])
    return {
        "observations": np.array(seen),
        "rewards": np.array(rewards),
        "ends": np.array(ends, np.int8),
        "phases": np.array(phases),
        "states": np.array(states),
    }


def vector(name: str, mode: str) -> Arrays:
    """Return what many cars give."""
    from qcar_env.envs.vector import QuarterCarHumpVectorEnv

    env: Any = QuarterCarHumpVectorEnv(CARS, name, autoreset_mode=mode)
    rng = np.random.default_rng([7, 3])
    observation, _ = env.reset(seed=3)
    seen, rewards, forces, ends = [observation], [], [], []
    for k in range(STEPS):
        observation, reward, terminated, truncated, info = env.step(actions(observation, k, rng))
        seen.append(observation)
        rewards.append(reward)
        forces.append(info["force"])
        ends.append(terminated + 2 * truncated)
    return {
        "observations": np.array(seen),
        "rewards": np.array(rewards),
        "forces": np.array(forces),
        "ends": np.array(ends, np.int8),
    }


def stored(found: Arrays) -> Arrays:
    """Return what is kept of a trajectory: some of it, and the fingerprint of each array.

    An observation's rate of the road, entry 5, is left out of its fingerprint
    (`test_trajectories`).
    """
    kept: Arrays = {}
    for key, values in found.items():
        whole = values
        if key == "observations" and values.shape[-1] > 4:
            whole = np.delete(values, 5, axis=-1)
        # -0.0 and 0.0 are one number
        digest = hashlib.sha256((whole + whole.dtype.type(0)).tobytes()).digest()
        kept[f"{key}/sha256"] = np.frombuffer(digest, np.uint8)
        kept[key] = values if key in ("ends", "phases") else values[::20]
    return kept


def every() -> Arrays:
    """Return all that is stored."""
    found: dict[str, Arrays] = {}
    for name in SCENARIOS:
        for observe in ("full", "feedback"):
            for seed in SEEDS if observe == "full" else SEEDS[:1]:
                found[f"{name}/{observe}/{seed}"] = scalar(name, observe, seed)
        for mode in ("NextStep", "SameStep"):
            found[f"{name}/{mode}"] = vector(name, mode)
    return {
        f"{case}/{key}": values
        for case, arrays in found.items()
        for key, values in stored(arrays).items()
    }


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **every())
