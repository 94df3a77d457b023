"""Measure environment steps per second, against other environments and the processor.

python scripts/throughput.py
python scripts/throughput.py --rounds 21 --num-envs 64 1024 16384 --out results/throughput

All candidates run in one process in interleaved rounds, so that a busy machine slows all of them
alike; ratios are taken within a round, and their median and quartiles are printed. The clock is
the thread's own processor time. For closed loops on several threads it is that of the thread which
takes longest, so that a processor shared with other programs does not count as ours; for what uses
threads of its own, or other processes, the wall's, or this process's on the processor if shorter.

Episodes differ: CartPole-v1 lasts some 20 steps under random actions, Pendulum-v1 200, ours 1000.
Our cars start with staggered clocks, as a batch that ends in one step would flatter the others.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.classic_control.cartpole import CartPoleVectorEnv

import qcar_env
from qcar_env.control import CNVC, Passive
from qcar_env.envs.cars import CARS_A_THREAD
from qcar_env.envs.vector import QuarterCarHumpVectorEnv
from qcar_env.evaluation import storage
from qcar_env.physics import engine, engine_continuous
from qcar_env.physics.motion import plant, world_at
from qcar_env.physics.rk4 import step_fractions
from qcar_env.validation import whole

NUM_ENVS = (1, 64, 1024, 16384, 262144)
SLICE = 0.03  # [s] that a candidate runs in a round
PROCESSES = 8  # of the AsyncVectorEnv: one process a car, so no more than a machine can hold
ASYNC = f"AsyncVectorEnv Pendulum {PROCESSES}"
FIRST_STEP = (
    "import gymnasium as gym, qcar_env; import time; t = time.perf_counter()\n"
    "e = gym.make('QuarterCarHump-v0'); e.reset(); e.step(e.action_space.sample())\n"
    "print(time.perf_counter() - t)"
)
SINGLE_NUMBERS = (
    "bytes_per_car",
    "import_seconds",
    "first_step_seconds",
    "first_step_with_import_seconds",
    "environment_share_of_ppo",
)
LENGTHS = (250, 500, 1000, 2000, 4000)  # [intervals] of closed loops
OPERATIONS = 144  # of an RK4 step of the plant, see `count_operations` in the tests


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Something that is timed."""

    name: str
    run: Callable[[int], None]  # does so many calls
    steps: int  # environment steps of one call
    alone: bool = True  # whether it is one thread, whose own time on the processor is measured
    spent: Callable[[], float] | None = None  # time [s] of the calls since it was asked last


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Seconds a step in every round."""

    name: str
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median time of a step [s]."""
        return statistics.median(self.seconds)

    def times_faster_than(self, other: Timing) -> tuple[float, float, float]:
        """Return median and quartiles of the ratio of the other's time to ours, round by round."""
        ratios = sorted(b / a for a, b in zip(self.seconds, other.seconds, strict=True))
        low, middle, high = statistics.quantiles(ratios, n=4)
        return middle, low, high


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print and store; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=11, help="interleaved rounds")
    parser.add_argument(
        "--num-envs", type=int, nargs="+", default=list(NUM_ENVS), help="batch sizes"
    )
    parser.add_argument("--threads", type=int, default=engine.cores(), help="threads to compare")
    parser.add_argument("--out", type=Path, default=Path("results/throughput"), help="folder")
    arguments = parser.parse_args(argv)
    try:
        whole("rounds", arguments.rounds, least=3)
        for n in arguments.num_envs:
            whole("num-envs", n)
        whole("threads", arguments.threads)
        storage.check_folder(arguments.out)
    except ValueError as error:
        print(f"throughput: {error}", file=sys.stderr)
        return 2
    result = measure(arguments.rounds, arguments.num_envs, arguments.threads)
    storage.write_text(arguments.out / "throughput.json", json.dumps(result, indent=1) + "\n")
    print(table(result))
    if find_spec("matplotlib"):
        _plot(result, arguments.out / "throughput.png")
    print(f"\nwritten to {arguments.out}")
    return 0


