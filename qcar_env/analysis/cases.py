"""The cases of one call of `qcar_env.analysis.simulate`: checked, brought to one form, and run."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.law import ControlledState, Law, check_law
from qcar_env.engine.closed_loop import Case, Drive, Outcome, drive, run
from qcar_env.engine.course import road_functions
from qcar_env.engine.loop_kernels import NEVER, Composition, loop_road
from qcar_env.engine.starts import Force
from qcar_env.parts.actuator import SuspensionActuator
from qcar_env.parts.part import Nothing
from qcar_env.physics import tree
from qcar_env.physics.car import REST, Car
from qcar_env.physics.closed_loop import Limits, LoopNumbers, loop_functions
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Input
from qcar_env.physics.rk4 import ACCURACY_LIMIT, STABILITY_LIMIT
from qcar_env.physics.state import State
from qcar_env.roads.excitation import Excitation
from qcar_env.validation import entries, finite, instance, positive, shown

Array = NDArray[np.float64]

MOST_STEPS = 10**10  # of one call, chosen here: minutes of a compiled case, months of driving
DIVERGED = 1e6  # [m], [m/s] a car that moves by more has diverged, chosen here


class Cases:
    """The n cases of a call (arguments: `qcar_env.analysis.simulate.simulate`)."""

    def __init__(
        self,
        car: Any,
        road: Any,
        force: Any,
        law: Any,
        start: Any,
        force_limit: Any,
        actuator: SuspensionActuator | None,
        hold: float | None,
    ) -> None:
        given: dict[str, Any] = {"car": car, "road": road, "force": force, "law": law}
        given["start"] = REST if start is None else start
        given["force_limit"] = Limits() if force_limit is None else force_limit
        sequences = {name: each for name, each in given.items() if not _is_one(each)}
        self.many = bool(sequences)
        self.n = len(next(iter(sequences.values()))) if self.many else 1
        for name, each in sequences.items():
            if len(each) != self.n or self.n == 0:
                lengths = ", ".join(f"{len(one)} of {key}" for key, one in sequences.items())
                raise ValueError(
                    f"{name} must be one object or one for each case, got {lengths}; "
                    "give sequences of equal length"
                )
        self.cars: list[Car] = self._listed(given["car"])
        self.roads: list[Excitation] = self._listed(given["road"])
        self.forces: list[ExternalForce] = self._listed(given["force"])
        self.laws: list[Law] = self._listed(given["law"])
        for each in self.cars:
            check_car(each)
        for each in self.roads:
            instance("road", each, Excitation)
        for each in self.forces:
            instance("force", each, ExternalForce)
        for each in self.laws:
            check_law(each)
        kinds = sorted({type(each).__name__ for each in self.laws})
        if len(kinds) != 1:
            raise ValueError(
                f"the laws of one call must be of one class, got {', '.join(kinds)}; "
                "make one call for each"
            )
        rest = self.laws[0].at_rest
        self.at_rest = ControlledState(REST, rest)
        self.starts = [_checked_start(each, rest) for each in self._listed(given["start"])]
        limits = [_checked_limit(each) for each in self._listed(given["force_limit"])]
        self.actuator = None if actuator is None else self._checked_actuator(actuator, force_limit)
        if self.actuator is not None:
            limits = [self.actuator.numbers] * self.n
        elif force_limit is None:
            limits = [Nothing()] * self.n
        self.limits: list[Any] = limits
        self.hold = None if hold is None else positive("hold", hold, "s")
        for each_law, each_car in set(zip(self.laws, self.cars, strict=True)):
            each_law.check(each_car)

    def _checked_actuator(self, actuator: Any, force_limit: Any) -> SuspensionActuator:
        instance("actuator", actuator, SuspensionActuator)
        if force_limit is not None:
            raise ValueError(
                f"give force_limit or an actuator, which has its own limit, not both; got "
                f"force_limit = {shown(force_limit)}"
            )
        if not all(each.has_masses for each in self.cars):
            raise ValueError(
                "an actuator rated in newtons needs a car with masses, got a PaperCar; "
                "make the car with QuarterCar"
            )
        return actuator

    def _listed(self, value: Any) -> list[Any]:
        return [value] * self.n if _is_one(value) else list(value)

    def shaped(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return `values` (n,) as they are, or with shape () if the call had one case."""
        return values if self.many else values[0]

    @property
    def periods(self) -> Array:
        """Period of the slower harmonic forcing of each case [s], shape (n,)."""
        found = np.empty(self.n)
        for i, (road, force) in enumerate(zip(self.roads, self.forces, strict=True)):
            frequencies = [road.omega] if road.harmonic else []
            if force.f != 0.0 and force.Omega > 0.0:
                frequencies.append(force.Omega)
            if not frequencies:
                raise ValueError(
                    f"a steady motion needs a harmonic road or force, got {shown(road.road)} "
                    "and no force; use simulate for a single hump"
                )
            found[i] = 2.0 * math.pi / min(frequencies)
        return found

    def run(
        self, step: float, steps: int, *, window: Array | None = None, every: int, fused: bool
    ) -> Outcome:
        """Integrate all cases, those of one composition together.

        Parameters
        ----------
        step : float
            RK4 step [s].
        steps : int
            Number of steps.
        window : ndarray (n,), optional
            First step that is measured.
        every : int
            Steps from one record to the next; 0 for none.
        fused : bool
            See `qcar_env.engine.closed_loop.run`.
        """
        hold = 0 if self.hold is None else whole_steps("hold", self.hold, step)
        if self.hold is not None and abs(hold * step / self.hold - 1.0) > 1e-9:
            raise ValueError(
                f"hold must be a whole number of steps of {step:g} s, got {self.hold:g} s; "
                f"give {hold * step:g} s or another step"
            )
        groups, cases = self._prepared(step, window)
        parts = [
            run(
                what,
                [cases[i] for i in chosen],
                step=step,
                steps=steps,
                hold=hold,
                every=every,
                fused=fused,
            )
            for what, chosen in groups.items()
        ]
        if len(parts) == 1:
            return parts[0]
        found = Outcome(*(np.empty((*each.shape[:-1], self.n)) for each in parts[0]))
        for chosen, part in zip(groups.values(), parts, strict=True):
            for whole, each in zip(found, part, strict=True):
                whole[..., chosen] = each
        return found

    def _prepared(
        self, step: float, window: Array | None
    ) -> tuple[dict[Composition, list[int]], list[Case]]:
        """Return the cases, and which of them have one composition."""
        drives: dict[tuple[int, ...], Drive] = {}  # by identity: these objects outlive the call
        alike: dict[tuple[Any, ...], list[int]] = {}
        groups: dict[Composition, list[int]] = {}
        cases: list[Case] = []
        for i in range(self.n):
            car, road, force = self.cars[i], self.roads[i], self.forces[i]
            law = self.laws[i].numbers
            key = id(car), id(road), id(force)
            if key not in drives:
                drives[key] = _drive(car, road, force, step)
            one = drives[key]
            opened = float(NEVER) if window is None else float(window[i])
            cases.append(Case(one, self.starts[i], law, self.limits[i], opened))
            kind = *key, *_lengths(law)
            if kind not in alike:
                what = Composition(
                    car.functions,
                    loop_road(road_functions(type(road.road))),
                    self.laws[i].functions,
                    one.under(law, self.limits[i]),
                    None if self.actuator is None else type(self.actuator),
                )
                alike[kind] = groups.setdefault(what, [])
            alike[kind].append(i)
        return groups, cases

    def check_step(self, step: float) -> None:
        """Refuse a step that diverges on a closed loop, warn of a coarse one."""
        at_rest = self._fastest([self.at_rest] * self.n)
        starts = any(each != self.at_rest for each in self.starts)
        at_start = self._fastest(self.starts) if starts else at_rest
        for where, fastest in (("at rest", at_rest), ("at its start", at_start)):
            worst = int(np.argmax(fastest))
            product = step * fastest[worst]
            if product > STABILITY_LIMIT:
                raise ValueError(
                    f"step must be below {STABILITY_LIMIT / fastest[worst]:.2g} s for "
                    f"{self.laws[worst].name} {where}{self._label(worst)}, got {step:g} s "
                    f"(step * |lambda|max = {product:.3g}, RK4 is stable up to {STABILITY_LIMIT}); "
                    "give a smaller step or gain"
                )
        worst = int(np.argmax(at_rest))
        if step * at_rest[worst] > ACCURACY_LIMIT:
            warnings.warn(
                f"step {step:g} s is coarse for {self.laws[worst].name}{self._label(worst)}: "
                f"step * |lambda|max = {step * at_rest[worst]:.3g}; below "
                f"{ACCURACY_LIMIT / at_rest[worst]:.2g} s is accurate",
                UserWarning,
                stacklevel=3,
            )

    def _label(self, case: int) -> str:
        return f" (case {case})" if self.many else ""

    def _fastest(self, states: list[ControlledState]) -> Array:
        """Return the largest |eigenvalue| of each closed loop about a state [1/s], (n,)."""
        found = np.empty(self.n)
        groups: dict[Any, list[int]] = {}
        kinds: dict[int, Any] = {}  # by identity: these objects outlive the call
        for i, (car, law) in enumerate(zip(self.cars, self.laws, strict=True)):
            if id(car) not in kinds:
                kinds[id(car)] = car.functions, tuple(tree.paths(car.numbers))
            groups.setdefault((kinds[id(car)], _lengths(law.numbers)), []).append(i)
        for chosen in groups.values():
            found[chosen] = self._fastest_of(chosen, states)
        return found

    def _fastest_of(self, chosen: list[int], states: list[ControlledState]) -> Array:
        """Return the same of cases whose cars have the same functions.

        The slope is a difference, and the larger one where it jumps at the state.
        """
        functions, first = self.cars[chosen[0]].functions, chosen[0]
        kind = None if self.actuator is None else type(self.actuator)
        limited = isinstance(self.limits[first], Limits)
        law = self.laws[first].functions
        rate = loop_functions(functions, law, limited=limited, actuator=kind).rate
        of_car = {id(each): each.numbers for each in (self.cars[i] for i in chosen)}
        car = _columns([of_car[id(self.cars[i])] for i in chosen])
        ready = functions.prepare(car)
        limits = _columns([self.limits[i] for i in chosen])
        p = LoopNumbers(ready, _columns([self.laws[i].numbers for i in chosen]), limits)
        still = Input(functions.road_input(0.0, 0.0, ready), 0.0)
        about = np.array(tree.flat(_columns([states[i] for i in chosen])))
        size, n = about.shape

        def rates(values: Array) -> Array:
            x = tree.unflat(self.at_rest, values)
            return np.array(
                [np.broadcast_to(each, n) for each in tree.flat(rate(x, still, None, p))]
            )

        jacobians = np.empty((2, n, size, size))
        here = rates(about)
        for i in range(size):
            change = 1e-5 * np.maximum(1.0, np.abs(about[i]))  # cubic laws: error 1e-10 of G
            aside = np.zeros_like(about)
            aside[i] = change
            jacobians[0, :, :, i] = ((rates(about + aside) - here) / change).T
            jacobians[1, :, :, i] = ((here - rates(about - aside)) / change).T
        found = np.abs(np.linalg.eigvals(jacobians[0])).max(axis=1)
        apart = np.abs(jacobians[1] - jacobians[0]).max(axis=(1, 2))
        kinked = apart > 1e-3 * np.abs(jacobians[0]).max(axis=(1, 2))  # a smooth one: to 1e-5
        other = np.abs(np.linalg.eigvals(jacobians[1, kinked])).max(axis=1, initial=0.0)
        found[kinked] = np.maximum(found[kinked], other)
        return found


