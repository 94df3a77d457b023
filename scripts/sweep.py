"""Sweep trainings: algorithms x settings x tracks x seeds, on this machine, Ray or Slurm.

    qcar sweep --algo ppo --seeds 0 1 2 --points 8 --set gamma=0.9..0.99
    qcar sweep --set learning_rate.0=1e-4..3e-3:log --set batch=256,512
    qcar sweep --address 10.0.0.1:6379 --out /shared/sweep ...
    qcar sweep --runner pool ...
    qcar sweep --resume results/sweep

A track with a number is the track at that force limit alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import json
import os
import time
from functools import partial
from pathlib import Path

from qcar_env.agents import trial_runs
from qcar_env.agents.recipes import ALGORITHMS, TASKS
from qcar_env.agents.sweep import SEARCHES, Row, Sweep, check_searchable
from qcar_env.commands import command
from qcar_env.evaluation import ray_workers, slurm, storage, workers
from qcar_env.validation import known, whole

RUNNERS = {
    "ray": "Ray Tune, on a cluster with --address",
    "pool": "processes of this machine",
    "slurm": "a job array through submitit",
}
OWN = Sweep()

OPTIONS: command.Options = {
    "algo": (OWN.algorithms, f"any of: {', '.join(ALGORITHMS)}"),
    "track": (OWN.tasks, f"any of: {', '.join(TASKS)}"),
    "seeds": (OWN.seeds, "seeds that each setting is trained with"),
    "set": (
        str,
        "what varies: NAME=LOW..HIGH, NAME=LOW..HIGH:log or NAME=A,B,C; may be given more than "
        "once",
        {"action": "append", "default": [], "metavar": "NAME=RANGE"},
    ),
    "points": (
        OWN.points,
        "settings drawn for each algorithm and track (default: 16; one where nothing varies)",
    ),
    "steps": (int, "environment steps of a training instead of the recipe's"),
    "search": (OWN.search, f"Optuna's sampler, one of: {', '.join(SEARCHES)} (default: random)"),
    "search-seed": (OWN.search_seed, "seed of the sampler (default: 0)"),
    "round-points": (
        OWN.round_points,
        "points that are drawn before any of their results are known, with --search tpe "
        "(default: 8)",
    ),
    "early-stop": (False, "stop what is behind (ASHA, on Ray); the table then hangs on the order"),
    "runner": ("ray", "; ".join(f"{name}: {what}" for name, what in RUNNERS.items())),
    "address": (
        str,
        "host:port of a Ray cluster to join (default: a local one with --jobs cores)",
        {"metavar": "HOST:PORT"},
    ),
    "jobs": (os.cpu_count() or 1, "worker processes, or jobs of the array (default: the cores)"),
    "partition": (str, "Slurm's partition"),
    "minutes": (240, "time limit of a Slurm job [min]"),
    "out": (Path("results/sweep"), "folder, on a disk that all workers share"),
    "resume": (Path, "go on with a killed sweep", {"metavar": "FOLDER"}),
    "no-benchmark": (False, "do not score the best settings on the held-out episodes"),
}


def run(arguments: argparse.Namespace) -> int:
    """Run a sweep, or go on with one."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # of the workers: they share the cores
    known("runner", arguments.runner, RUNNERS)
    whole("jobs", arguments.jobs)
    whole("minutes", arguments.minutes)
    out = (arguments.resume or arguments.out).absolute()
    storage.check_folder(out, "sweep.json", "table.csv", "leaderboard.md")
    described = out / "sweep.json"
    if arguments.resume is not None:
        chosen, early_stop = _resumed(described)
    else:
        chosen, early_stop = _chosen(arguments), arguments.early_stop
        if described.exists():
            raise ValueError(
                f"{out} holds a sweep; go on with --resume {out}, or give another --out"
            )
    if early_stop and arguments.runner != "ray":
        raise ValueError(
            f"--early-stop needs results while trials run, which --runner {arguments.runner} does "
            "not bring; use --runner ray, or leave it out"
        )
    if arguments.address is not None and arguments.runner != "ray":
        raise ValueError(f"--address {arguments.address} is of a Ray cluster; use --runner ray")
    if arguments.runner == "ray" and importlib.util.find_spec("ray") is None:
        raise ValueError(
            f"Ray is not installed; {ray_workers.INSTALL}, or give --runner pool for processes of "
            "this machine"
        )
    if arguments.runner == "slurm":
        slurm.check_installed()
    if chosen.settings:
        check_searchable()
    with storage.held(out):
        try:
            return _run(chosen, out, early_stop, arguments)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"go on with: qcar sweep --resume {out} --runner {arguments.runner}"
            ) from None


