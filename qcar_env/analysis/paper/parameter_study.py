"""Parameter studies: any list of parameters over any ranges, by averaging or by simulation.

`response_curves` follows the steady motion against one parameter for several values of others;
`simulated_amplitudes` runs a whole grid of cases to steady state in the compiled engine.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.analysis.paper.averaging import Form
from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.analysis.paper.frequency_response import Method, Response, response
from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.physics.state import State
from qcar_env.validation import finite_array, known, shown

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Amplitudes over a grid of parameters."""

    parameters: tuple[str, ...]  # names, in the order of the axes
    values: tuple[Array, ...]  # values along each axis
    a1: Array  # (n1, n2, ...) largest displacement of the wheel in steady state [m]
    a2: Array  # (n1, n2, ...) of the body [m]
    peak_u1: Array  # (n1, n2, ...) largest specific force on the wheel [m/s^2]
    peak_u2: Array  # (n1, n2, ...) on the body [m/s^2]
    diverged: NDArray[np.bool_]  # (n1, n2, ...) whether the case left all bounds


def cases(car: ForcedCar, ranges: Mapping[str, ArrayLike]) -> list[ForcedCar]:
    """Return the cars of a grid, the last parameter moving fastest.

    Parameters
    ----------
    car : ForcedCar
        What all of them share.
    ranges : mapping of str to array_like
        Values of each parameter; names as `ForcedCar.vary` knows, applied in order.

    Raises
    ------
    ValueError
        If there is no parameter, a name is unknown, a range is empty or a value out of range.
    """
    axes = _axes(car, ranges)
    grid: list[ForcedCar] = [car]
    for name, values in axes.items():
        grid = [each.vary(name, float(value)) for each in grid for value in values]
    return grid


def simulated_amplitudes(
    car: ForcedCar,
    ranges: Mapping[str, ArrayLike],
    *,
    duration: float = 60.0,
    step: float = 1e-3,
    start: State | None = None,
) -> Grid:
    """Simulate a grid of cases of the full equations to steady state.

    Parameters
    ----------
    car : ForcedCar
        What all cases share.
    ranges : mapping of str to array_like
        Values of each parameter, see `cases`.
    duration : float, optional
        Time to settle [s]; the paper's car without control needs 40 s or more.
    step : float, optional
        RK4 step [s].
    start : State, optional
        State at time 0; rest by default.

    Returns
    -------
    Grid
        Diverged cases are marked and have infinite amplitudes.

    Raises
    ------
    ValueError
        As `cases`; if a gain makes a loop, at rest or at its start, too stiff for the step; if the
        law takes the car's static stability.
    """
    axes = _axes(car, ranges)
    grid = cases(car, ranges)
    found = steady_amplitudes(
        [each.car for each in grid],
        [each.road for each in grid],
        [each.force for each in grid],
        [each.law for each in grid],
        duration=duration,
        step=step,
        start=start,
        on_divergence="keep",
    )
    shape = tuple(len(values) for values in axes.values())
    return Grid(
        parameters=tuple(axes),
        values=tuple(axes.values()),
        a1=np.reshape(found.x1, shape),
        a2=np.reshape(found.x2, shape),
        peak_u1=np.reshape(found.peak_u1, shape),
        peak_u2=np.reshape(found.peak_u2, shape),
        diverged=np.reshape(found.diverged, shape),
    )


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A response at one setting of the other parameters."""

    setting: Mapping[str, float]  # the other parameters' values
    response: Response


def response_curves(
    car: ForcedCar,
    against: str,
    start: float,
    end: float,
    settings: Mapping[str, ArrayLike] | Sequence[Mapping[str, float]],
    *,
    method: Method = "averaging",
    form: Form = "frozen",
    longest: float = 0.05,
) -> tuple[Curve, ...]:
    """Follow the steady motion against one parameter, for several settings of others.

    Parameters
    ----------
    car : ForcedCar
        What all share.
    against : str
        Parameter along the curves, from `start` to `end`.
    start, end : float
        Its range.
    settings : mapping or sequence of mappings
        Values of each other parameter (all combinations), or the settings one by one.
    method, form, longest
        See `qcar_env.analysis.paper.frequency_response.response`.

    Returns
    -------
    tuple of Curve
        In the order of the settings; each `response` carries stability, bifurcation points and,
        if the solver lost the branch, where.

    Raises
    ------
    ValueError
        If a name is unknown or a value out of range.
    """
    if isinstance(settings, Mapping):
        axes = _axes(car, settings)
        chosen: list[Mapping[str, float]] = [
            dict(zip(axes, map(float, combination), strict=True))
            for combination in itertools.product(*axes.values())
        ]
    else:
        chosen = list(settings)
    curves: list[Curve] = []
    for setting in chosen:
        one = car
        for name, value in setting.items():
            one = one.vary(name, value)
        followed = response(one, against, start, end, method=method, form=form, longest=longest)
        curves.append(Curve(setting=setting, response=followed))
    return tuple(curves)


def _axes(car: ForcedCar, ranges: Mapping[str, ArrayLike]) -> dict[str, Array]:
    mapped = isinstance(ranges, Mapping)  # pyright: ignore[reportUnnecessaryIsInstance]
    if not mapped or not ranges:
        raise ValueError(
            f"a study needs at least one parameter, got {'none' if mapped else shown(ranges)}; "
            "give name and values"
        )
    axes: dict[str, Array] = {}
    for name, values in ranges.items():
        known("parameter", name, car.parameters)
        axes[name] = finite_array(f"values of {name}", values).ravel()
        if axes[name].size == 0:
            raise ValueError(f"values of {name} must not be empty; give at least one")
    return axes
