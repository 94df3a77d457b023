"""Steps per second against the number of cars, and cost against cars, length and substeps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

OURS = "#0072B2"
SERIES = {
    r"batch (\d+)": ("this library", OURS, "o"),
    r"batch (\d+), single": ("single precision", "#56B4E9", "s"),
    r"batch (\d+), exact": ("exact map", "#D55E00", "P"),
    r"batch (\d+), \d+ threads": ("all threads", "#009E73", "^"),
    r"CartPoleVectorEnv (\d+)": ("CartPoleVectorEnv", "#E69F00", "v"),
    r"EnvPool Pendulum (\d+)": ("EnvPool Pendulum", "#CC79A7", "D"),
    r"gymnax Pendulum (\d+)": ("gymnax Pendulum", "#000000", "x"),
}


def draw(result: Mapping[str, Any], axes: Sequence[Any]) -> Sequence[Any]:
    """Draw a result of ``qcar throughput`` into four axes, and return them.

    Dashed: a cost in proportion to the number of cars, from 1024 on, as below that the call itself
    counts; and straight lines through the first and the last point.
    """
    times = {name: each["median"] for name, each in result["microseconds"].items()}
    rate, cars, length, substeps = axes
    for pattern, (label, color, marker) in SERIES.items():
        points = [(n, 1.0 / us) for n, us in _points(times, pattern)]
        if points:
            rate.loglog(*zip(*points, strict=True), marker=marker, color=color, label=label)
    rate.set(xlabel="cars [-]", ylabel="million steps a second")
    bottom, top = rate.get_ylim()
    rate.set_ylim(bottom / (top / bottom) ** 0.5, top)  # room for the legend
    rate.legend(fontsize="x-small", loc="lower right", ncols=2)

    points = [(n, n * us) for n, us in _points(times, r"batch (\d+)")]
    whole = [(n, us) for n, us in points if n >= 1024]
    if whole:
        n, us = whole[0]
        cars.loglog([n, points[-1][0]], [us, us * points[-1][0] / n], "k--", lw=0.8)
    if points:
        cars.loglog(*zip(*points, strict=True), marker="o", color=OURS)
    cars.set(xlabel="cars [-]", ylabel="time of a step of all [us]")

    points = [(t, 1e-3 * t * us) for t, us in _points(times, r"rollout of (\d+) intervals")]
    _straight(length, points)
    length.set(xlabel="control intervals of a closed loop [-]", ylabel="time for a car [ms]")

    points = [(k, 1e3 * us) for k, us in _points(times, r"batch 1024, (\d+) substeps")]
    _straight(substeps, points)
    substeps.set(xlabel="substeps [-]", ylabel="time of a car's step [ns]")
    return axes


def _points(times: Mapping[str, float], pattern: str) -> list[tuple[int, float]]:
    found = [(re.fullmatch(pattern, name), us) for name, us in times.items()]
    return sorted((int(match[1]), us) for match, us in found if match)


def _straight(axes: Any, points: Sequence[tuple[int, float]]) -> None:
    """Draw points, and the straight line through the first and the last of them."""
    if points:
        first, last = points[0], points[-1]
        axes.plot(*zip(first, last, strict=True), "k--", lw=0.8)
        axes.plot(*zip(*points, strict=True), marker="o", ls="none", color=OURS)
    axes.set_xlim(0, None)
    axes.set_ylim(0, None)
