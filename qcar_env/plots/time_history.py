"""Time histories of wheel and body."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from qcar_env.evaluation.comparison import Comparison
from qcar_env.plots.style import DOUBLE_COLUMN, MASSES, line, log_ticks

Array = NDArray[np.float64]

SHOWN = 10.0  # [s] of the time histories


def envelope(ax: Axes, t: Array, x: Array, period: float, law: str) -> Axes:
    """Draw the largest displacement of each period against time, on a logarithmic axis.

    Parameters
    ----------
    ax, law
        Where to draw, and in whose colour.
    t, x : ndarray (k,)
        Evenly spaced times [s] and displacement [m].
    period : float
        Period of the motion [s].
    """
    step = (t[-1] - t[0]) / max(len(t) - 1, 1)
    per_period = min(max(1, round(period / step)), len(t)) if step > 0.0 else 1
    count = len(t) // per_period
    peaks = np.abs(x[: count * per_period]).reshape(count, per_period).max(axis=1)
    middles = t[: count * per_period].reshape(count, per_period).mean(axis=1)
    ax.semilogy(middles, peaks, **line(law)._asdict())
    low, high = ax.get_ylim()
    log_ticks(ax, (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,))
    return ax


def comparison(found: Comparison) -> Figure | None:
    """Draw policies against the uncontrolled motion, and all envelopes together.

    Those that left the travel limits are left out; without any other there is no figure. Of the
    learned ones one gets a time history: by reinforcement if there is one, and the best.
    """
    complete = [each.policy for each in found.outcomes if not each.terminated]
    if not complete:
        return None
    best = min(
        (each for each in found.outcomes if each.policy in found.learned),
        key=lambda each: (not each.policy.startswith(("ppo", "sac")), each.rho),
        default=None,
    )
    aside = {"none", *found.learned} - {best.policy if best else ""}
    laws = [name for name in complete if name not in aside]
    histories = {name: (found.rollouts[name].x1, found.rollouts[name].x2) for name in complete}
    t = found.rollouts[complete[0]].t
    period = 2.0 * np.pi / found.scenario.reference_frequency
    figure = plt.figure(figsize=(DOUBLE_COLUMN, 5.4))
    parts: Any = figure.subfigures(2, 1, height_ratios=[3.1, 2.3])
    upper, lower = parts
    axes = upper.subplots(2, max(1, len(laws)), sharex=True, sharey="row", squeeze=False)
    window = t <= min(SHOWN, float(t[-1]))

    def displacement(ax: Axes, law: str, row: int) -> None:
        color = "#BBBBBB" if law == "none" else line(law).color
        x = histories[law][row][window]
        ax.plot(t[window], x, color=color, linewidth=0.5, rasterized=True)

    for row, (symbol, mass) in enumerate(MASSES):
        for ax, law in zip(axes[row], laws, strict=False):
            if "none" in histories:
                displacement(ax, "none", row)
            displacement(ax, law, row)
            ax.grid(False)
            if row == 0:
                ax.set_title(line(law).label, color=line(law).color)
            else:
                ax.set_xlabel("$t$ [s]")
        axes[row][0].set_ylabel(f"${symbol}$ ({mass}) [m]")
    envelopes = lower.subplots(1, 2)
    for row, (ax, (symbol, mass)) in enumerate(zip(envelopes, MASSES, strict=True)):
        for law, history in histories.items():
            envelope(ax, t, history[row], period, law)
        ylabel = f"peak of ${symbol}$ ({mass}) [m]"
        ax.set(xlabel="$t$ [s]", ylabel=ylabel, xlim=(0.0, float(t[-1])))
    handles, labels = envelopes[0].get_legend_handles_labels()
    lower.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure
