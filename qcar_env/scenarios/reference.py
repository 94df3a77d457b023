"""The uncontrolled motion of a scenario: what observations, rewards and scores are divided by.

On a harmonic road a linear car has a steady motion, whose amplitudes scores divide by. Elsewhere
they are the largest displacements, at every instant, of an episode from rest; where the road has
ended by then and is level, of all the motion that follows, however short the episode. What a policy
is shown is divided by the largest value that the same signal reaches without control: in that
motion, with its transient, and in episodes from starts as they are drawn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.engine.starts import OBSERVATION_LIMIT
from qcar_env.physics import linear
from qcar_env.physics.peaks import largest_between
from qcar_env.physics.signals import SIGNALS, Signal
from qcar_env.validation import non_negative, positive, store

if TYPE_CHECKING:
    from qcar_env.scenarios.scenario import Scenario

DRAWN = 32  # episodes from drawn starts that are looked at beside the one from rest
MOST_STEPS = 100_000  # control intervals that are looked at, chosen here: some seconds of work
ACTUATORS = {"u1": 0, "u2": 1}  # signals of forces, and which actuator makes them
SETTLED = math.log(1e6)  # [-] time constants of the slowest mode until a motion is steady
TINY = 1e-6  # makes a reading of any signal small enough for the bound of an observation


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales that a scenario states itself.

    Parameters
    ----------
    A1, A2 : float
        Of the displacements of wheel and body [m]; positive.
    omega1, omega2 : float
        Of their velocities, over those [rad/s]; positive.
    others : mapping of str to float
        Of other signals, in their units.
    """

    A1: float
    A2: float
    omega1: float
    omega2: float
    others: Mapping[str, float] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every number."""
        for name, unit in (("A1", "m"), ("A2", "m"), ("omega1", "rad/s"), ("omega2", "rad/s")):
            store(self, **{name: positive(f"scale {name}", getattr(self, name), unit)})
        store(self, others={k: non_negative(f"scale of {k}", v) for k, v in self.others.items()})

    def __hash__(self) -> int:
        """Hash the numbers."""
        return hash((self.A1, self.A2, self.omega1, self.omega2, tuple(self.others.items())))


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The uncontrolled motion of a scenario."""

    amplitudes: tuple[float, float]  # of x1 and x2 [m], which scores divide by
    start: tuple[float, float]  # of x1 and x2 [m], which starts are drawn from
    frequencies: tuple[float, float]  # of v1 over x1 and v2 over x2, likewise [rad/s]
    scales: Mapping[str, float]  # largest values of signals, by name, in their units

    def scale(self, signal: Signal, scenario: Scenario) -> float:
        """Return what a signal is divided by.

        Its own scale, the scenario's, or its largest value; of an actuator's force, where there is
        none without control, its limit.
        """
        if signal.scale is not None:
            return signal.scale
        found = self.scales.get(signal.name)
        if found is None:
            found = _largest(_plain(scenario), (signal,))[1][signal.name]
        if found == 0.0 and signal.name in ACTUATORS:  # without control there is none
            limits = _limits(scenario)
            return limits[min(ACTUATORS[signal.name], len(limits) - 1)]
        return found


def reference(scenario: Scenario) -> Reference:
    """Return the uncontrolled motion of a scenario.

    Raises
    ------
    ValueError
        If the car does not move at all (no road, no force), as nothing can be reduced then.
    """
    return _reference(_plain(scenario))


def _limits(scenario: Scenario) -> tuple[float, ...]:
    actuator: Any = scenario.actuator
    return actuator.limit


def _plain(scenario: Scenario) -> Scenario:
    """Return the scenario without what does not change its uncontrolled motion."""
    plain = {"name": "", "title": "", "source": ""}
    return dataclasses.replace(scenario, **plain, randomisation=(), sensors=())


@lru_cache(maxsize=1024)
def _reference(scenario: Scenario) -> Reference:
    steady = _steady(scenario)
    stated = scenario.scales
    if stated is not None:
        amplitudes = steady or _largest(scenario, ())[0][0]
        known = {
            "x1": stated.A1,
            "x2": stated.A2,
            "v1": stated.omega1 * stated.A1,
            "v2": stated.omega2 * stated.A2,
            "limit": _limits(scenario)[0],
            **stated.others,
        }
        return Reference(
            amplitudes=amplitudes,
            start=(stated.A1, stated.A2),
            frequencies=(stated.omega1, stated.omega2),
            scales=known,
        )
    (peaks, frequencies), largest = _largest(scenario, ())
    return Reference(
        amplitudes=steady or peaks,
        start=peaks,
        frequencies=frequencies,
        scales={**largest, "limit": _limits(scenario)[0]},
    )


