"""Train an agent: PPO, SAC, TD3, policy search by CMA-ES, or the analytic gradient.

    qcar train --algo ppo --track paper --seed 3
    qcar train --algo sac --track budget-0.5 --seeds 0 1 2 3 4
    qcar train --resume runs/ppo-paper-seed3
    qcar train --algo ppo --track paper --seeds 0 1 2 3 4 --publish mine

A track with a number is the track at that force limit alone.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from qcar_env.agents.publish import check_unpublished, publish
from qcar_env.agents.recipes import ALGORITHMS, TASKS, Recipe, recipe
from qcar_env.commands import command
from qcar_env.evaluation.storage import check_folder, held, replacing
from qcar_env.validation import positive, whole

if TYPE_CHECKING:
    from qcar_env.agents.train import Progress, References, Result

RUNS = Path("runs")


OPTIONS: command.Options = {
    "algo": ("ppo", f"one of: {', '.join(ALGORITHMS)}"),
    "track": ("paper", f"one of: {', '.join(TASKS)}"),
    "seed": (0, "seed of everything drawn"),
    "seeds": (int, "several seeds, one after another", {"nargs": "+"}),
    "steps": (int, "environment steps instead of the recipe's"),
    "out": (Path, "run folder (default runs/NAME-seedN)"),
    "resume": (Path, "go on with a killed run", {"metavar": "FOLDER"}),
    "force": (False, "replace what is there"),
    "target-db": (float, "stop when both amplitudes are reduced by this [dB]"),
    "tensorboard": (False, "write TensorBoard files into the run folder"),
    "publish": (
        Path,
        "copy the seed that is best on validation into this folder; those that are shipped stand "
        "in agents/pretrained of a checkout",
        {"metavar": "FOLDER"},
    ),
    "quiet": (False, "no progress bar"),
}


def run(args: argparse.Namespace) -> None:
    """Train what is asked for."""
    from qcar_env.agents.train import resumed_recipe

    if args.target_db is not None:
        positive("target-db", args.target_db, "dB")
    if args.resume is not None:
        algorithm, task, seed, steps = resumed_recipe(args.resume)
        chosen = dataclasses.replace(recipe(algorithm, task), steps=steps)
        _one(chosen, seed, args.resume, args, resume=True)
        return
    chosen = recipe(args.algo, args.track)
    if args.steps is not None:
        steps = whole("steps", args.steps, most=10**12)  # a year of the fastest trainer
        chosen = dataclasses.replace(chosen, steps=steps)
    if args.publish is not None:
        if args.steps is not None:
            raise ValueError("--publish ships what the recipe makes; leave out --steps")
        check_unpublished(chosen.name, args.publish, force=args.force)
    results = [
        _one(chosen, seed, folder, args, resume=False)
        for seed, folder in _folders(chosen, args).items()
    ]
    if args.publish is not None:
        folders = [each.folder for each in results]
        print(f"published {publish(folders, args.publish, force=args.force)}")


def _folders(chosen: Recipe, args: argparse.Namespace) -> dict[int, Path]:
    """Return the run folder of each seed, all of them checked before the first one is trained."""
    from qcar_env.agents.train import check_new

    seeds = [whole("seed", each, least=0) for each in args.seeds or [args.seed]]
    if args.out is not None and len(seeds) > 1:
        raise ValueError(
            f"--out must be the folder of one run, got {len(seeds)} seeds; leave it out, or give "
            "one seed"
        )
    folders = {seed: args.out or RUNS / f"{chosen.name}-seed{seed}" for seed in seeds}
    for folder in folders.values():
        check_folder(folder)
        check_new(folder, force=args.force)
    return folders


def _one(
    chosen: Recipe, seed: int, folder: Path, args: argparse.Namespace, *, resume: bool
) -> Result:
    from tqdm import tqdm

    from qcar_env.agents.train import train
    from qcar_env.plots.learning import progress as draw

    print(f"{chosen.name}, seed {seed}: {chosen.steps:,} environment steps into {folder}")
    with tqdm(total=chosen.steps, unit="step", unit_scale=True, disable=args.quiet) as bar:

        def report(progress: Progress, beside: References) -> None:
            bar.update(progress.steps - bar.n)
            bar.set_postfix_str(describe(progress, beside))

        try:
            with held(folder):
                result = train(
                    chosen,
                    seed,
                    folder,
                    resume=resume,
                    force=args.force,
                    target_db=args.target_db,
                    tensorboard=args.tensorboard,
                    report=report,
                )
        except KeyboardInterrupt:
            how = f"go on with: qcar train --resume {folder}"
            raise KeyboardInterrupt(how if (folder / "checkpoint.pt").exists() else "") from None
    curves = {name: [getattr(each, name) for each in result.history] for name in ("x1", "x2")}
    figure = draw(curves, [each.wall for each in result.history])
    with replacing(result.folder / "learning_curve.png") as path:
        figure.savefig(path, dpi=150)
    for scale, found in result.validation.items():
        print(
            f"  s = {scale}: rho {found['rho']:.4f} (optimum {found['optimum']:.4f}), "
            f"x1 {found['x1']:.5f} m, x2 {found['x2']:.5f} m"
        )
    print(f"  {result.steps:,} steps, {result.wall:.0f} s wall, {result.cpu:.0f} s CPU")
    return result


def describe(progress: Progress, beside: References) -> str:
    """Return a live evaluation in words: dB below the uncontrolled amplitudes."""
    x1, x2 = progress.reductions
    c1, c2 = dataclasses.replace(progress, x1=beside.cnvc[0], x2=beside.cnvc[1]).reductions
    return (
        f"x1 {x1:.1f}, x2 {x2:.1f} dB (CNVC {c1:.1f}, {c2:.1f}); "
        f"rho {progress.rho:.4f} (optimum {beside.optimum:.4f})"
    )


main = command.main("train", __doc__, OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
