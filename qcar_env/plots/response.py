"""Response curves: amplitude against a parameter, stable and unstable parts, simulated points."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from qcar_env.analysis.paper.experiments import Errors, SimulatedPoints
from qcar_env.analysis.paper.frequency_response import Response
from qcar_env.analysis.paper.stability import FloquetComparison, StabilityMap

Array = NDArray[np.float64]

# Symbol and unit of what stands on an axis; the latter of velocity feedback for the gains.
AXES = {
    "a1": ("a_1", "m"), "a2": ("a_2", "m"), "sigma1": (r"\sigma_1", "rad/s"),
    "sigma2": (r"\sigma_2", "rad/s"), "omega": (r"\omega", "rad/s"),
    "omega1": (r"\omega_1", "rad/s"), "omega2": (r"\omega_2", "rad/s"),
    "frequencies": (r"\omega = \omega_1 = \omega_2 = \Omega", "rad/s"), "h": ("h", "m"),
    "f": ("f", "m/s²"), "G": ("G", "s/m²"), "G1": ("G_1", "s/m²"), "G2": ("G_2", "s/m²"),
    "mu1": (r"\mu_1", "1/s²"), "mu2": (r"\mu_2", "1/s"), "b1": ("b_1", "1/s"),
    "b2": ("b_2", "1/s"), "E1": ("E_1", "1/s²"), "E2": ("E_2", "1/s"), "E3": ("E_3", "1/s²"),
}  # fmt: skip
# Methods of an error plot: shades of grey and lines, since colours belong to laws.
METHOD_LINES: dict[str, dict[str, Any]] = {
    "averaging, natural": {"color": "#999999", "linestyle": (0, (1, 1))},
    "averaging, frozen": {"color": "#000000", "linestyle": "-"},
    "harmonic balance, 1 harmonic": {"color": "#555555", "linestyle": (0, (5, 2))},
    "harmonic balance, 9 harmonics": {"color": "#555555", "linestyle": (0, (3, 1, 1, 1))},
}
# Open circles, for what is simulated.
MARKERS: dict[str, Any] = {
    "marker": "o", "markersize": 3.2, "markerfacecolor": "none", "markeredgewidth": 0.8,
    "linestyle": "none",
}  # fmt: skip


def axis_label(name: str) -> str:
    """Return symbol and unit of a parameter or amplitude, for an axis."""
    symbol, unit = AXES[name]
    return f"${symbol}$ [{unit}]"


def response_curve(
    ax: Axes, curve: Response, amplitude: str, *, label: str | None = None, **style: Any
) -> Axes:
    """Draw one response curve: solid where the motion is stable, dashed where it is not.

    Parameters
    ----------
    ax, curve, amplitude
        Where to draw which curve, and of which amplitude, ``"a1"`` or ``"a2"`` [m].
    label : str, optional
        Text of the legend.
    **style
        Line properties, such as `color`; not the line's style, which tells stability.
    """
    values, heights = curve.values, getattr(curve, amplitude)
    edges = np.flatnonzero(np.diff(curve.stable.astype(int))) + 1
    for part in np.split(np.arange(len(values)), edges):
        shown = np.append(part, part[-1] + 1) if part[-1] + 1 < len(values) else part
        stable = bool(curve.stable[part[0]])
        ax.plot(
            values[shown],
            heights[shown],
            linestyle="-" if stable else (0, (4, 2)),
            label=label if stable else None,
            **style,
        )
        label = None if stable else label
    for each in curve.folds:
        ax.plot(each.value, getattr(each, amplitude), "|", color="#000000", markersize=7)
    return ax


def points(ax: Axes, simulated: SimulatedPoints, amplitude: str, **style: Any) -> Axes:
    """Draw simulated amplitudes as open markers."""
    ax.plot(simulated.values, getattr(simulated, amplitude), **{**MARKERS, **style})
    return ax


def errors(ax: Axes, found: Errors) -> Axes:
    """Draw the error of each method against the detuning, on a logarithmic axis."""
    for name, values in found.errors.items():
        ax.semilogy(
            found.values, 100.0 * np.maximum(values, 1e-6), label=name, **METHOD_LINES[name]
        )
    ax.set_xlabel(axis_label(found.parameter))
    ax.set_ylabel("error of amplitude [%]")
    return ax


def stability_regions(ax: Axes, found: StabilityMap) -> Axes:
    """Draw the growth rate over two parameters, with the border of stability as a thick line."""
    levels = MaxNLocator(10).tick_values(np.nanmin(found.growth), np.nanmax(found.growth))
    filled = ax.contourf(
        found.x_values, found.y_values, found.growth, levels=levels, cmap="Greys", alpha=0.8
    )
    ax.contour(
        found.x_values, found.y_values, found.growth, levels=[0.0], colors="#D55E00", linewidths=1.6
    )
    figure: Any = ax.figure
    figure.colorbar(filled, ax=ax, label="growth rate [1/s]")
    ax.set_xlabel(axis_label(found.x))
    ax.set_ylabel(axis_label(found.y))
    ax.grid(False)
    return ax


def growth_rates(ax: Axes, values: Array, found: FloquetComparison, **style: Any) -> Axes:
    """Draw averaged growth rates as a line and those of the full equations as markers.

    Rates [1/s] are drawn against the values (n,) of a parameter, with any line properties.
    """
    label = style.pop("label", "")
    ax.plot(values, found.averaged, label=f"{label}, averaged", **style)
    ax.plot(values, found.exact, **MARKERS, label=f"{label}, Floquet", **style)
    return ax
