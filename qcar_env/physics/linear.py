"""A linear plant: its matrices, exact transition, modes and steady state.

The matrices are read off the plant's own rate; a plant that is not linear is refused. The state is
``(x1, x2, v1, v2)`` everywhere. These functions are the truth that the integrators are tested
against, and the model that LQR, MPC and the optimum use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from qcar_env.parts.actuator import Actuator
from qcar_env.parts.part import Nothing
from qcar_env.physics.car import Car
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Input, Phasor, Phasors, turning, turning_step
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.state import State
from qcar_env.roads.excitation import Excitation
from qcar_env.validation import finite, positive, whole

Array = NDArray[np.float64]


INPUTS = (*State._fields, "u1", "u2", "y", "y'", "F")
RATES = ("x1'", "x2'", "x1''", "x2''")
PROBES = np.random.default_rng(0).uniform(-1.0, 1.0, (len(INPUTS), 4)) * [1e-3, 1e-2, 1e-1, 1.0]
ROUNDING = 1e-12  # of the terms of a sum, a few thousand roundings [-]
TINY = 1e-300  # below which numbers lose digits
MOST_TURNED = 1e9  # [rad] in one exact map: its phase is known to 1e-7 then


@dataclass(frozen=True, kw_only=True)
class Matrices:
    """The plant as ``x' = A x + B u + R w``."""

    A: Array  # (4, 4) of the state
    B: Array  # (4, 2) of the specific actuator forces ``u = (u1, u2)`` [m/s^2]
    R: Array  # (4, 3) of the forcing ``w = (y, y', F)``


def matrices(car: Car) -> Matrices:
    """Read the matrices off the plant's rate, by applying it to unit vectors.

    Parameters
    ----------
    car : Car
        The plant.

    Returns
    -------
    Matrices

    Raises
    ------
    ValueError
        If the plant is not linear. The rate must vanish at rest, follow each input in proportion
        (from a thousandth of its unit to the unit, and below zero), and add up for four mixtures
        of all inputs. The message names what does not.
    """
    unit = np.eye(len(INPUTS))
    columns = np.hstack([unit, -unit, 0.1 * unit, -1e-3 * unit, 0.0 * unit[:, :1], PROBES])
    found = _rates(columns, car)
    each = found[:, : len(unit)]
    expected, size = each @ columns, np.abs(each) @ np.abs(columns)
    off = ~(np.abs(found - expected) <= ROUNDING * size + TINY)  # NaN is off, too
    if np.any(off):
        alone = np.any(off[:, : 4 * len(unit)].reshape(len(RATES), 4, -1), axis=(0, 1))
        rates = [name for name, bad in zip(RATES, np.any(off, axis=1), strict=True) if bad]
        inputs = [name for name, bad in zip(INPUTS, alone, strict=True) if bad]
        raise ValueError(
            f"the car must be linear, got {' and '.join(rates)} out of proportion to "
            f"{', '.join(inputs) or 'the inputs taken together'}; give it linear parts, or simulate"
        )
    return Matrices(A=each[:, :4], B=each[:, 4:6], R=each[:, 6:])


def _rates(columns: Array, car: Car) -> Array:
    """Return the rates of the state, (4, k), for columns (9, k) of `INPUTS`."""
    u1, u2, y, y_dot, F = columns[4:]
    functions = car.functions
    c = functions.prepare(car.numbers)
    input = Input(functions.road_input(y, y_dot, c), F)
    entries = functions.rate(State(*columns[:4]), input, u1, u2, c)
    return np.array(np.broadcast_arrays(*entries, columns[0])[:4])


def actuation(car: Car, actuator: Actuator) -> Array:
    """Return the specific forces on wheel and body [m/s^2] that action 1 of each actuator makes.

    Returns
    -------
    ndarray (2, m)
        For an actuator that pushes on both masses, one column.

    Raises
    ------
    ValueError
        If the actuator is not linear, remembers, or acts late; the message says what to give.
    """
    numbers, functions = actuator.numbers, car.functions
    if not actuator.linear or actuator.delay or actuator.State is not Nothing:
        raise ValueError(
            f"the actuator must be linear, at once and without a lag, got {actuator}; "
            "give IndependentActuators or a SuspensionActuator, or simulate"
        )
    columns: list[tuple[float, float]] = []
    for action in np.eye(actuator.size).tolist():
        command = type(actuator).command(action, numbers)
        forces = type(actuator).force(Nothing(), command, 0.0, numbers)
        if actuator.unit == "N":
            forces = functions.by_mass(*forces, functions.prepare(car.numbers))
        columns.append(forces)
    return np.array(columns, dtype=np.float64).T


