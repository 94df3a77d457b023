"""The linear truth: matrices, exact transition, modes and steady state."""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, example, given, strategies as st
from scipy.integrate import solve_ivp

from qcar_env.parts.actuator import (
    IndependentActuators,
    LaggedSuspensionActuator,
    SemiActiveDamper,
    SuspensionActuator,
)
from qcar_env.parts.spring import CubicSpring, Stops
from qcar_env.parts.tyre import LiftOffTyre
from qcar_env.physics import linear, motion
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Input, Phasors
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.state import State
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation

PAPER = PaperCar(
    omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5, mu1=2510.0, mu2=16.0
)
PAPER_ROAD = roads.harmonic(h=0.1, omega=55.0)
PAPER_FORCE = ExternalForce(f=24.8, Omega=55.0)
MATHWORKS = PaperCar.from_physical(m1=60.0, m2=300.0, k1=190_000.0, k2=16_000.0, c1=0.0, c2=1_000.0)
UNDAMPED = PaperCar.from_physical(60.0, 300.0, 190e3, 16e3, 0.0, 0.0)
harmonic = st.builds(roads.harmonic, h=st.floats(-0.2, 0.2), omega=st.floats(1.0, 100.0))


def test_the_matrices_are_those_of_equations_3_and_4():
    found = linear.matrices(PAPER)
    np.testing.assert_array_equal(
        found.A,
        [[0, 0, 1, 0], [0, 0, 0, 1], [-(55.0**2), 0.5, -8.7, 3.4], [0.5, -(55.0**2), 0.71, -0.71]],
    )
    np.testing.assert_array_equal(found.B, [[0, 0], [0, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(found.R, [[0, 0, 0], [0, 0, 0], [2510, 16, 0], [0, 0, 1]])


@given(...)
def test_the_matrices_stand_for_the_rate(car: PaperCar, x: State):
    u, w = np.array([3.0, -5.0]), (0.1, -2.0, 7.0)
    input = Input(car.functions.road_input(*w[:2], car.numbers), w[2])
    expected = car.functions.rate(x, input, *u, car.numbers)
    plant = linear.matrices(car)
    found = plant.A @ np.array(x) + plant.B @ u + plant.R @ np.array(w)
    # a dozen terms in another order, each rounded to 1.1e-16 of the largest
    scale = np.max(np.abs(plant.A)) * (np.max(np.abs(x)) + 1.0) + 1e4
    assert found == pytest.approx(np.array(expected), abs=1e-14 * scale)


@pytest.mark.parametrize(
    ("extra", "named"),
    [  # what joins x2'': a cubic spring, friction, a stop at 0.5 m, an offset, two mixtures
        (lambda x, u1: -1e-3 * (x.x2 - x.x1) * (x.x2 - x.x1) * (x.x2 - x.x1), "x1, x2"),
        (lambda x, u1: -1e-3 * abs(x.v2 - x.v1), "v1, v2"),
        (lambda x, u1: -1e3 * (x.x2 > 0.5) * (x.x2 - 0.5), "x2"),
        (lambda x, u1: 9.81, "x1, x2, v1, v2, u1, u2, y, y', F"),
        (lambda x, u1: 1e-3 * x.v1 * u1, "the inputs taken together"),
        (lambda x, u1: 1e-3 * x.x1 * x.v2, "the inputs taken together"),
    ],
)
def test_a_plant_that_is_not_linear_is_refused_by_name(extra, named):
    def rate(x, input, u1, u2, c):
        found = PAPER.functions.rate(x, input, u1, u2, c)
        return found._replace(v2=found.v2 + extra(x, u1))

    bent = SimpleNamespace(numbers=PAPER.numbers, functions=PAPER.functions._replace(rate=rate))
    message = f"the car must be linear, got x2'' out of proportion to {named}; give it linear parts"
    for refuse in (
        lambda: linear.matrices(bent),
        lambda: linear.poles(bent),
        lambda: linear.steady_state(bent, PAPER_ROAD, PAPER_FORCE),
        lambda: linear.exact_transition(bent, PAPER_ROAD, PAPER_FORCE, 0.005),
        lambda: linear.rk4_transition(bent, PAPER_ROAD, PAPER_FORCE, 0.005, 4),
    ):
        with pytest.raises(ValueError, match=message):
            refuse()


# Transitions ------------------------------------------------------------------------------------


def test_the_exact_transition_agrees_with_dop853(crossings):
    for each in crossings:
        x = np.array(each.x0)
        for begin, end in itertools.pairwise(each.edges):
            angle = each.road.omega * begin
            raised = abs(float(each.road.height(0.5 * (begin + end)))) > 0.0
            if each.profile == "harmonic":
                phasor = (math.sin(angle), math.cos(angle))
            elif each.profile == "step":
                phasor = (float(raised), 0.0)
                x[2] += each.car.mu2 * each.road.h * raised * (begin > 0.0)  # the jump
            else:
                phasor = (0.0, float(raised))
            t = linear.exact_transition(each.car, each.road, each.force, end - begin)
            x = t.A @ x + t.B @ np.array(each.u) + t.road @ np.array(phasor, dtype=float)
            x += t.force @ np.array(each.force.phasor(begin), dtype=float)
        # 1e-12 that DOP853 is asked for, a few hundred steps of it
        assert np.max(np.abs(x - each.truth) / each.scale) < 1e-10


@given(car=st.from_type(PaperCar), a=st.floats(1e-3, 0.1), b=st.floats(1e-3, 0.1))
def test_two_transitions_make_one(car, a, b):
    road, force = PAPER_ROAD, PAPER_FORCE
    first, second, both = (
        whole_matrix(linear.exact_transition(car, road, force, t), road, force)
        for t in (a, b, a + b)
    )
    # rounding of three exponentials of a matrix of norm up to 2e3 (mu1 h, omega^2 dt)
    scale = np.linalg.norm(first) * np.linalg.norm(second)
    assert second @ first == pytest.approx(both, abs=1e-12 * scale)


def whole_matrix(transition, road, force):
    """Return the map of state, held force and both phasors."""
    m = np.eye(10)
    m[:4] = np.hstack([transition.A, transition.B, transition.road, transition.force])
    for at, angle in ((6, road.omega * transition.dt), (8, force.Omega * transition.dt)):
        c, s = math.cos(angle), math.sin(angle)
        m[at : at + 2, at : at + 2] = [[c, s], [-s, c]]
    return m


@given(car=st.from_type(PaperCar), dt=st.floats(1e-3, 0.1))
def test_the_held_transition_is_the_same_map_without_the_world(car, dt):
    A, B = linear.held_transition(car, dt)
    full = linear.exact_transition(car, PAPER_ROAD, PAPER_FORCE, dt)
    # two exponentials of different matrices, each good to 1e-13 of its norm
    assert pytest.approx(full.A, abs=1e-12 * np.linalg.norm(full.A)) == A
    assert pytest.approx(full.B, abs=1e-12 * np.linalg.norm(full.A)) == B


@given(
    car=st.from_type(PaperCar),
    x=st.from_type(State),
    force=st.from_type(ExternalForce),
    road=harmonic,
    t=st.floats(0.0, 10.0),
    substeps=st.integers(1, 8),
)
def test_the_rk4_transition_is_what_the_integrator_does(car, x, force, road, t, substeps):
    dt, u = 0.005, (20.0, -30.0)
    functions, c, h, omega = car.functions, car.numbers, road.h, road.omega
    start = phasors = Phasors(motion.angle(omega * t), motion.angle(force.Omega * t))
    road_s, road_c = functions.road_input(h, 0.0, c), functions.road_input(0.0, h * omega, c)
    prepared = motion.turning(road_s, road_c, force.f, omega, force.Omega, dt / substeps)
    found, step = x, step_fractions(dt / substeps)
    for _ in range(substeps):
        found, phasors = motion.turning_step(functions.rate, found, phasors, prepared, step, *u, c)
    m = linear.rk4_transition(car, road, force, dt, substeps)
    expected = m.A @ np.array(x) + m.B @ np.array(u)
    expected += m.road @ np.array(start.road) + m.force @ np.array(start.force)
    # a few dozen roundings of each term, in another order
    scale = np.linalg.norm(m.A) * (np.max(np.abs(x)) + 1.0) + 30.0
    assert np.array(found) == pytest.approx(expected, abs=1e-13 * scale)


@given(car=st.from_type(PaperCar), force=st.from_type(ExternalForce))
@example(  # of the first order that is left out there is much: 18.1 at 4 steps, 17.0 at 8
    car=PaperCar(
        omega1=21.0, omega2=5.0, b1=12.0, b2=0.0, E1=0.0, E2=0.0, E3=0.0, mu1=0.0, mu2=0.0
    ),
    force=ExternalForce(f=0.0, Omega=0.0),
)
def test_the_rk4_transition_converges_to_the_exact_one(car, force):
    road = PAPER_ROAD
    dt = 0.2 / max(np.max(np.abs(linear.poles(car))), road.omega, force.Omega)
    exact = whole_matrix(linear.exact_transition(car, road, force, dt), road, force)
    errors = [
        np.linalg.norm(
            whole_matrix(linear.rk4_transition(car, road, force, dt, n), road, force) - exact
        )
        for n in (8, 16)
    ]
    # 2^4, and a share of the next order, of the size of the coarse step: z = 0.025
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@pytest.mark.parametrize("dt", [0.0, -0.005])
def test_an_interval_must_be_positive(dt):
    message = f"dt must be positive, got {dt:g} s; give a value above 0 s"
    for make in (
        lambda: linear.exact_transition(PAPER, PAPER_ROAD, PAPER_FORCE, dt),
        lambda: linear.held_transition(PAPER, dt),
        lambda: linear.rk4_transition(PAPER, PAPER_ROAD, PAPER_FORCE, dt, 4),
    ):
        with pytest.raises(ValueError, match=message):
            make()


@pytest.mark.parametrize("dt", [1e9, 1e18, 1e300])
def test_an_interval_whose_map_float64_cannot_hold_is_refused(dt):
    for make in (
        lambda: linear.exact_transition(PAPER, PAPER_ROAD, PAPER_FORCE, dt),
        lambda: linear.held_transition(PAPER, dt),
    ):
        with pytest.raises(ValueError, match="dt must be so short that float64 holds the exact"):
            make()


def test_a_map_over_an_hour_is_the_steady_motion():
    """All that is left of the start is gone, and the forcing alone says where the car is."""
    hour = linear.exact_transition(PAPER, PAPER_ROAD, PAPER_FORCE, 3600.0)
    assert np.max(np.abs(hour.A)) < 1e-9
    steady = linear.steady_state(PAPER, PAPER_ROAD, PAPER_FORCE).state(3600.0)
    # a phase of 2e5 rad is known to 3e-11, of velocities of some 90 m/s
    assert hour.road @ [0.0, 1.0] + hour.force @ [0.0, 1.0] == pytest.approx(steady, abs=1e-6)


def test_a_car_that_grows_for_ever_outgrows_float64():
    growing = dataclasses.replace(PAPER, E1=500.0, E3=500.0, b1=0.0, b2=0.0)
    assert np.max(linear.poles(growing).real) > 0.5
    with pytest.raises(ValueError, match="so short that float64 holds"):
        linear.held_transition(growing, 1e5)


@pytest.mark.parametrize("size", [1e-200, 1e150, 1e300])
def test_the_exact_map_is_proportional_to_the_forcing_however_large(size):
    one = linear.exact_transition(PAPER, roads.harmonic(h=1.0, omega=55.0), PAPER_FORCE, 0.005)
    large = linear.exact_transition(
        PAPER, roads.harmonic(h=size, omega=55.0), ExternalForce(f=size, Omega=55.0), 0.005
    )
    np.testing.assert_array_equal(large.road, one.road * size)
    np.testing.assert_array_equal(large.A, one.A)


# Modes ------------------------------------------------------------------------------------------


def test_the_poles_of_the_papers_car_slowest_first():
    expected = [-0.209 + 55.0j, -0.209 - 55.0j, -4.50 + 54.8j, -4.50 - 54.8j]
    # equations.md prints three digits of the damping and of the frequency
    assert linear.poles(PAPER) == pytest.approx(np.array(expected), abs=0.05)
    assert linear.poles(PAPER).real[[0, 2]] == pytest.approx([-0.209, -4.50], abs=6e-3)


@given(...)
def test_the_poles_have_the_sum_and_product_of_the_characteristic_polynomial(car: PaperCar):
    found = linear.poles(car)
    assert found.sum() == pytest.approx(-(car.b1 + car.b2), rel=1e-9, abs=1e-9)
    static = car.omega1**2 * car.omega2**2 - car.E1 * car.E3
    # double eigenvalues are good to the root of a rounding error
    assert np.prod(found) == pytest.approx(static, rel=1e-6)
    assert np.all(np.diff(found.real) <= 1e-6)


def test_the_modes_of_a_printed_car():
    """MathWorks: 7.06 rad/s with damping ratio 0.20, 58.2 rad/s with 0.15."""
    body, wheel = linear.modes(MATHWORKS)
    assert (body.frequency, wheel.frequency) == pytest.approx((7.06, 58.2), rel=1e-3)
    assert (body.damping_ratio, wheel.damping_ratio) == pytest.approx((0.20, 0.15), abs=5e-3)
    assert body.shape[1] == pytest.approx(1.0)  # the body moves most in its own mode
    assert wheel.shape[0] == pytest.approx(1.0)
    assert abs(body.shape[0]) < 1.0
    assert abs(wheel.shape[1]) < 1.0


@given(
    m1=st.floats(20, 100), m2=st.floats(150, 900), k1=st.floats(1e5, 3e5), k2=st.floats(1e4, 5e4)
)
def test_undamped_modes_are_orthogonal_and_have_rayleighs_frequency(m1, m2, k1, k2):
    slow, fast = linear.modes(PaperCar.from_physical(m1, m2, k1, k2, 0.0, 0.0))
    assert (slow.damping_ratio, fast.damping_ratio) == pytest.approx((0.0, 0.0), abs=1e-9)
    M, K = np.diag([m1, m2]), np.array([[k1 + k2, -k2], [-k2, k2]])
    for mode in (slow, fast):
        shape = np.real(mode.shape)  # without damping the masses move in phase or against it
        quotient = (shape @ K @ shape) / (shape @ M @ shape)
        assert mode.frequency == pytest.approx(math.sqrt(quotient), rel=1e-9)
    cross = np.real(slow.shape) @ M @ np.real(fast.shape)
    assert cross == pytest.approx(0.0, abs=1e-9 * (m1 + m2))


def test_an_overdamped_mode_counts_once_for_each_real_pole():
    car = PaperCar.from_physical(60.0, 300.0, 190e3, 16e3, 0.0, 10e3)
    found = linear.modes(car)
    assert len(found) == 3
    assert [mode.damping_ratio for mode in found if mode.shape[0].imag == 0.0] == [1.0, 1.0]
    assert [mode.frequency for mode in found] == sorted(mode.frequency for mode in found)


# Steady state -----------------------------------------------------------------------------------


@given(
    car=st.from_type(PaperCar),
    road=harmonic,
    force=st.from_type(ExternalForce),
    t=st.floats(0, 9),
)
def test_the_steady_state_obeys_the_equations_of_motion(car, road, force, t):
    assume(car.b1 + car.b2 > 0.1)
    steady = linear.steady_state(car, road, force)
    omegas = ((steady.road, steady.omega), (steady.force, steady.Omega))
    xdot = sum(np.real(1j * omega * X * np.exp(1j * omega * t)) for X, omega in omegas)
    on_road = car.functions.road_input(float(road.height(t)), float(road.rate(t)), car.numbers)
    input = Input(on_road, float(force.value(t)))
    expected = car.functions.rate(State(*steady.state(t)), input, 0.0, 0.0, car.numbers)
    # the solve loses what the condition of i omega - A takes, which is largest near resonance
    scale = np.max(np.abs(linear.matrices(car).A)) * sum(np.max(np.abs(X)) for X, _ in omegas)
    assert xdot == pytest.approx(np.array(expected), abs=1e-10 * (scale + 1.0))


@pytest.mark.parametrize(
    ("car", "road", "force", "settle"),
    [  # settle: time in which the slowest mode falls below 1e-7 of its start [s]
        (PAPER, PAPER_ROAD, PAPER_FORCE, 80.0),
        (MATHWORKS, roads.harmonic(h=0.1, V=20.0, L=3.0), ExternalForce(), 12.0),
        (MATHWORKS, roads.harmonic(h=0.02, omega=30.0), ExternalForce(f=2.0, Omega=7.0), 12.0),
        (MATHWORKS, roads.harmonic(h=0.02, omega=9.0), ExternalForce(f=2.0), 12.0),
    ],
)
def test_a_long_integration_ends_in_the_steady_state(car, road, force, settle):
    A, R = linear.matrices(car).A, linear.matrices(car).R
    h, omega, f, Omega = road.h, road.omega, force.f, force.Omega

    def derivative(t, x):
        y, y_dot = h * math.sin(omega * t), h * omega * math.cos(omega * t)
        return A @ x + R @ (y, y_dot, f * math.cos(Omega * t))

    found = solve_ivp(derivative, (0.0, settle), np.zeros(4), "DOP853", rtol=1e-9, atol=1e-10)
    steady = linear.steady_state(car, road, force)
    scale = np.abs(steady.road) + np.abs(steady.force)
    assert np.abs(found.y[:, -1] - steady.state(settle)) / scale == pytest.approx(0.0, abs=1e-6)


@given(car=st.from_type(PaperCar), road=harmonic, f=st.floats(-50, 50))
def test_at_one_frequency_the_amplitude_is_the_largest_displacement(car, road, f):
    assume(car.b1 + car.b2 > 0.1)
    steady = linear.steady_state(car, road, ExternalForce(f=f, Omega=road.omega))
    t = np.linspace(0.0, 2.0 * math.pi / road.omega, 2001)
    largest = np.max(np.abs([steady.state(each)[:2] for each in t]), axis=0)
    # a peak between samples is missed by (pi / 2000)^2 / 2
    assert largest == pytest.approx(np.array(steady.amplitudes), rel=2e-6, abs=1e-12)


@given(car=st.from_type(PaperCar), road=harmonic, force=st.from_type(ExternalForce))
def test_at_two_frequencies_no_displacement_is_above_the_amplitude(car, road, force):
    assume(car.b1 + car.b2 > 0.1)
    steady = linear.steady_state(car, road, force)
    largest = np.max(np.abs([steady.state(t)[:2] for t in np.linspace(0.0, 20.0, 500)]), axis=0)
    assert np.all(largest <= np.array(steady.amplitudes) * (1.0 + 1e-12))


def test_the_papers_uncontrolled_amplitudes():
    """1.116 and 1.589 m (equations.md, four digits), within 5 % of the paper's 1.12 and 1.566."""
    found = linear.steady_state(PAPER, PAPER_ROAD, PAPER_FORCE).amplitudes
    assert found == pytest.approx((1.116, 1.589), abs=6e-4)
    assert found == pytest.approx((1.12, 1.566), rel=0.05)


@given(...)
def test_a_hump_has_no_steady_state(road: Excitation):
    assume(not road.harmonic)
    with pytest.raises(
        ValueError, match=r"a steady state needs a harmonic road, got .* give a Sine"
    ):
        linear.steady_state(PAPER, road, PAPER_FORCE)


def test_an_undamped_car_at_resonance_has_no_steady_state():
    slow, _ = linear.modes(UNDAMPED)
    with pytest.raises(ValueError, match="meets an undamped mode; give the car damping or another"):
        linear.steady_state(UNDAMPED, roads.harmonic(h=0.1, omega=slow.frequency), PAPER_FORCE)


def test_an_undamped_car_off_resonance_has_one():
    slow, fast = linear.modes(UNDAMPED)
    road = roads.harmonic(h=0.1, omega=0.5 * (slow.frequency + fast.frequency))
    assert min(linear.steady_state(UNDAMPED, road, PAPER_FORCE).amplitudes) > 0.0


@pytest.mark.parametrize(
    ("dt", "substeps", "message"),
    [
        (0.005, 0, "substeps must be at least 1, got 0; give 1 or more"),
        (0.005, 1.5, "substeps must be a whole number, got 1.5"),
        (0.005, None, "substeps must be a whole number, got None"),
        (0.005, 10**9, "substeps must be at most 1000000, got 1000000000"),
        (0.0, 4, "dt must be positive, got 0 s"),
        (math.nan, 4, "dt must be finite, got nan s"),
    ],
)
def test_the_steps_of_an_rk4_transition_are_checked(dt, substeps, message):
    with pytest.raises(ValueError, match=message):
        linear.rk4_transition(PAPER, PAPER_ROAD, PAPER_FORCE, dt, substeps)


@pytest.mark.parametrize("t", [None, math.nan, math.inf])
def test_a_steady_state_is_read_at_a_finite_time(t):
    with pytest.raises(ValueError, match=f"t must be .*, got {t}.*; give a finite number"):
        linear.steady_state(PAPER, PAPER_ROAD, PAPER_FORCE).state(t)


# Cars of parts, actuators ---------------------------------------------------------------------

REAL = QuarterCar.from_physical(60.0, 300.0, 190e3, 16e3, 100.0, 1e3)


def test_a_car_of_linear_parts_has_the_matrices_of_its_coefficients():
    found = linear.matrices(REAL)
    expected = linear.matrices(PaperCar.from_physical(60.0, 300.0, 190e3, 16e3, 100.0, 1e3))
    for name in ("A", "B", "R"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        {"spring": CubicSpring(k=16e3, k3=1e5)},
        {"tyre": LiftOffTyre(k=190e3, c=100.0)},
        {"stops": Stops(bump=0.08, rebound=0.08, k=1e5)},
    ],
)
def test_a_car_that_is_not_linear_has_no_matrices_and_a_slope_at_rest(change):
    car = dataclasses.replace(REAL, **change)
    with pytest.raises(ValueError, match="the car must be linear, got "):
        linear.matrices(car)
    # differences over 1e-6, to 1e-6 (see `linear.jacobian`)
    scale = np.abs(linear.matrices(REAL).A).max()
    np.testing.assert_allclose(
        linear.jacobian(car), linear.matrices(REAL).A, rtol=1e-6, atol=1e-9 * scale
    )


def test_actions_become_specific_forces():
    pair = linear.actuation(PAPER, IndependentActuators(limit=(280.0, 33.0)))
    np.testing.assert_array_equal(pair, np.diag([280.0, 33.0]))
    between = linear.actuation(REAL, SuspensionActuator(limit=600.0))
    assert between == pytest.approx(np.array([[-10.0], [2.0]]), rel=1e-15)


@pytest.mark.parametrize(
    "actuator",
    [
        LaggedSuspensionActuator(limit=1.0, lag=0.1),
        SemiActiveDamper(c_min=100.0, c_max=1000.0),
        SuspensionActuator(limit=1.0, delay=0.01),
    ],
)
def test_an_actuator_that_is_not_linear_or_late_has_no_matrix(actuator):
    with pytest.raises(ValueError, match="the actuator must be linear, at once and without a lag"):
        linear.actuation(REAL, actuator)
