"""A scenario: car, road, speed, external force, actuator, and what varies."""

from __future__ import annotations

import dataclasses
import itertools
import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.engine.starts import Force, Numbers, vary
from qcar_env.parts.actuator import Actuator
from qcar_env.parts.sensor import Sensor
from qcar_env.physics import tree
from qcar_env.physics.car import Car
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.linear import jacobian
from qcar_env.physics.rk4 import ACCURACY_LIMIT, STABILITY_LIMIT
from qcar_env.roads.excitation import Excitation
from qcar_env.roads.profile import Road
from qcar_env.scenarios.randomise import Choice, Vary, arrays
from qcar_env.scenarios.reference import Reference, Scales, reference
from qcar_env.validation import instance, known, positive, shown, store, whole

MOST_INTERVALS = 2**53  # of an episode: what a float counts one by one
FORCING = ("road.", "force.", "actuator.limit.", "car.mu")  # numbers that move the car
LARGEST = 1e50  # size of one of these: squares of products of two stay finite
MOST_CORNERS = 64  # of what is drawn that are tried, chosen here: some 50 ms
MOST_SUBSTEPS = 1_000_000  # of a control interval, chosen here: 5 ns each at 200 Hz


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What is to be controlled.

    Parameters
    ----------
    name : str
        Name, as in `SCENARIOS`.
    title : str
        One line for people.
    source : str
        Where the numbers come from.
    car : PaperCar or QuarterCar
        The car.
    road : Road
        Road under the tyre, over the distance; the car is at distance 0 at time 0.
    speed : float
        Speed of the car [m/s]; positive.
    force : ExternalForce
        External force on the body.
    actuator : Actuator
        What makes the control force, and how hard it can push.
    sensors : sequence of Sensor
        Through which a policy reads their signals; every other signal is read as it is.
    randomisation : sequence of Vary
        What varies from episode to episode, always from these numbers.
    dt : float
        Control interval [s]; 0.005 s is 200 Hz, the rate of series suspension controllers.
    substeps : int
        RK4 steps in a control interval.
    duration : float
        Length of an episode [s].
    travel_limit : float
        Displacement that ends an episode, over the largest one of the uncontrolled motion [-].
    scales : Scales, optional
        What signals are divided by in observations and rewards, and how far from rest episodes
        start; found from the uncontrolled motion if left out.

    Raises
    ------
    ValueError
        If a number is out of range, the actuator does not fit the car, a path of the randomisation
        names nothing, or RK4 would diverge.

    Warns
    -----
    UserWarning
        If the integration step is coarse for the car's fastest mode.
    """

    name: str = "own"
    title: str = ""
    source: str = ""
    car: Car
    road: Road
    speed: float
    force: ExternalForce = field(default_factory=ExternalForce)
    actuator: Actuator
    sensors: tuple[Sensor, ...] = ()
    randomisation: tuple[Vary, ...] = ()
    dt: float = 0.005
    substeps: int = 4
    duration: float = 5.0
    travel_limit: float = 3.0
    scales: Scales | None = None

    def __post_init__(self) -> None:
        """Check the numbers, alone and against each other."""
        if not hasattr(self.car, "functions"):
            raise ValueError(
                f"car must be a PaperCar or a QuarterCar, got {shown(self.car)}; give such an "
                "object"
            )
        for name, kind in (("road", Road), ("force", ExternalForce), ("actuator", Actuator)):
            instance(name, getattr(self, name), kind)
        if self.scales is not None:
            instance("scales", self.scales, Scales)
        given: Any = self.randomisation
        varied = (given,) if isinstance(given, Vary) else tuple(given or ())
        for each in varied:
            instance("randomisation", each, Vary)
        store(
            self,
            randomisation=varied,
            sensors=_checked_sensors(self.sensors),
            dt=positive("dt", self.dt, "s"),
            substeps=whole("substeps", self.substeps, most=MOST_SUBSTEPS),
            duration=positive("duration", self.duration, "s"),
            travel_limit=positive("travel_limit", self.travel_limit),
        )
        store(self, speed=self.excitation.speed)
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
        if self.actuator.unit == "N" and not self.car.has_masses:
            raise ValueError(
                "an actuator rated in newtons needs a car with masses, got a PaperCar; "
                "make the car with QuarterCar"
            )
        index = tree.paths(self.numbers)
        for path, value in zip(index, tree.flat(self.numbers), strict=True):
            if path.startswith(FORCING) and LARGEST < abs(value) < math.inf:
                raise ValueError(
                    f"{path} must be at most {LARGEST:g} in size, got {value:g}; the motion would "
                    "overflow. Give a smaller number"
                )
        for each in varied:
            for path in each.numbers:
                known("number of the scenario", path, index)
                if path.rpartition(".")[2] in ("delay", "period"):
                    raise ValueError(
                        f"{path} must be the same in all episodes, as it says how much is "
                        "remembered; make a scenario for each"
                    )
        for _ in self.extremes():  # each is checked as it is made
            pass
        self.intervals("delay of the actuator", self.actuator.delay)
        for each in self.sensors:
            self.intervals(f"delay of the sensor of {each.signal}", each.delay)
            self.intervals(f"period of the sensor of {each.signal}", each.period)
        check_step(self)

    def intervals(self, name: str, time: float) -> int:
        """Return a time [s] in whole control intervals.

        Raises
        ------
        ValueError
            If it is no whole number of them, or more than an episode has.
        """
        count = round(time / self.dt)
        if abs(count * self.dt - time) > 1e-9 * self.dt or count > self.steps:
            raise ValueError(
                f"{name} must be a whole number of control intervals of {self.dt:g} s within an "
                f"episode of {self.duration:g} s, got {time:g} s; give {count * self.dt:g} s, or "
                "another dt"
            )
        return count

    @property
    def steps(self) -> int:
        """Control intervals in an episode."""
        return round(self.duration / self.dt)

    @property
    def excitation(self) -> Excitation:
        """The road at the car's speed."""
        return Excitation(road=self.road, speed=self.speed)

    @property
    def numbers(self) -> Numbers:
        """All numbers that can vary, by name."""
        force = Force(float(self.force.f), float(self.force.Omega))
        sensors = tuple(each.numbers for each in self.sensors)
        parts = self.car.numbers, self.road.numbers, self.speed, force, self.actuator.numbers
        return Numbers(*parts, sensors)

    @property
    def reference(self) -> Reference:
        """The uncontrolled motion, see `qcar_env.scenarios.reference`."""
        return reference(self)

    @property
    def reference_amplitudes(self) -> tuple[float, float]:
        """Amplitudes of x1 and x2 without control [m], which metrics divide by."""
        return self.reference.amplitudes

    @property
    def reference_frequency(self) -> float:
        """Frequency with which the body's velocity becomes an amplitude [rad/s]."""
        if self.excitation.harmonic:
            return self.excitation.omega
        return self.reference.frequencies[1]

    def with_force_scale(self, scale: float) -> Scenario:
        """Return the same scenario with the actuator's limits multiplied by `scale` [-]."""
        scale = positive("force scale", scale)
        scaled = self.actuator.scaled(scale)
        return dataclasses.replace(self, actuator=scaled, scales=self.scales)

    def replaced(self, numbers: Mapping[str, float]) -> Scenario:
        """Return the scenario with other numbers, by their dotted paths.

        Raises
        ------
        ValueError
            If there is no such number; the message gives the nearest one.
        """
        index = tree.paths(self.numbers)
        return _replaced(
            self, {known("number of the scenario", each, index): numbers[each] for each in numbers}
        )

    def extremes(self) -> Iterator[Scenario]:
        """Yield the episodes at the ends of what is drawn.

        They are all combinations of ends where there are at most `MOST_CORNERS` of them, and
        otherwise each number alone and all together.

        Raises
        ------
        ValueError
            If one of them is no scenario; the message says with which numbers.
        """
        ends = [each.by.ends for each in self.randomisation]
        if math.prod(map(len, ends)) <= MOST_CORNERS:
            corners = [tuple(enumerate(each)) for each in itertools.product(*ends) if each]
        else:
            corners = [((which, end),) for which, row in enumerate(ends) for end in row]
            corners += [tuple(enumerate(pick(row) for row in ends)) for pick in (min, max)]
        for values in corners:
            varied = tuple(
                dataclasses.replace(self.randomisation[which], by=Choice(values=(end,)))
                for which, end in values
            )
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # the nominal scenario has been warned of
                    found = self._changed(varied, np.zeros(len(varied)))
            except ValueError as error:
                given = ", ".join(
                    f"{', '.join(self.randomisation[which].numbers)} by {end:g}"
                    for which, end in values
                )
                raise ValueError(
                    f"every drawn number must make a scenario, but not {given}: {error}; narrow "
                    "the distribution"
                ) from None
            yield found

    def drawn(self, uniforms: ArrayLike) -> Scenario:
        """Return the scenario of one episode, which no longer varies.

        Parameters
        ----------
        uniforms : array_like
            A number from [0, 1) for each entry of `randomisation`.
        """
        if not self.randomisation:
            return self
        return self._changed(self.randomisation, np.asarray(uniforms, dtype=np.float64))

    def _changed(self, varied: tuple[Vary, ...], uniforms: NDArray[np.float64]) -> Scenario:
        """Return the scenario with numbers changed by what is drawn, and nothing left to draw."""
        index = tree.paths(self.numbers)
        draws, targets = arrays(varied, index)
        row = np.array(tree.flat(self.numbers))
        vary(row, uniforms, draws, targets)
        changed = {path for each in varied for path in each.numbers}
        numbers = {path: float(row[index[path]]) for path in changed}
        return _replaced(self, numbers, randomisation=())


