"""The paper's Figures 3 to 14, and four of our own, composed from data.

Each function takes the numbers that `qcar_env.analysis.paper.experiments` computes and returns a
figure; nothing is computed or saved here. Inside `qcar_env.plots.style.journal` they have the
look of all figures. Simulated points are open circles, unstable motions dashed. What is mapped by
law has the uncontrolled one, ``none``, first; `period` is that of the forcing [s], and `shown` the
length of the motion that is drawn [s].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
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
    axis_label,
    errors,
    growth_rates,
    points,
    response_curve,
    stability_regions,
)
from qcar_env.plots.style import DOUBLE_COLUMN, MASSES, line, log_ticks, shared_legend

Array = NDArray[np.float64]

AMPLITUDES = ("a1", "a2")
# One law at three settings: shades of its colour, told apart in grey as well.
SHADES = {"cnvc": ("#7FC4EE", "#0072B2", "#00304F"), "ppf": ("#E5B7D2", "#CC79A7", "#6B2E50")}
WIDTHS = (1.6, 1.2, 0.9)
BOUND: dict[str, Any] = {"color": "#D55E00", "linewidth": 0.8}  # a line that must not be crossed
OVER: dict[str, Any] = {"color": "#000000", "linestyle": (0, (4, 2))}  # an approximation


def time_and_phase(histories: Mapping[str, Simulation], period: float, shown: float) -> Figure:
    """Draw Figure 3: time history, last five periods and phase plane of each mass, by law."""
    figure, axes = _grid(2, 3, 4.2, [1.6, 1.0, 1.0])
    for row, (symbol, mass) in enumerate(MASSES):
        history, last, plane = axes[row]
        for law, motion in histories.items():
            x, v = _moved(motion, row)
            first, end = motion.t <= shown, motion.t >= motion.t[-1] - 5.0 * period
            color = line(law).color
            history.plot(motion.t[first], x[first], color=color, linewidth=0.4, rasterized=True)
            last.plot(motion.t[end] - motion.t[end][0], x[end], color=color)
            plane.plot(x[end], v[end], **_of(law))
        history.set(xlabel="$t$ [s]", ylabel=f"${symbol}$ ({mass}) [m]", xlim=(0.0, shown))
        last.set(xlabel="$t - t_0$ [s]", ylabel=f"${symbol}$ [m]")
        plane.set(xlabel=f"${symbol}$ [m]", ylabel=rf"$\dot {symbol}$ [m/s]")
    for ax, title in zip(axes[0], ("from rest", "steady", "phase plane, steady"), strict=True):
        ax.set_title(title)
    return _legend_above(figure, axes[0][2])


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
    simulated, exact : mapping, optional
        The same of points of long simulations, and of responses by harmonic balance.
    """

    def draw(ax: Axes, amplitude: str, against: str) -> None:
        for law, curve in curves[against].items():
            color, label = line(law).color, line(law).label
            name = f"{label}, averaged" if simulated else label
            response_curve(ax, curve, amplitude, color=color, label=name)
            if exact:
                other, name = exact[against][law], f"{label}, harmonic balance"
                x, y, dots = other.values, getattr(other, amplitude), (0, (1, 1.5))
                ax.plot(x, y, color=color, linestyle=dots, label=name)
            if simulated:
                name = f"{label}, simulated"
                points(ax, simulated[against][law], amplitude, color=color, label=name)
        _logarithmic(ax)

    figure, axes = _amplitudes(list(curves), 4.4, draw)
    for ax, letter in zip(axes[0], "ab", strict=False):
        ax.set_title(f"({letter})")
    return _legend_above(figure, axes[0][0])


