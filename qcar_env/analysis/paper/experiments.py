"""The experiments behind the paper's Figures 3 to 14, as numbers.

Each function computes what one figure shows, from a `ForcedCar` (the calibrated preset, or any
other); `qcar_env.plots.paper_figures` draws them. Time histories and points are simulations of
the full equations, curves are averaged motions with coefficients frozen at `omega`.

Source: Alluhydan et al., Mathematics 2024, 12(19), 3046, figure captions and section 5.2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.averaging import SlowMotion, slow_motion
from qcar_env.analysis.paper.fixed_points import FixedPoints, balanced_start, fixed_points
from qcar_env.analysis.paper.forced_car import ALL_FREQUENCIES, ForcedCar, stack, sweep
from qcar_env.analysis.paper.frequency_response import Response, response
from qcar_env.analysis.paper.parameter_study import Curve, response_curves
from qcar_env.analysis.simulate import Simulation, simulate, steady_amplitudes
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.control.law import Law
from qcar_env.physics.state import State
from qcar_env.roads.excitation import step as step_road
from qcar_env.validation import entries, finite, non_negative, positive, whole

Array = NDArray[np.float64]

SETTLED = 80.0  # [s] from rest to steady: the slow mode has decayed to exp(-0.2 * 80) = 1e-7
STEP = 5e-4  # [s] peaks read at the steps are low by (omega step / 2)^2 / 2 = 1e-4
DETUNING = 20.0  # [rad/s] half width of the response curves


# What section 5.2 says of each parameter, in the order of the panels of Figures 5 to 8.
# "+": the amplitude grows with it, "-": falls, "0": does not change, "": not stated in the text.
@dataclass(frozen=True, kw_only=True)
class Effects:
    """One of the paper's figures on parameter effects."""

    figure: int
    amplitude: str  # "a1" or "a2"
    against: str  # "sigma1" or "sigma2"
    claims: Mapping[str, str]  # parameter to claimed trend, in the order of the panels


EFFECTS: tuple[Effects, ...] = (
    Effects(
        figure=5,
        amplitude="a1",
        against="sigma1",
        claims={"f": "0", "h": "+", "G1": "-", "mu1": "+", "mu2": "+", "omega": "-", "omega1": "-"},
    ),
    Effects(
        figure=6,
        amplitude="a2",
        against="sigma1",
        claims={
            "f": "+", "h": "+", "G2": "-", "G1": "-", "mu1": "+", "mu2": "+", "b2": "+",
            "omega": "-", "omega2": "-",
        },
    ),
    Effects(
        figure=7,
        amplitude="a1",
        against="sigma2",
        claims={
            "h": "+", "f": "0", "G1": "-", "G2": "-", "mu1": "+", "mu2": "+", "b1": "-",
            "b2": "", "E1": "-", "E2": "+", "E3": "+", "omega1": "-", "omega": "-",
        },
    ),
    Effects(
        figure=8,
        amplitude="a2",
        against="sigma2",
        claims={
            "f": "+", "G2": "-", "mu1": "+", "b2": "+", "E3": "+", "omega2": "-", "omega": "-",
        },
    ),
)  # fmt: skip

LAWS: Mapping[str, Law] = {
    "none": Passive(),
    "cnvc": CNVC(),
    "lnvc": LNVC(),
    "ppf": PPF(G1=70.0, G2=70.0),
    "ndf": NDF(),
    "pd": PD(),
}


def with_law(car: ForcedCar, law: Law) -> ForcedCar:
    """Return the same car and forcing under another law."""
    return dataclasses.replace(car, law=law)


def moved_by(name: str) -> str:
    """Return the parameter that a frequency of section 5.2 stands for.

    At given detunings no natural frequency moves without the others, since
    ``omega_i = omega + sigma_i``: raising one raises all.
    """
    return ALL_FREQUENCIES if name in ("omega", "omega1", "omega2") else name


def time_histories(
    car: ForcedCar, laws: Mapping[str, Law], *, duration: float, step: float = 1e-3
) -> dict[str, Simulation]:
    """Simulate the full equations from rest under several laws.

    Parameters
    ----------
    car : ForcedCar
        Car and forcing.
    laws : mapping of str to Law
        Laws by a name of the caller's choice.
    duration : float
        [s].
    step : float, optional
        RK4 step and distance of the recorded instants [s].
    """
    return {
        name: simulate(car.car, car.road, car.force, law, duration=duration, step=step)
        for name, law in laws.items()
    }


