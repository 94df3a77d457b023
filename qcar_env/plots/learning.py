"""Learning curves: what is left of the vibration while an agent trains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito


def learning_curve(
    axes: Axes,
    x: ArrayLike,
    curves: Sequence[ArrayLike],
    *,
    label: str,
    colour: str,
) -> Axes:
    """Draw the median over seeds of an amplitude with the range of all seeds.

    Parameters
    ----------
    axes : Axes
        Where; its vertical axis becomes logarithmic.
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
    axes : Axes
        Where.
    levels : mapping
        Relative amplitude [-] by name; levels that are not positive have no place on a
        logarithmic axis and are left out.
    """
    for name, level in levels.items():
        if level > 0.0:
            axes.axhline(level, color="0.4", linewidth=0.8, linestyle="--")
            axes.annotate(
                name,
                (1.0, level),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize="small",
                color="0.3",
            )
    return axes
