"""The controllers of real cars by name: one force between the masses, or a semi-active damper.

They act in scenarios of cars with masses. The baselines of `qcar_env.baselines.catalogue` are
those of the paper's car and its tracks.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from qcar_env.control.comfort_damping import comfort_damping
from qcar_env.control.controller import feedback
from qcar_env.control.h_infinity import ABOVE, h_infinity
from qcar_env.control.kalman import kalman, lqg as lqg_of, road_intensity
from qcar_env.control.pid import pid as pid_controller
from qcar_env.control.preview import Acceptable, Regulator, regulator
from qcar_env.control.semi_active import SEMI_ACTIVE_LAWS
from qcar_env.control.suspension import suspension
from qcar_env.control.suspension_mpc import suspension_program
from qcar_env.evaluation.entry import Entry
from qcar_env.evaluation.tracks import Track
from qcar_env.roads.iso8608 import CLASSES
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import finite, known, non_negative

from .actuation import check_one, is_valve
from .controller_policy import ControllerPolicy
from .learning import learn
from .road_ahead import heights_ahead, intervals, knows_road
from .semi_active_policy import SemiActivePolicy
from .sensed import sensed
from .suspension_mpc_policy import SuspensionMPCPolicy

DEFAULT = Acceptable()
SENSED = (
    "the sensors of the scenario, or acceleration of the body and travel; designed on the car, "
    "their noise"
)
STATE = "travel, tyre deflection, velocities of body and wheel; designed on the car"


def passive(
    scenario: Scenario, stiffness: float = 0.0, damping: float | None = None
) -> ControllerPolicy:
    """Another spring and damper beside the car's own, which may be softer [N/m], [N s/m].

    An actuator gives it within its limits. A semi-active damper has no spring: clipped to what it
    can give, one would be a law that switches. By default the damper is the one that is best for
    comfort on a random road (`qcar_env.control.comfort_damping`).
    """
    if stiffness != 0.0 and is_valve(scenario):
        raise ValueError(
            f"stiffness of a semi-active damper must be 0 N/m, got {stiffness:g} N/m; leave it out"
        )
    if damping is None:
        check_one(scenario, "tuned passive")
        best, own = comfort_damping(scenario.car)
        damping = best - own
    gains = {
        "travel": -finite("stiffness", stiffness, "N/m"),
        "travel_rate": -finite("damping", damping, "N s/m"),
    }
    return ControllerPolicy(feedback("tuned passive", gains), scenario)


def skyhook(scenario: Scenario, c_sky: float = 2_000.0) -> ControllerPolicy:
    """Active skyhook, ``F = -c_sky v2`` [N s/m]."""
    gains = {"v2": -non_negative("c_sky", c_sky, "N s/m")}
    return ControllerPolicy(feedback("skyhook", gains), scenario)


def pid(
    scenario: Scenario, Kp: float = 2_000.0, Ki: float = 1_000.0, Kd: float = 100.0
) -> ControllerPolicy:
    """PID of the body's velocity; gains [N s/m], [N/m], [kg]."""
    return ControllerPolicy(pid_controller(scenario.dt, Kp=Kp, Ki=Ki, Kd=Kd), scenario)


def lqr(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
) -> ControllerPolicy:
    """Linear-quadratic regulator by what is acceptable [m/s^2, m, m, N] (`Acceptable`)."""
    found = _regulator(scenario, acceleration, travel, tyre, force)
    return ControllerPolicy(found.controller, scenario)


def preview(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
    ahead: float = 0.5,
) -> ControllerPolicy:
    """Regulator that sees the road `ahead` [s], which it knows without error (see `lqr`)."""
    found = _regulator(scenario, acceleration, travel, tyre, force)
    plan = found.plan(heights_ahead(scenario), intervals(scenario, "ahead", ahead))
    controller = dataclasses.replace(found.controller, name="LQR + preview")
    return ControllerPolicy(controller, scenario, plan=plan)


def mpc(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
    ahead: float = 0.5,
    horizon: float = 0.4,
    stroke: float = 0.08,
    rate: float = 1e9,
) -> SuspensionMPCPolicy:
    """MPC with the cost of `preview`, keeping the actuator's limits and `stroke` for `horizon`.

    Sees the road `ahead` [s]; `horizon` [s], `stroke` [m], `rate` of the force [N/s]: the
    actuator's own where that is lower.
    """
    found = _regulator(scenario, acceleration, travel, tyre, force)
    actuator: Any = scenario.actuator
    program = suspension_program(
        found,
        limit=actuator.limit[0],
        rate=min(rate, getattr(actuator, "rate_limit", rate)),
        stroke=stroke,
        horizon=max(intervals(scenario, "horizon", horizon), 1),
        preview=intervals(scenario, "ahead", ahead),
    )
    slopes = np.diff(heights_ahead(scenario)) / scenario.dt
    return SuspensionMPCPolicy(program, scenario, slopes)


def lqg(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
    G: float = CLASSES["C"],
) -> ControllerPolicy:
    """Regulator on a Kalman filter's estimate, for a road of ``Gd(n0) = G`` [m^3] (see `lqr`)."""
    found = _regulator(scenario, acceleration, travel, tyre, force)
    signals, noise = sensed(scenario)
    intensity = road_intensity(G, scenario.speed)
    return ControllerPolicy(lqg_of(found, kalman(found.plant, signals, noise, intensity)), scenario)


