"""Tune the gains of the baselines and store them in baselines/tuned.json.

python scripts/tune.py                                     # everything that has no gains yet
python scripts/tune.py --track budget --force-scale 0.5 --baselines lnvc state --force
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from baselines import catalogue, tune
from qcar_env.evaluation import storage
from qcar_env.evaluation.tracks import TRACKS, track
from qcar_env.validation import known, positive, whole

DEFAULT_TRACKS = ("budget", "randomised")  # the other two have the same scenario as `budget`


def main(argv: Sequence[str] | None = None) -> int:
    """Tune and store; return the exit status."""
    arguments = _parse(argv)
    try:
        whole("seed", arguments.seed, least=0)
        whole("population", arguments.population, least=tune.LEAST_POPULATION)
        for scale in arguments.force_scale or ():
            positive("force scale", scale)
        storage.check_file(arguments.out)
        jobs = [
            (name, each.name, scale)
            for each in map(track, arguments.track)
            for scale in arguments.force_scale or each.force_scales
            for name in arguments.baselines
        ]
        for name in arguments.baselines:
            known("baseline to tune", name, tune.SEARCHES)
        return _run(jobs, arguments.seed, arguments.population, arguments.out, arguments.force)
    except ValueError as error:
        print(f"tune: {error}", file=sys.stderr)
        return 2


def _run(
    jobs: Sequence[tuple[str, str, float]], seed: int, population: int, out: Path, force: bool
) -> int:
    stored = {(each.baseline, each.track, each.force_scale): each for each in tune.load(out)}
    todo = [job for job in jobs if force or job not in stored]
    if not todo:
        print(f"every one of these has gains in {out}; give --force to tune them again")
        return 0
    begin = time.monotonic()
    for count, (name, track_name, scale) in enumerate(todo, start=1):
        found = tune.tune(
            name,
            track(track_name),
            scale,
            seed=seed,
            population=population,
            command=f"python scripts/tune.py --track {track_name} --force-scale {scale:g} "
            f"--baselines {name} --seed {seed} --population {population}",
        )
        stored[(name, track_name, scale)] = found
        order = sorted(stored, key=lambda key: (key[1], -key[2], key[0]))
        storage.write_json(out, [dataclasses.asdict(stored[key]) for key in order])
        spent = time.monotonic() - begin
        print(
            f"[{count}/{len(todo)}] {track_name} x{scale:g} {name:16s} "
            f"training {found.training_rho:.4f}  validation {found.validation_rho:.4f}  "
            f"{found.evaluations} candidates, {spent:.0f} s, "
            f"about {spent / count * (len(todo) - count):.0f} s left",
            flush=True,
        )
    print(f"written to {out}")
    return 0


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track",
        nargs="+",
        default=list(DEFAULT_TRACKS),
        help=f"tracks whose training sets are searched: {', '.join(TRACKS)} "
        f"(default: {' '.join(DEFAULT_TRACKS)})",
    )
    parser.add_argument(
        "--force-scale",
        nargs="+",
        type=float,
        help="force limits over the scenario's own [-] (default: the track's)",
    )
    parser.add_argument(
        "--baselines",
        nargs="+",
        default=list(tune.SEARCHES),
        help=f"what is tuned (default: {' '.join(tune.SEARCHES)})",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the search (default: 0)")
    parser.add_argument(
        "--population", type=int, default=48, help="candidates in a generation (default: 48)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=catalogue.STORE,
        help="file of the gains (default: baselines/tuned.json)",
    )
    parser.add_argument(
        "--force", action="store_true", help="tune again what has gains, and replace them"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
