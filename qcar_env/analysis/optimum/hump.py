"""How much there is to win on a hump: the least acceleration of the body, with a proof.

A linear quarter car at rest drives over a hump. Its one actuator, between the masses, keeps limits
of force and, where given, of the force's rate, of the travel and of the tyre's load. The force may
begin `preview` seconds before the hump and knows the whole road from then on; no policy that
meets a flat road with no force and sees that far ahead does better.

**What the bound covers.** Every motion of the *linear* car within the limits. A car with stops and
a tyre that lifts off is linear between its stops and on the road: with ``travel`` as far as the
nearer stop and ``contact=True`` the bound covers each of its motions that touches no stop and keeps
the road, and says nothing of the others. Without these two limits it covers every policy on the
linear car itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.linalg import matrix_balance

from qcar_env.analysis.optimum.grid import MOST_NODES
from qcar_env.analysis.optimum.hump_certificate import Multipliers, least
from qcar_env.analysis.optimum.hump_program import Solution, solve
from qcar_env.analysis.optimum.sampled import (
    NO_FILTER,
    PARTS,
    STIFFEST,
    Filter,
    Sampled,
    sampled,
    stiffness,
)
from qcar_env.physics import linear
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import known, non_negative, positive, shown, whole

Array = NDArray[np.float64]
HumpObjective = Literal["peak_acceleration", "rms_acceleration", "vdv"]
Shape = Literal["held", "any"]

NORMS: dict[str, float] = {"peak_acceleration": math.inf, "rms_acceleration": 2.0, "vdv": 4.0}
SHAPES = ("held", "any")
GAP = 0.01  # between program and bound, in objectives of the uncontrolled motion: else no solution


@dataclass(frozen=True, kw_only=True)
class Headroom:
    """The least objective on a hump, the force that reaches it, and the proof of it.

    Objectives are in m/s^2, the vibration dose value in m/s^1.75, of the weighted acceleration if
    there is a weighting. Where no force keeps the limits, `value`, `upper` and `bound` are infinite
    (the bound is certified then, too, or else 0) and force and motion are those of no force.
    """

    objective: HumpObjective
    shape: Shape  # of the forces that `bound` covers
    value: float  # of the program: the found force, measured where the program looks
    upper: float  # the found force, measured in every part of an interval
    bound: float  # certified: no force within the limits leaves less
    passive: float  # no force, measured as `upper`
    travel: float  # largest |x2 - x1| of the found force [m]
    load: float  # least load of the tyre [N]
    t: Array  # (n + 1,) [s]: the force is held from each to the next
    x: Array  # (n + 1, 4) state [m, m, m/s, m/s]
    u: Array  # (n,) force on the body, and against the wheel [N]
    multipliers: Multipliers = field(repr=False)  # of the proof, see `hump_certificate.least`
    car: Sampled = field(repr=False)  # of the proof
    status: str  # the solver's own words
    iterations: int

    @property
    def feasible(self) -> bool:
        """Whether a force keeps the limits."""
        return self.value < math.inf

    @property
    def gap(self) -> float:
        """Distance between program and bound: what the solver left."""
        return self.value - self.bound if self.feasible else 0.0


def hump_optimum(
    scenario: str | Scenario,
    objective: HumpObjective = "peak_acceleration",
    *,
    force: float | None = None,
    travel: float | None = 0.08,
    rate: float | None = None,
    contact: bool = True,
    preview: float | None = 0.3,
    shape: Shape = "held",
    weighting: Sequence[Any] | None = None,
    inside: int | None = None,
    dt: float | None = None,
    duration: float | None = None,
) -> Headroom:
    """Return the least objective that any force within the limits leaves.

    Parameters
    ----------
    scenario : str or Scenario
        A linear `QuarterCar` with a `SuspensionActuator`, a road of any profile and its speed. The
        car is at rest at time 0 on a road of height 0. What it draws is not looked at.
    objective : {"peak_acceleration", "rms_acceleration", "vdv"}
        Largest |a| of the body, root of its mean square over the duration, or its vibration dose
        value ``(int a^4 dt)^(1/4)``.
    force : float, optional
        Largest force [N]; the actuator's if left out.
    travel : float, optional
        Largest |x2 - x1| [m]; without a limit if None.
    rate : float, optional
        Largest rate of the force [N/s]: from one control interval to the next its mean changes by
        no more than `rate` times `dt`. Without a limit if None.
    contact : bool
        Whether the tyre must keep the road, its load never below zero.
    preview : float, optional
        How long before the road's first kink the force may begin [s]; from the beginning of the
        episode on if None. A road that is not flat at its beginning is known from there on.
    shape : {"held", "any"}
        Forces held over the control interval, as the environment holds them, or of every shape: a
        bound for every control interval and for actuators with a lag, too.
    weighting : tuple, optional
        A filter of the acceleration as `scipy.signal.lti` takes it, ``(A, B, C, D)``, ``(zeros,
        poles, gain)`` [rad/s] or ``(numerator, denominator)``: of ISO 2631-1 the weighting Wk.
    inside : int, optional
        Nodes in a control interval at which the limits are kept: 2 for held forces. For forces of
        every shape as many pieces, in each of which the program's force differs: 8.
    dt, duration : float, optional
        Control interval and length of the episode [s]; the scenario's if left out.

    Returns
    -------
    Headroom

    Raises
    ------
    ValueError
        If car or actuator are not linear (the message names the parts), an argument is out of
        range, or nothing moves the car.
    ImportError
        If the solver, Clarabel, is not installed.
    RuntimeError
        If the solver fails.

    Notes
    -----
    Limits are kept at the nodes, so that the bound holds as well where they are kept always; the
    found force may pass them by a little in between (`Headroom.travel`, `Headroom.load`). The peak
    is that of every instant: one that is read at the control instants alone, on both sides of a
    change of the force, belongs to ``inside=1``. The end is free: a longer episode has no lower
    peak or dose.
    """
    scenario = find_scenario(scenario)
    norm = NORMS[known("objective", objective, tuple(NORMS))]
    any_shape = known("shape", shape, SHAPES) == "any"
    _check_linear(scenario)
    limit = scenario.actuator.limit[0] if force is None else positive("force", force, "N")
    travel = None if travel is None else positive("travel", travel, "m")
    rate = math.inf if rate is None else positive("rate", rate, "N/s")
    hold = scenario.dt if dt is None else positive("dt", dt, "s")
    length = scenario.duration if duration is None else positive("duration", duration, "s")
    inside = (8 if any_shape else 2) if inside is None else whole("inside", inside, most=MOST_NODES)
    filter = NO_FILTER if weighting is None else _filter(weighting)
    holds = round(length / hold)
    if not 1 <= holds * inside <= MOST_NODES:
        raise ValueError(
            f"duration must be 1 to {MOST_NODES} nodes long, got {length:g} s with dt = {hold:g} s "
            f"and inside = {inside}; give another duration or dt"
        )
    fastest = stiffness(filter, scenario.car)
    if fastest * hold / (PARTS * inside) > STIFFEST:
        raise ValueError(
            f"dt must be at most {STIFFEST * PARTS * inside / fastest:.3g} s for this car, got "
            f"{hold:g} s with inside = {inside}; give a shorter dt or more nodes inside"
        )
    first = 0
    if preview is not None:
        begin = _flat_until(scenario) - non_negative("preview", preview, "s")
        whole_holds = begin / hold
        first = math.floor(whole_holds + 1e-9) if any_shape else math.ceil(whole_holds - 1e-9)
        first = max(0, first)
        if first >= holds:
            raise ValueError(
                f"duration must reach beyond the beginning of the force at {begin:g} s, got "
                f"{length:g} s; give a longer duration, an earlier hump or more preview"
            )
    pieces = inside if any_shape else 1
    cell = hold / inside
    car = sampled(
        scenario,
        first * hold,
        (holds - first) * pieces,
        hold / pieces,
        inside=1 if any_shape else inside,
        group=pieces,
        norm=norm,
        means=any_shape or norm < math.inf,
        over={math.inf: 1.0, 2.0: cell / (holds * hold), 4.0: cell}[norm],
        limit=limit,
        travel=travel,
        rate=rate * hold,
        contact=bool(contact),
        filter=filter,
    )
    found = solve(car)
    return _judged(car, found, objective, shape, limit, holds * hold)


def _judged(
    car: Sampled,
    found: Solution,
    objective: HumpObjective,
    shape: Shape,
    limit: float,
    duration: float,
) -> Headroom:
    """Return what the found force leaves and what the found multipliers prove."""
    multipliers = found.multipliers
    if found.feasible:
        u = found.u
        x = car.motion(u)
        value = float(np.linalg.norm(car.objective.at(x[:-1], u).ravel(), car.norm))
        held = max(0.0, least(car, multipliers, any_shape=False))
        solved = value - held <= GAP
        bound = max(0.0, least(car, multipliers, any_shape=True)) if shape == "any" else held
    else:
        u = np.zeros(car.count)
        x = car.motion(u)
        nothing = np.zeros_like(multipliers.objective)
        multipliers = dataclasses.replace(multipliers, objective=nothing)
        held = least(car, multipliers, any_shape=False)
        solved = held > 0.0
        value = bound = math.inf
        if shape == "any" and least(car, multipliers, any_shape=True) <= 0.0:
            bound = 0.0  # no force of so many pieces keeps the limits, and of others none is known
    if not solved:
        raise RuntimeError(
            f"the program was not solved (status {found.status}; {value:.3g} against a bound of "
            f"{held:.3g}); try another number of nodes inside or another duration"
        )
    upper = _measured(car, x, u, duration) if found.feasible else math.inf
    nothing = np.zeros(car.count)
    return Headroom(
        objective=objective,
        shape=shape,
        value=value * car.reference,
        upper=upper,
        bound=bound * car.reference,
        passive=_measured(car, car.motion(nothing), nothing, duration),
        travel=float(np.abs(car.travel_every.at(x[:-1], u)).max()),
        load=float(car.load_every.at(x[:-1], u).min()),
        t=car.t,
        x=x[:, :4] * car.scale[:4],
        u=u * limit,
        multipliers=multipliers,
        car=car,
        status=found.status,
        iterations=found.iterations,
    )


def _measured(car: Sampled, x: Array, u: Array, duration: float) -> float:
    """Return the objective of a motion, of e in all parts of the intervals."""
    e = np.abs(car.every.at(x[:-1], u))
    if car.norm == math.inf:
        return float(e.max())
    power = simpson(e**car.norm, dx=car.length / (e.shape[1] - 1), axis=1).sum()
    return float((power / (duration if car.norm == 2.0 else 1.0)) ** (1.0 / car.norm))


def _flat_until(scenario: Scenario) -> float:
    """Return until when the road is flat and at height 0 [s]; 0 if it does not begin so."""
    road = scenario.road
    first = road.kink(0, road.numbers, road.table)
    if scenario.force.f or not 0.0 < first < math.inf:
        return 0.0
    s = first * np.arange(64) / 64
    flat = not np.any(road.heights(s)) and not np.any(road.slopes(s))
    return first / scenario.speed if flat else 0.0


def _check_linear(scenario: Scenario) -> None:
    """Refuse what is not linear, by name."""
    car, actuator = scenario.car, scenario.actuator
    if not car.has_masses:
        raise ValueError(
            f"the car must have masses, got a {type(car).__name__}; make it with QuarterCar"
        )
    bent = [
        f"{name} {type(part).__name__}"
        for name in ("spring", "damper", "tyre", "stops")
        if not getattr(part := getattr(car, name, None), "linear", True)
    ]
    if bent:
        raise ValueError(
            f"the car must be linear, got {', '.join(bent)}; give it a LinearSpring, a "
            "LinearDamper, a LinearTyre and NoStops: between stops and on the road the bound then "
            "holds for this car, too"
        )
    linear.matrices(car)
    if actuator.size != 1 or actuator.unit != "N" or not actuator.linear or actuator.State._fields:
        raise ValueError(
            f"the actuator must push between the masses, linear and without a lag, got {actuator}; "
            "give a SuspensionActuator of the same limit: with shape='any' the bound then holds "
            "for one with lag, power and limited rate, too"
        )
    if actuator.delay:
        raise ValueError(
            f"the actuator must act at once, got a delay of {actuator.delay:g} s; give none, and "
            "that much less preview"
        )


def _filter(weighting: Sequence[Any]) -> Filter:
    """Return a filter with balanced states."""
    from scipy import signal  # slow to import

    lti: Any = signal.lti
    try:
        given: Any = lti(*weighting).to_ss()
        parts = (given.A, given.B, given.C, given.D)
        A, B, C, D = (np.asarray(each, dtype=np.float64) for each in parts)
        sizes = B.shape[1], C.shape[0]
    except (TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"weighting must be a filter as scipy.signal.lti takes it, got {shown(weighting)} "
            f"({error}); give (A, B, C, D) or (zeros, poles, gain)"
        ) from None
    if sizes != (1, 1) or not all(np.isfinite(each).all() for each in (A, B, C, D)):
        raise ValueError(
            f"weighting must be of one finite input and output, got {shown(weighting)}; give a "
            "filter of the acceleration"
        )
    if A.size and np.linalg.eigvals(A).real.max() >= 0.0:
        raise ValueError(f"weighting must be stable, got {shown(weighting)}; give another filter")
    balanced: Any = matrix_balance(A, permute=False)
    T = balanced[1]
    return Filter(A=balanced[0], B=np.linalg.solve(T, B[:, 0]), C=C[0] @ T, D=float(D[0, 0]))
