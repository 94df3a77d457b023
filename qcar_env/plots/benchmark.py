"""Figures of the benchmark: the frontier, forces against velocity, histories, robustness.

Each function draws into the axes, or the figure, that it is given first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from qcar_env.evaluation.statistics import Interval, share_interval
from qcar_env.plots.style import DOUBLE_COLUMN, Line, line

Array = NDArray[np.float64]

SIZE = (DOUBLE_COLUMN, 3.0)  # [in]
TALL = (DOUBLE_COLUMN, 4.0)  # [in]
DECADE = 10.0  # ratio of values from which an axis is logarithmic
LIMIT_LABEL = "force limit over CNVC's own peak force [-]"
SMALLEST = 1e-5  # [-] lower edge of a logarithmic axis: stillness for any purpose

# Policies that every figure may show, in this order, with one look each.
LOOKS: Mapping[str, Line] = {
    "cnvc": line("cnvc"),
    "cnvc (tuned)": Line(line("cnvc").color, (0, (4, 2)), "CNVC, tuned"),
    "lnvc (tuned)": Line(line("lnvc").color, "-", "linear velocity feedback, tuned"),
    "state (tuned)": Line("#999933", "-", "state feedback, tuned"),
    "linear (tuned)": Line("#332288", "-", "linear in state and forcing, tuned"),
    "lqr-model": Line("#44AA99", "-", "LQR with internal model"),
    "mpc": Line("#117733", "-", "MPC with preview"),
    "ppo": line("ppo"),
    "sac": Line(line("sac").color, line("sac").linestyle, "SAC"),
    "cma": Line(line("cma").color, "-", "CMA-ES"),
    "optimum": Line(line("optimum").color, "-", "optimum"),
}


MARKERS: Mapping[str, str] = dict(zip(LOOKS, "os^DvPX<>h", strict=False))  # of each of these


def look(policy: str) -> Line:
    """Return how a policy is drawn; those without a look of their own by `style.line`."""
    return LOOKS.get(policy) or line(policy)


def frontier(
    ax: Axes,
    limits: ArrayLike,
    policies: Mapping[str, Sequence[Interval | None]],
    *,
    optimum_limits: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
) -> Axes:
    """Draw what is left of the vibration against the force limit.

    Parameters
    ----------
    limits : array_like (k,)
        Force limits over the scenario's own [-], rising.
    policies : mapping of str to sequence of Interval or None
        rho at each limit by policy [-]; None where it did not run.
    optimum_limits : array_like (j,)
        Force limits of the frontier [-], rising.
    lower, upper : array_like (j,)
        The optimum's bracket at each of those [-]; below it nothing can be.
    """
    s = np.asarray(limits, dtype=np.float64)
    at = np.asarray(optimum_limits, dtype=np.float64)
    # Where stillness can be had the frontier leaves the axes: it is zero, and no line is at zero.
    low, high = (np.maximum(each, 1e-3 * SMALLEST) for each in (lower, upper))
    ran = {name: values for name, values in policies.items() if any(values)}
    least = [each.value for values in ran.values() for each in values if each is not None]
    bottom = min([SMALLEST, *(0.5 * value for value in least if value > 0.1 * SMALLEST)])
    ax.fill_between(at, 1e-3 * SMALLEST, low, color="#EEEEEE", linewidth=0.0, zorder=0)
    ax.fill_between(at, low, high, color=look("optimum").color, alpha=0.5, linewidth=0.0)
    ax.plot(at, high, color=look("optimum").color, linewidth=1.6, label="optimum")
    words = "no force within\nthe limit leaves\nso little"
    x = float(at[0] + 0.04 * (at[-1] - at[0]))
    ax.text(x, bottom * 3.0, words, color="#666666", fontsize=6.5)
    for name, values in ran.items():
        style = look(name)
        there = [(x, v) for x, v in zip(s, values, strict=True) if v is not None]
        ax.errorbar(  # not joined: a chord between two limits would cross the frontier
            [x for x, _ in there],
            [v.value for _, v in there],
            yerr=_errors([v for _, v in there]),
            color=style.color,
            linestyle="none",
            marker=MARKERS.get(name, "*"),
            markersize=4.6,
            markerfacecolor="none",
            markeredgewidth=1.0,
            capsize=1.5,
            elinewidth=0.7,
            label=style.label,
        )
    ax.set_yscale("log")
    ylabel = r"vibration left, $\rho=\max_i a_i/A_i$ [-]"
    ax.set(ylim=(bottom, 1.5), xlabel=LIMIT_LABEL, ylabel=ylabel)
    return ax


def _errors(
    values: Sequence[Interval], factor: float = 1.0, over: float = 1.0
) -> list[list[float]]:
    """Return the lengths of error bars downward and upward; as lists: of arrays 3.10 warns."""
    down = [max(factor * (each.value - each.low) / over, 0.0) for each in values]
    return [down, [max(factor * (each.high - each.value) / over, 0.0) for each in values]]


def over_optimum(
    ax: Axes,
    limits: Sequence[float],
    policies: Mapping[str, Sequence[Interval | None]],
    lower: Sequence[float],
) -> Axes:
    """Draw how far policies stay above the optimum, in percent, where there is one to divide by.

    Parameters
    ----------
    limits, policies
        See `frontier`.
    lower : sequence of float (k,)
        Lower bound of the optimum at each limit [-].
    """
    kept = [i for i, value in enumerate(lower) if value > 0.01]
    groups = [name for name, values in policies.items() if any(values[i] for i in kept)]
    width = 0.8 / max(1, len(groups))
    for number, name in enumerate(groups):
        style = look(name)
        for place, i in enumerate(kept):
            value = policies[name][i]
            if value is None:
                continue
            excess = 100.0 * (value.value / lower[i] - 1.0)
            ax.bar(
                place + (number - 0.5 * (len(groups) - 1)) * width,
                max(excess, 1e-3),
                width * 0.9,
                color=style.color,
                yerr=_errors([value], 100.0, lower[i]),
                error_kw={"elinewidth": 0.6, "capsize": 1.2},
                hatch="////" if style.linestyle != "-" else None,
                edgecolor="white",
                linewidth=0.3,
            )
    ax.set_yscale("log")
    ax.set_xticks(range(len(kept)), [f"{limits[i]:g}" for i in kept])
    ax.grid(visible=False, axis="x")
    ax.set(ylim=(0.03, 100.0), xlabel=LIMIT_LABEL, ylabel=r"$\rho$ above the optimum [%]")
    return ax


def force_against_velocity(
    ax: Axes, velocity: ArrayLike, force: ArrayLike, name: str, *, limit: float
) -> Axes:
    """Draw the force that a policy gave against the velocity that it saw.

    Parameters
    ----------
    velocity, force : array_like (k,)
        Velocity of a mass [m/s] and the specific force that followed on it [m/s^2].
    name : str
        The policy.
    limit : float
        Force limit [m/s^2].
    """
    style = look(name)
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2.5}
    ax.plot(velocity, force, color=style.color, label=style.label, **dots)
    for sign in (-1.0, 1.0):
        ax.axhline(sign * limit, color="#999999", linewidth=0.5, linestyle=(0, (1, 2)))
    return ax


def histories(
    figure: Figure,
    records: Mapping[str, tuple[Array, Array, Array]],
    amplitudes: tuple[float, float],
    limits: tuple[float, float],
) -> NDArray[Any]:
    """Draw the last periods of displacements and forces of several policies.

    Parameters
    ----------
    records : mapping of str to tuple
        ``(t, x, force)`` by policy: times (k,) [s], states (k, 4), forces (k, 2) [m/s^2].
    amplitudes : tuple of float
        Uncontrolled amplitudes [m], for the relative scale.
    limits : tuple of float
        Force limits [m/s^2].
    """
    axes = figure.subplots(2, 2, sharex=True)
    for name, (t, x, force) in records.items():
        style = look(name)
        time = 1e3 * (t - t[0])
        for mass in (0, 1):
            axes[0, mass].plot(time, x[:, mass] / amplitudes[mass], **style._asdict())
            # The force at a sample was held over the interval before it.
            axes[1, mass].step(
                time, force[:, mass] / limits[mass], where="pre", color=style.color, linewidth=0.8
            )
    for mass, word in enumerate(("wheel", "body")):
        axes[0, mass].set(title=word, ylabel=rf"$x_{mass + 1}/A_{mass + 1}$ [-]")
        ylabel = rf"$u_{mass + 1}$ over its limit [-]"
        axes[1, mass].set(ylabel=ylabel, xlabel="time [ms]", ylim=(-1.15, 1.15))
    return axes


def robustness(ax: Axes, policies: Mapping[str, Sequence[float]], cases: Sequence[str]) -> Axes:
    """Draw a table of what is left in cases that policies were not made for, dark where much is.

    Parameters
    ----------
    policies : mapping of str to sequence of float
        rho in each case by policy [-]; not a number where it did not run.
    cases : sequence of str
        What the cases are.
    """
    values = np.array([list(each) for each in policies.values()], dtype=np.float64)
    shade = np.log10(np.clip(values, 1e-3, 1.0))
    ax.imshow(shade, cmap="YlOrRd", aspect="auto", vmin=-3.0, vmax=0.5)
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            text = f"{value:.3f}".lstrip("0") if value < 1.0 else f"{value:.2f}"
            white = value > 0.4
            ax.text(
                *(column, row, text),
                ha="center",
                va="center",
                fontsize=5.5,
                color="white" if white else "black",
                fontweight="bold" if value > 1.0 else "normal",
            )
    ax.set_xticks(range(len(cases)), cases, rotation=40, ha="left", fontsize=6.5)
    ax.set_yticks(range(len(policies)), list(policies), fontsize=6.5)
    ax.xaxis.tick_top()
    ax.tick_params(length=0.0)
    ax.grid(visible=False)
    return ax


def shares(ax: Axes, policies: Mapping[str, ArrayLike], bound: ArrayLike) -> Axes:
    """Draw the share of held-out episodes in which at most some vibration is left.

    Parameters
    ----------
    policies : mapping of str to array_like (n,)
        rho of every episode by policy [-].
    bound : array_like (n,)
        Lower bound of the optimum in every episode [-].

    Notes
    -----
    The bands are the 95 % intervals of the share in all episodes of which these are a sample, at
    each abscissa by itself (see `qcar_env.evaluation.statistics.share_interval`).
    """
    for name, values in {"optimum": bound, **policies}.items():
        style = look(name)
        ordered = np.sort(np.maximum(np.asarray(values, dtype=np.float64), SMALLEST))
        count = np.arange(len(ordered) + 1)
        edges = np.concatenate([ordered[:1], ordered])
        low, high = share_interval(count, len(ordered))
        ax.fill_between(edges, low, high, step="post", color=style.color, alpha=0.12, linewidth=0.0)
        ax.step(
            edges,
            count / len(ordered),
            where="post",
            **style._asdict(),
            linewidth=1.6 if name == "optimum" else 1.0,
        )
    drawn = np.concatenate([np.asarray(ax_line.get_xdata()) for ax_line in ax.get_lines()])
    if float(drawn.max()) > DECADE * float(drawn.min()):
        ax.set_xscale("log")
    ax.set_ylim(0.0, 1.02)
    ax.set_xlabel(r"vibration left, $\rho$ [-]")
    return ax
