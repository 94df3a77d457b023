"""Scenarios: car, road, external force, actuator and what varies, under a name with a source."""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from qcar_env.physics import linear, roads
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.dynamics import Coefficients
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.rk4 import ACCURACY_LIMIT, STABILITY_LIMIT
from qcar_env.physics.roads import Road
from qcar_env.validation import (
    entries,
    finite,
    instance,
    known,
    positive,
    shown,
    store,
    whole,
)

Actuation = Literal["independent", "suspension"]
ACTUATIONS: tuple[Actuation, ...] = ("independent", "suspension")
MOST_INTERVALS = 2**53  # of an episode: what a float counts one by one
MOST_SUBSTEPS = 1_000_000  # of a control interval, chosen here: 5 ns each at 200 Hz
MOST_STEPS = 10_000_000  # of a crossing whose peaks are looked for, chosen here: a minute's work


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """What pushes on the car, and how hard it can.

    Parameters
    ----------
    actuation : {"independent", "suspension"}
        ``independent``: two actuators against the ground, as the paper's `u1` and `u2`; their
        limits are specific forces on wheel and body [m/s^2]. ``suspension``: one actuator
        between wheel and body, ``-F`` on the wheel and ``+F`` on the body; its limit is a force
        [N], and the car must have masses.
    limit : tuple of float
        Largest force: two numbers [m/s^2] or one [N]; positive.

    Raises
    ------
    ValueError
        If a limit is not positive or their number is wrong.
    """

    actuation: Actuation
    limit: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check kind and limits."""
        actuation = known("actuation", self.actuation, ACTUATIONS)
        limit, expected = entries(self.limit), 2 if actuation == "independent" else 1
        if len(limit) != expected:
            raise ValueError(
                f"actuation {actuation!r} takes {expected} force limit(s), "
                f"got {len(limit)}: {shown(self.limit)}; give a tuple of {expected}"
            )
        store(
            self,
            actuation=actuation,
            limit=tuple(positive("force limit", value, self.unit) for value in limit),
        )

    @property
    def unit(self) -> str:
        """Unit of limit and force."""
        return "m/s^2" if self.actuation == "independent" else "N"

    @property
    def size(self) -> int:
        """Number of actions."""
        return len(self.limit)

    def specific_limits(self, car: QuarterCar) -> tuple[float, float]:
        """Return the specific forces ``(u1, u2)`` [m/s^2] that action 1 makes.

        The wheel's is negative for a suspension actuator, which pushes the wheel down when it
        lifts the body.

        Raises
        ------
        ValueError
            If the actuator is rated in newtons and the car has no masses.
        """
        if self.actuation == "independent":
            return float(self.limit[0]), float(self.limit[1])
        if car.m1 is None or car.m2 is None:
            raise ValueError(
                "a suspension actuator needs a car with masses, got m1=None; "
                "make the car with QuarterCar.from_physical"
            )
        return -self.limit[0] / car.m1, self.limit[0] / car.m2


@dataclass(frozen=True, kw_only=True)
class Randomisation:
    """Factors drawn uniformly for each episode, each applied to the nominal scenario.

    Parameters
    ----------
    height : tuple of float
        Range of the factor on the hump height `h` [-].
    force : tuple of float
        Range of the factor on the external force `f` [-].
    frequency : tuple of float
        Range of the factor on `omega` and `Omega`, that is on the speed of the car [-].
    load : tuple of float
        Range of the factor on the body's mass [-]. The actuator and the external force keep
        their newtons, so their specific forces on the body fall.
    wheel_mass : tuple of float
        Range of the factor on the wheel's mass [-], likewise.
    limit : tuple of float
        Range of the factor on the actuator's force limit [-].

    Raises
    ------
    ValueError
        If a range is not two positive numbers in rising order.
    """

    height: tuple[float, float] = (1.0, 1.0)
    force: tuple[float, float] = (1.0, 1.0)
    frequency: tuple[float, float] = (1.0, 1.0)
    load: tuple[float, float] = (1.0, 1.0)
    wheel_mass: tuple[float, float] = (1.0, 1.0)
    limit: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        """Check every range."""
        for each in dataclasses.fields(self):
            given = entries(getattr(self, each.name))
            if len(given) != 2:
                raise ValueError(
                    f"range of {each.name} must be two numbers, "
                    f"got {shown(getattr(self, each.name))}; "
                    "give the lowest and the highest factor"
                )
            low, high = (positive(f"{each.name} factor", value) for value in given)
            if high < low:
                raise ValueError(
                    f"range of {each.name} must rise, got ({low:g}, {high:g}); swap the two"
                )
            store(self, **{each.name: (low, high)})


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A crossing to be controlled.

    Parameters
    ----------
    name : str
        Name, as in `SCENARIOS`.
    title : str
        One line for people.
    source : str
        Where the numbers come from.
    car : QuarterCar
        The plant.
    road : Road
        Road under the tyre.
    force : ExternalForce
        External force on the body.
    actuator : Actuator
        Kind and limit of the control force.
    randomisation : Randomisation or None
        What varies from episode to episode.
    dt : float
        Control interval [s]; 0.005 s is 200 Hz, the rate of series suspension controllers.
    substeps : int
        RK4 steps in a control interval.
    duration : float
        Length of an episode [s].
    travel_limit : float
        Displacement that ends an episode, in reference amplitudes [-].

    Raises
    ------
    ValueError
        If a number is out of range, the actuator does not fit the car, or RK4 would diverge.

    Warns
    -----
    UserWarning
        If the integration step is coarse for the car's fastest mode.
    """

    name: str
    title: str
    source: str
    car: QuarterCar
    road: Road
    force: ExternalForce = field(default_factory=ExternalForce)
    actuator: Actuator
    randomisation: Randomisation | None = None
    dt: float = 0.005
    substeps: int = 4
    duration: float = 5.0
    travel_limit: float = 3.0

    def __post_init__(self) -> None:
        """Check the numbers, alone and against each other."""
        for name, kind in (("car", QuarterCar), ("road", Road), ("force", ExternalForce)):
            instance(name, getattr(self, name), kind)
        instance("actuator", self.actuator, Actuator)
        if self.randomisation is not None:
            instance("randomisation", self.randomisation, Randomisation)
        store(
            self,
            dt=positive("dt", self.dt, "s"),
            substeps=whole("substeps", self.substeps, most=MOST_SUBSTEPS),
            duration=positive("duration", self.duration, "s"),
            travel_limit=positive("travel_limit", self.travel_limit),
        )
        if self.duration / self.dt > MOST_INTERVALS:
            raise ValueError(
                f"duration must be at most {MOST_INTERVALS:.1e} control intervals, got "
                f"{self.duration:g} s with dt = {self.dt:g} s; give a shorter duration"
            )
        if self.steps < 1:
            raise ValueError(
                f"duration must hold a control interval, got {self.duration:g} s with "
                f"dt = {self.dt:g} s; give {self.dt:g} s or more"
            )
        self.actuator.specific_limits(self.car)
        check_step(self.car, self.dt / self.substeps)

    @property
    def steps(self) -> int:
        """Control intervals in an episode."""
        return round(self.duration / self.dt)

    @property
    def reference_amplitudes(self) -> tuple[float, float]:
        """Amplitudes of x1 and x2 without control [m], see `reference_amplitudes`."""
        return reference_amplitudes(self.car, self.road, self.force)

    @property
    def reference_frequency(self) -> float:
        """Frequency of the motion [rad/s], with which a velocity becomes an amplitude.

        That of a harmonic road; elsewhere that of the external force, or without one the body's
        own, in which the car swings after a hump.
        """
        if self.road.profile == "harmonic":
            return self.road.omega
        return (self.force.Omega if self.force.f else 0.0) or self.car.omega2

    def with_force_scale(self, scale: float) -> Scenario:
        """Return the same scenario with the force limits multiplied by `scale` [-]."""
        scale = positive("force scale", scale)
        limit = tuple(scale * value for value in self.actuator.limit)
        return dataclasses.replace(self, actuator=dataclasses.replace(self.actuator, limit=limit))


