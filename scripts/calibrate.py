"""Repeat the calibration of the preset `paper` on the paper's Table 1, and show how flat it is.

qcar calibrate
qcar calibrate --omegas 40 55 70
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from qcar_env.analysis.paper import calibration
from qcar_env.analysis.paper.experiments import trends
from qcar_env.analysis.paper.forced_car import from_scenario
from qcar_env.analysis.paper.table1 import PRINTED
from qcar_env.commands import command
from qcar_env.control import CNVC
from qcar_env.evaluation import storage
from qcar_env.scenarios import scenario
from qcar_env.validation import positive

OMEGAS = (26.0, 33.0, 40.0, 47.0, 55.0, 60.0, 66.0)  # [rad/s]


OPTIONS: command.Options = {
    "omegas": (
        OMEGAS,
        "common frequencies at which the fit is repeated [rad/s]",
        {"metavar": "RAD_PER_S"},
    ),
    "out": (Path("results/calibration"), "folder to write to"),
}


def run(arguments: argparse.Namespace) -> None:
    """Fit, print and write."""
    storage.check_folder(arguments.out)
    for omega in arguments.omegas:
        positive("omega", omega, "rad/s")
    start = calibration.candidate_of(from_scenario(scenario("paper")))
    calibrate(start, arguments.omegas, arguments.out)


def calibrate(start: calibration.Candidate, omegas: Sequence[float], out: Path) -> None:
    """Print the preset's residuals, the refit, its flat directions and its profile."""
    labels = [f"{row.law.name} {row.gain:g} x{i}" for row in PRINTED for i in (1, 2)]
    labels += ["no control x1 [m]", "no control x2 [m]"]
    wanted, at_preset = calibration.targets(), calibration.predictions(start)
    refit = calibration.fit(start)
    at_refit = calibration.predictions(refit.candidate)
    print("Ratios of uncontrolled to controlled amplitude, and uncontrolled amplitudes:")
    print(f"{'':>20} {'paper':>8} {'preset':>8} {'':>7} {'refit':>8}")
    for label, want, ours, again in zip(labels, wanted, at_preset, at_refit, strict=True):
        print(
            f"{label:>20} {want:8.3f} {ours:8.3f} {100 * (ours / want - 1):+6.1f}% "
            f"{again:8.3f} {100 * (again / want - 1):+6.1f}%"
        )
    residuals = calibration.residuals(start)
    print(
        f"\nroot mean square residual: preset {100 * np.sqrt(np.mean(residuals**2)):.1f} %, "
        f"refit {100 * refit.cost:.1f} %; worst cell: preset "
        f"{100 * np.expm1(np.abs(residuals).max()):.1f} %, refit {100 * refit.worst:.1f} %"
    )
    print(f"\n{'parameter':>12} {'preset':>10} {'refit':>10}")
    for name in refit.fitted:
        print(f"{name:>12} {getattr(start, name):10.4g} {getattr(refit.candidate, name):10.4g}")
    print("\nDirections that the table sees least (moving by a factor e along one changes all")
    print("fourteen numbers together by the sensitivity); h and mu1, mu2 enter only as products:")
    for each in calibration.directions(refit)[:3]:
        parts = [f"{w:+.2f} ln {n}" for n, w in each.weights.items() if abs(w) > 0.2]
        print(f"  {each.sensitivity:6.3f}: {' '.join(parts)}")
    print("\nRefitted with the frequency held and E1, E3 free as well")
    print("(trends of section 5.2: holds/negligible/contradicts):")
    print(f"{'omega':>8} {'rms':>7} {'worst':>7}  trends    fitted parameters")
    rows = []
    for each in calibration.profile(start, omegas, fitted=tuple(calibration.BOUNDS)):
        found = Counter(t.verdict for t in trends(each.candidate.under(CNVC())))
        counts = "/".join(str(found[kind]) for kind in ("holds", "negligible", "contradicts"))
        values = ", ".join(f"{n} {getattr(each.candidate, n):.3g}" for n in each.fitted)
        print(
            f"{each.candidate.omega:8.1f} {100 * each.cost:6.1f}% {100 * each.worst:6.1f}%  "
            f"{counts:8}  {values}" + ("" if each.success else f"  ({each.message})")
        )
        rows.append({**asdict(each.candidate), "rms": each.cost, "worst": each.worst})
    print("Many sets match the table: the preset is one of them, not the authors' values.")
    storage.write_json(
        out / "calibration.json",
        {"preset": asdict(start), "refit": asdict(refit.candidate), "profile": rows},
    )
    print(f"written to {out / 'calibration.json'}")


main = command.main("calibrate", __doc__.splitlines()[0], OPTIONS, run)

if __name__ == "__main__":
    raise SystemExit(main())
