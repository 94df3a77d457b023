"""Write the fidelity report: every number, trend and claim of the paper beside ours.

python scripts/fidelity.py
"""

from __future__ import annotations

from qcar_env.commands import command  # first: it tells Ctrl-C in a line from here on

# isort: split
import argparse
import sys
from functools import partial
from pathlib import Path

from qcar_env.evaluation import storage
from qcar_env.report.fidelity import page
from qcar_env.scenarios import scenario

OPTIONS: command.Options = {
    "preset": ("paper", "scenario to compare with the paper"),
    "out": (Path(__file__).parents[1] / "docs" / "fidelity.md", "file to write"),
}


def run(arguments: argparse.Namespace) -> None:
    """Compute and write the page."""
    storage.check_file(arguments.out)
    text = page(scenario(arguments.preset), partial(print, flush=True))
    storage.write_text(arguments.out, text)
    print(f"written to {arguments.out}")


main = command.main("fidelity", __doc__.splitlines()[0], OPTIONS, run)

if __name__ == "__main__":
    sys.exit(main())
