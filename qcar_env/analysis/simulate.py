"""The closed loop in continuous time: the law acts inside the Runge-Kutta stages.

These are the paper's experiments: the law sees the state at every instant, its filter is
integrated together with the plant, and amplitudes are read when the motion has become steady.
A policy that acts every `dt` through the environment is another thing (see `qcar_env.envs`).

Many cases run in one compiled call. Each of `car`, `road`, `force`, `law` and `start` is one object
for all cases or a sequence with one for each:

>>> from qcar_env.control import CNVC
>>> from qcar_env.scenarios import PAPER_CAR, PAPER_FORCE
>>> from qcar_env.roads.excitation import harmonic
>>> road = harmonic(h=0.1, omega=55.0)
>>> laws = [CNVC(G1=G, G2=G) for G in (0.5, 1.2)]
>>> steady = steady_amplitudes(PAPER_CAR, road, PAPER_FORCE, laws)
>>> steady.x2.round(4).tolist()  # [m], body
[0.0732, 0.0547]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.cases import (
    MOST_STEPS,
    Cases,
    has_diverged,
    refuse_divergence,
    whole_steps,
)
from qcar_env.control.law import ControlledState, Law
from qcar_env.parts.actuator import SuspensionActuator
from qcar_env.physics.car import Car
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.state import State
from qcar_env.roads.excitation import Excitation
from qcar_env.validation import known, positive, whole

Array = NDArray[np.float64]
Start = State | ControlledState
OnDivergence = Literal["raise", "keep"]

MOST_RECORDED = 2**32  # [bytes] largest time history, chosen here


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
    car: Car | Sequence[Car],
    road: Excitation | Sequence[Excitation],
    force: ExternalForce | Sequence[ExternalForce],
    law: Law | Sequence[Law],
    *,
    duration: float,
    step: float = 1e-3,
    start: Start | Sequence[Start] | None = None,
    force_limit: Sequence[float] | Sequence[Sequence[float]] | None = None,
    actuator: SuspensionActuator | None = None,
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
    actuator : SuspensionActuator, optional
        One actuator between the masses instead, with its own limit [N]: it gives
        ``F = m2 u2 - m1 u1``, what the law asks for both masses, to the body and ``-F`` to the
        wheel. The car needs masses.
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
    cases = Cases(car, road, force, law, start, force_limit, actuator, hold)
    duration, step = positive("duration", duration, "s"), positive("step", step, "s")
    steps = whole_steps("duration", duration, step)
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
    found = cases.run(step, steps, every=every, fused=fused)
    diverged = has_diverged(found.final)  # the record may end before the motion does
    if on_divergence == "raise":
        refuse_divergence(diverged, duration)
    t = np.arange(count, dtype=np.float64) * every * step
    shape = (count, cases.n) if cases.many else (count,)
    columns = (np.ascontiguousarray(found.record[:, i]).reshape(shape) for i in range(6))
    x1, x2, v1, v2, u1, u2 = columns
    return Simulation(
        t=t, x1=x1, x2=x2, v1=v1, v2=v2, u1=u1, u2=u2, diverged=cases.shaped(diverged)
    )


def steady_amplitudes(
    car: Car | Sequence[Car],
    road: Excitation | Sequence[Excitation],
    force: ExternalForce | Sequence[ExternalForce],
    law: Law | Sequence[Law],
    *,
    duration: float = 60.0,
    step: float = 1e-3,
    periods: int = 5,
    start: Start | Sequence[Start] | None = None,
    force_limit: Sequence[float] | Sequence[Sequence[float]] | None = None,
    actuator: SuspensionActuator | None = None,
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
    car, road, force, law, step, start, force_limit, actuator, hold, fused, on_divergence
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
    cases = Cases(car, road, force, law, start, force_limit, actuator, hold)
    duration, step = positive("duration", duration, "s"), positive("step", step, "s")
    steps = whole_steps("duration", duration, step)
    known("on_divergence", on_divergence, ("raise", "keep"))
    measured = np.round(whole("periods", periods, most=MOST_STEPS) * cases.periods / step)
    if measured.max() > steps:
        raise ValueError(
            f"{periods} periods last {measured.max() * step:.3g} s and must end within the "
            f"duration, got {duration:g} s; give a longer duration or fewer periods"
        )
    cases.check_step(step)
    found = cases.run(step, steps, window=steps - measured + 1.0, every=0, fused=fused)
    diverged = has_diverged(found.final)
    if on_divergence == "raise":
        refuse_divergence(diverged, duration)
    values = np.concatenate([found.peaks, np.sqrt(found.squares / measured)])
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
