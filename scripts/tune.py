"""Tune the gains of the baselines and store them in a file.

qcar tune                                     # everything that has no gains yet
qcar tune --track budget --force-scale 0.5 --baselines lnvc state --force
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from qcar_env.baselines import tune
from qcar_env.commands import command
from qcar_env.evaluation import storage
from qcar_env.evaluation.tracks import TRACKS, track
from qcar_env.validation import known, positive, whole

DEFAULT_TRACKS = ("budget", "randomised")  # the other two have the same scenario as `budget`


OPTIONS: command.Options = {
    "track": (
        DEFAULT_TRACKS,
        f"tracks whose training sets are searched: {', '.join(TRACKS)} "
        f"(default: {' '.join(DEFAULT_TRACKS)})",
    ),
    "force-scale": (
        float,
        "force limits over the scenario's own [-] (default: the track's)",
        {"nargs": "+"},
    ),
    "baselines": (tuple(tune.SEARCHES), f"what is tuned (default: {' '.join(tune.SEARCHES)})"),
    "seed": (0, "seed of the search (default: 0)"),
    "population": (48, "candidates in a generation (default: 48)"),
    "out": (
        Path("results/tune/tuned.json"),
        "file of the gains (default: results/tune/tuned.json); those that are shipped stand in "
        "baselines/tuned.json of a checkout",
    ),
    "force": (False, "tune again what has gains, and replace them"),
}


def run(arguments: argparse.Namespace) -> None:
    """Tune and store."""
    seed, population, out = arguments.seed, arguments.population, arguments.out
    whole("seed", seed, least=0)
    whole("population", population, least=tune.LEAST_POPULATION)
    for scale in arguments.force_scale or ():
        positive("force scale", scale)
    storage.check_file(out)
    jobs = [
        (name, each.name, scale)
        for each in map(track, arguments.track)
        for scale in arguments.force_scale or each.force_scales
        for name in arguments.baselines
    ]
    for name in arguments.baselines:
        known("baseline to tune", name, tune.SEARCHES)
    stored = {each.key for each in tune.load(out)}
    todo = [job for job in jobs if arguments.force or job not in stored]
    if not todo:
        print(f"every one of these has gains in {out}; give --force to tune them again")
        return
    begin = time.monotonic()
    for count, (name, track_name, scale) in enumerate(todo, start=1):
        found = tune.tune(
            name,
            track(track_name),
            scale,
            seed=seed,
            population=population,
            command=f"qcar tune --track {track_name} --force-scale {scale:g} "
            f"--baselines {name} --seed {seed} --population {population}",
        )
        tune.store(found, out)
        spent = time.monotonic() - begin
        print(
            f"[{count}/{len(todo)}] {track_name} x{scale:g} {name:16s} "
            f"training {found.training_rho:.4f}  validation {found.validation_rho:.4f}  "
            f"{found.evaluations} candidates, {spent:.0f} s, "
            f"about {command.left(spent, count, len(todo)):.0f} s left",
            flush=True,
        )
    print(f"written to {out}")


main = command.main("tune", __doc__, OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