def parameter_effects(effects: Effects, panels: Mapping[str, Sequence[Curve]]) -> Figure:
    """Draw one of Figures 5 to 8: a panel for each parameter, with its curves."""
    columns = 3 if len(panels) in (3, 5, 6, 9) else 4
    rows = -(-len(panels) // columns)
    figure, axes = _grid(rows, columns, 1.75 * rows + 0.2)
    flat = axes.ravel()
    amplitude = effects.amplitude
    tallest = max(
        float(np.max(getattr(curve.response, amplitude)))
        for curves in panels.values()
        for curve in curves
    )
    for index, (name, curves) in enumerate(panels.items()):
        ax = flat[index]
        for number, curve in enumerate(curves):
            (value,) = curve.setting.values()
            response_curve(ax, curve.response, amplitude, **_shade(number), label=f"{value:.4g}")
        ax.set_title(f"({chr(ord('A') + index)})", loc="left")
        ax.legend(
            title=axis_label(name), loc="upper center", ncols=len(curves), columnspacing=0.6,
            handlelength=0.7, handletextpad=0.3, borderaxespad=0.1, title_fontsize=7.0,
            fontsize=6.5,
        )  # fmt: skip
        # room for the legend above the curves
        ax.set(xlabel=axis_label(effects.against), ylim=(0.0, 1.5 * tallest))
        if index % columns == 0:
            ax.set_ylabel(axis_label(amplitude))
    for ax in flat[len(panels) :]:
        ax.set_visible(False)
    return figure


def frequency_effect(
    histories: Mapping[float, Simulation], curves: Mapping[str, Response], shown: float
) -> Figure:
    """Draw Figure 9: the end of steady motions, and amplitude against frequency.

    Motions are mapped by ``omega = omega1 = omega2 = Omega`` [rad/s], averaged responses by law.
    """
    figure, axes = _grid(2, 2, 4.2, [1.3, 1.0])
    for row, (symbol, mass) in enumerate(MASSES):
        history, curve = axes[row]
        for number, (omega, motion) in enumerate(histories.items()):
            end = motion.t >= motion.t[-1] - shown
            x, label = _moved(motion, row)[0][end], rf"$\omega$ = {omega:g} rad/s"
            history.plot(motion.t[end] - motion.t[end][0], x, **_shade(number), label=label)
        history.set(xlabel="$t - t_0$ [s]", ylabel=f"${symbol}$ ({mass}) [m]")
        amplitude = AMPLITUDES[row]
        for law, found in curves.items():
            response_curve(curve, found, amplitude, **_of(law))
        _logarithmic(curve)
        curve.set(xlabel=axis_label("frequencies"), ylabel=axis_label(amplitude))
        for number, omega in enumerate(histories):
            found = curves["cnvc"]
            height = float(np.interp(omega, found.values, getattr(found, amplitude)))
            curve.plot(
                omega, height, "o", color=SHADES["cnvc"][number], markersize=4,
                markeredgecolor="#000000", markeredgewidth=0.4,
            )  # fmt: skip
    axes[0][0].set_title("(a) CNVC, steady")
    axes[0][1].set_title("(b) averaged amplitude")
    return _legend_above(figure, *axes[0])


def hump_height(panels: Mapping[str, Mapping[float, Response]]) -> Figure:
    """Draw Figure 10: amplitude against `h`, ``panels[parameter][value]``."""

    def draw(ax: Axes, amplitude: str, parameter: str) -> None:
        for number, (value, curve) in enumerate(panels[parameter].items()):
            response_curve(ax, curve, amplitude, **_shade(number), label=f"{value:.4g}")
        ax.set_ylim(bottom=0.0)
        ax.set_xlim(left=0.0)
        ax.xaxis.set_major_locator(MaxNLocator(5))

    figure, axes = _amplitudes(list(panels), 4.2, draw, against="h")
    for column, parameter in enumerate(panels):
        # the lower panels have room under their curves
        axes[1][column].legend(
            title=axis_label(parameter), loc="lower center", ncols=3, title_fontsize=7.0
        )
        axes[0][column].set_title(f"({'ab'[column]})")
    return figure


def step_hump(
    without_force: Mapping[str, Simulation], with_force: Mapping[str, Simulation]
) -> Figure:
    """Draw Figure 11: the answer to ``y = h`` without and with the external force, by law."""
    figure, axes = _grid(2, 2, 4.0)
    for column, histories in enumerate((without_force, with_force)):
        for row, (symbol, mass) in enumerate(MASSES):
            ax = axes[row][column]
            for law, motion in histories.items():
                style = {**line(law)._asdict(), "linewidth": 0.8}
                ax.plot(motion.t, _moved(motion, row)[0], **style)
            ax.set(xlabel="$t$ [s]", ylabel=f"${symbol}$ ({mass}) [m]")
    axes[0][0].set_title("(a) $f = 0$")
    axes[0][1].set_title("(b) with the external force")
    return _legend_above(figure, axes[0][0])


def law_comparison(
    rows: Sequence[Mapping[str, tuple[str, Simulation]]], period: float, shown: float
) -> Figure:
    """Draw Figure 12: the largest displacement of each period under each law, from rest.

    Parameters
    ----------
    rows : sequence of mappings
        For each row of panels: label to ``(law, Simulation)``. Two settings of one law are told
        apart by shade.
    period, shown : float
        Of the motion, and how much of it is drawn [s].
    """
    figure, axes = _grid(len(rows), 2, 1.9 * len(rows) + 0.3)
    for index, entries in enumerate(rows):
        laws = [law for law, _ in entries.values()]
        for number, (label, (law, motion)) in enumerate(entries.items()):
            count = laws[:number].count(law)
            style = line(law)
            color = SHADES[law][2 * count] if law in SHADES and count else style.color
            for column, ax in enumerate(axes[index]):
                t, peaks = _peaks(motion, column, period)
                ax.plot(t, peaks, color=color, linestyle=style.linestyle, label=label)
        for ax, (symbol, mass) in zip(axes[index], MASSES, strict=True):
            _logarithmic(ax)
            ax.set(ylabel=f"peak of ${symbol}$ ({mass}) [m]", xlabel="$t$ [s]", xlim=(0.0, shown))
        axes[index][0].set_title(f"({'abcdef'[index]})", loc="left")
        axes[index][1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def numerical_and_averaged(
    comparisons: Mapping[str, Comparison], period: float, shown: Mapping[str, float]
) -> Figure:
    """Draw Figure 13: the full equations and the averaged motion, from rest and steady, by law."""
    figure, axes = _grid(2 * len(comparisons), 2, 6.6, [1.7, 1.0])
    for block, (law, both) in enumerate(comparisons.items()):
        t = both.numerical.t
        first, end = t <= shown[law], t >= t[-1] - 3.0 * period
        averaged = ((both.averaged.a1, both.averaged.x1), (both.averaged.a2, both.averaged.x2))
        light = "#AAAAAA" if law == "none" else line(law).color
        for row, (symbol, mass) in enumerate(MASSES):
            transient, steady = axes[2 * block + row]
            x, (a, approximate) = _moved(both.numerical, row)[0], averaged[row]
            transient.plot(t[first], x[first], color=light, linewidth=0.5, rasterized=True)
            for sign in (1.0, -1.0):
                transient.plot(t[first], sign * a[first], **OVER)
            since = t[end] - t[end][0]
            steady.plot(since, x[end], color=light, linewidth=1.8, label="numerical")
            steady.plot(since, approximate[end], **OVER, linewidth=0.9, label="averaged")
            transient.set(
                xlabel="$t$ [s]", ylabel=f"${symbol}$ ({mass}) [m]", xlim=(0.0, shown[law])
            )
            steady.set_xlabel("$t - t_0$ [s]")
        axes[2 * block][0].set_title(f"({'ab'[block]}) {line(law).label}, from rest", loc="left")
        axes[2 * block][1].set_title("steady", loc="left")
    return _legend_above(figure, axes[0][1])


def accuracy(panels: Mapping[str, Mapping[str, Errors]]) -> Figure:
    """Draw where averaging fails: errors against detuning, ``panels[law][parameter]``."""
    figure, axes = _grid(len(panels), 2, 4.2)
    for row, (law, by_parameter) in zip(axes, panels.items(), strict=True):
        for ax, found in zip(row, by_parameter.values(), strict=True):
            errors(ax, found)
            for level, name in ((5.0, "5 %"), (0.1, "0.1 %")):
                ax.axhline(level, color="#D55E00", linewidth=0.6)
                ax.annotate(
                    name, (1.0, level), xycoords=("axes fraction", "data"), fontsize=6.0,
                    xytext=(2, 0), textcoords="offset points", va="center",
                )  # fmt: skip
            ax.axvspan(-5.0, 5.0, color="#EEEEEE", zorder=0)
            ax.set_title(f"{line(law).label}", loc="left")
    return _legend_above(figure, axes[0][0])


def hardening(found: FoldedResponse, law: str = "none") -> Figure:
    """Draw a folded response, in a law's colour, with points simulated upward and downward."""
    figure, axes = _grid(1, 2, 2.9)
    averaged: dict[str, Any] = {"color": "#999999", "linewidth": 2.2, "label": "averaged"}
    for ax, amplitude in zip(axes[0], AMPLITUDES, strict=True):
        response_curve(ax, found.averaged, amplitude, **averaged)
        exact = line(law).color
        response_curve(ax, found.balanced, amplitude, color=exact, label="harmonic balance")
        for some, marker, way in ((found.upward, "^", "rising"), (found.downward, "v", "falling")):
            points(ax, some, amplitude, color="#000000", marker=marker, label=f"simulated, {way}")
        ax.set(xlabel=axis_label(found.averaged.parameter), ylabel=axis_label(amplitude))
    return _legend_above(figure, axes[0][0])


def stability(
    found: StabilityMap, growth: Mapping[str, tuple[Array, FloquetComparison]], against: str
) -> Figure:
    """Draw a stability map, and averaged growth rates beside Floquet exponents.

    `growth` has by law the values of the parameter called `against`, and the rates there.
    """
    figure, axes = _grid(1, 2, 2.9)
    left, right = axes[0]
    stability_regions(left, found)
    left.set_title("(a) no control, averaged", loc="left")
    for law, (values, rates) in growth.items():
        growth_rates(right, values, rates, **_of(law))
    right.axhline(0.0, **BOUND)
    right.set(xlabel=axis_label(against), ylabel="growth rate [1/s]")
    right.set_title("(b) averaged and Floquet", loc="left")
    right.legend(loc="best")
    return figure


def chaos(
    sections: Mapping[str, Array], exponents: Mapping[str, LyapunovExponents], period: float
) -> Figure:
    """Draw Poincare sections and the estimate of the largest Lyapunov exponent, by law.

    Sections are arrays (m, 1, k) of the states once a period.
    """
    figure, axes = _grid(1, 3, 2.5)
    *planes, estimate = axes[0]
    for law, section in sections.items():
        for column, ax in enumerate(planes):
            x, v = section[column, 0], section[2 + column, 0]
            ax.plot(x, v, "o", markersize=3.5, markerfacecolor="none", **_of(law))
            ax.set(xlabel=f"$x_{column + 1}$ [m]", ylabel=rf"$\dot x_{column + 1}$ [m/s]")
            ax.margins(0.3)
    for law, found in exponents.items():
        periods = np.arange(1, len(found.history) + 1)
        estimate.plot(periods * period, found.history[:, 0], **_of(law))
    estimate.axhline(0.0, **BOUND)
    estimate.margins(y=0.1)
    estimate.set(xlabel="$t$ [s]", ylabel="largest Lyapunov\nexponent [1/s]")
    for ax, letter in zip(axes[0], "abc", strict=True):
        ax.set_title(f"({letter})", loc="left")
    return _legend_above(figure, axes[0][0])


def _grid(
    rows: int, columns: int, height: float, ratios: list[float] | None = None
) -> tuple[Figure, Any]:
    size, widths = (DOUBLE_COLUMN, height), {"width_ratios": ratios} if ratios else None
    return plt.subplots(rows, columns, figsize=size, squeeze=False, gridspec_kw=widths)


def _amplitudes(
    columns: Sequence[str],
    height: float,
    draw: Callable[[Axes, str, str], None],
    against: str | None = None,
) -> tuple[Figure, Any]:
    """Draw the amplitudes of wheel and body in a column for each name."""
    figure, axes = _grid(2, len(columns), height)
    for column, name in enumerate(columns):
        for ax, amplitude in zip(axes[:, column], AMPLITUDES, strict=True):
            draw(ax, amplitude, name)
            ax.set(xlabel=axis_label(against or name), ylabel=axis_label(amplitude))
    return figure, axes


def _legend_above(figure: Figure, *axes: Axes) -> Figure:
    shared_legend(figure, axes, place="upper")
    return figure


def _logarithmic(ax: Axes) -> None:
    ax.set_yscale("log")
    log_ticks(ax)


def _of(law: str) -> dict[str, Any]:
    return {"color": line(law).color, "label": line(law).label}


def _shade(number: int) -> dict[str, Any]:
    return {"color": SHADES["cnvc"][number], "linewidth": WIDTHS[number]}


def _peaks(motion: Simulation, row: int, period: float) -> tuple[Array, Array]:
    """Return the middle and the largest displacement of each whole period."""
    step = float(motion.t[1] - motion.t[0])
    edges = np.round(np.arange(0.0, float(motion.t[-1]), period) / step).astype(int)
    peaks = np.maximum.reduceat(np.abs(_moved(motion, row)[0]), edges)[:-1]
    return 0.5 * (motion.t[edges[:-1]] + motion.t[edges[1:]]), peaks


def _moved(motion: Simulation, row: int) -> tuple[Array, Array]:
    """Return displacement and velocity of the wheel (0) or the body (1)."""
    return (motion.x2, motion.v2) if row else (motion.x1, motion.v1)