def check_step(car: QuarterCar, step: float) -> None:
    """Refuse an RK4 step that diverges on the uncontrolled car, warn of a coarse one.

    Parameters
    ----------
    car : QuarterCar
        The plant.
    step : float
        RK4 step [s].

    Raises
    ------
    ValueError
        If the step is not positive, or ``step * |lambda|max`` exceeds the stability limit of RK4.

    Warns
    -----
    UserWarning
        If it exceeds the accuracy limit.
    """
    fastest = float(np.max(np.abs(linear.poles(car))))
    product = positive("integration step", step, "s") * fastest
    if product > STABILITY_LIMIT:
        raise ValueError(
            f"integration step must be below {STABILITY_LIMIT / fastest:.3g} s for this car, got "
            f"{step:.3g} s (step * |lambda|max = {product:.3g}, RK4 is stable up to "
            f"{STABILITY_LIMIT}); give a smaller dt or more substeps"
        )
    if product > ACCURACY_LIMIT:
        warnings.warn(
            f"integration step {step:.3g} s is coarse for this car: step * |lambda|max = "
            f"{product:.3g}; below {ACCURACY_LIMIT / fastest:.3g} s is accurate",
            UserWarning,
            stacklevel=3,
        )


@lru_cache(maxsize=1024)
def reference_amplitudes(car: QuarterCar, road: Road, force: ExternalForce) -> tuple[float, float]:
    """Return the amplitudes of x1 and x2 without control [m].

    On a harmonic road those of the steady motion. Where the road ends or steps, the largest
    displacements of a crossing that starts at rest, and at least those of the steady answer to
    the external force.

    Raises
    ------
    ValueError
        If the car does not move at all (no road, no force), as nothing can be reduced then, or if
        the crossing is too long for its peaks to be looked for.
    """
    if road.profile == "harmonic":
        found = linear.steady_state(car, road, force).amplitudes
    else:
        found = _crossing_peaks(car, road, force)
    if min(found) <= 0.0:
        raise ValueError(
            f"the uncontrolled car must move, got amplitudes {found} m; "
            "give the road a height h or the external force an amplitude f"
        )
    return found


