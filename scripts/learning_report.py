"""Report how agents learn: amplitude against training time and steps, and what each seed reached.

    qcar learning-report                     from the runs in runs/
    qcar learning-report --train             train what is missing first, five seeds
    qcar learning-report --recipes ppo-paper sac-paper --seeds 0 1 2

Writes results/learning/: report.md, curves.csv, and a figure for each task, with CNVC, saturated
velocity feedback and the optimum as lines. Bands and intervals span all seeds; rows state the
median of the seeds on the track's held-out set, and 95 % bootstrap intervals of that median.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from qcar_env.agents.recipes import RECIPES
from qcar_env.baselines.tune import best
from qcar_env.commands import command
from qcar_env.evaluation.storage import check_folder, replacing, write_csv, write_text
from qcar_env.validation import whole

OPTIONS: command.Options = {
    "recipes": (str, "recipes to report (default: all with runs)", {"nargs": "+"}),
    "seeds": ((0, 1, 2, 3, 4), None),
    "train": (False, "train the runs that are missing"),
    "runs": (Path("runs"), "folder of the run folders"),
    "out": (Path("results/learning"), "where the report goes"),
}


def run(args: argparse.Namespace) -> None:
    """Collect and write the report."""
    from qcar_env.agents.learning import collect, levels, report
    from qcar_env.plots.learning import recipes as draw

    check_folder(args.out)
    seeds = [whole("seed", each, least=0) for each in dict.fromkeys(args.seeds)]
    rows, curves = collect(args.recipes, seeds, args.runs, tuned=best, train_missing=args.train)
    write_csv(args.out / "curves.csv", curves)
    write_text(args.out / "report.md", report(rows))
    for task in dict.fromkeys(row["task"] for row in rows):
        points = [each for each in curves if each["task"] == task]
        figure = draw(task, points, levels(RECIPES[points[0]["recipe"]], best))
        with replacing(args.out / f"{task}.png") as path:
            figure.savefig(path, dpi=150)
    print(f"wrote {args.out}/report.md")


main = command.main("learning-report", __doc__, OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
