"""A quarter car under harmonic road and harmonic force of one frequency, with a law around it.

Averaging, harmonic balance, shooting and parameter studies all start from a `ForcedCar`; its
parameters are changed by the paper's names, among them the detunings of (19)

    omega1 = omega + sigma1        omega2 = Omega + sigma2        omega = Omega

The paper needs ``omega = Omega`` for its periodic solutions without saying so; here there is one
frequency `omega` for road and force.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.control.law import Law, check_law
from qcar_env.control.passive import Passive
from qcar_env.parts.part import numbers_class, units
from qcar_env.physics import tree
from qcar_env.physics.car import PAPER_FUNCTIONS, REST, PaperCar
from qcar_env.physics.closed_loop import (
    ControlledState,
    LawFunctions,
    LoopNumbers,
    loop_functions,
)
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Input
from qcar_env.roads.excitation import Excitation, harmonic
from qcar_env.scenarios import Scenario
from qcar_env.validation import finite, finite_array, instance, known, positive, store

Array = NDArray[np.float64]

CAR_PARAMETERS = tuple(units(PaperCar))
ALL_FREQUENCIES = "frequencies"  # omega, omega1 and omega2 moved together, detunings kept
PARAMETER_UNITS = {
    **units(PaperCar),
    "h": "m",
    "f": "m/s^2",
    "omega": "rad/s",
    ALL_FREQUENCIES: "rad/s",
    "sigma1": "rad/s",
    "sigma2": "rad/s",
}


@dataclass(frozen=True, kw_only=True)
class ForcedCar:
    """One car on the paper's road, under the paper's force, with one law.

    Parameters
    ----------
    car : PaperCar
        The plant.
    h : float
        Height of the road ``y = h sin(omega t)`` [m].
    f : float
        Amplitude of the specific force ``F = f cos(omega t)`` on the body [m/s^2].
    omega : float
        Frequency of both [rad/s]; positive.
    law : Law, optional
        The control law; none by default.

    Raises
    ------
    ValueError
        If a value is not finite or out of range, or if the law is known to destabilise the car.
    """

    car: PaperCar
    h: float
    f: float
    omega: float
    law: Law = Passive()

    def __post_init__(self) -> None:
        """Check every argument."""
        instance("car", self.car, PaperCar)
        check_law(self.law)
        store(
            self,
            h=finite("h", self.h, "m"),
            f=finite("f", self.f, "m/s^2"),
            omega=positive("omega", self.omega, "rad/s"),
        )
        self.law.check(self.car)

    @property
    def sigma1(self) -> float:
        """Detuning of the wheel, ``omega1 - omega`` [rad/s]."""
        return self.car.omega1 - self.omega

    @property
    def sigma2(self) -> float:
        """Detuning of the body, ``omega2 - omega`` [rad/s]."""
        return self.car.omega2 - self.omega

    @property
    def road(self) -> Excitation:
        """The road."""
        return harmonic(h=self.h, omega=self.omega)

    @property
    def force(self) -> ExternalForce:
        """The external force."""
        return ExternalForce(f=self.f, Omega=self.omega)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names that `vary` and `value` know, those of the law's gains included."""
        return (*PARAMETER_UNITS, *self._shared_gains, *self._gains)

    def value(self, name: str) -> float:
        """Return a parameter by name (see `vary`)."""
        known("parameter", name, self.parameters)
        if name in CAR_PARAMETERS:
            return float(getattr(self.car, name))
        if name == ALL_FREQUENCIES:
            return self.omega
        if name in self._gains:
            return float(getattr(self.law, name))
        if name in self._shared_gains:
            return float(getattr(self.law, f"{name}1"))
        return float(getattr(self, name))

    def vary(self, name: str, value: float) -> ForcedCar:
        """Return this car with one parameter changed.

        Parameters
        ----------
        name : str
            A coefficient of the car (`omega1` ... `mu2`), `h`, `f`, `omega` (of road and force,
            the car's own frequencies stay), `sigma1` or `sigma2` (moves `omega1` or `omega2`),
            `frequencies` (moves `omega`, `omega1` and `omega2`, keeps the detunings), a gain of
            the law by its own name (`G1`, `zeta2`, ...), or that name without its number to set
            both masses' gains (`G`).
        value : float
            The new value, in the parameter's unit.

        Returns
        -------
        ForcedCar

        Raises
        ------
        ValueError
            If the name is unknown or the value is out of range; a detuning that brings a natural
            frequency to zero or below is named as such.
        """
        known("parameter", name, self.parameters)
        if name in CAR_PARAMETERS:
            return dataclasses.replace(self, car=dataclasses.replace(self.car, **{name: value}))
        if name in ("sigma1", "sigma2"):
            natural = f"omega{name[-1]}"
            if self.omega + finite(name, value, "rad/s") <= 0.0:
                raise ValueError(
                    f"{name} must be above -omega = {-self.omega:g} rad/s, got {value:g} rad/s: "
                    f"{natural} = omega + {name} would not be positive; give a narrower range"
                )
            return self.vary(natural, self.omega + value)
        if name == ALL_FREQUENCIES:
            at = positive(name, value, "rad/s")
            moved = dataclasses.replace(self.car, omega1=at + self.sigma1, omega2=at + self.sigma2)
            return dataclasses.replace(self, car=moved, omega=at)
        if name in self._gains:
            return dataclasses.replace(self, law=_with_gains(self.law, {name: value}))
        if name in self._shared_gains:
            both = {f"{name}1": value, f"{name}2": value}
            return dataclasses.replace(self, law=_with_gains(self.law, both))
        return dataclasses.replace(self, **{name: value})

    @property
    def _gains(self) -> tuple[str, ...]:
        return tuple(each.name for each in dataclasses.fields(self.law))

    @property
    def _shared_gains(self) -> tuple[str, ...]:
        names = self._gains
        return tuple(n[:-1] for n in names if n.endswith("1") and f"{n[:-1]}2" in names)