def _crossing_peaks(car: QuarterCar, road: Road, force: ExternalForce) -> tuple[float, float]:
    slowest = float(np.min(np.abs(linear.poles(car))))
    fastest = max(float(np.max(np.abs(linear.poles(car)))), road.omega, force.Omega)
    begin = min(road.start, 0.0)
    # Three periods of the slowest mode hold its peak.
    settle = 3.0 * 2.0 * math.pi / slowest if slowest > 0.0 else math.inf
    last = road.end if math.isfinite(road.end) else road.start
    dt = 2.0 * math.pi / fastest / 200.0  # peaks to (pi / 200)^2 / 2 = 1e-4 of their height
    if not (last + settle - begin) / dt <= MOST_STEPS:
        raise ValueError(
            f"a crossing must be over within {MOST_STEPS * dt:.3g} s for a car, road and force of "
            f"up to {fastest:.3g} rad/s, got {last + settle - begin:.3g} s with three periods of "
            "the slowest mode; give the road an earlier end or the car more stiffness"
        )
    edges = [begin, *road.kinks(begin, last + settle), last + settle]
    x = np.zeros(4)
    peaks = np.zeros(4)
    for start, end in itertools.pairwise(edges):
        if end <= start:
            continue  # humps without a gap: one ends where the next begins
        count = max(1, math.ceil((end - start) / dt))
        step = linear.exact_transition(car, road, force, (end - start) / count)
        middle = road.phasor(0.5 * (start + end))  # which piece this is
        moving = bool(np.hypot(middle.s, middle.c) > 0.0)
        times = start + step.dt * np.arange(count)
        local = road.omega * (times - start)
        if road.profile == "step":
            on_road = np.stack([np.full(count, float(middle.s)), np.zeros(count)], axis=1)
        else:
            on_road = np.stack([np.sin(local), np.cos(local)], axis=1) * moving
        at_force = force.phasor(times)
        drive = on_road @ step.road.T + np.stack([at_force.s, at_force.c], axis=1) @ step.force.T
        for each in drive:
            x = step.A @ x + each
            peaks = np.maximum(peaks, np.abs(x))
    if force.f:
        steady = linear.steady_state(car, roads.harmonic(h=0.0, omega=1.0), force).amplitudes
        peaks[:2] = np.maximum(peaks[:2], steady)
    return float(peaks[0]), float(peaks[1])