def step_hump(
    car: ForcedCar, laws: Mapping[str, Law], *, duration: float, with_force: bool
) -> dict[str, Simulation]:
    """Simulate the hump ``y = h`` (Fig. 11) from rest, with or without the external force."""
    force = car.force if with_force else dataclasses.replace(car.force, f=0.0)
    road = step_road(h=car.h)
    return {
        name: simulate(car.car, road, force, law, duration=duration, step=STEP)
        for name, law in laws.items()
    }


def response_of(car: ForcedCar, against: str, *, longest: float = 0.04) -> Response:
    """Follow the averaged motion over the paper's range of detuning."""
    return response(car, against, -DETUNING, DETUNING, longest=longest)


@dataclass(frozen=True, kw_only=True)
class SimulatedPoints:
    """Steady amplitudes of long simulations against one parameter."""

    parameter: str
    values: Array  # (n,)
    a1: Array  # (n,) largest displacement of the wheel [m]
    a2: Array  # (n,) of the body [m]


def simulated_points(
    car: ForcedCar, parameter: str, values: ArrayLike, *, duration: float = SETTLED
) -> SimulatedPoints:
    """Simulate to steady state at each value of a parameter (circles of Fig. 14)."""
    cars = list(sweep(car, parameter, values))
    steady = steady_amplitudes(
        [each.car for each in cars],
        [each.road for each in cars],
        [each.force for each in cars],
        [each.law for each in cars],
        duration=duration,
        step=STEP,
    )
    return SimulatedPoints(
        parameter=parameter, values=np.asarray(values, dtype=float), a1=steady.x1, a2=steady.x2
    )


def parameter_effect(
    car: ForcedCar, effects: Effects, name: str, *, factors: Sequence[float] = (0.7, 1.0, 1.3)
) -> tuple[Curve, ...]:
    """Compute one panel of Figures 5 to 8.

    Parameters
    ----------
    car : ForcedCar
        The car under CNVC.
    effects : Effects
        Which figure.
    name : str
        The panel's parameter; `f` takes 60 and 100 m/s^2 as the text does, the others factors.
    factors : sequence of float, optional
        Multiples of the car's own value [-].
    """
    moved = moved_by(name)
    value = car.value(moved)
    values = (
        (value, 60.0, 100.0)
        if name == "f"
        else tuple(value * finite("factor", each) for each in entries(factors))
    )
    return response_curves(car, effects.against, -DETUNING, DETUNING, {moved: values}, longest=0.05)


def amplitude_against(car: ForcedCar, parameter: str, start: float, end: float) -> Response:
    """Follow the averaged motion against any parameter (Figs 9 and 10)."""
    return response(car, parameter, start, end)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A transient of the full equations beside the slow flow's (Fig. 13)."""

    numerical: Simulation
    averaged: SlowMotion


def transient(car: ForcedCar, *, duration: float) -> Comparison:
    """Integrate the full equations and the slow flow from rest."""
    numerical = simulate(car.car, car.road, car.force, car.law, duration=duration, step=1e-3)
    return Comparison(numerical=numerical, averaged=slow_motion(car, numerical.t))


@dataclass(frozen=True, kw_only=True)
class Errors:
    """How far approximate amplitudes are from simulated ones, against a detuning."""

    parameter: str
    values: Array  # (n,) [rad/s]
    errors: Mapping[str, Array]  # (n,) by method [-]: the larger of the two masses'


def approximation_errors(
    car: ForcedCar, parameter: str, values: ArrayLike, *, duration: float = SETTLED
) -> Errors:
    """Compare averaging and harmonic balance with long simulations.

    Parameters
    ----------
    car : ForcedCar
        The car.
    parameter : str
        `sigma1` or `sigma2`.
    values : array_like (n,)
        Detunings [rad/s].
    duration : float, optional
        Simulated time from rest [s].
    """
    truth = simulated_points(car, parameter, values, duration=duration)
    cars = stack(list(sweep(car, parameter, values)))
    amplitudes: dict[str, tuple[Array, Array]] = {}
    for form in ("natural", "frozen"):
        points = fixed_points(cars, form=form)
        amplitudes[f"averaging, {form}"] = (points.a1, points.a2)
    start = balanced_start(cars)
    for harmonics in (1, 9):
        peaks = balance(cars, harmonics=harmonics, start=start).peaks
        name = f"harmonic balance, {harmonics} harmonic" + ("s" if harmonics > 1 else "")
        amplitudes[name] = (peaks[0], peaks[1])
    errors = {
        name: np.maximum(np.abs(one / truth.a1 - 1.0), np.abs(two / truth.a2 - 1.0))
        for name, (one, two) in amplitudes.items()
    }
    return Errors(parameter=parameter, values=truth.values, errors=errors)


