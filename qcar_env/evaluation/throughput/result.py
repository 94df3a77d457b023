"""Measure a machine: environment steps per second, and the ratios that are asked for."""

from __future__ import annotations

import importlib.metadata
import platform
import statistics
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from qcar_env.engine.closed_loop import cores
from qcar_env.evaluation.tables import markdown
from qcar_env.evaluation.throughput import closed_loops, environments
from qcar_env.evaluation.throughput.timing import Candidate, Timing, fresh, interleave

SINGLE_NUMBERS = (
    "bytes_per_car",
    "import_seconds",
    "first_step_seconds",
    "first_step_with_import_seconds",
    "environment_share_of_ppo",
)


def measure(
    rounds: int,
    num_envs: Sequence[int],
    threads: int,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Return all figures of this machine.

    Parameters
    ----------
    rounds : int
        Interleaved rounds.
    num_envs : sequence of int
        Batch sizes.
    threads : int
        Threads to compare with one.
    say : callable, optional
        Told what is being done.
    """
    timings: dict[str, Timing] = {}
    groups: list[Callable[[], list[Candidate]]] = [environments.single]
    groups += [partial(environments.batch, n, threads) for n in num_envs]
    groups += [closed_loops.rollouts, closed_loops.lengths, environments.substeps]
    for number, group in enumerate(groups):
        say(f"group {number + 1} of {len(groups)}")
        timings |= {each.name: each for each in interleave(group(), rounds)}
    return {
        "machine": platform.processor() or platform.machine(),
        "cores": cores(),
        "python": platform.python_version(),
        "versions": {
            name: importlib.metadata.version(name) for name in ("numpy", "numba", "gymnasium")
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
        "bytes_per_car": environments.bytes_per_car(),
        "import_seconds": fresh("import qcar_env"),
        "first_step_seconds": environments.first_step(),
        "first_step_with_import_seconds": fresh(environments.FIRST_STEP),
    }


def ratios(
    timings: Mapping[str, Timing], num_envs: Sequence[int], threads: int
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
            (f"batch {n}", environments.ASYNC, None) if n == 64 else (f"batch {n}", "", None),
            (f"batch {n}", f"EnvPool Pendulum {n}", 50.0 if n == 1024 else None),
            (f"batch {n}", f"gymnax Pendulum {n}", None),
        ]
    threaded = f"rollout, held, fused, {cores()} threads"
    wanted += [
        ("rollout, held", "multiply-add peak", 0.85),
        ("rollout, held, fused", "multiply-add peak", 0.85),
        (threaded, "rollout, held, fused", 1.9),
        # what the machine gives: less than 2 where the other core is somebody else's too
        (f"multiply-add peak, {cores()} threads", "multiply-add peak", None),
    ]
    for n in num_envs:  # shares of what the machine can do at most
        for name in ("", ", single"):
            wanted.append((f"batch {n}{name}", f"multiply-add peak{name} beside {n}", None))
        wanted += [(f"batch {n}{name}", f"copy of {n} cars", None) for name in ("", ", exact")]
    rows: list[dict[str, Any]] = []
    for ours, theirs, limit in wanted:
        if ours in timings and theirs in timings:
            middle, *quartiles = timings[ours].times_faster_than(timings[theirs])
            found = {"ratio": middle, "quartiles": quartiles, "least": limit}
            rows.append({"ours": ours, "theirs": theirs, **found})
    return rows


def table(result: Mapping[str, Any]) -> str:
    """Return the result as a Markdown table."""
    against = [
        [
            row["ours"],
            row["theirs"],
            f"{row['ratio']:.3g}",
            "{:.3g} to {:.3g}".format(*row["quartiles"]),
            "" if row["least"] is None else f"{row['least']:.3g}",
        ]
        for row in result["ratios"]
    ]
    times = [
        [name, f"{each['median']:.4g}", f"{1 / each['median']:.4g}"]
        for name, each in result["microseconds"].items()
    ]
    return "\n".join(
        [
            *markdown(("what", "against", "times faster", "quartiles", "asked for"), against),
            "",
            *markdown(("what", "us a step", "million steps a second"), times),
            "",
            *(
                f"{name.replace('_', ' ')}: {result[name]:.3g}  "
                for name in SINGLE_NUMBERS
                if result.get(name) is not None
            ),
        ]
    )