def check_car(car: Any) -> None:
    """Refuse what is no car."""
    if not hasattr(car, "functions") or isinstance(car, Law):
        raise ValueError(
            f"car must be a PaperCar or a QuarterCar, got {shown(car)}; give such an object"
        )


def whole_steps(name: str, length: float, step: float) -> int:
    """Return how many whole steps are nearest to a length of time, at least one."""
    if length / step > MOST_STEPS:
        raise ValueError(
            f"{name} must be at most {MOST_STEPS:.0e} steps, got {length:g} s with step = "
            f"{step:g} s; give a shorter {name} or a longer step"
        )
    return max(1, round(length / step))


def has_diverged(x: Array) -> NDArray[np.bool_]:
    """Return which of n motions with final states `x` (4, n) have left all bounds."""
    return np.logical_not(np.all(np.abs(x) <= DIVERGED, axis=0, keepdims=True))[0]


def refuse_divergence(diverged: NDArray[np.bool_], duration: float) -> None:
    """Refuse a call some of whose cases have diverged.

    Raises
    ------
    FloatingPointError
        If there is one.
    """
    if diverged.any():
        cases = np.flatnonzero(diverged)
        raise FloatingPointError(
            f"{cases.size} of {diverged.size} cases diverged within {duration:g} s (the first is "
            f"case {cases[0]}): the closed loop is unstable or the step too long; change gains, "
            "car or step, or give on_divergence='keep'"
        )