def _checked_sensors(given: Any) -> tuple[Sensor, ...]:
    sensors = (given,) if isinstance(given, Sensor) else tuple(given or ())
    for each in sensors:
        instance("sensor", each, Sensor)
    names = [each.signal for each in sensors]
    if len(set(names)) != len(names):
        raise ValueError(
            f"sensors must read different signals, got {', '.join(names)}; give one for each"
        )
    return sensors


def _replaced(part: Any, numbers: Mapping[str, float], **fields: Any) -> Any:
    """Return `part`, a record, a tuple or a number, with numbers replaced by their dotted paths.

    Other fields of a record are replaced by name.
    """
    if "" in numbers:
        return numbers[""]
    inner: dict[str, dict[str, float]] = {}
    for path, value in numbers.items():
        name, _, rest = path.partition(".")
        inner.setdefault(name, {})[rest] = value
    if isinstance(part, tuple):
        each: list[Any] = list(part)  # pyright: ignore[reportUnknownArgumentType]
        return tuple(
            _replaced(x, inner[str(i)]) if str(i) in inner else x for i, x in enumerate(each)
        )
    for name in inner:
        if name not in {each.name for each in dataclasses.fields(part)}:
            raise ValueError(
                f"{name} of {type(part).__name__} is made from its other numbers and cannot be "
                "set; make the part anew"
            )
    changes = {name: _replaced(getattr(part, name), given) for name, given in inner.items()}
    return dataclasses.replace(part, **changes, **fields)


def check_step(scenario: Scenario) -> None:
    """Refuse an RK4 step that diverges on the uncontrolled car, warn of a coarse one.

    Raises
    ------
    ValueError
        If ``step * |lambda|max`` of the car about its rest exceeds the stability limit of RK4.

    Warns
    -----
    UserWarning
        If it exceeds the accuracy limit.
    """
    step = scenario.dt / scenario.substeps
    fastest = float(np.max(np.abs(np.linalg.eigvals(jacobian(scenario.car)))))
    lag = getattr(scenario.actuator, "lag", None)
    fastest = max(fastest, 0.0 if lag is None else 1.0 / lag)
    product = step * fastest
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
            stacklevel=4,
        )