def measure(rounds: int, num_envs: Sequence[int], threads: int) -> dict[str, Any]:
    """Return all figures of this machine.

    Parameters
    ----------
    rounds : int
        Interleaved rounds.
    num_envs : sequence of int
        Batch sizes.
    threads : int
        Threads to compare with one.
    """
    timings: dict[str, Timing] = {}
    groups: list[Callable[[], list[Candidate]]] = [_single]
    groups += [lambda n=n: _batch(n, threads) for n in num_envs]
    groups += [_rollouts, _lengths, _substeps]
    for number, group in enumerate(groups):
        print(f"group {number + 1} of {len(groups)}", file=sys.stderr)
        timings |= {each.name: each for each in interleave(group(), rounds)}
    return {
        "machine": platform.processor() or platform.machine(),
        "cores": engine.cores(),
        "python": platform.python_version(),
        "versions": {
            name: __import__(name).__version__ for name in ("numpy", "numba", "gymnasium")
        },
        "rounds": rounds,
        "microseconds": {
            name: {
                "median": 1e6 * each.median,
                "quartiles": [1e6 * q for q in statistics.quantiles(each.seconds, n=4)[::2]],
            }
            for name, each in timings.items()
        },
        "ratios": ratios(timings, num_envs, threads),
        "bytes_per_car": _memory(),
        "import_seconds": _fresh("import qcar_env"),
        "first_step_seconds": _first_step(),
        "first_step_with_import_seconds": _fresh(FIRST_STEP),
        "environment_share_of_ppo": _share(),
    }


def interleave(candidates: Sequence[Candidate], rounds: int) -> list[Timing]:
    """Time candidates in turn, each for about `SLICE` in every round."""
    calls: list[int] = []
    for each in candidates:
        each.run(1)  # compiles
        count = 1
        while (spent := _time(each, count)) < SLICE / 4.0:
            count *= 2
        calls.append(max(1, round(count * SLICE / spent)))
    seconds: list[list[float]] = [[] for _ in candidates]
    for k in range(rounds):
        order = range(len(candidates)) if k % 2 == 0 else range(len(candidates) - 1, -1, -1)
        for i in order:
            seconds[i].append(_time(candidates[i], calls[i]) / calls[i] / candidates[i].steps)
    return [
        Timing(name=each.name, seconds=tuple(spent))
        for each, spent in zip(candidates, seconds, strict=True)
    ]


def _time(candidate: Candidate, calls: int) -> float:
    if candidate.spent is not None:
        candidate.spent()
        candidate.run(calls)
        return candidate.spent()
    clocks = (time.thread_time,) if candidate.alone else (time.perf_counter, time.process_time)
    started = [clock() for clock in clocks]
    candidate.run(calls)
    spent = [clock() - before for clock, before in zip(clocks, started, strict=True)]
    return max(min(spent), 1e-9)


def ratios(
    timings: dict[str, Timing], num_envs: Sequence[int], threads: int
) -> list[dict[str, Any]]:
    """Return the ratios that are asked for, as rows of a table."""
    wanted = [
        ("step", "Pendulum-v1 step", 10.0),
        ("step", "CartPole-v1 step", 5.0),
        ("step", "floor: eight numbers", 1.0 / 1.3),
        ("gym.make step", "gym.make Pendulum-v1 step", 8.0),
    ]
    least = {64: 12.0, 1024: 3.5, 16384: 2.0}
    fast = {1024: 5.0, 16384: 3.3}
    for n in num_envs:
        wanted += [
            (f"batch {n}", f"CartPoleVectorEnv {n}", least.get(n)),
            (f"batch {n}, single", f"CartPoleVectorEnv {n}", None),
            (f"batch {n}, exact", f"CartPoleVectorEnv {n}", None),
            (f"batch {n}, exact single", f"CartPoleVectorEnv {n}", fast.get(n)),
            (f"batch {n}, {threads} threads", f"batch {n}", None),
            (f"batch {n}", f"SyncVectorEnv Pendulum {n}", None),
            (f"batch {n}", ASYNC, None) if n == 64 else (f"batch {n}", "", None),
            (f"batch {n}", f"EnvPool Pendulum {n}", 50.0 if n == 1024 else None),
            (f"batch {n}", f"gymnax Pendulum {n}", None),
        ]
    threaded = f"rollout, held, fused, {engine.cores()} threads"
    wanted += [
        ("rollout, held", "multiply-add peak", 0.85),
        ("rollout, held, fused", "multiply-add peak", 0.85),
        (threaded, "rollout, held, fused", 1.9),
        # what the machine gives: less than 2 where the other core is somebody else's too
        (f"multiply-add peak, {engine.cores()} threads", "multiply-add peak", None),
    ]
    rows: list[dict[str, Any]] = []
    for ours, theirs, limit in wanted:
        if ours in timings and theirs in timings:
            middle, low, high = timings[ours].times_faster_than(timings[theirs])
            rows.append(
                {
                    "ours": ours,
                    "theirs": theirs,
                    "ratio": middle,
                    "quartiles": [low, high],
                    "least": limit,
                }
            )
    return rows