def from_scenario(scenario: Scenario, law: Law | None = None) -> ForcedCar:
    """Return a scenario's car on its harmonic road, with a law (none by default).

    Raises
    ------
    ValueError
        If the car is none of the paper's, the road is not harmonic, or the external force has
        another frequency.
    """
    road, force, car = scenario.excitation, scenario.force, scenario.car
    if not isinstance(car, PaperCar):
        raise ValueError(
            f"the averaged equations are those of a PaperCar, got a {type(car).__name__} in "
            f"scenario {scenario.name!r}; simulate it instead, or give PaperCar.from_physical"
        )
    if not road.harmonic:
        raise ValueError(
            f"frequency response needs a harmonic road, got a {type(road.road).__name__} in "
            f"scenario {scenario.name!r}; choose one with an endless harmonic hump, such as 'paper'"
        )
    if force.f != 0.0 and force.Omega != road.omega:
        raise ValueError(
            f"the averaged equations need omega = Omega, got omega = {road.omega:g} and "
            f"Omega = {force.Omega:g} rad/s in scenario {scenario.name!r}; simulate it instead"
        )
    return ForcedCar(
        car=car,
        h=road.h,
        f=force.f,
        omega=road.omega,
        law=Passive() if law is None else law,
    )


class Gains(NamedTuple):
    """The formula of a law with arrays of gains, one entry per car."""

    law: LawFunctions
    values: Any  # NamedTuple of arrays (n,), see `qcar_env.control.law.Law.numbers`