def _run(chosen: Sweep, out: Path, early_stop: bool, arguments: argparse.Namespace) -> int:
    content = {**dataclasses.asdict(chosen), "early_stop": early_stop}
    begin = time.monotonic()
    before = {path.parent.name for path in out.glob("runs/*/result.json")}
    fresh = 0

    def progress(row: Row, done: int, total: int) -> None:
        nonlocal fresh
        if row.run in before:
            return
        fresh += 1
        spent = time.monotonic() - begin
        rest = spent / fresh * (total - done)
        said = row.error or f"rho {row.rho:.4f}"
        command.say(
            f"[{done}/{total}] {row.run} {row.status}: {said}; {spent:.0f} s, about {rest:.0f} s "
            "left"
        )

    if arguments.runner == "ray":
        with ray_workers.cluster(arguments.address, arguments.jobs):
            storage.write_json(out / "sweep.json", content)  # not before it can begin
            from qcar_env.agents import ray_sweep

            execute = partial(ray_sweep.execute, early_stop=early_stop)
            rows = trial_runs.run(chosen, out, execute, progress=progress)
    else:
        storage.write_json(out / "sweep.json", content)
        each_done = partial(workers.each_done, jobs=arguments.jobs)
        if arguments.runner == "slurm":
            more = {} if arguments.partition is None else {"slurm_partition": arguments.partition}
            each_done = partial(
                slurm.each_done,
                jobs=arguments.jobs,
                folder=out / "slurm",
                minutes=arguments.minutes,
                **more,
            )
        execute = partial(trial_runs.in_workers, each_done)
        rows = trial_runs.run(chosen, out, execute, progress=progress)
    try:  # what cannot be written is still said
        trial_runs.write(out, rows)
    finally:
        print(trial_runs.ranking(rows), flush=True)
    written = ["table.csv", "leaderboard.md"]
    if not arguments.no_benchmark:
        command.say("the best settings on the benchmark's held-out episodes")
        names = trial_runs.score_best(out, rows, jobs=arguments.jobs)
        written += [f"benchmark/{name}" for name in names]
    print(f"written to {out}: {', '.join(written)}")
    return 1 if any(row.status == "failed" for row in rows) else 0


def _chosen(arguments: argparse.Namespace) -> Sweep:
    settings: dict[str, str] = {}
    for text in arguments.set:
        name, equals, span = text.partition("=")
        if not equals:
            raise ValueError(f"--set must be NAME=RANGE, got {text!r}; such as gamma=0.9..0.99")
        if name in settings:
            raise ValueError(f"--set {name} is given twice; leave one out")
        settings[name] = span
    return Sweep(
        algorithms=tuple(arguments.algo),
        tasks=tuple(arguments.track),
        seeds=tuple(arguments.seeds),
        settings=settings,
        points=arguments.points,
        steps=arguments.steps,
        search=arguments.search,
        search_seed=arguments.search_seed,
        round_points=arguments.round_points,
    )


def _resumed(described: Path) -> tuple[Sweep, bool]:
    try:
        found = json.loads(described.read_text(encoding="utf-8"))
        early_stop = bool(found.pop("early_stop"))
        given = {k: tuple(v) if isinstance(v, list) else v for k, v in found.items()}
        return Sweep(**given), early_stop
    except (OSError, KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"{described.parent} holds no sweep that can be resumed ({type(error).__name__}: "
            f"{error}); give a folder that qcar sweep made"
        ) from None


main = command.main("sweep", __doc__, OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