# The paper states no parameter values. This set was calibrated: least squares on Table 1's ratios
# and uncontrolled amplitudes, then on the signs of the trends of its section 5.2. Many sets fit.
PAPER_CAR = QuarterCar(
    omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5, mu1=2510.0, mu2=16.0
)
PAPER_FORCE = ExternalForce(f=24.8, Omega=55.0)
PAPER_SOURCE = "calibrated on Table 1 of Alluhydan et al., Mathematics 2024, 12(19), 3046"
# CNVC's own peak forces in steady state with G = 1.2 are 277.5 and 32.3 m/s^2.
PAPER_ACTUATOR = Actuator(actuation="independent", limit=(280.0, 33.0))

# Sprung 300 kg, unsprung 60 kg, k 16 and 190 kN/m, damper 1 kN s/m; modes at 7.1 and 58 rad/s.
MATHWORKS_CAR = QuarterCar.from_physical(
    m1=60.0, m2=300.0, k1=190_000.0, k2=16_000.0, c1=0.0, c2=1_000.0
)
MATHWORKS_SOURCE = "MathWorks, Robust Control of Active Suspension (quarter-car example)"

_PRESETS = (
    Scenario(
        name="paper",
        title="The paper's worst case: omega1 = omega2 = omega = Omega, endless harmonic hump",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=roads.harmonic(h=0.1, omega=55.0),
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
    ),
    Scenario(
        name="paper-hump",
        title="The paper's car over one half-sine hump, under the external force",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=roads.hump(h=0.1, omega=55.0, start=0.5),
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
    ),
    Scenario(
        name="paper-step",
        title="The paper's car on a constant step (its Fig. 11), under the external force",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=roads.step(h=0.1),
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
    ),
    Scenario(
        name="paper-randomised",
        title="The paper's worst case with height, force, speed and masses drawn per episode",
        source=PAPER_SOURCE + "; ranges chosen here: a hump half to one and a half times as "
        "high, speed and masses within 10 %",
        car=PAPER_CAR,
        road=roads.harmonic(h=0.1, omega=55.0),
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
        randomisation=Randomisation(
            height=(0.5, 1.5),
            force=(0.5, 1.5),
            frequency=(0.9, 1.1),
            load=(0.9, 1.1),
            wheel_mass=(0.9, 1.1),
        ),
    ),
    Scenario(
        name="mathworks-hump",
        title="A passenger car over one hump, 3 m long and 0.1 m high, at 10 km/h",
        source=MATHWORKS_SOURCE + "; hump within the usual 3 to 9 m, 60 to 120 mm",
        car=MATHWORKS_CAR,
        road=roads.hump(h=0.1, V=10.0, L=3.0, start=0.5),
        actuator=Actuator(actuation="suspension", limit=(1_500.0,)),
        duration=4.0,
    ),
    Scenario(
        name="mathworks-train",
        title="A passenger car over five humps, 3 m long and 3 m apart, at 20 km/h",
        source=MATHWORKS_SOURCE + "; humps as above",
        car=MATHWORKS_CAR,
        road=roads.train(h=0.1, V=20.0, L=3.0, count=5, gap=1.0, start=0.5),
        actuator=Actuator(actuation="suspension", limit=(1_500.0,)),
        duration=8.0,
    ),
)

