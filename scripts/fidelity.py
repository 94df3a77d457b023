"""Write the fidelity report: every number, trend and claim of the paper beside ours.

python scripts/fidelity.py
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from qcar_env.evaluation import storage
from qcar_env.report.fidelity import page
from qcar_env.scenarios import scenario

ROOT = Path(__file__).parents[1]


def main(argv: Sequence[str] | None = None) -> int:
    """Compute and write the page; return the exit status."""
    arguments = _parse(argv)
    try:
        storage.check_file(arguments.out)
        text = page(scenario(arguments.preset), partial(print, flush=True))
    except ValueError as error:
        print(f"fidelity: {error}", file=sys.stderr)
        return 2
    storage.write_text(arguments.out, text)
    print(f"written to {arguments.out}")
    return 0


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="paper", help="scenario to compare with the paper")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "docs" / "fidelity.md", help="file to write"
    )
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
