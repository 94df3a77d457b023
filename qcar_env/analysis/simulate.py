"""The closed loop in continuous time: the law acts inside the Runge-Kutta stages.

These are the paper's experiments: the law sees the state at every instant, its filter is
integrated together with the plant, and amplitudes are read when the motion has become steady.
A policy that acts every `dt` through the environment is another thing (see `qcar_env.envs`).

Many cases run in one compiled call. Each of `car`, `road`, `force`, `law` and `start` is one object
for all cases or a sequence with one for each:

>>> from qcar_env.control import CNVC
>>> from qcar_env.scenarios import PAPER_CAR, PAPER_FORCE
>>> from qcar_env.physics.roads import harmonic
>>> road = harmonic(h=0.1, omega=55.0)
>>> laws = [CNVC(G1=G, G2=G) for G in (0.5, 1.2)]
>>> steady = steady_amplitudes(PAPER_CAR, road, PAPER_FORCE, laws)
>>> steady.x2.round(4).tolist()  # [m], body
[0.0732, 0.0547]
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from numbers import Real
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.law import REST, ControlledState, Law, check_law
from qcar_env.physics import closed_loop, engine, engine_continuous
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.dynamics import Coefficients, Forcing
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import plant, world_at
from qcar_env.physics.rk4 import ACCURACY_LIMIT, STABILITY_LIMIT, step_fractions
from qcar_env.physics.roads import Road
from qcar_env.physics.state import Filter, State
from qcar_env.validation import entries, finite, instance, known, positive, shown, whole

Array = NDArray[np.float64]
Start = State | ControlledState
OnDivergence = Literal["raise", "keep"]

MOST_RECORDED = 2**32  # [bytes] largest time history, chosen here
MOST_STEPS = 10**10  # of one call, chosen here: minutes of a compiled case, months of driving
DIVERGED = 1e6  # [m], [m/s] a car that moves by more has diverged, chosen here
UNLIMITED = (closed_loop.UNLIMITED, closed_loop.UNLIMITED)
AT_REST = ControlledState(State(0.0, 0.0, 0.0, 0.0), REST)


@dataclass(frozen=True, kw_only=True)
class Simulation:
    """Time histories of closed loops: arrays (k,) of one case, or (k, n) of a sequence of n."""

    t: Array  # time, always (k,) [s]
    x1: Array  # wheel displacement [m]
    x2: Array  # body displacement [m]
    v1: Array  # wheel velocity [m/s]
    v2: Array  # body velocity [m/s]
    u1: Array  # specific actuator force on the wheel [m/s^2]
    u2: Array  # specific actuator force on the body [m/s^2]
    diverged: NDArray[np.bool_]  # whether the case left all bounds, shape () or (n,)


@dataclass(frozen=True, kw_only=True)
class Steady:
    """What closed loops do over their last whole periods: shape () of one case, (n,) of n."""

    x1: Array  # amplitude of the wheel, max |x1| [m]
    x2: Array  # amplitude of the body, max |x2| [m]
    peak_u1: Array  # largest specific force on the wheel [m/s^2]
    peak_u2: Array  # largest specific force on the body [m/s^2]
    rms_u1: Array  # root mean square of the specific force on the wheel [m/s^2]
    rms_u2: Array  # root mean square of the specific force on the body [m/s^2]
    diverged: NDArray[np.bool_]  # whether the case left all bounds


def simulate(
    car: QuarterCar | Sequence[QuarterCar],
    road: Road | Sequence[Road],
    force: ExternalForce | Sequence[ExternalForce],
    law: Law | Sequence[Law],
    *,
    duration: float,
    step: float = 1e-3,
    start: Start | Sequence[Start] | None = None,
    force_limit: Sequence[float] | Sequence[Sequence[float]] | None = None,
    hold: float | None = None,
    fused: bool = False,
    record_every: int = 1,
    on_divergence: OnDivergence = "raise",
) -> Simulation:
    """Integrate closed loops from time 0 and return their time histories.

    Parameters
    ----------
    car, road, force, law
        Plant, road, external force and control law; each one object, or a sequence with one for
        each of n cases. The laws of a sequence are of one class, with their own gains.
    duration : float
        End of the time histories [s], rounded to whole steps.
    step : float, optional
        RK4 step [s]. The step that holds a kink of the road is cut there.
    start : State or ControlledState, or a sequence of them, optional
        State of the plant, or of plant and control filter, at time 0; at rest if left out. Four
        numbers ``(x1, x2, v1, v2)`` are a state, too.
    force_limit : sequence of float, optional
        Largest specific forces ``(u1, u2)`` of the actuators [m/s^2], or one pair for each case;
        no limit if left out.
    hold : float, optional
        Sample the law this often [s], a whole number of steps, and hold its forces in between, as
        a digital controller does; its filter goes on in between. If left out the law acts at
        every instant.
    fused : bool, optional
        Let the processor multiply and add in one operation, where it can: faster by 5 to 30 %,
        depending on the law, and different by rounding from the same loops in plain Python, which
        are met to the last bit otherwise.
    record_every : int, optional
        Steps from one instant of the time histories to the next.
    on_divergence : {"raise", "keep"}, optional
        What to do about a case whose motion grows beyond all bounds.

    Returns
    -------
    Simulation

    Raises
    ------
    ValueError
        If an argument is out of range, the sequences differ in length, a law is known to
        destabilise its car, or the step is too long for a closed loop at rest or at its start.
    FloatingPointError
        If a case diverges and `on_divergence` is ``"raise"``.

    Warns
    -----
    UserWarning
        If the step is coarse for the fastest mode of a closed loop at rest.

    Notes
    -----
    CNVC's local slope ``3 G v^2`` is 27 000 1/s where it is switched on at the uncontrolled
    velocities of the paper's worst case; such a start needs a step of 0.1 ms.
    """
    cases = _Cases(car, road, force, law, start, force_limit, hold)
    duration, step = positive("duration", duration, "s"), positive("step", step, "s")
    steps = _steps("duration", duration, step)
    every = min(whole("record_every", record_every), steps + 1)
    known("on_divergence", on_divergence, ("raise", "keep"))
    cases.check_step(step)
    count = steps // every + 1
    if count * 6 * cases.n * 8 > MOST_RECORDED:
        least = math.ceil(steps * 6 * cases.n * 8 / MOST_RECORDED)
        raise ValueError(
            f"{count} instants of {cases.n} cases are {count * 6 * cases.n * 8 / 2**30:.1f} GiB; "
            f"give record_every={least} or more, or use steady_amplitudes"
        )
    record = np.empty((count, 6, cases.n))
    slabs = engine.slabs(cases.rows(step, np.full(cases.n, float(engine.NEVER))))
    cases.run(slabs, step, steps, every, record, fused)
    # The record may end before the motion does.
    final = engine.from_slabs(slabs, cases.n)
    diverged = _has_diverged(final[engine_continuous.PLANT : engine_continuous.PLANT + 4])
    if on_divergence == "raise":
        _refuse_divergence(diverged, duration)
    t = np.arange(count, dtype=np.float64) * every * step
    shape = (count, cases.n) if cases.many else (count,)
    columns = (np.ascontiguousarray(record[:, i]).reshape(shape) for i in range(6))
    x1, x2, v1, v2, u1, u2 = columns
    return Simulation(
        t=t, x1=x1, x2=x2, v1=v1, v2=v2, u1=u1, u2=u2, diverged=cases.shaped(diverged)
    )


def steady_amplitudes(
    car: QuarterCar | Sequence[QuarterCar],
    road: Road | Sequence[Road],
    force: ExternalForce | Sequence[ExternalForce],
    law: Law | Sequence[Law],
    *,
    duration: float = 60.0,
    step: float = 1e-3,
    periods: int = 5,
    start: Start | Sequence[Start] | None = None,
    force_limit: Sequence[float] | Sequence[Sequence[float]] | None = None,
    hold: float | None = None,
    fused: bool = False,
    on_divergence: OnDivergence = "raise",
) -> Steady:
    """Integrate closed loops until they are steady and measure their last whole periods.

    Parameters
    ----------
    duration : float, optional
        Time that the motion has to become steady [s]. The paper's worst case without control
        needs 40 s: its slow mode decays with 0.21 1/s.
    periods : int, optional
        Number of periods that are measured at the end: of the harmonic road or of the external
        force, whichever is slower.
    car, road, force, law, step, start, force_limit, hold, fused, on_divergence
        As in `simulate`. A diverged case that is kept has infinite amplitudes and forces.

    Returns
    -------
    Steady

    Raises
    ------
    ValueError
        As `simulate`; if a case has no harmonic forcing, or the periods outlast `duration`.
    FloatingPointError, UserWarning
        As `simulate`.

    Notes
    -----
    Amplitudes are read at the steps: ``max |x|`` is low by at most ``(omega step / 2)^2 / 2``,
    4e-4 of it at 55 rad/s and 1 ms.
    """
    cases = _Cases(car, road, force, law, start, force_limit, hold)
    duration, step = positive("duration", duration, "s"), positive("step", step, "s")
    steps = _steps("duration", duration, step)
    known("on_divergence", on_divergence, ("raise", "keep"))
    measured = np.round(whole("periods", periods, most=MOST_STEPS) * cases.periods / step)
    if measured.max() > steps:
        raise ValueError(
            f"{periods} periods last {measured.max() * step:.3g} s and must end within the "
            f"duration, got {duration:g} s; give a longer duration or fewer periods"
        )
    cases.check_step(step)
    slabs = engine.slabs(cases.rows(step, steps - measured + 1.0))
    cases.run(slabs, step, steps, 0, np.empty((0, 6, cases.n)), fused)
    final = engine.from_slabs(slabs, cases.n)
    peaks = final[engine_continuous.PEAKS : engine_continuous.PEAKS + 4]
    squares = final[engine_continuous.SQUARES : engine_continuous.SQUARES + 2]
    diverged = _has_diverged(final[engine_continuous.PLANT : engine_continuous.PLANT + 4])
    if on_divergence == "raise":
        _refuse_divergence(diverged, duration)
    values = np.concatenate([peaks, np.sqrt(squares / measured)])
    x1, x2, peak_u1, peak_u2, rms_u1, rms_u2 = (
        cases.shaped(value) for value in np.where(diverged, np.inf, values)
    )
    return Steady(
        x1=x1,
        x2=x2,
        peak_u1=peak_u1,
        peak_u2=peak_u2,
        rms_u1=rms_u1,
        rms_u2=rms_u2,
        diverged=cases.shaped(diverged),
    )


class _Cases:
    """The n cases of a call, checked and brought to one form."""

    def __init__(
        self,
        car: QuarterCar | Sequence[QuarterCar],
        road: Road | Sequence[Road],
        force: ExternalForce | Sequence[ExternalForce],
        law: Law | Sequence[Law],
        start: Start | Sequence[Start] | None,
        force_limit: Sequence[float] | Sequence[Sequence[float]] | None,
        hold: float | None,
    ) -> None:
        given: dict[str, Any] = {"car": car, "road": road, "force": force, "law": law}
        given["start"] = AT_REST if start is None else start
        given["force_limit"] = UNLIMITED if force_limit is None else force_limit
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
        self.cars: list[QuarterCar] = self._listed(given["car"])
        self.roads: list[Road] = self._listed(given["road"])
        self.forces: list[ExternalForce] = self._listed(given["force"])
        self.laws: list[Law] = self._listed(given["law"])
        for name, kind, listed in (
            ("car", QuarterCar, self.cars),
            ("road", Road, self.roads),
            ("force", ExternalForce, self.forces),
        ):
            for each in listed:
                instance(name, each, kind)
        for each in self.laws:
            check_law(each)
        self.starts = [_checked_start(each) for each in self._listed(given["start"])]
        self.limits = [_checked_limit(each) for each in self._listed(given["force_limit"])]
        self.saturated = force_limit is not None
        self.hold = None if hold is None else positive("hold", hold, "s")
        kinds = sorted({type(each).__name__ for each in self.laws})
        if len(kinds) != 1:
            raise ValueError(
                f"the laws of one call must be of one class, got {', '.join(kinds)}; "
                "make one call for each"
            )
        for each_law, each_car in set(zip(self.laws, self.cars, strict=True)):
            each_law.check(each_car)

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
            frequencies = [road.omega] if road.profile == "harmonic" else []
            if force.f != 0.0 and force.Omega > 0.0:
                frequencies.append(force.Omega)
            if not frequencies:
                raise ValueError(
                    f"a steady motion needs a harmonic road or force, got a {road.profile!r} road "
                    "and no force; use simulate for a single crossing"
                )
            found[i] = 2.0 * math.pi / min(frequencies)
        return found

    def rows(self, step: float, window: Array) -> Array:
        """Return the quantities of `qcar_env.physics.engine_continuous`, shape (rows, n)."""
        rows = np.zeros((engine_continuous.ROWS, self.n))
        worlds = _once(lambda road, force: _flat(world_at(0.0, road, force)))
        plants = _once(lambda car, road, force: plant(car, road, force, step))
        gains = _once(lambda law: tuple(law.gains))
        for i in range(self.n):
            road, force = self.roads[i], self.forces[i]
            one = plants(self.cars[i], road, force)
            chosen = gains(self.laws[i])
            column = (
                *_flat(self.starts[i]),
                *worlds(road, force),
                *_flat(one.passage.by),
                *one.passage.middle,
                *one.car,
                *one.amplitudes,
                *self.limits[i],
                *one.road,
                road.next_kink(0.0),
                one.Omega,
            )
            rows[: engine_continuous.WINDOW, i] = column
            rows[engine_continuous.GAINS : engine_continuous.GAINS + len(chosen), i] = chosen
        rows[engine_continuous.WINDOW] = window
        return rows

    def run(
        self, slabs: Array, step: float, steps: int, every: int, record: Array, fused: bool
    ) -> None:
        """Integrate all cases, on several threads if there is enough to do."""
        law = self.laws[0]
        kernel = engine_continuous.closed_loop_kernel(
            law.command,
            law.filter_rate,
            type(law.gains),
            self.saturated,
            self.hold is not None,
            bool(fused),
        )
        hold = 1 if self.hold is None else _steps("hold", self.hold, step)
        if self.hold is not None and abs(hold * step / self.hold - 1.0) > 1e-9:
            raise ValueError(
                f"hold must be a whole number of steps of {step:g} s, got {self.hold:g} s; "
                f"give {hold * step:g} s or another step"
            )
        fractions = step_fractions(step)
        engine.over_blocks(
            lambda begin, end: kernel(
                slabs, begin, end, self.n, fractions, steps, hold, every, record
            ),
            blocks=slabs.shape[0],
            work=steps * self.n,
        )

    def check_step(self, step: float) -> None:
        """Refuse a step that diverges on a closed loop, warn of a coarse one."""
        at_rest = self._fastest([AT_REST] * self.n)
        at_start = self._fastest(self.starts) if set(self.starts) != {AT_REST} else at_rest
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
        law = self.laws[0]
        filter_rate = law.filter_rate or closed_loop.no_filter
        size = 4 if law.filter_rate is None else 8
        car = Coefficients(*np.array([each.coefficients for each in self.cars]).T)
        gains = cast("Callable[..., Any]", type(law.gains))(
            *np.array([tuple(each.gains) for each in self.laws]).T
        )
        limits = closed_loop.Limits(*np.array(self.limits).T)
        about = np.array([_flat(each) for each in states]).T
        still = Forcing(0.0, 0.0)

        def rates(values: Array) -> Array:
            x = ControlledState(State(*values[:4]), Filter(*values[4:]))
            found = closed_loop.saturated_rate(
                x, still, law.command, filter_rate, gains, limits, car
            )
            return np.array([np.broadcast_to(each, self.n) for each in _flat(found)])

        jacobian = np.empty((self.n, size, size))
        for i in range(size):
            change = 1e-5 * np.maximum(1.0, np.abs(about[i]))  # cubic laws: error 1e-10 of G
            aside = np.zeros_like(about)
            aside[i] = change
            slope = (rates(about + aside) - rates(about - aside)) / (2.0 * change)
            jacobian[:, :, i] = slope[:size].T
        return np.abs(np.linalg.eigvals(jacobian)).max(axis=1)


def _is_one(value: Any) -> bool:
    """Return whether `value` is one object for all cases, not a sequence with one for each."""
    if hasattr(value, "_fields") or getattr(value, "ndim", 1) == 0:
        return True
    if isinstance(value, (Sequence, np.ndarray)):
        return any(isinstance(each, Real) for each in entries(value)[:1])
    return True


def _flat(values: Any) -> tuple[Any, ...]:
    """Return the entries of a named tuple of named tuples, one after the other."""
    return tuple(entry for part in values for entry in part)


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    return lru_cache(maxsize=None)(function)


def _steps(name: str, length: float, step: float) -> int:
    """Return how many whole steps are nearest to a length of time, at least one."""
    if length / step > MOST_STEPS:
        raise ValueError(
            f"{name} must be at most {MOST_STEPS:.0e} steps, got {length:g} s with step = "
            f"{step:g} s; give a shorter {name} or a longer step"
        )
    return max(1, round(length / step))


def _checked_start(start: Any) -> ControlledState:
    state, memory = start if isinstance(start, ControlledState) else (start, REST)
    given = entries(state), entries(memory)
    if [len(part) for part in given] != [4, 4]:
        raise ValueError(
            f"start must be a State of four numbers or a ControlledState, got {shown(start)}; "
            "give State(x1, x2, v1, v2) in m and m/s"
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
        Filter(
            *(
                finite(f"start {name}", value)
                for name, value in zip(Filter._fields, given[1], strict=True)
            )
        ),
    )


def _checked_limit(limit: Any) -> tuple[float, float]:
    given = entries(limit)
    if len(given) != 2:
        raise ValueError(
            f"force_limit must be a pair (u1, u2) in m/s^2, got {shown(limit)}; "
            "give one pair, or one for each case"
        )
    return positive("force_limit u1", given[0], "m/s^2"), positive(
        "force_limit u2", given[1], "m/s^2"
    )


def _has_diverged(x: Array) -> NDArray[np.bool_]:
    return np.logical_not(np.all(np.abs(x) <= DIVERGED, axis=0, keepdims=True))[0]


def _refuse_divergence(diverged: NDArray[np.bool_], duration: float) -> None:
    if diverged.any():
        cases = np.flatnonzero(diverged)
        raise FloatingPointError(
            f"{cases.size} of {diverged.size} cases diverged within {duration:g} s (the first is "
            f"case {cases[0]}): the closed loop is unstable or the step too long; change gains, "
            "car or step, or give on_divergence='keep'"
        )
