"""Learning curves: what is left of the vibration while an agent trains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito
GRID = 60  # points of a curve
LOWEST = 1e-5  # [-] level that still has a line in a figure


def learning_curve(
    axes: Axes, x: ArrayLike, curves: Sequence[ArrayLike], *, label: str, colour: str
) -> Axes:
    """Draw the median over seeds of an amplitude with the range of all, on a logarithmic axis.

    Parameters
    ----------
    x : array_like (k,)
        Training time [s] or environment steps.
    curves : sequence of array_like (k,)
        Relative amplitudes [-], one curve a seed, all at `x`.
    label : str
        Name of the agent.
    colour : str
        Its colour.
    """
    values: NDArray[np.float64] = np.array(curves, dtype=np.float64)
    at: NDArray[np.float64] = np.asarray(x, dtype=np.float64)
    axes.plot(at, np.median(values, axis=0), color=colour, label=label)
    if len(values) > 1:
        axes.fill_between(
            at, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.2, linewidth=0.0
        )
    axes.set_yscale("log")
    return axes


def reference_lines(axes: Axes, levels: Mapping[str, float]) -> Axes:
    """Draw laws and the optimum as horizontal lines, named at the right edge.

    Parameters
    ----------
    levels : mapping
        Relative amplitude [-] by name; levels that are not positive have no place on a
        logarithmic axis and are left out.
    """
    for name, level in levels.items():
        if level > 0.0:
            axes.axhline(level, color="0.4", linewidth=0.8, linestyle="--")
            axes.annotate(
                name, (1.0, level), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                fontsize="small", color="0.3",
            )  # fmt: skip
    return axes


def progress(curves: Mapping[str, ArrayLike], time: ArrayLike) -> Figure:
    """Draw one run.

    Parameters
    ----------
    curves : mapping of str to array_like (k,)
        Relative amplitudes [-] by the mass's symbol.
    time : array_like (k,)
        Training time [s].
    """
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for (name, curve), colour in zip(curves.items(), COLOURS, strict=False):
        learning_curve(axes, time, [curve], label=f"{name} / uncontrolled", colour=colour)
    axes.set(xlabel="training time [s]", ylabel="relative amplitude [-]")
    axes.legend()
    return figure


def recipes(task: str, points: Sequence[Mapping[str, Any]], levels: Mapping[str, float]) -> Figure:
    """Draw rho against training time and steps for all recipes of a task.

    Parameters
    ----------
    task : str
        Its name.
    points : sequence of mapping
        One for each live evaluation: `recipe`, `run`, `cpu` [s], `steps` and `rho` [-].
    levels : mapping
        rho of what they are drawn beside [-]; what lies far below the curves is named in the title.
    """
    lowest = 0.8 * min(each["rho"] for each in points)
    lowest = min(lowest, 0.8 * min(filter(lambda level: level > LOWEST, levels.values())))
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, across, label in (
        (left, "cpu", "training time on the processor [s]"),
        (right, "steps", "environment steps"),
    ):
        for name, colour in zip(dict.fromkeys(p["recipe"] for p in points), COLOURS, strict=False):
            runs: dict[str, list[tuple[float, float]]] = {}
            for each in points:
                if each["recipe"] == name and each["steps"] > 0:
                    runs.setdefault(each["run"], []).append((each[across], each["rho"]))
            begin = max(run[0][0] for run in runs.values())
            end = min(run[-1][0] for run in runs.values())
            at = np.geomspace(begin, end, GRID)
            curves = [np.interp(at, *np.array(run).T) for run in runs.values()]
            learning_curve(axes, at, curves, label=f"{name}, {len(curves)} seeds", colour=colour)
        axes.set_xscale("log")
        axes.set_xlabel(label)
        reference_lines(axes, {name: each for name, each in levels.items() if each > lowest})
    left.set_ylim(bottom=lowest)
    left.set_ylabel("rho, live evaluation [-]")
    right.legend(fontsize="small", loc="lower left")
    below = ", ".join(f"{name} {each:.1g}" for name, each in levels.items() if each <= lowest)
    figure.suptitle(
        f"{task}: median and range of the seeds" + (f"; below the axis: {below}" if below else ""),
        fontsize="medium",
    )
    return figure
