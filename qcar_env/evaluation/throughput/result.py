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

SHARES = ("of_peak", "of_memory")
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
    """Return ratios as rows of a table, with our shares of what the machine can do at most."""
    pendulum = "Pendulum-v1 step"
    wanted = [
        ("step", pendulum),
        ("step", "CartPole-v1 step"),
        ("step", "floor: eight numbers"),
        ("gym.make step", f"gym.make {pendulum}"),
    ]
    for n in num_envs:
        ours = f"batch {n}"
        wanted += [(f"{ours}{name}", f"CartPoleVectorEnv {n}") for name in environments.OURS]
        wanted += [
            (f"{ours}, {threads} threads", ours),
            (ours, f"SyncVectorEnv Pendulum {n}"),
            *([(ours, environments.ASYNC)] if n == 64 else []),
            (ours, f"EnvPool Pendulum {n}"),
            (ours, f"gymnax Pendulum {n}"),
        ]
    threaded = f"rollout, held, fused, {cores()} threads"
    wanted += [
        ("rollout, held", "multiply-add peak"),
        ("rollout, held, fused", "multiply-add peak"),
        (threaded, "rollout, held, fused"),
        # what the machine gives: less than 2 where the other core is somebody else's too
        (f"multiply-add peak, {cores()} threads", "multiply-add peak"),
    ]
    rows: list[dict[str, Any]] = []
    for ours, theirs in wanted:
        if ours in timings and theirs in timings:
            middle, *quartiles = timings[ours].times_faster_than(timings[theirs])
            found = {"ratio": middle, "quartiles": quartiles, **_shares(timings, ours)}
            rows.append({"ours": ours, "theirs": theirs, **found})
    return rows


def _shares(timings: Mapping[str, Timing], ours: str) -> dict[str, float | None]:
    """Return a batch's share of the multiply-add peak and of the memory's speed, where known."""
    _, _, size = ours.partition("batch ")
    n, _, settings = size.partition(", ")
    single = ", single" if "single" in settings else ""
    limits = {"of_peak": f"multiply-add peak{single} beside {n}", "of_memory": f"copy of {n} cars"}
    if "exact" in settings:
        del limits["of_peak"]  # it does other operations
    if "threads" in settings:
        limits = {}  # the limits are those of one
    return {
        name: timings[ours].times_faster_than(timings[limits[name]])[0]
        if limits.get(name) in timings
        else None
        for name in SHARES
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the result as a Markdown table."""
    against = [
        [
            row["ours"],
            row["theirs"],
            f"{row['ratio']:.3g}",
            "{:.3g} to {:.3g}".format(*row["quartiles"]),
            *("" if row[name] is None else f"{100 * row[name]:.2g} %" for name in SHARES),
        ]
        for row in result["ratios"]
    ]
    times = [
        [name, f"{each['median']:.4g}", f"{1 / each['median']:.4g}"]
        for name, each in result["microseconds"].items()
    ]
    return "\n".join(
        [
            *markdown(
                ("what", "against", "times faster", "quartiles", "of the peak", "of the memory"),
                against,
            ),
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
