"""Write the fidelity report: every number, trend and claim of the paper beside ours.

qcar fidelity
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from qcar_env.commands import command
from qcar_env.evaluation import storage
from qcar_env.report.fidelity import page
from qcar_env.scenarios import scenario

OPTIONS: command.Options = {
    "out": (Path("results/fidelity.md"), "file to write (default: results/fidelity.md)"),
}


def run(arguments: argparse.Namespace) -> None:
    """Compute and write the page."""
    storage.check_file(arguments.out)
    text = page(scenario("paper"), partial(print, flush=True))
    storage.write_text(arguments.out, text)
    print(f"written to {arguments.out}")


main = command.main("fidelity", __doc__.splitlines()[0], OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
