"""How soon a law's motion is steady: by the paper's introduction CNVC takes 'a shorter time'.

The control is switched on in the steady motion without control, or the car starts from rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.analysis.simulate import simulate
from qcar_env.physics import linear
from qcar_env.physics.car import REST
from qcar_env.physics.state import State
from qcar_env.validation import positive

Array = NDArray[np.float64]

STEPS = 2400  # of a period: CNVC, switched on at 90 m/s, diverges with less than 1200
KEPT = 100  # instants of a period: an extreme is missed by (2 pi / 100)^2 / 8 = 5e-4 at most


@dataclass(frozen=True, kw_only=True)
class Settling:
    """How a closed loop becomes steady."""

    time: float  # since the start [s]
    amplitudes: tuple[float, float]  # steady ones of wheel and body [m]
    peak_force: tuple[float, float]  # largest specific force on wheel and body on the way [m/s^2]


def settling(
    car: ForcedCar,
    *,
    from_rest: bool = False,
    force_limit: Sequence[float] | None = None,
    band: float = 0.05,
    duration: float = 40.0,
) -> Settling:
    """Return from which extreme of the displacements on all are near the steady amplitude.

    Parameters
    ----------
    car : ForcedCar
        The car under its law, which acts at every instant.
    from_rest : bool, optional
        Start from rest, instead of in the steady motion without control.
    force_limit : sequence of float, optional
        Largest specific forces on wheel and body [m/s^2]; none if left out.
    band : float, optional
        How near, on wheel and body [-].
    duration : float, optional
        After which the motion counts as steady [s].
    """
    step = 2.0 * math.pi / car.omega / STEPS
    moving = linear.steady_state(car.car, car.road, car.force).state(0.0)
    motion = simulate(
        *(car.car, car.road, car.force, car.law),
        duration=round(positive("duration", duration, "s") / step / STEPS) * STEPS * step,
        step=step,
        start=REST if from_rest else State(*moving.tolist()),
        force_limit=force_limit,
        record_every=STEPS // KEPT,
    )
    found = [_settled(motion.t, x, positive("band", band)) for x in (motion.x1, motion.x2)]
    (time1, a1), (time2, a2) = found
    return Settling(
        time=max(time1, time2),
        amplitudes=(a1, a2),
        peak_force=(float(np.abs(motion.u1).max()), float(np.abs(motion.u2).max())),
    )


def _settled(t: Array, x: Array, band: float) -> tuple[float, float]:
    """Return when a displacement settles [s], and its steady amplitude [m]."""
    slope = np.diff(x)
    at = 1 + np.flatnonzero(slope[:-1] * slope[1:] <= 0.0)
    extremes = np.abs(x[at])
    steady = float(extremes[-2:].max())
    outside = np.flatnonzero(np.abs(extremes / steady - 1.0) > band)
    return (float(t[at[outside[-1] + 1]]) if outside.size else 0.0), steady
