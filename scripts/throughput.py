"""Measure environment steps per second, against other environments and the processor.

qcar throughput
qcar throughput --rounds 21 --num-envs 64 1024 16384 --out results/throughput

Ratios are taken within interleaved rounds (`qcar_env.evaluation.throughput.timing`); their median
and quartiles are printed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from qcar_env.commands import command
from qcar_env.engine.closed_loop import cores
from qcar_env.evaluation import storage
from qcar_env.evaluation.throughput.result import measure, table
from qcar_env.validation import whole

OPTIONS: command.Options = {
    "rounds": (11, "interleaved rounds (default: %(default)s)"),
    "num-envs": (
        (1, 64, 1024, 16384, 262144),
        "batch sizes (default: 1 64 1024 16384 262144)",
    ),
    "threads": (cores(), "threads to compare (default: %(default)s)"),
    "out": (Path("results/throughput"), "folder (default: %(default)s)"),
}


def run(arguments: argparse.Namespace) -> None:
    """Measure, print and store."""
    whole("rounds", arguments.rounds, least=3)
    for n in arguments.num_envs:
        whole("num-envs", n)
    whole("threads", arguments.threads, most=1024)
    storage.check_folder(arguments.out)
    result = measure(arguments.rounds, arguments.num_envs, arguments.threads, command.say)
    result["environment_share_of_ppo"] = _share()
    storage.write_text(arguments.out / "throughput.json", json.dumps(result, indent=1) + "\n")
    print(table(result))
    if find_spec("matplotlib"):
        _plot(result, arguments.out / "throughput.png")
    print(f"\nwritten to {arguments.out}")


def _share() -> float | None:
    """Return the environment's share of PPO's training time, where SB3 is installed."""
    if not find_spec("stable_baselines3"):
        return None
    from qcar_env.agents.environment_share import environment_share

    return environment_share()


def _plot(result: Mapping[str, Any], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from qcar_env.plots.throughput import draw

    figure, axes = plt.subplots(2, 2, figsize=(7.2, 5.6), layout="constrained")
    draw(result, axes.ravel())
    with storage.replacing(path) as temporary:
        figure.savefig(temporary, dpi=200)
    plt.close(figure)


main = command.main("throughput", __doc__.splitlines()[0], OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