def _steady(scenario: Scenario) -> tuple[float, float] | None:
    if not (scenario.car.linear and scenario.excitation.harmonic):
        return None
    found = linear.steady_state(scenario.car, scenario.excitation, scenario.force).amplitudes
    _check_moves(found)
    return found


def _check_moves(amplitudes: tuple[float, float]) -> None:
    if min(amplitudes) <= 0.0:
        raise ValueError(
            f"the uncontrolled car must move, got amplitudes {amplitudes} m; "
            "give the road a height h, the external force an amplitude f, or the episode a longer "
            "duration"
        )


@lru_cache(maxsize=256)
def _largest(
    scenario: Scenario, signals: tuple[Signal, ...]
) -> tuple[tuple[tuple[float, float], tuple[float, float]], dict[str, float]]:
    """Return amplitudes and frequencies from rest, and the largest value of each signal."""
    from qcar_env.scenarios.plan import UNSCALED, Plan

    steps = scenario.steps
    if steps > MOST_STEPS:
        raise ValueError(
            f"duration must be at most {MOST_STEPS} control intervals where scales are found, got "
            f"{steps}; give a shorter one, or the scenario its own scales"
        )
    masses = scenario.car.has_masses
    chosen = signals or tuple(each for each in SIGNALS.values() if masses or not each.needs_masses)
    rest = next(_idle(Plan(_until_steady(scenario), chosen, unscaled=UNSCALED), None, 1))
    names, largest = [each.name for each in chosen], np.max(np.abs(rest), axis=0)
    if signals:
        basis, _ = _largest(scenario, ())
    else:
        x, v = (rest[:, [names.index(f"{of}{mass}") for mass in (1, 2)]] for of in "xv")
        found = largest_between(x[:-1], v[:-1], x[1:], v[1:], scenario.dt)
        peaks, fastest = found.max(axis=0), np.max(np.abs(v), axis=0)
        amplitudes = float(peaks[0]), float(peaks[1])
        _check_moves(amplitudes)
        basis = amplitudes, (float(fastest[0]) / amplitudes[0], float(fastest[1]) / amplitudes[1])
    begun = Plan(scenario, chosen, unscaled=(*basis[0], *basis[1]))
    for drawn in _idle(begun, 0, DRAWN):
        np.maximum(largest, np.max(np.abs(drawn), axis=0), out=largest)
    return basis, {name: float(each) for name, each in zip(names, largest, strict=True)}


def _until_steady(scenario: Scenario) -> Scenario:
    """Return the scenario with a longer episode, if its road ends in it and leaves a level one."""
    road = scenario.excitation
    decay = -float(np.linalg.eigvals(linear.jacobian(scenario.car)).real.max())
    if road.end > scenario.duration or decay <= 0.0:
        return scenario
    last = min(max(road.end, 0.0) + SETTLED / decay, MOST_STEPS * scenario.dt)
    after = road.height(np.linspace(road.end, last, 1000))
    if last <= scenario.duration or np.any(after != after[0]):
        return scenario
    return dataclasses.replace(scenario, duration=last)


def _idle(plan: Any, seed: int | None, n: int) -> Iterator[NDArray[np.float64]]:
    """Yield the readings (k, size) of idle cars, from rest or from drawn starts, one by one."""
    from qcar_env.engine.car import Car

    car = Car(plan)
    rng = np.random.default_rng(seed)
    given = np.full(5, np.nan if seed is not None else 0.0)
    idle, force = np.zeros(car.actions, np.float32), np.empty(car.actions)
    rows = np.empty((plan.scenario.steps + 1, car.size), np.float32)
    for _ in range(n):
        rows[0] = car.begin(rng.random(plan.source.uniforms), given)
        for seen in rows[1:]:
            car.advance(car.array, idle, seen, force)
        if not np.isfinite(rows).all() or np.abs(rows).max() >= OBSERVATION_LIMIT:
            raise ValueError(
                "the uncontrolled car must stay within bounds, but it diverges; give it damping, "
                "softer stops, a smaller dt or more substeps"
            )
        yield rows / np.float64(TINY)