def _drive(car: Car, road: Excitation, force: ExternalForce, step: float) -> Drive:
    numbers = car.numbers, road.road.numbers, road.speed, Force(force.f, force.Omega)
    kind = road_functions(type(road.road))
    return drive(car.functions, kind, numbers, np.asarray(road.road.table, np.float64), step)


def _lengths(numbers: Any) -> tuple[int, ...]:
    """Return the lengths of the tables among the numbers of a law."""
    return tuple(len(tree.flat(each)) for each in numbers if isinstance(each, tuple))


def _columns(numbers: list[Any]) -> Any:
    """Return named tuples of numbers as one of arrays (n,)."""
    rows: dict[int, tuple[float, ...]] = {}
    for each in numbers:
        if id(each) not in rows:
            rows[id(each)] = tree.flat(each)
    return tree.unflat(numbers[0], np.array([rows[id(each)] for each in numbers]).T)


def _is_one(value: Any) -> bool:
    """Return whether `value` is one object for all cases, not a sequence with one for each."""
    if hasattr(value, "_fields") or getattr(value, "ndim", 1) == 0:
        return True
    if isinstance(value, (Sequence, np.ndarray)):
        return any(isinstance(each, Real) for each in entries(value)[:1])
    return True


def _checked_start(start: Any, rest: Any) -> ControlledState:
    state, memory = start if isinstance(start, ControlledState) else (start, rest)
    given = entries(state), tree.flat(memory)
    if len(given[0]) != len(REST) or not isinstance(memory, tuple):
        raise ValueError(
            f"start must be a State of four numbers or a ControlledState, got {shown(start)}; "
            "give State(x1, x2, v1, v2) in m and m/s"
        )
    if len(given[1]) != len(tree.flat(rest)):
        raise ValueError(
            f"the filter of start must be a {type(rest).__name__} of {len(tree.flat(rest))} "
            f"numbers, got {shown(memory)}; give that of the law, or a State for a filter at rest"
        )
    return ControlledState(
        State(
            *(
                finite(f"start {name}", value, unit)
                for name, value, unit in zip(
                    State._fields, given[0], ("m", "m", "m/s", "m/s"), strict=True
                )
            )
        ),
        tree.unflat(
            rest,
            [
                finite(f"start {name}", value)
                for name, value in zip(tree.paths(rest), given[1], strict=True)
            ],
        ),
    )


def _checked_limit(limit: Any) -> Limits:
    given = entries(limit)
    if len(given) != 2:
        raise ValueError(
            f"force_limit must be a pair (u1, u2) in m/s^2, got {shown(limit)}; "
            "give one pair, or one for each case"
        )
    return Limits(
        positive("force_limit u1", given[0], "m/s^2"), positive("force_limit u2", given[1], "m/s^2")
    )
