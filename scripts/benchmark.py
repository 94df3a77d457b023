"""Score every policy on every track, beside the optimum that none can pass.

python scripts/benchmark.py
python scripts/benchmark.py --policy my_module:my_policy --tracks budget randomised
python scripts/benchmark.py --policy run/policy.onnx --force
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Worker processes share the cores; more threads in each would only wait for one another.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402

from qcar_env.evaluation import benchmark, storage  # noqa: E402
from qcar_env.evaluation.benchmark import Bound, History, Row, Scores, Standing  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, Track, track  # noqa: E402
from qcar_env.validation import whole  # noqa: E402
from scripts import contestants  # noqa: E402
from scripts.contestants import Contestant  # noqa: E402

FRONTIER = 37  # force limits at which the frontier is drawn: every 0.025
SLOWEST = ("mpc",)  # started first, so that no core waits for them at the end
Unit = tuple[str, float]  # name of a track, force limit over the scenario's own


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A policy that did not run to the end."""

    policy: str
    track: str
    force_scale: float
    error: str  # one line
    details: str  # where


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What one contestant brought home."""

    scores: dict[Unit, Scores]
    failures: tuple[Failure, ...]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The whole benchmark."""

    rows: tuple[Row, ...]
    histories: dict[tuple[str, str, float], History]
    bounds: dict[Unit, tuple[Bound, ...]]
    standings: tuple[Standing, ...]
    failures: tuple[Failure, ...]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark and write its results; return the exit status."""
    arguments = _parse(argv)
    try:
        whole("jobs", arguments.jobs)
        if arguments.report:
            _check_report()
        if arguments.seed is not None:
            whole("seed", arguments.seed, least=0)
        out: Path = arguments.out
        storage.check_folder(out)
        if (out / "result.json").exists() and not arguments.force:
            raise ValueError(f"{out} already holds results; give --force to replace them, or --out")
        tracks = [track(name) for name in dict.fromkeys(arguments.tracks)]
        entered = (
            *contestants.baselines(arguments.baselines),
            *(() if arguments.no_agents else contestants.agents()),
            *(contestants.yours(spec) for spec in arguments.policy),
        )
        names = [each.name for each in entered]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two policies are called {name!r}; rename yours")
        outcome = run(entered, tracks, seed=arguments.seed, jobs=arguments.jobs)
    except ValueError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 2
    _write(out, outcome, tracks, seed=arguments.seed, figures=not arguments.no_figures)
    if arguments.report:
        print(f"report: {_write_report(out / 'report.html', outcome, tracks, arguments.seed)}")
    print(leaderboard(outcome, tracks, short=True))
    print(f"written to {out}: leaderboard.md, table.csv, result.json" + _parquet_note(out))
    for failure in outcome.failures:
        print(
            f"benchmark: {failure.policy} failed on {failure.track} x{failure.force_scale:g}: "
            f"{failure.error}",
            file=sys.stderr,
        )
    return 1 if outcome.failures else 0


def run(
    entered: Sequence[Contestant],
    tracks: Sequence[Track],
    *,
    seed: int | None = None,
    jobs: int = 1,
) -> Outcome:
    """Score contestants on tracks.

    Parameters
    ----------
    entered : sequence of Contestant
        Who enters.
    tracks : sequence of Track
        Where.
    seed : int, optional
        Another seed of the crossings than the tracks'.
    jobs : int
        Worker processes; with 1 everything runs in this one.

    Returns
    -------
    Outcome
        A policy that fails somewhere is listed in `failures`; what it did elsewhere counts.
    """
    names = [each.name for each in tracks]
    order = sorted(entered, key=lambda each: each.spec not in SLOWEST)
    begin = time.monotonic()
    entries: dict[str, Entry] = {}
    if jobs == 1:
        bounds = _for_all(names, {unit: _bound(*unit, seed) for unit in _distinct(names)})
        for each in order:
            entries[each.name] = _enter(each, names, seed)
            _progress(each.name, len(entries), len(order), begin)
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs, mp_context=context) as pool:
            # The optimum goes in among the first: alone at the end it would keep all waiting.
            first = sum(each.spec in SLOWEST for each in order)
            futures: dict[Future[Entry], Contestant] = {
                pool.submit(_enter, each, names, seed): each for each in order[:first]
            }
            optima = {unit: pool.submit(_bound, *unit, seed) for unit in _distinct(names)}
            futures |= {pool.submit(_enter, each, names, seed): each for each in order[first:]}
            for future in as_completed(futures):
                each = futures[future]
                try:
                    entries[each.name] = future.result()
                except Exception as error:  # the worker itself died
                    entries[each.name] = _all_failed(each, names, error)
                _progress(each.name, len(entries), len(order), begin)
            bounds = _for_all(names, {unit: each.result() for unit, each in optima.items()})
    inside = [entries[each.name] for each in entered]
    rows = tuple(row for entry in inside for scores in entry.scores.values() for row in scores.rows)
    lower = {unit: [bound.lower for bound in each] for unit, each in bounds.items()}
    return Outcome(
        rows=rows,
        histories={
            (each.name, *unit): scores.history
            for each, entry in zip(entered, inside, strict=True)
            for unit, scores in entry.scores.items()
        },
        bounds=bounds,
        standings=benchmark.standings(rows, lower, seed=seed or 0),
        failures=tuple(failure for entry in inside for failure in entry.failures),
    )


def leaderboard(outcome: Outcome, tracks: Sequence[Track], *, short: bool = False) -> str:
    """Return the result as Markdown.

    Parameters
    ----------
    outcome : Outcome
        What was found.
    tracks : sequence of Track
        For their titles.
    short : bool
        Only what is found, without the tables.
    """
    lines = ["# Leaderboard", ""] if not short else [""]
    lines += ["## What is found", ""] if not short else []
    lines += [f"- {sentence}" for sentence in benchmark.findings(outcome.standings)]
    lines += [
        f"- {each.policy} failed on track {each.track}, force limit x {each.force_scale:g}: "
        f"{each.error}"
        for each in outcome.failures
    ]
    if short:
        return "\n".join(lines) + "\n"
    lines += [
        "",
        "rho is the share of the uncontrolled amplitude that is left, the larger of wheel and "
        "body: interquartile mean over the crossings, with its 95 % bootstrap interval. The "
        "optimum is the certified lower bound: no force within the limit, of any shape, leaves "
        "less. P(< CNVC) is the probability that a crossing ends with a lower rho than CNVC's "
        "with the paper's gain 1.2.",
    ]
    for each in tracks:
        lines += ["", f"## Track `{each.name}`, version {each.version}: {each.title}"]
        lines += [
            "",
            f"{each.episodes} held-out crossings of {each.duration:g} s at each limit, amplitudes "
            f"over the last {each.periods} periods; policies may read: "
            + ("the state alone." if each.observe == "feedback" else "state, road and force."),
        ]
        for scale in each.force_scales:
            lines += ["", *_table(outcome, each, scale)]
    return "\n".join(lines) + "\n"


def _table(outcome: Outcome, where: Track, scale: float) -> list[str]:
    here = [s for s in outcome.standings if (s.track, s.force_scale) == (where.name, scale)]
    bound = outcome.bounds[(where.name, scale)]
    low = benchmark.iqm([each.lower for each in bound])
    high = benchmark.iqm([each.upper for each in bound])
    lines = [
        f"### Force limit x {scale:g}",
        "",
        "| # | policy | gains | reads | rho | 95 % interval | over the optimum | P(< CNVC) |",
        "|--:|---|---|---|--:|---|--:|---|",
        f"| | *optimum* | | everything | {_rho(float(low))} | up to {_rho(float(high))} reached "
        "| | |",
    ]
    held = [each.held for each in bound if each.held is not None]
    if held:
        lines.append(
            f"| | *optimum at {1.0 / where.nominal.dt:g} Hz* | | everything | {_rho(max(held))} "
            "| forces held over the control interval | | |"
        )
    for number, each in enumerate(here, start=1):
        chance = each.improvement
        over = f"x {each.over_optimum:.3f}" if np.isfinite(each.over_optimum) else "-"
        left = f", {each.terminated} crossings left the travel limits" if each.terminated else ""
        lines.append(
            f"| {number} | {each.policy}{left} | {each.kind} | {each.reads} "
            f"| {_rho(each.rho.value)} | {_rho(each.rho.low)} to {_rho(each.rho.high)} | {over} | "
            + (f"{chance.value:.2f} ({chance.low:.2f} to {chance.high:.2f}) |" if chance else "|")
        )
    return lines


def _rho(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.2e}" if value < 1e-3 else f"{value:.4f}"


def _enter(contestant: Contestant, names: Sequence[str], seed: int | None) -> Entry:
    """Run one contestant over its tracks; every error stays with its own track and limit."""
    scores: dict[Unit, Scores] = {}
    failures: list[Failure] = []
    done: dict[tuple[Any, ...], Scores] = {}
    tracks = {name: track(name) for name in names}
    try:
        units = contestant.tracks(tuple(tracks.values()))
    except Exception as error:
        return _all_failed(contestant, names, error)
    for where, scale in units:
        try:
            made = contestant.make(where, scale)
            if not benchmark.may_enter(made.reads, where):
                continue
            key = (_crossings(where), scale, made.reads, made.observe_limit)
            if key not in done:  # tracks that show the same crossings are run once
                done[key] = benchmark.score(
                    made.policy,
                    where,
                    scale,
                    name=contestant.name,
                    kind=contestant.kind,
                    reads=made.reads,
                    observe_limit=made.observe_limit,
                    seed=seed,
                )
            scores[(where.name, scale)] = benchmark.for_track(done[key], where)
        except Exception as error:
            failures.append(_failure(contestant.name, where.name, scale, error))
    return Entry(scores=scores, failures=tuple(failures))


def _all_failed(contestant: Contestant, names: Sequence[str], error: Exception) -> Entry:
    failures = tuple(
        _failure(contestant.name, name, scale, error)
        for name in names
        for scale in track(name).force_scales
    )
    return Entry(scores={}, failures=failures)


def _failure(policy: str, where: str, scale: float, error: Exception) -> Failure:
    text = " ".join(str(error).split()) or "no message"
    return Failure(
        policy=policy,
        track=where,
        force_scale=scale,
        error=f"{type(error).__name__}: {text}",
        details="".join(traceback.format_exception(error)[-3:]),
    )


def _bound(name: str, scale: float, seed: int | None) -> tuple[Bound, ...]:
    return benchmark.optimum_of(track(name), scale, seed=seed)


def _distinct(names: Sequence[str]) -> tuple[Unit, ...]:
    """Return tracks and limits without those that have the crossings of one before."""
    found: dict[tuple[Track, float], Unit] = {}
    for name in names:
        for scale in track(name).force_scales:
            found.setdefault((_crossings(track(name)), scale), (name, scale))
    return tuple(found.values())


def _for_all(
    names: Sequence[str], found: Mapping[Unit, tuple[Bound, ...]]
) -> dict[Unit, tuple[Bound, ...]]:
    """Return the bounds of all tracks and limits from those of the distinct ones."""
    by_crossings = {(_crossings(track(name)), scale): v for (name, scale), v in found.items()}
    return {
        (name, scale): by_crossings[(_crossings(track(name)), scale)]
        for name in names
        for scale in track(name).force_scales
    }


def _crossings(where: Track) -> Track:
    """Return what a track's crossings hang on: two tracks with the same are run once."""
    return dataclasses.replace(
        where, name="", version=1, title="", observe="full", force_scales=(), metrics=()
    )