def table(result: dict[str, Any]) -> str:
    """Return the result as a Markdown table."""
    lines = ["| what | against | times faster | quartiles | asked for |", "|---|---|---|---|---|"]
    for row in result["ratios"]:
        low, high = row["quartiles"]
        least = "" if row["least"] is None else f"{row['least']:.3g}"
        lines.append(
            f"| {row['ours']} | {row['theirs']} | {row['ratio']:.3g} | {low:.3g} to {high:.3g} "
            f"| {least} |"
        )
    lines += ["", "| what | us a step | million steps a second |", "|---|---|---|"]
    for name, each in result["microseconds"].items():
        lines.append(f"| {name} | {each['median']:.4g} | {1 / each['median']:.4g} |")
    lines.append("")
    for name in SINGLE_NUMBERS:
        if result.get(name) is not None:
            lines.append(f"{name.replace('_', ' ')}: {result[name]:.3g}  ")
    return "\n".join(lines)


class Floor:
    """What Python itself takes for a step that makes an observation of eight numbers."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Return a fresh observation and nothing else."""
        numbers = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]
        return np.array(numbers, dtype=np.float32), 0.0, False, False, {}


def _single() -> list[Candidate]:
    def of(name: str, env: Any, action: Any) -> Candidate:
        env.reset(seed=0)

        def run(calls: int) -> None:
            step = env.step
            for _ in range(calls):
                _, _, terminated, truncated, _ = step(action)
                if terminated or truncated:
                    env.reset()

        return Candidate(name=name, run=run, steps=1)

    def floor(calls: int) -> None:
        step, action = Floor().step, np.zeros(2, np.float32)
        for _ in range(calls):
            _, _, terminated, truncated, _ = step(action)
            if terminated or truncated:
                raise AssertionError

    push, torque = np.array([0.1, 0.1], np.float32), np.array([0.1], np.float32)
    ours = "QuarterCarHump-v0"
    return [
        of("step", gym.make(ours).unwrapped, push),
        of("Pendulum-v1 step", gym.make("Pendulum-v1").unwrapped, torque),
        of("CartPole-v1 step", gym.make("CartPole-v1").unwrapped, 1),
        Candidate(name="floor: eight numbers", run=floor, steps=1),
        of("gym.make step", gym.make(ours), push),
        of("gym.make Pendulum-v1 step", gym.make("Pendulum-v1"), torque),
        of("gym.make CartPole-v1 step", gym.make("CartPole-v1"), 1),
    ]


def _batch(n: int, threads: int) -> list[Candidate]:
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
        of(f"batch {n}", QuarterCarHumpVectorEnv(n), push),
        of(f"batch {n}, single", QuarterCarHumpVectorEnv(n, precision="single"), push),
        of(f"batch {n}, exact", QuarterCarHumpVectorEnv(n, method="exact"), push),
        of(
            f"batch {n}, exact single",
            QuarterCarHumpVectorEnv(n, method="exact", precision="single"),
            push,
        ),
        of(f"CartPoleVectorEnv {n}", CartPoleVectorEnv(num_envs=n), rng.integers(0, 2, n)),
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
        import envpool

        pool = envpool.make("Pendulum-v1", env_type="gymnasium", num_envs=n, num_threads=1)
        found.append(of(f"EnvPool Pendulum {n}", pool, torque))
    if find_spec("gymnax") and 1 < n <= 16384:
        found.append(_gymnax(n, torque))
    return found


def _gymnax(n: int, torque: Any) -> Candidate:
    """Step gymnax's Pendulum, compiled, with the same random keys in each step."""
    import gymnax
    import jax

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


