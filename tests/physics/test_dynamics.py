"""Equations (3)-(4) against the printed physical form (1)-(2), Newton's laws and energy."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.physics.car import PAPER_FUNCTIONS, PaperCar, QuarterCar
from qcar_env.physics.motion import Input
from qcar_env.physics.state import State


class Parts(NamedTuple):
    """Masses, springs and dampers of a car."""

    m1: float
    m2: float
    k1: float
    k2: float
    c1: float
    c2: float


parts = st.builds(
    Parts,
    m1=st.floats(20.0, 500.0),
    m2=st.floats(150.0, 3_000.0),
    k1=st.floats(5e4, 6e5),
    k2=st.floats(5e3, 1e5),
    c1=st.floats(0.0, 2e4),
    c2=st.floats(0.0, 1e4),
)
state = st.from_type(State)
number = st.floats(-100.0, 100.0)


def forcing_by(y, y_dot, F, car):
    """Return what road and external force do to a car."""
    functions = car.functions
    return Input(functions.road_input(y, y_dot, functions.prepare(car.numbers)), F)


def rate(x, forcing, u1, u2, car):
    """Return the rate of a car's state; `forcing` is None on a road at rest."""
    functions = car.functions
    forcing = forcing or forcing_by(0.0, 0.0, 0.0, car)
    return functions.rate(x, forcing, u1, u2, functions.prepare(car.numbers))


def accelerations(x, u1, u2, forcing, car):
    """Return the accelerations of wheel and body."""
    return tuple(rate(x, forcing, u1, u2, car))[2:]


ROAD_AT_REST = None


def energy(x: State, p: Parts) -> float:
    """Kinetic energy of the masses and potential energy of tyre and suspension [J]."""
    travel = x.x2 - x.x1
    kinetic = p.m1 * x.v1**2 + p.m2 * x.v2**2
    return 0.5 * (kinetic + p.k1 * x.x1**2 + p.k2 * travel**2)


def power(x: State, xdot: State, p: Parts) -> tuple[float, float]:
    """Return d(energy)/dt along `xdot` [W], and the size of its terms for the tolerance."""
    terms = [
        p.m1 * x.v1 * xdot.v1,
        p.m2 * x.v2 * xdot.v2,
        p.k1 * x.x1 * xdot.x1,
        p.k2 * (x.x2 - x.x1) * (xdot.x2 - xdot.x1),
    ]
    forces = [p.k1 * x.x1, p.k2 * x.x1, p.k2 * x.x2, p.c1 * x.v1, p.c2 * x.v1, p.c2 * x.v2]
    scale = (abs(x.v1) + abs(x.v2)) * sum(abs(force) for force in forces)
    return sum(terms), scale + 1e-280  # numbers below lose digits


@given(p=parts, x=state, y=st.floats(-0.2, 0.2), y_dot=number, reciprocal=st.booleans())
def test_the_coefficients_reproduce_the_printed_physical_equations(p, x, y, y_dot, reciprocal):
    car = PaperCar.from_physical(*p, reciprocal=reciprocal)
    a1, a2 = accelerations(x, 0.0, 0.0, forcing_by(y, y_dot, 0.0, car), car)
    wheel = [p.m1 * a1, (p.c1 + p.c2) * x.v1, -p.c2 * x.v2, (p.k1 + p.k2) * x.x1, -p.k2 * x.x2]
    tyre = [-p.k1 * y, -p.c1 * y_dot]
    coupling = p.k2 if reciprocal else p.k1  # the paper prints k1; Newton's law needs k2
    body = [p.m2 * a2, -p.c2 * x.v1, p.c2 * x.v2, -coupling * x.x1, p.k2 * x.x2]
    for equation in (wheel + tyre, body):  # (1), (2): everything on the left side
        # a dozen roundings of the largest term
        assert sum(equation) == pytest.approx(0.0, abs=1e-14 * sum(map(abs, equation)))


@given(p=parts, x=state, y=st.floats(-0.2, 0.2), y_dot=number, F=number, u1=number, u2=number)
def test_the_suspension_pushes_both_masses_with_opposite_forces(p, x, y, y_dot, F, u1, u2):
    car = PaperCar.from_physical(*p)
    a1, a2 = accelerations(x, u1, u2, forcing_by(y, y_dot, F, car), car)
    outside = [
        p.k1 * y, -p.k1 * x.x1, p.c1 * y_dot, -p.c1 * x.v1, p.m1 * u1, p.m2 * u2, p.m2 * F
    ]  # fmt: skip
    inside = [p.k2 * x.x1, p.k2 * x.x2, p.c2 * x.v1, p.c2 * x.v2]  # these cancel
    scale = sum(abs(force) for force in outside + inside)
    assert p.m1 * a1 + p.m2 * a2 == pytest.approx(sum(outside), abs=1e-14 * scale)