def _write(
    out: Path, outcome: Outcome, tracks: Sequence[Track], *, seed: int | None, figures: bool
) -> None:
    rows = [dataclasses.asdict(row) for row in outcome.rows]
    if rows:
        storage.write_csv(out / "table.csv", rows)
        _write_parquet(out / "table.parquet", rows)
    storage.write_text(out / "leaderboard.md", leaderboard(outcome, tracks))
    if figures and rows:
        _draw(out / "figures", outcome, tracks)
    result = {
        "command": storage.command(),
        "versions": storage.versions(),
        "seed": seed,
        "tracks": [dataclasses.asdict(each) for each in tracks],
        "findings": list(benchmark.findings(outcome.standings)),
        "standings": [dataclasses.asdict(each) for each in outcome.standings],
        "optimum": [
            {
                "track": unit[0],
                "force_scale": unit[1],
                "crossings": [dataclasses.asdict(b) for b in each],
            }
            for unit, each in outcome.bounds.items()
        ],
        "failures": [dataclasses.asdict(each) for each in outcome.failures],
        "rows": rows,
    }
    storage.write_json(out / "result.json", result)  # last: its presence says that all is there


def _check_report() -> None:
    """Raise ValueError where what writes the report is absent."""
    for name in ("plotly", "jinja2"):
        if importlib.util.find_spec(name) is None:
            raise ValueError(f"a report needs {name}; install qcar_env[report]")