def _rollout(
    name: str,
    law: Any,
    *,
    held: bool,
    fused: bool = False,
    threads: int = 1,
    intervals: int = 1000,
    cars: int = 1024,
) -> Candidate:
    """Close the loops of many cars in one compiled call."""
    scenario = qcar_env.scenario("paper")
    steps, step = intervals * scenario.substeps, scenario.dt / scenario.substeps
    one = plant(scenario.car, scenario.road, scenario.force, step)
    world = world_at(0.0, scenario.road, scenario.force)
    column = [0.0] * 8 + [*world.road, *world.force, *one.passage.by.road]
    column += [*one.passage.by.force, *one.passage.middle, *one.car]
    column += [*one.amplitudes, *scenario.actuator.limit, *one.road, 0.0, one.Omega]
    rows = np.zeros((engine_continuous.ROWS, cars))
    rows[: engine_continuous.WINDOW] = np.array(column)[:, np.newaxis]
    rows[engine_continuous.WINDOW] = engine.NEVER
    gains = np.array(law.gains)[:, np.newaxis]
    rows[engine_continuous.GAINS : engine_continuous.GAINS + len(gains)] = gains
    slabs, record = engine.slabs(rows), np.empty((0, 6, cars))
    kernel = engine_continuous.closed_loop_kernel(
        law.command, law.filter_rate, type(law.gains), False, held, fused
    )
    fractions = step_fractions(step)
    edges = [slabs.shape[0] * i // threads for i in range(threads + 1)]

    def part(i: int) -> None:
        kernel(slabs, edges[i], edges[i + 1], cars, fractions, steps, scenario.substeps, 0, record)

    return _shared_out(name, part, threads, steps=cars * intervals)


def _shared_out(name: str, part: Callable[[int], Any], threads: int, *, steps: int) -> Candidate:
    """Let each thread do its part; a call takes as long as the slowest."""
    pool = ThreadPoolExecutor(threads)  # as for several threads, so for one
    longest = [0.0]

    def timed(i: int) -> float:
        started = time.thread_time()
        part(i)
        return time.thread_time() - started

    def run(calls: int) -> None:
        for _ in range(calls):
            longest[0] += max(pool.map(timed, range(threads)))

    def spent() -> float:
        found, longest[0] = longest[0], 0.0
        return found

    return Candidate(name=name, run=run, steps=steps, spent=spent)


def _lengths() -> list[Candidate]:
    """Cost against the length of a closed loop, with everything else as it is."""
    return [
        _rollout(f"rollout of {k} intervals", CNVC(), held=True, intervals=k, cars=64)
        for k in LENGTHS
    ]


def _rollouts() -> list[Candidate]:
    """Close loops in one compiled call; beside them the processor's peak."""
    scenario = qcar_env.scenario("paper")
    cores = engine.cores()
    found = [
        _rollout("rollout, held", CNVC(), held=True),
        _rollout("rollout, held, fused", CNVC(), held=True, fused=True),
        _rollout("rollout, in every stage", CNVC(), held=False),
        _rollout("rollout, in every stage, fused", CNVC(), held=False, fused=True),
        _rollout("rollout, no control", Passive(), held=False),
    ]
    if cores > 1:
        name = f"rollout, held, fused, {cores} threads"
        found.append(_rollout(name, CNVC(), held=True, fused=True, threads=cores))
    # what a control interval would take if the processor did nothing but multiply and add
    repeats = 10_000  # some milliseconds: a call of a tenth of one spends 8 % on its array
    flops = 2 * engine.PEAK_LENGTH * engine.PEAK_WIDTH * repeats
    steps = max(1, flops // (OPERATIONS * scenario.substeps))
    found.append(
        Candidate(
            name="multiply-add peak",
            run=lambda calls: [engine.multiply_add(repeats) for _ in range(calls)] and None,
            steps=steps,
        )
    )
    if cores > 1:
        found.append(
            _shared_out(
                f"multiply-add peak, {cores} threads",
                lambda _: engine.multiply_add(repeats),
                cores,
                steps=cores * steps,
            )
        )
    return found


def _substeps() -> list[Candidate]:
    """Cost against substeps, with everything else as it is."""
    import dataclasses

    found: list[Candidate] = []
    for substeps in (1, 2, 4, 8, 16):
        scenario = dataclasses.replace(qcar_env.scenario("paper"), substeps=substeps)
        env = QuarterCarHumpVectorEnv(1024, scenario)
        env.reset(seed=0)
        push = np.zeros((1024, 2), np.float32)

        def run(calls: int, env: Any = env, push: Any = push) -> None:
            for _ in range(calls):
                env.step(push)

        found.append(Candidate(name=f"batch 1024, {substeps} substeps", run=run, steps=1024))
    return found


def _memory() -> float:
    env = QuarterCarHumpVectorEnv(16384)
    return env.nbytes / env.num_envs


def _first_step() -> float:
    """Return the time of making, resetting and stepping an environment, compiled before."""

    def once() -> float:
        command = [sys.executable, "-c", FIRST_STEP]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        return float(done.stdout)

    once()  # fills the caches
    return min(once() for _ in range(5))


def _share() -> float | None:
    """Return the environment's share of PPO's training time, where SB3 is installed."""
    if not find_spec("stable_baselines3"):
        return None
    from agents.environment_share import environment_share

    return environment_share()


def _fresh(code: str) -> float:
    """Return the time that `code` takes in a new interpreter, beyond starting it; best of five."""

    def once(text: str) -> float:
        started = time.perf_counter()
        subprocess.run([sys.executable, "-c", text], check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - started

    once(code)  # fills the caches
    return min(once(code) for _ in range(5)) - min(once("pass") for _ in range(5))


def _plot(result: dict[str, Any], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from qcar_env.plots.throughput import draw

    figure, axes = plt.subplots(2, 2, figsize=(7.2, 5.6), layout="constrained")
    draw(result, axes.ravel())
    figure.savefig(path, dpi=200)
    plt.close(figure)


if __name__ == "__main__":
    raise SystemExit(main())
