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

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from qcar_env.physics.state import State, squared_amplitudes
from qcar_env.scenarios import Scenario

OBSERVATION_LIMIT = 10.0  # [-] bound of every entry; travel ends an episode long before
Observe = Literal["full", "feedback"]
OBSERVE: tuple[Observe, ...] = ("full", "feedback")
FEEDBACK_SIZE = 4  # entries of observe="feedback": the state
FULL_SIZE = 8  # entries of observe="full": also road and external force

WEIGHTS = (0.5, 0.5)  # [-] of the two relative amplitudes in the cost, chosen here: equal
TRAVEL_PENALTY = 100.0  # [-] steps at the travel limit that leaving it costs: 1 / (1 - 0.99)

RESET_OPTIONS = ("state", "phase", "force_scale", "scenario")

REST_SHARE = 0.25  # [-] share of the episodes that start from rest
START_RANGE = (0.01, 1.5)  # [-] of start amplitudes over the uncontrolled ones, log-uniform


class Scales(NamedTuple):
    """What turns a state into observation and reward, for one car."""

    inverse_omega: Any  # 1 / omega [s]
    x1: Any  # 1 / A1 [1/m]
    x2: Any  # 1 / A2 [1/m]
    v1: Any  # 1 / (omega A1) [s/m]
    v2: Any  # 1 / (omega A2) [s/m]
    y: Any  # h of this episode over the nominal one [-]
    y_dot: Any  # h omega over the nominal one [-]
    F: Any  # f over the nominal one [-]
    F_dot: Any  # f Omega over the nominal one [-]
    cost1: Any  # weight / A1 [1/m]
    cost2: Any  # weight / A2 [1/m]
    travel1: Any  # largest |x1| [m]
    travel2: Any  # largest |x2| [m]
    penalty: Any  # reward of leaving the travel limits, negative [-]


def observation_size(observe: Observe, observe_limit: bool) -> int:
    """Return the number of entries of the observation."""
    return (FULL_SIZE if observe == "full" else FEEDBACK_SIZE) + int(observe_limit)


def scales(nominal: Scenario, episode: Scenario | None = None) -> Scales:
    """Return the scales of an episode.

    Parameters
    ----------
    nominal : Scenario
        The scenario whose reference amplitudes, height and force scale the observation and the
        reward: they stay the same however an episode varies.
    episode : Scenario, optional
        The episode's own road and force; the nominal ones if left out.

    Returns
    -------
    Scales
    """
    episode = nominal if episode is None else episode
    a1, a2 = nominal.reference_amplitudes
    omega = nominal.reference_frequency
    road, force = nominal.road, nominal.force
    return Scales(
        inverse_omega=1.0 / omega,
        x1=1.0 / a1,
        x2=1.0 / a2,
        v1=1.0 / (omega * a1),
        v2=1.0 / (omega * a2),
        y=_ratio(episode.road.h, road.h),
        y_dot=_ratio(episode.road.h * episode.road.omega, road.h * road.omega),
        F=_ratio(episode.force.f, force.f),
        F_dot=_ratio(episode.force.f * episode.force.Omega, force.f * force.Omega),
        cost1=WEIGHTS[0] / a1,
        cost2=WEIGHTS[1] / a2,
        travel1=nominal.travel_limit * a1,
        travel2=nominal.travel_limit * a2,
        penalty=-TRAVEL_PENALTY * nominal.travel_limit * (WEIGHTS[0] + WEIGHTS[1]),
    )


def observe(x: Any, world: Any, scales: Any) -> tuple[Any, ...]:
    """Return the eight entries of the full observation, not yet clipped.

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
    )


def costs(x: Any, scales: Any) -> tuple[Any, Any]:
    """Return the two terms of the cost: weighted envelope amplitudes over reference amplitudes.

    The reward of a step is minus their sum at its end, plus `Scales.penalty` when it leaves the
    travel limits.
    """
    square1, square2 = squared_amplitudes(x, scales.inverse_omega)
    return np.sqrt(square1) * scales.cost1, np.sqrt(square2) * scales.cost2


def out_of_travel(x: Any, scales: Any) -> Any:
    """Return whether a displacement has left its limit (a state that is not a number has)."""
    return not (abs(x.x1) <= scales.travel1 and abs(x.x2) <= scales.travel2)


def draw_start(
    rng: np.random.Generator, scenario: Scenario, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw starts of `n` episodes.

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
        A share `REST_SHARE` starts from rest; the others on each mass's own circle in the phase
        plane, its amplitude log-uniform in `START_RANGE` times the uncontrolled one.
    phase : ndarray (n,)
        Phase of road and force, uniform [rad]; 0 where the road is not harmonic, whose humps
        come when they come.
    """
    draws = rng.random((n, 6))
    low, high = np.log(START_RANGE)
    amplitude = np.exp(low + (high - low) * draws[:, :2]) * np.array(scenario.reference_amplitudes)
    angle = 2.0 * np.pi * draws[:, 2:4]
    moving = (draws[:, 4:5] >= REST_SHARE) * amplitude
    omega = scenario.reference_frequency
    state = np.concatenate([moving * np.cos(angle), -omega * moving * np.sin(angle)], axis=1)
    harmonic = scenario.road.profile == "harmonic"
    phase = 2.0 * np.pi * draws[:, 5] if harmonic else np.zeros(n)
    return state, phase


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
        If the shape is wrong, a value is not finite, or a displacement is beyond its limit.
    """
    state = np.asarray(values, dtype=np.float64)
    if state.shape != (4,) or not np.all(np.isfinite(state)):
        raise ValueError(
            f"state must be four finite numbers (x1, x2, v1, v2), got {values!r}; "
            "give metres and metres a second"
        )
    for name, value, amplitude in zip(
        ("x1", "x2"), state[:2], scenario.reference_amplitudes, strict=True
    ):
        limit = scenario.travel_limit * amplitude
        if abs(value) > limit:
            raise ValueError(
                f"state {name} must be within its travel limit of {limit:.4g} m, got {value:g} m; "
                "start closer to rest"
            )
    return state


def limit_entry(nominal: Scenario, episode: Scenario) -> float:
    """Return the observation's `limit` entry: the force limit over that of `nominal` [-]."""
    return episode.actuator.limit[0] / nominal.actuator.limit[0]


def start_time(scenario: Scenario, phase: float) -> float:
    """Return the time [s] at which the road of `scenario` has `phase` [rad]."""
    return phase / scenario.road.omega if scenario.road.profile == "harmonic" else 0.0


def as_state(values: NDArray[np.float64]) -> State:
    """Return the four numbers ``(x1, x2, v1, v2)`` as a state of floats."""
    return State(*(float(value) for value in values))


def _ratio(value: float, nominal: float) -> float:
    return value / nominal if nominal else 0.0
