"""What a drive did to people, suspension, tyre and actuator, from its history.

found = ride(rollout(policy, over_hump("escort", "watts"), signals=RIDE_SIGNALS))
found.vdv, found.least_load, found.shaft_energy

All are of the whole record and of every instant of it, not of the control instants alone: between
these the motion is found from what is kept at them (`qcar_env.evaluation.fine`).

**How accurate.** Against the same drives with all numbers kept 20 times as often (two cars, nine
crossings down to a bump of 0.3 m at 20 km/h and a bar at 50; no force, a force that jumps at every
control instant, one with a lag of 5 ms, a damper of 8 ms; 200 Hz): peak acceleration within 0.2 %,
where the control instants alone miss 25 % of it under a force that jumps, 2 % otherwise; VDV, MTVV
and weighted root mean square 0.05 %, travel 0.05 %, loads 0.5 % of the static one, time without
contact 0.6 ms; the force's root mean square and energies 1.5 %, peak power of a damper 10 %, as the
force of an actuator with a memory is taken on the line between two control instants; that of a held
force is exact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.evaluation import comfort
from qcar_env.evaluation.fine import FINE_SIGNALS, Fine, fine, middles
from qcar_env.evaluation.metrics import rms
from qcar_env.evaluation.rollouts import Rollout
from qcar_env.evaluation.weighting import Weighting, weighted

Array = NDArray[np.float64]

RIDE_SIGNALS = FINE_SIGNALS  # that a rollout must keep
SATURATED = 0.99  # of the limit: a force with a lag comes near it and never there


class Measure(NamedTuple):
    """What a measure is."""

    unit: str
    title: str


MEASURES: Mapping[str, Measure] = MappingProxyType(
    {
        "peak_acceleration": Measure("m/s^2", "largest acceleration of the body"),
        "rms_acceleration": Measure("m/s^2", "its root mean square"),
        "peak_jerk": Measure(
            "m/s^3", "largest change of it in a control interval, over its length"
        ),
        "weighted_rms": Measure("m/s^2", "root mean square of the weighted acceleration"),
        "vdv": Measure("m/s^1.75", "vibration dose value"),
        "mtvv": Measure("m/s^2", "largest root mean square over one second"),
        "crest_factor": Measure("-", "largest weighted acceleration over its root mean square"),
        "crossings": Measure("-", "such drives a day until the action value of 9.1 m/s^1.75"),
        "peak_travel": Measure("m", "largest suspension travel"),
        "rms_travel": Measure("m", "its root mean square"),
        "stop_hits": Measure("-", "times that a stop is touched"),
        "stop_depth": Measure("m", "how deep, at most"),
        "rms_load": Measure(
            "-", "root mean square of the tyre load's change, over the static load"
        ),
        "least_load": Measure("-", "least tyre load over the static load"),
        "largest_load": Measure("-", "largest tyre load over the static load"),
        "lost_contact": Measure("s", "time for which the tyre has no load"),
        "rms_force": Measure("N", "root mean square of the actuator's force"),
        "peak_force": Measure("N", "its largest"),
        "force_rate": Measure(
            "N/s", "its change from one control instant to the next, 99th centile"
        ),
        "saturation": Measure("-", "share of time within 1 % of the largest force"),
        "peak_power": Measure("W", "largest power of the actuator, in or out"),
        "shaft_energy": Measure("J", "all energy that passes its shaft, in and out"),
        "net_energy": Measure("J", "energy that it feeds into the car"),
    }
)


@dataclass(frozen=True, kw_only=True)
class Ride:
    """Measures of one drive; units and titles: `MEASURES`."""

    peak_acceleration: float  # [m/s^2]
    rms_acceleration: float  # [m/s^2]
    peak_jerk: float  # [m/s^3]
    weighted_rms: float  # [m/s^2]
    vdv: float  # [m/s^1.75]
    mtvv: float  # [m/s^2]
    crest_factor: float  # [-]
    crossings: float  # [-]
    peak_travel: float  # [m]
    rms_travel: float  # [m]
    stop_hits: int
    stop_depth: float  # [m]
    rms_load: float  # [-]
    least_load: float  # [-]
    largest_load: float  # [-]
    lost_contact: float  # [s]
    rms_force: float  # [N]
    peak_force: float  # [N]
    force_rate: float  # [N/s]
    saturation: float  # [-]; NaN of a damper, which has no largest force
    peak_power: float  # [W]
    shaft_energy: float  # [J]
    net_energy: float  # [J]

    @property
    def measures(self) -> dict[str, float]:
        """All measures by name."""
        return {name: getattr(self, name) for name in MEASURES}

    @property
    def words(self) -> tuple[str, ...]:
        """What ISO 2631-1 calls the weighted root mean square, see `comfort.words`."""
        return comfort.words(self.weighted_rms)


def ride(rollout: Rollout, *, weighting: str | Weighting = "Wk") -> Ride:
    """Measure a drive.

    Parameters
    ----------
    rollout : Rollout
        With the signals `RIDE_SIGNALS`, of a `QuarterCar` whose actuator pushes between the masses.
        Of many episodes each is measured by itself: ``[ride(each) for each in rollouts(...)]``.
    weighting : str or Weighting
        Of the acceleration: ``"Wk"``, ``"Wb"``, or one of one's own.

    Returns
    -------
    Ride

    Raises
    ------
    ValueError
        If the signals were not kept, the car has no masses or the actuator pushes against the
        ground.
    """
    motion = fine(rollout)
    a, force, travel = motion.acceleration, motion.force, motion.travel
    load, power = motion.load / motion.static, motion.force * motion.travel_rate
    aw = weighted(middles(a), motion.dt, weighting)
    dose = comfort.vdv(aw, motion.dt)
    dt = rollout.scenario.dt
    hits, depth = _stops(rollout.scenario.car, travel.ravel())
    return Ride(
        peak_acceleration=_largest(a),
        rms_acceleration=rms(middles(a)),
        peak_jerk=_largest(np.diff(a[:, -1], prepend=a[:1, 0])) / dt,
        weighted_rms=comfort.weighted_rms(aw),
        vdv=dose,
        mtvv=comfort.mtvv(aw, motion.dt),
        crest_factor=comfort.crest_factor(aw),
        crossings=comfort.crossings(dose),
        peak_travel=_largest(travel),
        rms_travel=rms(middles(travel)),
        stop_hits=hits,
        stop_depth=depth,
        rms_load=rms(middles(load) - 1.0),
        least_load=float(load.min()),
        largest_load=float(load.max()),
        lost_contact=float(np.count_nonzero(middles(load) <= 0.0)) * motion.dt,
        rms_force=rms(middles(force)),
        peak_force=_largest(force),
        force_rate=float(np.quantile(np.abs(np.diff(force[:, -1], prepend=0.0)), 0.99)) / dt,
        saturation=_saturation(rollout, motion),
        peak_power=_largest(power),
        shaft_energy=float(np.abs(middles(power)).sum()) * motion.dt,
        net_energy=float(middles(power).sum()) * motion.dt,
    )


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _stops(car: Any, travel: Array) -> tuple[int, float]:
    """Return how often a stop is touched, and how deep at most [m]."""
    bump, rebound = (getattr(car.stops, name, math.inf) for name in ("bump", "rebound"))
    depth = np.maximum(travel - rebound, -travel - bump)
    touched = depth > 0.0
    begins = touched & ~np.concatenate([[False], touched[:-1]])
    return int(np.count_nonzero(begins)), max(0.0, float(depth.max()))


def _saturation(rollout: Rollout, motion: Fine) -> float:
    actuator = rollout.scenario.actuator
    if hasattr(actuator, "c_max"):
        return math.nan
    return float(np.mean(np.abs(middles(motion.force)) >= SATURATED * actuator.limit[0]))