SCENARIOS: Mapping[str, Scenario] = MappingProxyType({each.name: each for each in _PRESETS})


def scenario(name: str | Scenario) -> Scenario:
    """Return the preset called `name`; a `Scenario` is returned as it is.

    Raises
    ------
    ValueError
        If there is no such preset; the message gives the nearest name and the list.
    """
    if isinstance(name, Scenario):
        return name
    return SCENARIOS[known("scenario", name, SCENARIOS)]


def draw(nominal: Scenario, rng: np.random.Generator) -> Scenario:
    """Draw the scenario of one episode.

    Parameters
    ----------
    nominal : Scenario
        What the factors are applied to; itself if it has no randomisation.
    rng : numpy.random.Generator
        Where the draws come from: six numbers.

    Returns
    -------
    Scenario
        Always made from the nominal one, so that draws do not compound.
    """
    if nominal.randomisation is None:
        return nominal
    low, high = np.array(dataclasses.astuple(nominal.randomisation)).T
    return vary(nominal, *(float(factor) for factor in low + (high - low) * rng.random(6)))


def vary(
    nominal: Scenario,
    height: float = 1.0,
    force: float = 1.0,
    frequency: float = 1.0,
    load: float = 1.0,
    wheel_mass: float = 1.0,
    limit: float = 1.0,
) -> Scenario:
    """Return `nominal` with factors on height, force, speed, body and wheel mass, force limit [-].

    Springs, dampers, the external force and the actuators keep their newtons; what is divided by
    a mass falls with it.

    Raises
    ------
    ValueError
        If a factor is not finite, or one of frequency, mass or limit not positive.
    """
    height, force = finite("height factor", height), finite("force factor", force)
    frequency = positive("frequency factor", frequency)
    load, wheel_mass = positive("load factor", load), positive("wheel_mass factor", wheel_mass)
    limit = positive("limit factor", limit)
    car = nominal.car
    varied = dataclasses.replace(
        car,
        **vary_car(car, load, wheel_mass)._asdict(),
        m1=None if car.m1 is None else car.m1 * wheel_mass,
        m2=None if car.m2 is None else car.m2 * load,
    )
    limits = tuple(limit * value for value in nominal.actuator.limit)
    if nominal.actuator.actuation == "independent":
        limits = (limits[0] / wheel_mass, limits[1] / load)
    return dataclasses.replace(
        nominal,
        car=varied,
        road=dataclasses.replace(
            nominal.road, h=nominal.road.h * height, omega=nominal.road.omega * frequency
        ),
        force=ExternalForce(
            f=nominal.force.f * force / load, Omega=nominal.force.Omega * frequency
        ),
        actuator=dataclasses.replace(nominal.actuator, limit=limits),
        randomisation=None,
    )


def vary_car(car: Any, load: Any, wheel_mass: Any) -> Coefficients:
    """Return the coefficients of a car whose masses are multiplied by factors [-].

    Plain arithmetic, so that compiled code starts its episodes with this same function.

    Parameters
    ----------
    car : QuarterCar or Coefficients
        The nominal car.
    load, wheel_mass : float
        Factors on the masses of body and wheel [-].
    """
    return Coefficients(
        car.omega1 / math.sqrt(wheel_mass),
        car.omega2 / math.sqrt(load),
        car.b1 / wheel_mass,
        car.b2 / load,
        car.E1 / wheel_mass,
        car.E2 / wheel_mass,
        car.E3 / load,
        car.mu1 / wheel_mass,
        car.mu2 / wheel_mass,
    )
