"""The task that the environments share: start, forces, observation, reward and end.

Pure functions on named tuples, as in `qcar_env.physics`: the scalar environment, the vector
environment and the SB3 adapter all use this one source.

Observation, each of order one in the uncontrolled motion (A: reference amplitudes, omega:
reference frequency, h, f: the scenario's nominal height and force):

====  =====================  ==============================
 #    entry                  meaning
====  =====================  ==============================
 0    x1 / A1                wheel displacement
 1    x2 / A2                body displacement
 2    v1 / (omega A1)        wheel velocity
 3    v2 / (omega A2)        body velocity
 4    y / h                  road height under the tyre
 5    y' / (h omega)         its rate
 6    F / f                  external force
 7    F' / (f Omega)         its rate
 8    limit                  force limit over the scenario's
====  =====================  ==============================

``observe="feedback"`` is 0 to 3, ``observe="full"`` 0 to 7; 8 follows with `observe_limit`.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.physics.closed_loop import Limits
from qcar_env.physics.forcing import World, amplitudes_of, passage_of
from qcar_env.physics.motion import Plant, angle, half_step_angles
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.roads import ENDLESS, Phasor, RoadPieces, kink_time
from qcar_env.physics.state import State
from qcar_env.scenarios import Randomisation, Scenario, vary_car
from qcar_env.validation import positive

OBSERVATION_LIMIT = 10.0  # [-] bound of every entry; travel ends an episode long before
Observe = Literal["full", "feedback"]
OBSERVE: tuple[Observe, ...] = ("full", "feedback")
FEEDBACK_SIZE = 4  # entries of observe="feedback": the state
FULL_SIZE = 8  # entries of observe="full": also road and external force

# Cost of a step of the uncontrolled motion [-]. SAC with Stable-Baselines3's defaults ended with
# the body at 0.010 m with 10, and at 0.048 m, just below CNVC, with 1 (one seed); PPO's learn with
# both.
UNCONTROLLED_COST = 10.0
WEIGHT = 0.5 * UNCONTROLLED_COST  # [-] of each relative amplitude in the cost: of their mean
STEPS_LOST = 100.0  # [-] steps at the travel limit that leaving it costs: 1 / (1 - 0.99)
TRAVEL_PENALTY = STEPS_LOST * UNCONTROLLED_COST  # [-] for each amplitude of the limit

HIGHEST_SCALE = 1e6  # [-] of a force limit; chosen here: no product of it overflows
RESET_OPTIONS = ("state", "phase", "force_scale", "scenario")

REST_SHARE = 0.25  # [-] share of the episodes that start from rest
START_RANGE = (0.01, 1.5)  # [-] of start amplitudes over the uncontrolled ones, log-uniform
LOG_START = math.log(START_RANGE[0])
LOG_RANGE = math.log(START_RANGE[1]) - math.log(START_RANGE[0])
CIRCLE = 2.0 * math.pi  # [rad]
DRAWS = 12  # uniform numbers that the start of an episode takes
REST = State(0.0, 0.0, 0.0, 0.0)


class Scales(NamedTuple):
    """What turns a state into observation and reward, for one car."""

    x1: Any  # 1 / A1 [1/m]
    x2: Any  # 1 / A2 [1/m]
    v1: Any  # 1 / (omega A1) [s/m]
    v2: Any  # 1 / (omega A2) [s/m]
    y: Any  # h of this episode over the nominal one [-]
    y_dot: Any  # h omega over the nominal one [-]
    F: Any  # f over the nominal one [-]
    F_dot: Any  # f Omega over the nominal one [-]
    limit: Any  # force limit of this episode over the scenario's own [-]
    travel: Any  # largest |x1 / A1| and |x2 / A2| [-]


class Nominal(NamedTuple):
    """A scenario as plain numbers, for compiled code."""

    omega1: Any  # coefficients of the car, see `qcar_env.physics.dynamics.Coefficients`
    omega2: Any
    b1: Any
    b2: Any
    E1: Any
    E2: Any
    E3: Any
    mu1: Any
    mu2: Any
    h: Any  # height of the road [m]
    omega: Any  # frequency of the road [rad/s]
    f: Any  # external force [m/s^2]
    Omega: Any  # its frequency [rad/s]
    endless: Any  # 1 for a harmonic road, 0 for one with kinks [-]
    start: Any  # time of the first kink [s]
    gap: Any  # flat stretch between humps, in lengths of a hump [-]
    count: Any  # number of humps [-]
    limit1: Any  # force on the wheel that action 1 makes [m/s^2] or [N]
    limit2: Any  # and on the body
    mass1: Any  # mass that this force is divided by [kg]; 1 if it is specific
    mass2: Any
    specific: Any  # 1 if the limits are specific forces, 0 if newtons [-]
    own_limit: Any  # force limit of the scenario before `force_scale` [m/s^2] or [N]
    A1: Any  # reference amplitudes [m]
    A2: Any
    frequency: Any  # reference frequency [rad/s]
    travel: Any  # largest displacement in reference amplitudes [-]
    steps: Any  # control intervals in an episode [-]
    step: Any  # integration step [s]
    height_low: Any  # ranges of the factors that are drawn for each episode [-]
    height_high: Any
    force_low: Any
    force_high: Any
    frequency_low: Any
    frequency_high: Any
    load_low: Any
    load_high: Any
    wheel_mass_low: Any
    wheel_mass_high: Any
    limit_low: Any
    limit_high: Any


class Factors(NamedTuple):
    """What an episode's scenario is the nominal one multiplied by [-], see `vary`."""

    height: Any
    force: Any
    frequency: Any
    load: Any
    wheel_mass: Any
    limit: Any


