"""The figures of a benchmark, each made from its outcome."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from qcar_env.evaluation.benchmark import Outcome
from qcar_env.evaluation.bounds import optimum
from qcar_env.evaluation.standings import Standing
from qcar_env.evaluation.statistics import Interval
from qcar_env.evaluation.tracks import Track
from qcar_env.plots import benchmark as plots
from qcar_env.plots.style import shared_legend

FRONTIER = 37  # force limits at which the frontier is drawn: every 0.025
SHRINKING = ("budget", "feedback")  # tracks whose force limit shrinks


def figures(outcome: Outcome) -> Iterator[tuple[str, Figure]]:
    """Yield the figures that an outcome has data for, each with its name."""
    tracks = {each.name: each for each in outcome.tracks}
    for name in SHRINKING:
        if name in tracks:
            yield f"frontier_{name}", _frontier(outcome, tracks[name])
    if "budget" in tracks:
        for scale in (1.0, 0.5):
            yield f"histories_budget_{scale:g}", _histories(outcome, tracks["budget"], scale)
            figure = _force_velocity(outcome, tracks["budget"], scale)
            yield f"force_velocity_budget_{scale:g}", figure
    if "randomised" in tracks:
        yield "shares_randomised", _shares(outcome, tracks["randomised"])
    if outcome.cases:
        yield "robustness", _robustness(outcome)


def _frontier(outcome: Outcome, track: Track) -> Figure:
    limits = sorted(track.force_scales)
    found = [{each.policy: each.rho for each in outcome.ranked(track.name, s)} for s in limits]
    shown: dict[str, Sequence[Interval | None]] = {
        policy: [each.get(policy) for each in found] for policy in _shown(outcome, track.name)
    }
    best = [_learned(outcome, track.name, s) for s in limits]
    for name in dict.fromkeys(name for each in best for name in each):
        shown[name] = [each[name].rho if name in each else None for each in best]
    between = np.linspace(limits[0], limits[-1], FRONTIER)
    optima = [optimum(track.at(float(s))) for s in between]
    figure = plt.figure(figsize=plots.SIZE)
    axes = figure.subplots(1, 2)
    plots.frontier(
        axes[0],
        limits,
        shown,
        optimum_limits=between,
        lower=[each.lower for each in optima],
        upper=[each.upper for each in optima],
    )
    lower = [min(b.lower for b in outcome.bounds[(track.name, s)]) for s in limits]
    plots.over_optimum(axes[1], limits, shown, lower)
    shared_legend(figure, axes)
    return figure


def _robustness(outcome: Outcome) -> Figure:
    found = outcome.by_case()
    figure = plt.figure(figsize=(plots.DOUBLE_COLUMN, 1.0 + 0.17 * len(found)))
    ax = figure.subplots()
    plots.robustness(ax, found, [each.name for each in outcome.cases])
    return figure


def _shares(outcome: Outcome, track: Track) -> Figure:
    figure = plt.figure(figsize=plots.SIZE)
    axes = figure.subplots(1, len(track.force_scales), sharey=True, squeeze=False)[0]
    for ax, scale in zip(axes, track.force_scales, strict=True):
        rho = outcome.by_policy(track.name, scale)
        shown = {name: rho[name] for name in _shown(outcome, track.name) if name in rho}
        for name, best in _learned(outcome, track.name, scale).items():
            shown[name] = rho[best.policy]
        lower = [each.lower for each in outcome.bounds[(track.name, scale)]]
        plots.shares(ax, shown, lower)
        ax.set_title(f"force limit x {scale:g}")
    axes[0].set_ylabel("share of held-out episodes [-]")
    shared_legend(figure, axes)
    return figure


def _histories(outcome: Outcome, track: Track, scale: float) -> Figure:
    nominal = track.at(scale)
    chosen = {name: name for name in ("cnvc", "lnvc (tuned)", "state (tuned)", "mpc")}
    for name, best in _learned(outcome, track.name, scale).items():
        chosen[name] = best.policy
        break  # the best one
    records = {}
    for look, policy in chosen.items():
        found = outcome.histories.get((policy, track.name, scale))
        if found is not None:
            keep = slice(-len(found.t) // 3, None)
            records[look] = (found.t[keep], found.x[keep], found.force[keep])
    figure = plt.figure(figsize=plots.TALL)
    limits = nominal.actuator.limit
    axes = plots.histories(figure, records, nominal.reference_amplitudes, (limits[0], limits[1]))
    shared_legend(figure, list(axes.ravel()))
    return figure


def _force_velocity(outcome: Outcome, track: Track, scale: float) -> Figure:
    learned = _learned(outcome, track.name, scale).items()
    second = next(
        ({name: best.policy} for name, best in learned), {"state (tuned)": "state (tuned)"}
    )
    limits = track.at(scale).actuator.limit
    figure = plt.figure(figsize=plots.SIZE)
    axes = figure.subplots(1, 2)
    for mass, (ax, word) in enumerate(zip(axes, ("wheel", "body"), strict=True)):
        for look, policy in {"cnvc": "cnvc", **second}.items():
            found = outcome.histories.get((policy, track.name, scale))
            if found is None:
                continue
            # Seen at a sample; the force of the next row followed.
            velocity, force = found.x[:-1, 2 + mass], found.force[1:, mass]
            plots.force_against_velocity(ax, velocity, force, look, limit=limits[mass])
        xlabel, ylabel = rf"$v_{mass + 1}$ [m/s]", rf"$u_{mass + 1}$ [m/s$^2$]"
        ax.set(title=word, xlabel=xlabel, ylabel=ylabel)
    shared_legend(figure, axes)
    return figure


def _learned(outcome: Outcome, track: str, scale: float) -> dict[str, Standing]:
    """Return the best policy of each algorithm there, the best one first."""
    found: dict[str, Standing] = {}
    for each in outcome.ranked(track, scale):
        if each.kind == "learned":
            name = each.policy.split("-")[0]
            found.setdefault(name if name in plots.LOOKS else each.policy, each)
    return found


def _shown(outcome: Outcome, track: str) -> list[str]:
    """Return the policies that figures show: those with a look of their own, and the user's."""
    there = {row.policy: row.kind for row in outcome.rows if row.track == track}
    mine = sorted(name for name, kind in there.items() if kind == "yours")
    return [name for name in plots.LOOKS if name in there] + mine