def jacobian(car: Car) -> Array:
    """Return the slope of the uncontrolled car's rate about its rest, shape (4, 4).

    Of a linear car this is A. Elsewhere it is a central difference over 1e-6 m and m/s, to 1e-6 of
    its size; a stop or a road that is not touched at rest does not count.
    """
    step = 1e-6
    columns = np.zeros((len(INPUTS), 8))
    columns[:4] = np.hstack([step * np.eye(4), -step * np.eye(4)])
    found = _rates(columns, car)
    return (found[:, :4] - found[:, 4:]) / (2.0 * step)


def poles(car: Car) -> NDArray[np.complex128]:
    """Return the eigenvalues of the uncontrolled plant [1/s], shape (4,), slowest first."""
    values = np.linalg.eigvals(matrices(car).A).astype(np.complex128)
    order = np.lexsort((-values.imag, np.round(-values.real, 9)))
    return values[order]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One natural mode of the uncontrolled car."""

    frequency: float  # magnitude of the pole [rad/s]
    damping_ratio: float  # -Re(pole) / |pole| [-]
    shape: tuple[complex, complex]  # displacements of wheel and body, the larger one 1 [-]


def modes(car: Car) -> tuple[Mode, ...]:
    """Return the modes of the uncontrolled car, lowest frequency first.

    Returns
    -------
    tuple of Mode
        Two for an underdamped car; an overdamped mode counts once for each real pole.
    """
    values, vectors = np.linalg.eig(matrices(car).A)
    found: list[Mode] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag < 0.0:
            continue
        displacement = vector[:2] / vector[:2][np.argmax(np.abs(vector[:2]))]
        found.append(
            Mode(
                frequency=float(abs(value)),
                damping_ratio=float(-value.real / abs(value)),
                shape=(complex(displacement[0]), complex(displacement[1])),
            )
        )
    return tuple(sorted(found, key=lambda mode: mode.frequency))


def held_transition(car: Car, dt: float) -> tuple[Array, Array]:
    """Return the exact map over `dt` under a held actuator force and no forcing.

    Parameters
    ----------
    car : Car
        The plant.
    dt : float
        Interval [s].

    Returns
    -------
    Ad : ndarray (4, 4)
    Bd : ndarray (4, 2)
        ``x(t + dt) = Ad x(t) + Bd u``.

    Raises
    ------
    ValueError
        If `dt` is not positive, or so long that the map is lost in rounding or overflows.
    """
    m = np.zeros((6, 6))
    plant = matrices(car)
    m[:4] = np.hstack([plant.A, plant.B])
    exact = _exponential(m, dt)
    return exact[:4, :4], exact[:4, 4:]


def _exponential(m: Array, dt: float) -> Array:
    """Return the exponential of `m` times `dt`, where float64 can hold it."""
    fastest = np.max(np.abs([*np.linalg.eigvals(m[:4, :4]), *m[4:].flat]))  # rates [rad/s]
    short = positive("dt", dt, "s") * fastest <= MOST_TURNED
    with np.errstate(over="ignore", invalid="ignore"):  # a car that gains energy grows for ever
        exact = expm(m * dt) if short else np.array(math.nan)
    if not np.isfinite(exact).all():
        raise ValueError(
            f"dt must be so short that float64 holds the exact map, got {dt:g} s at rates of up "
            f"to {fastest:.3g} rad/s; give an interval of seconds"
        )
    return exact


@dataclass(frozen=True, kw_only=True)
class Transition:
    """The exact map of plant, road phasor and force phasor over an interval, force held.

    ``x(t+dt) = A x + B u + road (s, c) + force (S, C)``, where ``(s, c)`` and ``(S, C)`` are the
    phasors of road and force at the beginning of the interval.
    """

    A: Array  # (4, 4)
    B: Array  # (4, 2) specific actuator forces
    road: Array  # (4, 2) phasor of the road
    force: Array  # (4, 2) phasor of the external force
    dt: float  # [s]


def exact_transition(car: Car, road: Excitation, force: ExternalForce, dt: float) -> Transition:
    """Return the exact map over `dt` on one piece of the road (matrix exponential).

    Parameters
    ----------
    car, road, force
        Plant, road and external force.
    dt : float
        Interval [s]; the road must have no kink inside.

    Returns
    -------
    Transition

    Raises
    ------
    ValueError
        If `dt` is not positive, or so long that the map is lost in rounding or overflows.
    """
    m = np.zeros((10, 10))
    plant = matrices(car)
    m[:4, :4], m[:4, 4:6] = plant.A, plant.B
    m[:4, 6] = plant.R[:, 0]  # y = h s
    m[:4, 7] = plant.R[:, 1] * road.omega  # y' = h omega c
    m[:4, 9] = plant.R[:, 2]  # F = f C
    m[6, 7], m[7, 6] = road.omega, -road.omega
    m[8, 9], m[9, 8] = force.Omega, -force.Omega
    exact = _exponential(m, dt)
    return Transition(
        A=exact[:4, :4],
        B=exact[:4, 4:6],
        road=exact[:4, 6:8] * road.h,
        force=exact[:4, 8:10] * force.f,
        dt=dt,
    )


def rk4_transition(
    car: Car, road: Excitation, force: ExternalForce, dt: float, substeps: int
) -> Transition:
    """Return the map that `substeps` RK4 steps make of an interval `dt` (see `exact_transition`).

    With a held force and harmonic forcing an RK4 step of the linear plant is itself linear in
    state, force and phasors; this is that map, found by applying the step to unit vectors.

    Raises
    ------
    ValueError
        If `dt` is not positive or `substeps` no whole number from 1 to 1 000 000; if the plant is
        not linear (see `matrices`).
    """
    matrices(car)  # refuses a plant that is not linear
    dt, substeps = positive("dt", dt, "s"), whole("substeps", substeps, most=1_000_000)
    unit = np.eye(10)
    x = State(*unit[:4])
    phasors = Phasors(Phasor(unit[6], unit[7]), Phasor(unit[8], unit[9]))
    step = step_fractions(dt / substeps)
    functions = car.functions
    c = functions.prepare(car.numbers)
    road_s = functions.road_input(road.h, 0.0, c)
    road_c = functions.road_input(0.0, road.h * road.omega, c)
    prepared = turning(road_s, road_c, force.f, road.omega, force.Omega, step.full)
    for _ in range(substeps):
        x, phasors = turning_step(functions.rate, x, phasors, prepared, step, unit[4], unit[5], c)
    m = np.array(x)
    return Transition(A=m[:, :4], B=m[:, 4:6], road=m[:, 6:8], force=m[:, 8:10], dt=dt)


@dataclass(frozen=True, kw_only=True)
class SteadyState:
    """Periodic motion of the uncontrolled car: ``x(t) = Re(X e^{i omega t} + Z e^{i Omega t})``."""

    omega: float  # frequency of the road [rad/s]
    Omega: float  # frequency of the external force [rad/s]
    road: NDArray[np.complex128]  # X (4,): answer to the road
    force: NDArray[np.complex128]  # Z (4,): answer to the external force

    @property
    def amplitudes(self) -> tuple[float, float]:
        """Amplitudes of x1 and x2 [m]; the largest displacement that the motion comes near."""
        if self.omega == self.Omega:
            total = np.abs(self.road + self.force)
        else:
            total = np.abs(self.road) + np.abs(self.force)
        return float(total[0]), float(total[1])

    def state(self, t: float) -> Array:
        """Return the state at `t` [s], shape (4,)."""
        finite("t", t, "s")
        return np.real(
            self.road * np.exp(1j * self.omega * t) + self.force * np.exp(1j * self.Omega * t)
        )


def steady_state(car: Car, road: Excitation, force: ExternalForce) -> SteadyState:
    """Return the steady motion of the uncontrolled car on a harmonic road.

    Parameters
    ----------
    car, road, force
        Plant, harmonic road and external force.

    Returns
    -------
    SteadyState

    Raises
    ------
    ValueError
        If the road is not harmonic (a hump passes and a step settles), or if a forcing frequency
        meets an undamped mode.
    """
    if not road.harmonic:
        raise ValueError(
            f"a steady state needs a harmonic road, got {road.road}; give a Sine, for example "
            "roads.excitation.harmonic(h=0.1, omega=55.0)"
        )
    plant = matrices(car)
    r = plant.R
    # y = Im(h e^{i omega t}) = Re(-i h e^{i omega t}); F = Re(f e^{i Omega t})
    into_road = (r[:, 0] + 1j * road.omega * r[:, 1]) * (-1j * road.h)
    into_force = r[:, 2] * force.f
    return SteadyState(
        omega=road.omega,
        Omega=force.Omega,
        road=_response(plant.A, road.omega, into_road),
        force=_response(plant.A, force.Omega, into_force),
    )


def _response(A: Array, frequency: float, into: NDArray[Any]) -> NDArray[np.complex128]:
    matrix = 1j * frequency * np.eye(4) - A
    if not np.any(into):
        return np.zeros(4, dtype=np.complex128)
    if np.linalg.cond(matrix) > 1e14:
        raise ValueError(
            f"no steady state: the forcing at {frequency:g} rad/s meets an undamped mode; "
            "give the car damping or another frequency"
        )
    return np.linalg.solve(matrix, into).astype(np.complex128)
