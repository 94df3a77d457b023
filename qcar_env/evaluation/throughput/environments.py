"""Environments whose steps are timed: ours, Gymnasium's, EnvPool's and gymnax's.

Episodes differ: CartPole-v1 lasts some 20 steps under random actions, Pendulum-v1 200, ours 1000.
Our cars start with staggered clocks, as a batch that ends in one step would flatter the others.
"""

from __future__ import annotations

import dataclasses
import importlib
import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.classic_control.cartpole import CartPoleVectorEnv

from qcar_env.engine.storage import CARS_A_THREAD
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.evaluation.throughput.closed_loops import peak
from qcar_env.evaluation.throughput.timing import Candidate
from qcar_env.scenarios import scenario

PROCESSES = 8  # of the AsyncVectorEnv: one process a car, so no more than a machine can hold
ASYNC = f"AsyncVectorEnv Pendulum {PROCESSES}"
OURS: dict[str, dict[str, Any]] = {
    "": {},
    ", single": {"precision": "single"},
    ", exact": {"method": "exact"},
    ", exact single": {"method": "exact", "precision": "single"},
}
FIRST_STEP = (
    "import gymnasium as gym, qcar_env; import time; t = time.perf_counter()\n"
    "e = gym.make('QuarterCarHump-v0'); e.reset(); e.step(e.action_space.sample())\n"
    "print(time.perf_counter() - t)"
)


class Floor:
    """What Python itself takes for a step that makes an observation of eight numbers."""

    def reset(self, seed: int) -> None:
        """Do nothing."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return a fresh observation and nothing else."""
        numbers = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
        return np.array(numbers, dtype=np.float32), 0.0, False, False, {}


def single() -> list[Candidate]:
    """Return single environments, and what Python itself takes."""

    def of(name: str, env: Any, action: Any) -> Candidate:
        env.reset(seed=0)

        def run(calls: int) -> None:
            step = env.step
            for _ in range(calls):
                _, _, terminated, truncated, _ = step(action)
                if terminated or truncated:
                    env.reset()

        return Candidate(name=name, run=run, steps=1)

    push, torque = np.array([0.1, 0.1], np.float32), np.array([0.1], np.float32)
    ours = "QuarterCarHump-v0"
    return [
        of("step", gym.make(ours).unwrapped, push),
        of("Pendulum-v1 step", gym.make("Pendulum-v1").unwrapped, torque),
        of("CartPole-v1 step", gym.make("CartPole-v1").unwrapped, 1),
        of("floor: eight numbers", Floor(), np.zeros(2, np.float32)),
        of("gym.make step", gym.make(ours), push),
        of("gym.make Pendulum-v1 step", gym.make("Pendulum-v1"), torque),
        of("gym.make CartPole-v1 step", gym.make("CartPole-v1"), 1),
    ]


def batch(n: int, threads: int) -> list[Candidate]:
    """Return batches of n environments, ours also on several threads."""

    def of(name: str, env: Any, action: Any) -> Candidate:
        env.reset(seed=0)
        if isinstance(env, QuarterCarHumpVectorEnv):
            clock = np.random.default_rng(0).integers(0, 1000, n)
            env.stagger(clock)

        def run(calls: int) -> None:
            step = env.step
            for _ in range(calls):
                step(action)

        alone = "threads" not in name and "Async" not in name and "EnvPool" not in name
        return Candidate(name=name, run=run, steps=len(action), alone=alone)

    rng = np.random.default_rng(0)
    push = rng.uniform(-0.1, 0.1, (n, 2)).astype(np.float32)
    torque = rng.uniform(-1.0, 1.0, (n, 1)).astype(np.float32)
    found = [
        *(
            of(f"batch {n}{name}", QuarterCarHumpVectorEnv(n, **settings), push)
            for name, settings in OURS.items()
        ),
        of(f"CartPoleVectorEnv {n}", CartPoleVectorEnv(num_envs=n), rng.integers(0, 2, n)),
        *(
            peak(f"multiply-add peak{name} beside {n}", scenario("paper").substeps, single=single)
            for name, single in (("", False), (", single", True))
        ),
        _copy(n),
    ]
    if threads > 1 and n >= 2 * CARS_A_THREAD:
        cars = QuarterCarHumpVectorEnv(n, threads=threads)
        found.append(of(f"batch {n}, {threads} threads", cars, push))
    if n == 64:
        many = gym.make_vec("Pendulum-v1", num_envs=n, vectorization_mode="sync")
        found.append(of(f"SyncVectorEnv Pendulum {n}", many, torque))
        few = gym.make_vec("Pendulum-v1", num_envs=PROCESSES, vectorization_mode="async")
        found.append(of(ASYNC, few, torque[:PROCESSES]))
    if find_spec("envpool") and 1 < n <= 16384:
        envpool: Any = importlib.import_module("envpool")
        pool = envpool.make("Pendulum-v1", env_type="gymnasium", num_envs=n, num_threads=1)
        found.append(of(f"EnvPool Pendulum {n}", pool, torque))
    if find_spec("gymnax") and 1 < n <= 16384:
        found.append(_gymnax(n, torque))
    return found


def _copy(n: int) -> Candidate:
    """Read and write as many bytes as the cars of a batch have, and do nothing else."""
    source = np.ones(QuarterCarHumpVectorEnv(n).nbytes, np.uint8)
    target = np.empty_like(source)

    def run(calls: int) -> None:
        for _ in range(calls):
            np.copyto(target, source)

    return Candidate(name=f"copy of {n} cars", run=run, steps=n)


def _gymnax(n: int, torque: Any) -> Candidate:
    """Step gymnax's Pendulum, compiled, with the same random keys in each step."""
    gymnax: Any = importlib.import_module("gymnax")
    jax: Any = importlib.import_module("jax")
    env, params = gymnax.make("Pendulum-v1")
    keys, actions = jax.random.split(jax.random.PRNGKey(0), n), jax.numpy.asarray(torque)
    step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
    _, state = jax.jit(jax.vmap(env.reset, in_axes=(0, None)))(keys, params)

    def run(calls: int) -> None:
        nonlocal state
        for _ in range(calls):
            _, state, reward, *_ = step(keys, state, actions, params)
            reward.block_until_ready()

    return Candidate(name=f"gymnax Pendulum {n}", run=run, steps=n, alone=False)


def substeps() -> list[Candidate]:
    """Cost against substeps, with everything else as it is."""
    found: list[Candidate] = []
    for count in (1, 2, 4, 8, 16):
        finer = dataclasses.replace(scenario("paper"), substeps=count)
        env = QuarterCarHumpVectorEnv(1024, finer)
        env.reset(seed=0)
        push = np.zeros((1024, 2), np.float32)

        def run(calls: int, env: Any = env, push: Any = push) -> None:
            for _ in range(calls):
                env.step(push)

        found.append(Candidate(name=f"batch 1024, {count} substeps", run=run, steps=1024))
    return found


def bytes_per_car() -> float:
    """Return the memory of a car in a batch [byte]."""
    env = QuarterCarHumpVectorEnv(16384)
    return env.nbytes / env.num_envs


def first_step() -> float:
    """Return the time of making, resetting and stepping an environment, compiled before."""

    def once() -> float:
        command = [sys.executable, "-c", FIRST_STEP]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        return float(done.stdout)

    once()  # fills the caches
    return min(once() for _ in range(5))