def robust(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
    road: float = 0.3,
    above: float = ABOVE,
) -> ControllerPolicy:
    """H-infinity control by what is acceptable, on roads whose rate is `road` [m/s] (see `lqr`)."""
    limits = _acceptable(scenario, acceleration, travel, tyre, force)
    signals, noise = sensed(scenario)
    plant = suspension(scenario.car, scenario.dt)
    found = h_infinity(plant, signals, noise, road=road, acceptable=limits, above=above)
    return ControllerPolicy(found.controller, scenario)


def ilc(
    scenario: Scenario,
    acceleration: float = DEFAULT.acceleration,
    travel: float = DEFAULT.travel,
    tyre: float = DEFAULT.tyre,
    force: float = DEFAULT.force,
    crossings: int = 5,
    caution: float = 1.0,
) -> ControllerPolicy:
    """Regulator and a plan that was learned in `crossings` of the same road (see `lqr`)."""
    limits = _acceptable(scenario, acceleration, travel, tyre, force)
    return learn(scenario, acceptable=limits, crossings=crossings, caution=caution).policy


def _regulator(scenario: Scenario, *acceptable: float) -> Regulator:
    limits = _acceptable(scenario, *acceptable)
    return regulator(suspension(scenario.car, scenario.dt), limits)


def _acceptable(scenario: Scenario, *given: float) -> Acceptable:
    check_one(scenario, "the design")
    names = (each.name for each in dataclasses.fields(Acceptable))
    return Acceptable(**dict(zip(names, given, strict=True)))


def _semi_active(kind: Any, scenario: Scenario, **numbers: float) -> SemiActivePolicy:
    return SemiActivePolicy(kind(**numbers), scenario)


@dataclass(frozen=True, kw_only=True)
class Classical:
    """A controller by name."""

    make: Callable[..., Any]  # of the scenario, and of gains by name
    title: str
    needs: str  # beside its gains: what it reads at each sample, and what it was designed on
    gains: Mapping[str, float | None]  # stated defaults; None where the car decides
    road: bool = False  # whether it knows the road beforehand
    valve: bool | None = None  # whether it needs a semi-active damper, or an actuator; None: either


def _designed(make: Callable[..., Any], title: str, needs: str, **needed: bool) -> Classical:
    parameters = list(inspect.signature(make).parameters.items())[1:]
    gains = {name: each.default for name, each in parameters}
    return Classical(make=make, title=title, needs=needs, gains=gains, **needed)


CLASSICAL: Mapping[str, Classical] = MappingProxyType(
    {
        "passive": _designed(passive, "tuned passive", "travel and its rate"),
        "skyhook": _designed(skyhook, "skyhook", "velocity of the body"),
        "pid": _designed(pid, "PID", "velocity of the body"),
        "lqr": _designed(lqr, "LQR", STATE),
        "mpc": _designed(
            mpc,
            "MPC",
            f"{STATE} and actuator; the road ahead, without error",
            road=True,
            valve=False,
        ),
        "ilc": _designed(
            ilc, "ILC", f"{STATE}; what crossings of the same road have taught", road=True
        ),
        "lqg": _designed(lqg, "LQG", f"{SENSED} and the spectrum of a road"),
        "h-infinity": _designed(robust, "H-infinity", f"{SENSED} and the size of a road's rate"),
        "preview": _designed(
            preview, "LQR + preview", f"{STATE}; the road ahead, without error", road=True
        ),
        **{
            name: Classical(
                make=partial(_semi_active, kind),
                title=kind.name,
                needs=", ".join(kind.signals).replace("_", " "),
                gains={each.name: each.default for each in dataclasses.fields(kind)},
                valve=True,
            )
            for name, kind in SEMI_ACTIVE_LAWS.items()
        },
    }
)


def make(name: str, scenario: str | Scenario, **gains: float) -> Any:
    """Make a controller.

    Parameters
    ----------
    name : str
        One of `CLASSICAL`.
    scenario : str or Scenario
        What it will act in.
    **gains : float
        Gains; the stated defaults otherwise.

    Raises
    ------
    ValueError
        If name or gain is unknown, a gain is out of range, or the scenario has another actuator
        than the controller needs.
    """
    found = CLASSICAL[known("controller", name, CLASSICAL)]
    for each in gains:
        known(f"gain of {name}", each, found.gains)
    return found.make(find_scenario(scenario), **{**found.gains, **gains})


def fits(name: str, scenario: Scenario) -> bool:
    """Return whether a scenario has the actuator, and the road, that a controller needs."""
    actuator = scenario.actuator
    if actuator.size != 1 or actuator.unit != "N" or not scenario.car.has_masses:
        return False
    needs = CLASSICAL[known("controller", name, CLASSICAL)]
    return needs.valve in (None, is_valve(scenario)) and (not needs.road or knows_road(scenario))


def entries(names: Sequence[str] | None = None) -> tuple[Entry, ...]:
    """Return controllers as entries, which enter where the actuator fits; all if none are named."""
    return tuple(
        Entry(
            name=name,
            kind="published",
            title=CLASSICAL[name].title,
            make=partial(_enter, name),
            needs=CLASSICAL[name].needs,
        )
        for name in (CLASSICAL if names is None else names)
        if known("controller", name, CLASSICAL)
    )


def _enter(name: str, scenario: Scenario, track: Track | None, force_scale: float) -> Any:
    return make(name, scenario) if fits(name, scenario) else None