@dataclass(frozen=True, kw_only=True)
class FoldedResponse:
    """The response of a car with a hardening spring, with points simulated up and down."""

    averaged: Response
    balanced: Response
    upward: SimulatedPoints  # each started from the motion at the value before
    downward: SimulatedPoints


def folded_response(
    car: ForcedCar, parameter: str, start: float, end: float, *, points: int = 25
) -> FoldedResponse:
    """Follow a response round its folds and sweep the parameter both ways in simulation."""
    points = whole("points", points, 2, 10_000)
    averaged = response(car, parameter, start, end, form="rotating")
    return FoldedResponse(
        averaged=averaged,
        balanced=response(
            car, parameter, start, end, method="harmonic balance", harmonics=5, longest=0.1
        ),
        upward=_swept(car, parameter, np.linspace(start, end, points)),
        downward=_swept(car, parameter, np.linspace(end, start, points)),
    )


def _swept(car: ForcedCar, parameter: str, values: Array) -> SimulatedPoints:
    """Simulate value after value, each from where the last one ended."""
    state = State(0.0, 0.0, 0.0, 0.0)
    peaks = np.empty((2, len(values)))
    for index, each in enumerate(sweep(car, parameter, values)):
        period = 2.0 * np.pi / each.omega
        whole_periods = round(40.0 / period) * period  # ends at the phase at which it began
        step = whole_periods / round(whole_periods / STEP)
        motion = simulate(
            each.car, each.road, each.force, each.law,
            duration=whole_periods, step=step, start=state,
        )  # fmt: skip
        state = State(
            float(motion.x1[-1]), float(motion.x2[-1]), float(motion.v1[-1]), float(motion.v2[-1])
        )
        last = slice(-round(5 * period / step), None)
        peaks[:, index] = np.abs(motion.x1[last]).max(), np.abs(motion.x2[last]).max()
    return SimulatedPoints(parameter=parameter, values=values, a1=peaks[0], a2=peaks[1])


@dataclass(frozen=True, kw_only=True)
class Trend:
    """One statement of section 5.2 and what the averaged response does."""

    figure: int
    amplitude: str
    against: str
    parameter: str
    claimed: str  # "+", "-" or "0"
    change: float  # of the largest amplitude over |sigma| <= 10 rad/s [-], for a parameter x 1.3
    found: str  # "+", "-" or "0" (under 1 %)

    @property
    def verdict(self) -> str:
        """``holds``, ``negligible`` (a claimed change is under 1 %) or ``contradicts``."""
        if self.found == self.claimed:
            return "holds"
        return "negligible" if self.found == "0" else "contradicts"

    @property
    def opposed(self) -> bool:
        """Whether a change is claimed and found with the other sign, however small."""
        return self.change * {"+": 1.0, "-": -1.0, "0": 0.0}[self.claimed] < 0.0


def trends(car: ForcedCar, *, factor: float = 1.3, threshold: float = 0.01) -> tuple[Trend, ...]:
    """Check the statements of section 5.2, parameter by parameter.

    Parameters
    ----------
    car : ForcedCar
        The car under CNVC.
    factor : float, optional
        By which a parameter grows [-].
    threshold : float, optional
        Relative change of the largest amplitude below which a parameter has no effect [-].
    """
    factor, threshold = positive("factor", factor), non_negative("threshold", threshold)
    sigma = np.linspace(-10.0, 10.0, 81)
    found: list[Trend] = []
    for effects in EFFECTS:
        for name, claimed in effects.claims.items():
            if not claimed:
                continue
            moved = moved_by(name)
            grown = car.vary(moved, factor * car.value(moved))
            largest = [
                float(np.max(getattr(_along(each, effects.against, sigma), effects.amplitude)))
                for each in (car, grown)
            ]
            change = largest[1] / largest[0] - 1.0
            sign = "0" if abs(change) < threshold else ("+" if change > 0.0 else "-")
            found.append(
                Trend(
                    figure=effects.figure,
                    amplitude=effects.amplitude,
                    against=effects.against,
                    parameter=name,
                    claimed=claimed,
                    change=change,
                    found=sign,
                )
            )
    return tuple(found)


def _along(car: ForcedCar, against: str, values: Array) -> FixedPoints:
    return fixed_points(stack(list(sweep(car, against, values))))