class Episode(NamedTuple):
    """A car at the start of an episode."""

    x: Any  # State
    world: Any  # World: phasors of road and force
    kink: Any  # index of the road's next kink
    plant: Any  # Plant: car, road, force and step
    scales: Any  # Scales
    limits: Any  # Limits: specific forces that action 1 makes [m/s^2]
    forces: Any  # Limits: the same in the actuator's unit [m/s^2] or [N]
    start: Any  # time on the road [s]


UNVARIED = Factors(1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def observation_size(observe: Observe, observe_limit: bool) -> int:
    """Return the number of entries of the observation."""
    return (FULL_SIZE if observe == "full" else FEEDBACK_SIZE) + int(observe_limit)


def nominal_numbers(scenario: Scenario, own: Scenario | None = None) -> Nominal:
    """Return a scenario as plain numbers.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    own : Scenario, optional
        The same before `force_scale`, for the observation's `limit` entry.
    """
    car, road, actuator = scenario.car, scenario.road, scenario.actuator
    specific = actuator.actuation == "independent"
    limit1, limit2 = actuator.limit if specific else (-actuator.limit[0], actuator.limit[0])
    ranges = scenario.randomisation or Randomisation()
    return Nominal(
        *car.coefficients,
        h=float(road.h),
        omega=float(road.omega),
        f=float(scenario.force.f),
        Omega=float(scenario.force.Omega),
        endless=float(road.profile == "harmonic"),
        start=float(road.start),
        gap=float(road.gap),
        count=float(road.count),
        limit1=float(limit1),
        limit2=float(limit2),
        mass1=1.0 if specific or car.m1 is None else float(car.m1),
        mass2=1.0 if specific or car.m2 is None else float(car.m2),
        specific=float(specific),
        own_limit=float((own or scenario).actuator.limit[0]),
        A1=scenario.reference_amplitudes[0],
        A2=scenario.reference_amplitudes[1],
        frequency=scenario.reference_frequency,
        travel=float(scenario.travel_limit),
        steps=float(scenario.steps),
        step=scenario.dt / scenario.substeps,
        height_low=ranges.height[0],
        height_high=ranges.height[1],
        force_low=ranges.force[0],
        force_high=ranges.force[1],
        frequency_low=ranges.frequency[0],
        frequency_high=ranges.frequency[1],
        load_low=ranges.load[0],
        load_high=ranges.load[1],
        wheel_mass_low=ranges.wheel_mass[0],
        wheel_mass_high=ranges.wheel_mass[1],
        limit_low=ranges.limit[0],
        limit_high=ranges.limit[1],
    )


def draw_factors(draws: Any, nominal: Any) -> Factors:
    """Return the factors of an episode, from the first six of its `DRAWS` uniform numbers."""
    return Factors(
        nominal.height_low + (nominal.height_high - nominal.height_low) * draws[0],
        nominal.force_low + (nominal.force_high - nominal.force_low) * draws[1],
        nominal.frequency_low + (nominal.frequency_high - nominal.frequency_low) * draws[2],
        nominal.load_low + (nominal.load_high - nominal.load_low) * draws[3],
        nominal.wheel_mass_low + (nominal.wheel_mass_high - nominal.wheel_mass_low) * draws[4],
        nominal.limit_low + (nominal.limit_high - nominal.limit_low) * draws[5],
    )


def draw_motion(draws: Any, nominal: Any) -> tuple[State, Any]:
    """Return state and phase [rad] at the start, from the last six of the uniform numbers.

    A share `REST_SHARE` starts from rest; the others on each mass's own circle in the phase
    plane, its amplitude log-uniform in `START_RANGE` times the uncontrolled one. The phase of the
    road is uniform; 0 where it is not harmonic, as its humps come when they come.
    """
    moving = 1.0 if draws[10] >= REST_SHARE else 0.0
    a1 = moving * math.exp(LOG_START + LOG_RANGE * draws[6]) * nominal.A1
    a2 = moving * math.exp(LOG_START + LOG_RANGE * draws[7]) * nominal.A2
    psi1 = CIRCLE * draws[8]
    psi2 = CIRCLE * draws[9]
    omega = nominal.frequency
    x = State(
        a1 * math.cos(psi1),
        a2 * math.cos(psi2),
        -omega * a1 * math.sin(psi1),
        -omega * a2 * math.sin(psi2),
    )
    return x, nominal.endless * CIRCLE * draws[11]


def begin(x: Any, phase: Any, factors: Any, nominal: Any) -> Episode:
    """Return the episode that starts in state `x` at `phase` of the road.

    Parameters
    ----------
    x : State
        State of the plant.
    phase : float
        Phase of a harmonic road [rad]; other roads begin at time 0.
    factors : Factors
        What the nominal scenario is multiplied by.
    nominal : Nominal
        The scenario whose reference amplitudes, height and force scale observation and reward:
        they stay the same however an episode varies.

    Returns
    -------
    Episode
        What `qcar_env.scenarios.vary` makes of the scenario, as plain numbers.
    """
    h = nominal.h * factors.height
    omega = nominal.omega * factors.frequency
    f = nominal.f * factors.force / factors.load
    Omega = nominal.Omega * factors.frequency
    road = road_pieces(h, omega, nominal)
    start = phase / omega if nominal.endless > 0.0 else 0.0
    kink = 0
    while kink_time(kink, road) <= start:
        kink += 1
    car = vary_car(nominal, factors.load, factors.wheel_mass)
    amplitudes = amplitudes_of(h, omega, f, car)
    plant = Plant(
        car,
        amplitudes,
        road,
        Omega,
        passage_of(half_step_angles(omega, Omega, nominal.step), amplitudes),
        step_fractions(nominal.step),
    )
    limits = Limits(
        factors.limit * nominal.limit1 / (nominal.mass1 * factors.wheel_mass),
        factors.limit * nominal.limit2 / (nominal.mass2 * factors.load),
    )
    newtons = factors.limit * nominal.limit2
    forces = limits if nominal.specific > 0.0 else Limits(newtons, newtons)
    scales = scales_of(h, omega, f, Omega, forces.u1, nominal)
    world = World(phasor_at(start, kink, road), angle(Omega * start))
    return Episode(x, world, kink, plant, scales, limits, forces, start)


def road_pieces(h: Any, omega: Any, nominal: Any) -> RoadPieces:
    """Return the road of `nominal` with another height [m] and frequency [rad/s]."""
    if nominal.endless > 0.0:
        return RoadPieces(h, omega, 0.0, ENDLESS, 0.0, 0.0)
    if omega == 0.0:
        return RoadPieces(h, 0.0, nominal.start, ENDLESS, 0.0, 1.0)
    duration = math.pi / omega
    pitch = (1.0 + nominal.gap) * duration
    return RoadPieces(h, omega, nominal.start, duration, pitch, nominal.count)


def phasor_at(t: Any, kink: Any, road: Any) -> Phasor:
    """Return the road's phasor at `t` [s], after which kink `kink` is the next."""
    if road.count == 0.0:
        return angle(road.omega * t)
    if kink % 2 == 0:
        return Phasor(0.0, 0.0)
    if road.omega == 0.0:
        return Phasor(1.0, 0.0)
    return angle(road.omega * (t - kink_time(kink - 1, road)))


def ratio(value: Any, nominal: Any) -> Any:
    """Return ``value / nominal``; 0 where the scenario has none of it."""
    return value / nominal if nominal != 0.0 else 0.0


def scales_of(h: Any, omega: Any, f: Any, Omega: Any, limit: Any, nominal: Any) -> Scales:
    """Return the scales of an episode with this road, external force and force limit."""
    return Scales(
        1.0 / nominal.A1,
        1.0 / nominal.A2,
        1.0 / (nominal.frequency * nominal.A1),
        1.0 / (nominal.frequency * nominal.A2),
        ratio(h, nominal.h),
        ratio(h * omega, nominal.h * nominal.omega),
        ratio(f, nominal.f),
        ratio(f * Omega, nominal.f * nominal.Omega),
        limit / nominal.own_limit,
        nominal.travel,
    )


def scales(nominal: Scenario, episode: Scenario | None = None) -> Scales:
    """Return the scales of an episode.

    Parameters
    ----------
    nominal : Scenario
        The scenario whose reference amplitudes, height and force scale observation and reward.
    episode : Scenario, optional
        The episode's own scenario; the nominal one if left out.
    """
    own = nominal if episode is None else episode
    return scales_of(
        own.road.h,
        own.road.omega,
        own.force.f,
        own.force.Omega,
        own.actuator.limit[0],
        nominal_numbers(nominal),
    )


def start_time(scenario: Scenario, phase: float) -> float:
    """Return the time [s] at which the road of `scenario` has `phase` [rad]."""
    return phase / scenario.road.omega if scenario.road.profile == "harmonic" else 0.0


def observe(x: Any, world: Any, scales: Any) -> tuple[Any, ...]:
    """Return the nine entries of the observation, not yet bounded.

    Parameters
    ----------
    x : State
        State of the plant.
    world : World
        Phasors of road and force.
    scales : Scales
        The episode's scales.
    """
    return (
        x.x1 * scales.x1,
        x.x2 * scales.x2,
        x.v1 * scales.v1,
        x.v2 * scales.v2,
        world.road.s * scales.y,
        world.road.c * scales.y_dot,
        world.force.c * scales.F,
        -world.force.s * scales.F_dot,
        scales.limit,
    )


def costs(x: Any, scales: Any) -> tuple[Any, Any]:
    """Return the two terms of the cost: weighted envelope amplitudes over reference amplitudes.

    As ``a_i / A_i = sqrt((x_i / A_i)^2 + (v_i / (omega A_i))^2)``, the observation says it all.
    The reward of a step is minus the sum of both at its end, and minus `penalty` when it leaves
    the travel limits.

    Parameters
    ----------
    x : State
        State of the plant.
    scales : Scales
        The episode's scales.
    """
    x1, x2, v1, v2 = x.x1 * scales.x1, x.x2 * scales.x2, x.v1 * scales.v1, x.v2 * scales.v2
    a1 = np.sqrt(x1 * x1 + v1 * v1)
    a2 = np.sqrt(x2 * x2 + v2 * v2)
    return a1 * WEIGHT, a2 * WEIGHT


def out_of_travel(x: Any, scales: Any) -> Any:
    """Return whether a displacement has left its limit (a state that is not a number has)."""
    inside1 = abs(x.x1 * scales.x1) <= scales.travel
    inside2 = abs(x.x2 * scales.x2) <= scales.travel
    return not (inside1 & inside2)


def penalty(scales: Any) -> Any:
    """Return the cost of leaving the travel limits: that of staying there for a long time."""
    return TRAVEL_PENALTY * scales.travel


def bounded(value: Any, limit: Any) -> Any:
    """Return `value` held within ``[-limit, limit]``."""
    return min(max(value, -limit), limit)


def draw_start(
    rng: np.random.Generator, scenario: Scenario, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw starts of `n` episodes (see `draw_motion`).

    Parameters
    ----------
    rng : numpy.random.Generator
        Where the draws come from; six numbers an episode.
    scenario : Scenario
        The nominal scenario.
    n : int
        Number of episodes.

    Returns
    -------
    state : ndarray (n, 4)
        ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    phase : ndarray (n,)
        Phase of the road [rad].
    """
    nominal = nominal_numbers(scenario)
    found = [draw_motion((0.0,) * 6 + tuple(row), nominal) for row in rng.random((n, 6)).tolist()]
    states = np.array([x for x, _ in found], dtype=np.float64)
    return states, np.array([phase for _, phase in found], dtype=np.float64)


def given_state(values: Any, scenario: Scenario) -> NDArray[np.float64]:
    """Check a start state that a user gives.

    Parameters
    ----------
    values : array_like (4,)
        ``(x1, x2, v1, v2)`` [m, m, m/s, m/s].
    scenario : Scenario
        For its travel limits.

    Returns
    -------
    ndarray (4,)

    Raises
    ------
    ValueError
        If the shape is wrong, a value is not finite, or an amplitude is beyond its limit.
    """
    state = numbers("state", values)
    if state.shape != (4,) or not np.all(np.isfinite(state)):
        raise ValueError(
            f"state must be four finite numbers (x1, x2, v1, v2), got {values!r}; "
            "give metres and metres a second"
        )
    amplitudes = np.array(scenario.reference_amplitudes) * scenario.travel_limit
    limits = np.concatenate([amplitudes, scenario.reference_frequency * amplitudes])
    for name, value, limit in zip(State._fields, state, limits, strict=True):
        unit = "m" if name in ("x1", "x2") else "m/s"
        if abs(value) > limit:
            raise ValueError(
                f"state {name} must be within its travel limit of {limit:.4g} {unit}, got "
                f"{value:g} {unit}; start closer to rest"
            )
    return state


def force_scale(value: Any) -> float:
    """Return a factor on the force limit, checked.

    Raises
    ------
    ValueError
        If it is not a positive number up to `HIGHEST_SCALE`.
    """
    scale = positive("force_scale", value)
    if scale > HIGHEST_SCALE:
        raise ValueError(
            f"force_scale must be at most {HIGHEST_SCALE:g}, got {scale:g}; no car needs more"
        )
    return scale


def checked_actions(
    name: str, given: Any, shape: tuple[int, ...], each: str
) -> NDArray[np.float32]:
    """Return a copy of actions as an array of the kind that the engine takes.

    Parameters
    ----------
    name : str
        What they are called.
    given : array_like
        Numbers of any kind. What is beyond float32 becomes 2 or -2, which are clipped like it.
    shape : tuple of int
        What their shape must be.
    each : str
        What each number is for.

    Raises
    ------
    ValueError
        If they are no numbers, or their shape is another.
    """
    wide = numbers(name, given)
    if wide.shape != shape:
        raise ValueError(
            f"{name} must have shape {shape}, got {wide.shape}; give one number for each {each}"
        )
    return np.where(np.isfinite(wide), np.clip(wide, -2.0, 2.0), wide).astype(np.float32)


def numbers(name: str, given: Any) -> NDArray[np.float64]:
    """Return what is given as an array of float64.

    Raises
    ------
    ValueError
        If it is not made of numbers.
    """
    try:
        found = np.asarray(given)
        if found.dtype.kind in "biufO":
            return found.astype(np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # the last: torch's
        pass
    raise ValueError(f"{name} must be numbers, got {given!r}; give a list or an array of numbers")