@given(p=parts, x=state)
def test_an_undriven_reciprocal_car_loses_the_dampers_power(p, x):
    """d(energy)/dt = -c1 v1^2 - c2 (v1 - v2)^2, which is never positive."""
    xdot = rate(x, ROAD_AT_REST, 0.0, 0.0, PaperCar.from_physical(*p))
    found, scale = power(x, xdot, p)
    lost = p.c1 * x.v1**2 + p.c2 * (x.v1 - x.v2) ** 2
    assert found == pytest.approx(-lost, abs=1e-14 * scale)


@given(p=parts, x=state)
def test_the_printed_coupling_adds_or_takes_power_without_a_source(p, x):
    """With E3 = k1 / m2 there is an extra (k1 - k2) x1 v2: erratum 6."""
    xdot = rate(x, ROAD_AT_REST, 0.0, 0.0, PaperCar.from_physical(*p, reciprocal=False))
    found, scale = power(x, xdot, p)
    extra = (p.k1 - p.k2) * x.x1 * x.v2
    lost = p.c1 * x.v1**2 + p.c2 * (x.v1 - x.v2) ** 2
    assert found == pytest.approx(extra - lost, abs=1e-14 * (scale + p.k1 * abs(x.x1 * x.v2)))


@given(...)
def test_the_rate_of_a_position_is_its_velocity(x: State, car: PaperCar):
    xdot = rate(x, ROAD_AT_REST, 0.0, 0.0, car)
    assert (xdot.x1, xdot.x2) == (x.v1, x.v2)
    assert (xdot.v1, xdot.v2) == accelerations(x, 0.0, 0.0, ROAD_AT_REST, car)


@given(...)
def test_a_car_at_rest_on_a_flat_road_stays(car: PaperCar):
    assert rate(State(0.0, 0.0, 0.0, 0.0), ROAD_AT_REST, 0.0, 0.0, car) == (0.0, 0.0, 0.0, 0.0)


@given(...)
def test_upward_forces_push_their_own_mass_up(car: PaperCar):
    rest = State(0.0, 0.0, 0.0, 0.0)
    assert accelerations(rest, 1.0, 0.0, ROAD_AT_REST, car) == (1.0, 0.0)
    assert accelerations(rest, 0.0, 1.0, ROAD_AT_REST, car) == (0.0, 1.0)
    assert accelerations(rest, 0.0, 0.0, forcing_by(0.0, 0.0, 1.0, car), car) == (0.0, 1.0)
    assert accelerations(rest, 0.0, 0.0, forcing_by(1.0, 0.0, 0.0, car), car) == (car.mu1, 0.0)
    assert accelerations(rest, 0.0, 0.0, forcing_by(0.0, 1.0, 0.0, car), car) == (car.mu2, 0.0)


@given(p=parts, x=state, y=st.floats(-0.2, 0.2), y_dot=number, F=number, u1=number, u2=number)
def test_a_car_of_linear_parts_has_the_same_equations(p, x, y, y_dot, F, u1, u2):
    coefficients, made = PaperCar.from_physical(*p), QuarterCar.from_physical(*p)
    found, expected = (
        rate(x, forcing_by(y, y_dot, F, car), u1, u2, car) for car in (made, coefficients)
    )
    forces = [p.k1 * y, p.k1 * x.x1, p.c1 * y_dot, p.c1 * x.v1, p.k2 * x.x1, p.k2 * x.x2]
    forces += [p.c2 * x.v1, p.c2 * x.v2]
    size = sum(map(abs, forces)) * (1 / p.m1 + 1 / p.m2) + abs(F) + abs(u1) + abs(u2)
    # a dozen roundings each
    assert found == pytest.approx(expected, rel=1e-15, abs=1e-14 * size)


def test_floats_arrays_and_tensors_give_the_same_bits(same_bits):
    rng = np.random.default_rng(1)
    n = 257  # no multiple of a vector register, so that numpy's remainder loop runs as well
    x = State(*rng.normal(size=(4, n)))
    coefficients = type(PaperCar.from_physical(*[1.0] * 6).numbers)(
        *rng.uniform(0.0, 60.0, size=(9, n))
    )
    y, y_dot, F, u1, u2 = rng.normal(size=(5, n))
    same_bits(PAPER_FUNCTIONS.road_input, y, y_dot, coefficients)
    input = Input(PAPER_FUNCTIONS.road_input(y, y_dot, coefficients), F)
    same_bits(PAPER_FUNCTIONS.rate, x, input, u1, u2, coefficients)
    same_bits(PAPER_FUNCTIONS.kick, x, y, coefficients)
