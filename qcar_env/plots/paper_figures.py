"""The paper's Figures 3 to 14, and four of our own, composed from data.

Each function takes the numbers that `qcar_env.analysis.paper.experiments` computes and returns a
figure; nothing is computed or saved here. Inside `qcar_env.plots.style.journal` they have the
look of all figures. Simulated points are open circles, unstable motions dashed. The file is long
because sixteen figures share their grids, axes and legends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from qcar_env.analysis.chaos import LyapunovExponents
from qcar_env.analysis.paper.experiments import (
    Comparison,
    Effects,
    Errors,
    FoldedResponse,
    SimulatedPoints,
)
from qcar_env.analysis.paper.frequency_response import Response
from qcar_env.analysis.paper.parameter_study import Curve
from qcar_env.analysis.paper.stability import FloquetComparison, StabilityMap
from qcar_env.analysis.simulate import Simulation
from qcar_env.plots.response import (
    SYMBOLS,
    axis_label,
    errors,
    growth_rates,
    points,
    response_curve,
    setting_label,
    stability_regions,
)
from qcar_env.plots.style import DOUBLE_COLUMN, line

Array = NDArray[np.float64]

MASSES = (("x_1", "wheel"), ("x_2", "body"))
# One law at three settings: shades of its colour, told apart in grey as well.
SHADES = {"cnvc": ("#7FC4EE", "#0072B2", "#00304F"), "ppf": ("#E5B7D2", "#CC79A7", "#6B2E50")}
WIDTHS = (1.6, 1.2, 0.9)


def time_and_phase(histories: Mapping[str, Simulation], period: float, shown: float) -> Figure:
    """Draw Figure 3: time history, last periods and phase plane of each mass.

    Parameters
    ----------
    histories : mapping of str to Simulation
        By law, the uncontrolled one (``none``) first.
    period : float
        Period of the forcing [s].
    shown : float
        Length of the time history shown [s].
    """
    figure, axes = _grid(2, 3, height=4.2, width_ratios=[1.6, 1.0, 1.0])
    for row, (symbol, mass) in enumerate(MASSES):
        history, last, plane = axes[row]
        for law, motion in histories.items():
            x, v = _displacement(motion, row), _velocity(motion, row)
            first = motion.t <= shown
            end = motion.t >= motion.t[-1] - 5.0 * period
            style = line(law)
            history.plot(
                motion.t[first], x[first], color=style.color, linewidth=0.4, rasterized=True
            )
            last.plot(motion.t[end] - motion.t[end][0], x[end], color=style.color)
            plane.plot(x[end], v[end], color=style.color, label=style.label)
        history.set_xlabel("$t$ [s]")
        history.set_ylabel(f"${symbol}$ ({mass}) [m]")
        history.set_xlim(0.0, shown)
        last.set_xlabel("$t - t_0$ [s]")
        last.set_ylabel(f"${symbol}$ [m]")
        plane.set_xlabel(f"${symbol}$ [m]")
        plane.set_ylabel(rf"$\dot {symbol}$ [m/s]")
    axes[0][0].set_title("from rest")
    axes[0][1].set_title("steady")
    axes[0][2].set_title("phase plane, steady")
    _legend_above(figure, axes[0][2])
    return figure


def responses(
    curves: Mapping[str, Mapping[str, Response]],
    simulated: Mapping[str, Mapping[str, SimulatedPoints]] | None = None,
    exact: Mapping[str, Mapping[str, Response]] | None = None,
) -> Figure:
    """Draw Figure 4, or with simulated points Figure 14.

    Parameters
    ----------
    curves : mapping
        ``curves[against][law]``: averaged response.
    simulated : mapping, optional
        ``simulated[against][law]``: points of long simulations.
    exact : mapping, optional
        ``exact[against][law]``: response by harmonic balance.
    """
    figure, axes = _grid(2, 2, height=4.4)
    for column, (against, by_law) in enumerate(curves.items()):
        for row, amplitude in enumerate(("a1", "a2")):
            ax = axes[row][column]
            for law, curve in by_law.items():
                style = line(law)
                name = f"{style.label}, averaged" if simulated else style.label
                response_curve(ax, curve, amplitude, color=style.color, label=name)
                if exact:
                    other = exact[against][law]
                    ax.plot(
                        other.values, getattr(other, amplitude), color=style.color,
                        linestyle=(0, (1, 1.5)), label=f"{style.label}, harmonic balance",
                    )  # fmt: skip
                if simulated:
                    points(
                        ax, simulated[against][law], amplitude, color=style.color,
                        label=f"{style.label}, simulated",
                    )  # fmt: skip
            _log_amplitude(ax)
            ax.set_xlabel(axis_label(against))
            ax.set_ylabel(axis_label(amplitude))
        axes[0][column].set_title(f"({'ab'[column]})")
    _legend_above(figure, axes[0][0])
    return figure


def parameter_effects(effects: Effects, panels: Mapping[str, Sequence[Curve]]) -> Figure:
    """Draw one of Figures 5 to 8: a panel for each parameter.

    Parameters
    ----------
    effects : Effects
        Which figure.
    panels : mapping of str to sequence of Curve
        Curves of each panel, in the order of the panels.
    """
    columns = 3 if len(panels) in (3, 5, 6, 9) else 4
    rows = -(-len(panels) // columns)
    figure, axes = _grid(rows, columns, height=1.75 * rows + 0.2)
    flat = [ax for row in axes for ax in row]
    tallest = max(
        float(np.max(getattr(curve.response, effects.amplitude)))
        for curves in panels.values()
        for curve in curves
    )
    for index, (name, curves) in enumerate(panels.items()):
        ax = flat[index]
        for number, curve in enumerate(curves):
            (value,) = curve.setting.values()
            response_curve(
                ax, curve.response, effects.amplitude,
                color=SHADES["cnvc"][number], linewidth=WIDTHS[number],
                label=f"{value:.4g}",
            )  # fmt: skip
        ax.set_title(f"({chr(ord('A') + index)})", loc="left")
        ax.legend(
            title=axis_label(name), loc="upper center", ncols=len(curves), columnspacing=0.6,
            handlelength=0.7, handletextpad=0.3, borderaxespad=0.1, title_fontsize=7.0,
            fontsize=6.5,
        )  # fmt: skip
        ax.set_xlabel(axis_label(effects.against))
        ax.set_ylim(0.0, 1.5 * tallest)  # room for the legend above the curves
        if index % columns == 0:
            ax.set_ylabel(axis_label(effects.amplitude))
    for ax in flat[len(panels) :]:
        ax.set_visible(False)
    return figure


def frequency_effect(
    histories: Mapping[float, Simulation], curves: Mapping[str, Response], shown: float
) -> Figure:
    """Draw Figure 9: steady motions at several common frequencies, and amplitude against them.

    Parameters
    ----------
    histories : mapping of float to Simulation
        By ``omega = omega1 = omega2 = Omega`` [rad/s].
    curves : mapping of str to Response
        Averaged amplitude against the common frequency, by law.
    shown : float
        Length of the motion shown, at its end [s].
    """
    figure, axes = _grid(2, 2, height=4.2, width_ratios=[1.3, 1.0])
    for row, (symbol, mass) in enumerate(MASSES):
        history, curve = axes[row]
        for number, (omega, motion) in enumerate(histories.items()):
            end = motion.t >= motion.t[-1] - shown
            history.plot(
                motion.t[end] - motion.t[end][0], _displacement(motion, row)[end],
                color=SHADES["cnvc"][number], linewidth=WIDTHS[number],
                label=rf"$\omega$ = {omega:g} rad/s",
            )  # fmt: skip
        history.set_xlabel("$t - t_0$ [s]")
        history.set_ylabel(f"${symbol}$ ({mass}) [m]")
        amplitude = f"a{row + 1}"
        for law, found in curves.items():
            response_curve(curve, found, amplitude, color=line(law).color, label=line(law).label)
        _log_amplitude(curve)
        curve.set_xlabel(axis_label("frequencies"))
        curve.set_ylabel(axis_label(amplitude))
        for number, omega in enumerate(histories):
            found = curves["cnvc"]
            height = float(np.interp(omega, found.values, getattr(found, amplitude)))
            curve.plot(
                omega, height, "o", color=SHADES["cnvc"][number], markersize=4,
                markeredgecolor="#000000", markeredgewidth=0.4,
            )  # fmt: skip
    axes[0][0].set_title("(a) CNVC, steady")
    axes[0][1].set_title("(b) averaged amplitude")
    _legend_above(figure, axes[0][0], axes[0][1])
    return figure


def hump_height(panels: Mapping[str, Mapping[float, Response]]) -> Figure:
    """Draw Figure 10: amplitude against `h` for several values of another parameter.

    Parameters
    ----------
    panels : mapping
        ``panels[parameter][value]``: averaged response against `h`.
    """
    figure, axes = _grid(2, len(panels), height=4.2)
    for column, (parameter, curves) in enumerate(panels.items()):
        for row, amplitude in enumerate(("a1", "a2")):
            ax = axes[row][column]
            for number, (value, curve) in enumerate(curves.items()):
                response_curve(
                    ax, curve, amplitude, color=SHADES["cnvc"][number],
                    linewidth=WIDTHS[number], label=f"{value:.4g}",
                )  # fmt: skip
            ax.set_xlabel(axis_label("h"))
            ax.set_ylabel(axis_label(amplitude))
            ax.set_ylim(bottom=0.0)
            ax.set_xlim(left=0.0)
            ax.xaxis.set_major_locator(MaxNLocator(5))
        # the lower panels have room under their curves
        axes[1][column].legend(
            title=axis_label(parameter), loc="lower center", ncols=3, title_fontsize=7.0
        )
        axes[0][column].set_title(f"({'ab'[column]})")
    return figure


def step_hump(
    without_force: Mapping[str, Simulation], with_force: Mapping[str, Simulation]
) -> Figure:
    """Draw Figure 11: the answer to the step ``y = h``, without and with the external force.

    Parameters
    ----------
    without_force, with_force : mapping of str to Simulation
        By law.
    """
    figure, axes = _grid(2, 2, height=4.0)
    for column, histories in enumerate((without_force, with_force)):
        for row, (symbol, mass) in enumerate(MASSES):
            ax = axes[row][column]
            for law, motion in histories.items():
                style = line(law)
                ax.plot(
                    motion.t, _displacement(motion, row), color=style.color, label=style.label,
                    linestyle=style.linestyle, linewidth=0.8,
                )  # fmt: skip
            ax.set_xlabel("$t$ [s]")
            ax.set_ylabel(f"${symbol}$ ({mass}) [m]")
    axes[0][0].set_title("(a) $f = 0$")
    axes[0][1].set_title("(b) with the external force")
    _legend_above(figure, axes[0][0])
    return figure


def law_comparison(
    rows: Sequence[Mapping[str, tuple[str, Simulation]]], period: float, shown: float
) -> Figure:
    """Draw Figure 12: the largest displacement of each period under each law, from rest.

    Parameters
    ----------
    rows : sequence of mappings
        For each row of panels: label to ``(law, Simulation)``. Two settings of one law are told
        apart by shade.
    period : float
        Period of the motion [s].
    shown : float
        Length shown [s].
    """
    figure, axes = _grid(len(rows), 2, height=1.9 * len(rows) + 0.3)
    for index, entries in enumerate(rows):
        seen: dict[str, int] = {}
        for label, (law, motion) in entries.items():
            count = seen.get(law, 0)
            seen[law] = count + 1
            style = line(law)
            color = SHADES[law][2 * count] if law in SHADES and count else style.color
            for column in range(2):
                t, peaks = _peaks(motion, column, period)
                axes[index][column].plot(
                    t, peaks, color=color, linestyle=style.linestyle, label=label
                )
        for column, (symbol, mass) in enumerate(MASSES):
            ax = axes[index][column]
            _log_amplitude(ax)
            ax.set_ylabel(f"peak of ${symbol}$ ({mass}) [m]")
            ax.set_xlabel("$t$ [s]")
            ax.set_xlim(0.0, shown)
        axes[index][0].set_title(f"({'abcdef'[index]})", loc="left")
        axes[index][1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def numerical_and_averaged(
    comparisons: Mapping[str, Comparison], period: float, shown: Mapping[str, float]
) -> Figure:
    """Draw Figure 13: the full equations and the averaged motion, from rest and in steady state.

    Parameters
    ----------
    comparisons : mapping of str to Comparison
        By law.
    period : float
        Period of the forcing [s].
    shown : mapping of str to float
        Length of the transient shown, by law [s].
    """
    figure, axes = _grid(2 * len(comparisons), 2, height=6.6, width_ratios=[1.7, 1.0])
    for block, (law, both) in enumerate(comparisons.items()):
        color = line(law).color
        t = both.numerical.t
        first, end = t <= shown[law], t >= t[-1] - 3.0 * period
        for row, (symbol, mass) in enumerate(MASSES):
            transient, steady = axes[2 * block + row]
            x = _displacement(both.numerical, row)
            a = both.averaged.a2 if row else both.averaged.a1
            approximate = both.averaged.x2 if row else both.averaged.x1
            light = "#AAAAAA" if law == "none" else color
            transient.plot(t[first], x[first], color=light, linewidth=0.5, rasterized=True)
            for sign in (1.0, -1.0):
                transient.plot(t[first], sign * a[first], color="#000000", linestyle=(0, (4, 2)))
            steady.plot(t[end] - t[end][0], x[end], color=light, linewidth=1.8, label="numerical")
            steady.plot(
                t[end] - t[end][0], approximate[end], color="#000000", linestyle=(0, (4, 2)),
                linewidth=0.9, label="averaged",
            )  # fmt: skip
            transient.set_ylabel(f"${symbol}$ ({mass}) [m]")
            transient.set_xlim(0.0, shown[law])
            transient.set_xlabel("$t$ [s]")
            steady.set_xlabel("$t - t_0$ [s]")
        axes[2 * block][0].set_title(f"({'ab'[block]}) {line(law).label}, from rest", loc="left")
        axes[2 * block][1].set_title("steady", loc="left")
    _legend_above(figure, axes[0][1])
    return figure


def accuracy(panels: Mapping[str, Mapping[str, Errors]]) -> Figure:
    """Draw where averaging fails: the error of each method against detuning.

    Parameters
    ----------
    panels : mapping
        ``panels[law][parameter]``.
    """
    figure, axes = _grid(len(panels), 2, height=4.2)
    for row, (law, by_parameter) in enumerate(panels.items()):
        for column, found in enumerate(by_parameter.values()):
            ax = axes[row][column]
            errors(ax, found)
            for level, name in ((5.0, "5 %"), (0.1, "0.1 %")):
                ax.axhline(level, color="#D55E00", linewidth=0.6)
                ax.annotate(
                    name, (1.0, level), xycoords=("axes fraction", "data"), fontsize=6.0,
                    xytext=(2, 0), textcoords="offset points", va="center",
                )  # fmt: skip
            ax.axvspan(-5.0, 5.0, color="#EEEEEE", zorder=0)
            ax.set_title(f"{line(law).label}", loc="left")
    _legend_above(figure, axes[0][0])
    return figure


def hardening(found: FoldedResponse, law: str = "none") -> Figure:
    """Draw a folded response with points simulated upward and downward.

    Parameters
    ----------
    found : FoldedResponse
        The curves and points.
    law : str, optional
        For the colour.
    """
    figure, axes = _grid(1, 2, height=2.9)
    for column, amplitude in enumerate(("a1", "a2")):
        ax = axes[0][column]
        response_curve(
            ax, found.averaged, amplitude, color="#999999", linewidth=2.2, label="averaged"
        )
        response_curve(
            ax, found.balanced, amplitude, color=line(law).color, label="harmonic balance"
        )
        points(ax, found.upward, amplitude, color="#000000", marker="^", label="simulated, rising")
        points(
            ax, found.downward, amplitude, color="#000000", marker="v", label="simulated, falling"
        )
        ax.set_xlabel(axis_label(found.averaged.parameter))
        ax.set_ylabel(axis_label(amplitude))
    _legend_above(figure, axes[0][0])
    return figure


def stability(
    found: StabilityMap, growth: Mapping[str, tuple[Array, FloquetComparison]], against: str
) -> Figure:
    """Draw a stability map, and averaged growth rates beside Floquet exponents.

    Parameters
    ----------
    found : StabilityMap
        The map.
    growth : mapping of str to tuple
        By law: the parameter's values and the rates.
    against : str
        Name of that parameter.
    """
    figure, axes = _grid(1, 2, height=2.9)
    left, right = axes[0]
    stability_regions(left, found)
    left.set_title("(a) no control, averaged", loc="left")
    for law, (values, rates) in growth.items():
        growth_rates(right, values, rates, color=line(law).color, label=line(law).label)
    right.axhline(0.0, color="#D55E00", linewidth=0.8)
    right.set_xlabel(axis_label(against))
    right.set_ylabel("growth rate [1/s]")
    right.set_title("(b) averaged and Floquet", loc="left")
    right.legend(loc="best")
    return figure


def chaos(
    sections: Mapping[str, Array], exponents: Mapping[str, LyapunovExponents], period: float
) -> Figure:
    """Draw Poincare sections and the estimate of the largest Lyapunov exponent.

    Parameters
    ----------
    sections : mapping of str to ndarray (m, 1, k)
        By law: states once a period.
    exponents : mapping of str to LyapunovExponents
        By law.
    period : float
        Period of the forcing [s].
    """
    figure, axes = _grid(1, 3, height=2.5)
    for law, section in sections.items():
        style = line(law)
        for column in range(2):
            ax = axes[0][column]
            ax.plot(
                section[column, 0], section[2 + column, 0], "o", markersize=3.5,
                color=style.color, markerfacecolor="none", label=style.label,
            )  # fmt: skip
            ax.set_xlabel(f"$x_{column + 1}$ [m]")
            ax.set_ylabel(rf"$\dot x_{column + 1}$ [m/s]")
            ax.margins(0.3)
    for law, found in exponents.items():
        style = line(law)
        periods = np.arange(1, len(found.history) + 1)
        axes[0][2].plot(periods * period, found.history[:, 0], color=style.color, label=style.label)
    axes[0][2].axhline(0.0, color="#D55E00", linewidth=0.8)
    axes[0][2].margins(y=0.1)
    axes[0][2].set_xlabel("$t$ [s]")
    axes[0][2].set_ylabel("largest Lyapunov\nexponent [1/s]")
    for index, ax in enumerate(axes[0]):
        ax.set_title(f"({'abc'[index]})", loc="left")
    _legend_above(figure, axes[0][0])
    return figure


def _grid(rows: int, columns: int, *, height: float, **options: Any) -> tuple[Figure, Any]:
    if "width_ratios" in options:
        options = {"gridspec_kw": {"width_ratios": options["width_ratios"]}}
    return plt.subplots(rows, columns, figsize=(DOUBLE_COLUMN, height), squeeze=False, **options)


def _legend_above(figure: Figure, *axes: Axes) -> None:
    entries: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    wide = sum(map(len, entries)) > 80
    figure.legend(
        list(entries.values()), list(entries), loc="outside upper center",
        ncols=-(-len(entries) // 2) if wide else len(entries),
    )  # fmt: skip


def _log_amplitude(ax: Axes) -> None:
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _peaks(motion: Simulation, row: int, period: float) -> tuple[Array, Array]:
    """Return the middle and the largest displacement of each whole period."""
    step = float(motion.t[1] - motion.t[0])
    edges = np.round(np.arange(0.0, float(motion.t[-1]), period) / step).astype(int)
    x = np.abs(_displacement(motion, row))
    peaks = np.maximum.reduceat(x, edges)[:-1]
    return 0.5 * (motion.t[edges[:-1]] + motion.t[edges[1:]]), peaks


def _displacement(motion: Simulation, row: int) -> Array:
    return motion.x2 if row else motion.x1


def _velocity(motion: Simulation, row: int) -> Array:
    return motion.v2 if row else motion.v1


__all__ = [
    "SYMBOLS",
    "accuracy",
    "chaos",
    "frequency_effect",
    "hardening",
    "hump_height",
    "law_comparison",
    "numerical_and_averaged",
    "parameter_effects",
    "responses",
    "setting_label",
    "stability",
    "step_hump",
    "time_and_phase",
]