def _write_report(path: Path, outcome: Outcome, tracks: Sequence[Track], seed: int | None) -> Path:
    from qcar_env.report.benchmark import benchmark as report
    from qcar_env.report.page import write

    versions = ", ".join(f"{name} {version}" for name, version in storage.versions().items())
    return write(
        path,
        report(
            tracks,
            outcome.rows,
            outcome.standings,
            outcome.bounds,
            outcome.histories,
            findings=benchmark.findings(outcome.standings),
            provenance={
                "command": storage.command(),
                "seed of the crossings": "the tracks' own" if seed is None else str(seed),
                "versions": versions,
                "failed": "; ".join(
                    f"{each.policy} on {each.track} x{each.force_scale:g}: {each.error}"
                    for each in outcome.failures
                )
                or "none",
                "numbers": "table.csv and result.json beside this file",
            },
        ),
    )


def _write_parquet(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the table as Parquet too, where pandas and pyarrow are installed."""
    try:
        import pandas
        import pyarrow  # noqa: F401
    except ImportError:
        return
    with storage.replacing(path) as temporary:
        pandas.DataFrame(rows).to_parquet(temporary)


def _parquet_note(out: Path) -> str:
    return ", table.parquet" if (out / "table.parquet").exists() else ""


def _draw(folder: Path, outcome: Outcome, tracks: Sequence[Track]) -> None:
    import matplotlib.pyplot as plt

    from qcar_env.plots import benchmark as plots
    from qcar_env.plots.style import journal

    found = {(s.policy, s.track, s.force_scale): s for s in outcome.standings}
    names = {each.name for each in tracks}

    def save(figure: Any, name: str) -> None:
        for suffix in (".png", ".pdf"):
            with storage.replacing(folder / f"{name}{suffix}") as temporary:
                figure.savefig(temporary)
        plt.close(figure)

    with journal():
        for name in sorted({"budget", "feedback"} & names):
            where = track(name)
            limits = sorted(where.force_scales)
            shown = {}
            for policy in _shown(outcome, name):
                values = [found.get((policy, name, s)) for s in limits]
                shown[policy] = [each.rho if each else None for each in values]
            best = [_best_learned(outcome, name, s) for s in limits]
            if any(best):
                shown["learned"] = [each.rho if each else None for each in best]
            lower = [min(b.lower for b in outcome.bounds[(name, s)]) for s in limits]
            between = np.linspace(limits[0], limits[-1], FRONTIER)
            optima = [benchmark.optimum(where.at(float(s))) for s in between]
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
            plots.over_optimum(axes[1], limits, shown, lower)
            plots.shared_legend(figure, axes)
            save(figure, f"frontier_{name}")
        if "budget" in names:
            for scale in (1.0, 0.5):
                save(_histories(outcome, scale), f"histories_budget_{scale:g}")
                save(_force_velocity(outcome, scale), f"force_velocity_budget_{scale:g}")
        if "randomised" in names:
            where = track("randomised")
            figure = plt.figure(figsize=plots.SIZE)
            axes = figure.subplots(1, len(where.force_scales), sharey=True, squeeze=False)[0]
            for ax, scale in zip(axes, where.force_scales, strict=True):
                rho = {
                    policy: [
                        row.rho
                        for row in outcome.rows
                        if (row.policy, row.track, row.force_scale) == (policy, "randomised", scale)
                    ]
                    for policy in _shown(outcome, "randomised")
                }
                best = _best_learned(outcome, "randomised", scale)
                if best:
                    rho["learned"] = [
                        row.rho
                        for row in outcome.rows
                        if (row.policy, row.track, row.force_scale)
                        == (best.policy, "randomised", scale)
                    ]
                lower = [b.lower for b in outcome.bounds[("randomised", scale)]]
                plots.robustness(ax, {k: v for k, v in rho.items() if v}, lower)
                ax.set_title(f"force limit x {scale:g}")
            axes[0].set_ylabel("share of held-out crossings [-]")
            plots.shared_legend(figure, axes)
            save(figure, "robustness_randomised")


def _shown(outcome: Outcome, where: str) -> list[str]:
    """Return the policies that figures show: those with a look of their own, and the user's."""
    from qcar_env.plots import benchmark as plots

    there = {row.policy for row in outcome.rows if row.track == where}
    mine = sorted({row.policy for row in outcome.rows if row.kind == "yours"} & there)
    return [name for name in plots.LOOKS if name in there] + mine


def _best_learned(outcome: Outcome, where: str, scale: float) -> Standing | None:
    entered = [
        each
        for each in outcome.standings
        if each.kind == "learned" and (each.track, each.force_scale) == (where, scale)
    ]
    return min(entered, key=lambda each: (each.rho.value, each.policy), default=None)


def _histories(outcome: Outcome, scale: float) -> Any:
    import matplotlib.pyplot as plt

    from qcar_env.plots import benchmark as plots

    nominal = track("budget").at(scale)
    best = _best_learned(outcome, "budget", scale)
    scripted = ("cnvc", "lnvc (tuned)", "state (tuned)", "mpc")
    chosen = {name: name for name in scripted}
    if best:
        chosen["learned"] = best.policy
    records = {}
    for look, policy in chosen.items():
        found = outcome.histories.get((policy, "budget", scale))
        if found is not None:
            keep = slice(-len(found.t) // 3, None)
            records[look] = (found.t[keep], found.x[keep], found.force[keep])
    figure = plt.figure(figsize=plots.TALL)
    limits = nominal.actuator.limit
    axes = plots.histories(figure, records, nominal.reference_amplitudes, (limits[0], limits[1]))
    plots.shared_legend(figure, list(axes.ravel()))
    return figure


def _force_velocity(outcome: Outcome, scale: float) -> Any:
    import matplotlib.pyplot as plt

    from qcar_env.plots import benchmark as plots

    best = _best_learned(outcome, "budget", scale)
    nominal = track("budget").at(scale)
    second = {"learned": best.policy} if best else {"state (tuned)": "state (tuned)"}
    chosen = {"cnvc": "cnvc", **second}
    figure = plt.figure(figsize=plots.SIZE)
    axes = figure.subplots(1, 2)
    for mass, (ax, word) in enumerate(zip(axes, ("wheel", "body"), strict=True)):
        for look, policy in chosen.items():
            found = outcome.histories.get((policy, "budget", scale))
            if found is None:
                continue
            plots.force_against_velocity(
                ax,
                found.x[:-1, 2 + mass],  # seen at a sample; the force of the next row followed
                found.force[1:, mass],
                look,
                limit=nominal.actuator.limit[mass],
            )
        ax.set_title(word)
        ax.set_xlabel(rf"$v_{mass + 1}$ [m/s]")
        ax.set_ylabel(rf"$u_{mass + 1}$ [m/s$^2$]")
    plots.shared_legend(figure, axes)
    return figure


def _progress(name: str, done: int, total: int, begin: float) -> None:
    spent = time.monotonic() - begin
    left = spent / done * (total - done)
    print(
        f"... [{done}/{total}] {name}: {spent:.0f} s, about {left:.0f} s left",
        file=sys.stderr,
        flush=True,
    )


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=list(TRACKS),
        help=f"tracks (default: {' '.join(TRACKS)})",
    )
    parser.add_argument(
        "--policy",
        action="append",
        default=[],
        metavar="POLICY",
        help="a policy of yours: module:object (anything with Stable-Baselines3's predict, or a "
        "function of the scenario that makes it), the path of an ONNX file, or a run folder; "
        "may be given more than once",
    )
    parser.add_argument(
        "--baselines",
        nargs="*",
        metavar="NAME",
        help="only these scripted policies (default: all; none with no name)",
    )
    parser.add_argument("--no-agents", action="store_true", help="leave the shipped agents out")
    parser.add_argument(
        "--seed",
        type=int,
        help="draw the crossings with another seed than the tracks' [whole number]",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="worker processes (default: one for each core)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/benchmark"),
        help="folder of the results (default: results/benchmark)",
    )
    parser.add_argument("--force", action="store_true", help="replace results that are there")
    parser.add_argument(
        "--report", action="store_true", help="write report.html, a page that opens offline"
    )
    parser.add_argument("--no-figures", action="store_true", help="leave the figures out")
    return parser.parse_args(argv)


if __name__ == "__main__":
    matplotlib.use("Agg")
    sys.exit(main())