@dataclass(frozen=True, kw_only=True)
class ForcedCars:
    """Many forced cars with one kind of law, as arrays (n,): what the vectorised solvers take.

    Make it with `stack`. It is a periodically forced first-order system: `dimension` states,
    `omega`, and `rate`.
    """

    car: Any  # the numbers of a PaperCar, entries (n,)
    h: Array  # (n,) [m]
    f: Array  # (n,) [m/s^2]
    omega: Array  # (n,) [rad/s]
    law: Law  # one of the laws, for its kind; its gains are in `gains`
    gains: Gains  # the law's formula and the gains of every car

    def __len__(self) -> int:
        """Return the number of cars."""
        return len(self.omega)

    @property
    def dimension(self) -> int:
        """Number of states of one car: four, and those of the law's filter."""
        return len(tree.flat((REST, self.law.at_rest)))

    @property
    def scale(self) -> Array:
        """Size of each state over that of a displacement [-, or 1/s for rates], (dimension, n)."""
        one = np.ones_like(self.omega)
        return np.array([one, one, self.omega, self.omega] * (self.dimension // 4))

    def rate(self, state: Array, phase: Array) -> Array:
        """Return the time derivative of the states.

        Parameters
        ----------
        state : ndarray (dimension, n, k)
            ``x1, x2, v1, v2`` and the law's filter, if it has one: ``eta1, eta2, eta1', eta2'``.
        phase : ndarray (k,) or (n, k)
            ``omega t`` [rad].

        Returns
        -------
        ndarray (dimension, n, k)
        """
        car = self.car._make(c[:, None] for c in self.car)
        gains = self.gains.values._make(g[:, None] for g in self.gains.values)
        h, f, omega = self.h[:, None], self.f[:, None], self.omega[:, None]
        sine, cosine = np.sin(phase), np.cos(phase)
        on_road = PAPER_FUNCTIONS.road_input(h * sine, h * omega * cosine, car)
        x = tree.unflat(ControlledState(REST, self.law.at_rest), state)
        loop = loop_functions(PAPER_FUNCTIONS, self.gains.law)
        found = loop.rate(x, Input(on_road, f * cosine), None, LoopNumbers(car, gains))
        return np.array(tree.flat(found))

    def select(self, index: ArrayLike) -> ForcedCars:
        """Return the cars at `index` (anything that indexes an array, repeats allowed)."""
        pick = np.asarray(index)
        return ForcedCars(
            car=self.car._make(c[pick] for c in self.car),
            h=self.h[pick],
            f=self.f[pick],
            omega=self.omega[pick],
            law=self.law,
            gains=self.gains._replace(
                values=self.gains.values._make(g[pick] for g in self.gains.values)
            ),
        )


def stack(cars: Sequence[ForcedCar]) -> ForcedCars:
    """Return cars as arrays.

    Parameters
    ----------
    cars : sequence of ForcedCar
        At least one; all with the same kind of law.

    Raises
    ------
    ValueError
        If there is none, or if the kinds of law differ.
    """
    if not cars:
        raise ValueError("no car to stack, got an empty sequence; give at least one")
    kinds = {type(each.law).__name__ for each in cars}
    if len(kinds) > 1:
        raise ValueError(
            f"cars stacked together must have one kind of law, got {', '.join(sorted(kinds))}; "
            "stack each kind by itself"
        )
    law = cars[0].law
    all_gains = [each.law.numbers for each in cars]
    kind: Any = type(all_gains[0])
    columns = np.array([[float(g) for g in each] for each in all_gains]).T
    coefficients = np.array([each.car.numbers for each in cars], dtype=float).T
    return ForcedCars(
        car=numbers_class(PaperCar)(*coefficients),
        h=np.array([each.h for each in cars], dtype=float),
        f=np.array([each.f for each in cars], dtype=float),
        omega=np.array([each.omega for each in cars], dtype=float),
        law=law,
        gains=Gains(law.functions, kind(*columns)),
    )


def sweep(car: ForcedCar, name: str, values: ArrayLike) -> Iterator[ForcedCar]:
    """Yield `car` with parameter `name` at each of `values`, array (n,) (see `ForcedCar.vary`)."""
    for value in finite_array(f"values of {name}", values).ravel():
        yield car.vary(name, float(value))


def _with_gains(law: Any, gains: dict[str, float]) -> Law:
    return dataclasses.replace(law, **gains)
