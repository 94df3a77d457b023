"""Steps per second against the number of cars, and time against substeps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

SERIES = {
    r"batch (\d+)": ("this library", "#0072B2", "o"),
    r"batch (\d+), single": ("single precision", "#56B4E9", "s"),
    r"batch (\d+), exact": ("exact map", "#D55E00", "P"),
    r"batch (\d+), \d+ threads": ("all threads", "#009E73", "^"),
    r"CartPoleVectorEnv (\d+)": ("CartPoleVectorEnv", "#E69F00", "v"),
    r"EnvPool Pendulum (\d+)": ("EnvPool Pendulum", "#CC79A7", "D"),
}


def draw(result: dict[str, Any], axes: Sequence[Any]) -> Sequence[Any]:
    """Draw a result of ``scripts/throughput.py`` into two axes, and return them."""
    times = {name: each["median"] for name, each in result["microseconds"].items()}
    left, right = axes
    for pattern, (label, color, marker) in SERIES.items():
        found = [(re.fullmatch(pattern, name), us) for name, us in times.items()]
        points = sorted((int(match[1]), 1.0 / us) for match, us in found if match)
        if points:
            left.loglog(*zip(*points, strict=True), marker=marker, color=color, label=label)
    left.set(xlabel="cars [-]", ylabel="million steps a second")
    left.legend()
    found = [(re.fullmatch(r"batch 1024, (\d+) substeps", name), us) for name, us in times.items()]
    points = sorted((int(match[1]), 1000.0 * us) for match, us in found if match)
    if points:
        right.plot(*zip(*points, strict=True), marker="o", color="#0072B2")
    right.set(xlabel="substeps [-]", ylabel="time of a car's step [ns]", xlim=(0, None))
    right.set_ylim(0, None)
    return axes
