"""RK4 of a car over an interval: against DOP853, across kinks, and against printed peaks."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, example, given, settings, strategies as st

from qcar_env.analysis.simulate import simulate
from qcar_env.control.law import Law
from qcar_env.control.passive import Passive
from qcar_env.parts.part import number
from qcar_env.physics import linear, motion
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Phasor, Phasors, Turning
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.state import State
from qcar_env.roads import excitation as roads
from qcar_env.validation import finite

MATHWORKS = QuarterCar.from_physical(
    m1=60.0, m2=300.0, k1=190_000.0, k2=16_000.0, c1=0.0, c2=1_000.0
)
REST = State(0.0, 0.0, 0.0, 0.0)
NO_FORCE = ExternalForce()
PAPER = PaperCar(
    omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5, mu1=2510.0, mu2=16.0
)
FLAT = roads.step(h=0.0, start=1e9)


@dataclass(frozen=True, kw_only=True)
class Push(Law):
    """Constant forces."""

    u1: float = number("", "m/s^2", finite)
    u2: float = number("", "m/s^2", finite)

    @staticmethod
    def command(x, eta, p):
        return p.u1 + 0.0 * x.v1, p.u2 + 0.0 * x.v2


def drive(car, road, force, x, dt, steps, u=(0.0, 0.0)):
    """Return the state after `dt`, (4,)."""
    law = Push(u1=u[0], u2=u[1])
    found = simulate(car, road, force, law, duration=dt, step=dt / steps, start=x)
    return np.array([found.x1[-1], found.x2[-1], found.v1[-1], found.v2[-1]])


# Against DOP853 ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def errors(crossings):
    """Errors with steps of at most 0.2 rad and of half that, over the size of the motion."""
    found = np.empty((len(crossings), 2))
    for each, row in zip(crossings, found, strict=True):
        x0, end = State(*each.x0), each.edges[-1]
        count = math.ceil(end * each.fastest / 0.2)
        for i, substeps in enumerate((count, 2 * count)):
            x = drive(each.car, each.road, each.force, x0, end, substeps, each.u)
            row[i] = np.max(np.abs(x - each.truth) / each.scale)
    return found


def test_the_error_falls_with_the_fourth_power_of_the_step(errors):
    # a step z = 0.1 costs z^5 / 120 of the state, and 0.3 s hold at most 60 rad / 0.1 of them
    assert np.max(errors[:, 1]) < 600 * 0.1**5 / 120 * 10  # 10: forces move the car further
    ratios = errors[:, 0] / errors[:, 1]
    resolved = errors[:, 1] > 1e-11  # below, the truth's own error counts
    assert np.mean(resolved) > 0.9
    assert np.median(ratios) == pytest.approx(16.0, rel=0.05)
    # the next power adds a share of the order of the step, 0.2 to 0.1, to each crossing's ratio,
    # and more where the leading term happens to vanish: so for all but a few of 200
    assert np.mean(np.abs(ratios[resolved] / 16.0 - 1.0) < 0.2) > 0.97


@pytest.mark.parametrize("profile", ["hump", "train", "step"])
def test_a_kink_does_not_lower_the_order(crossings, errors, profile):
    """A step across a kink would leave an error that falls with the first power."""
    fine = {name: [] for name in ("harmonic", "hump", "train", "step")}
    for each, (_, error) in zip(crossings, errors, strict=True):
        fine[each.profile].append(error)
    assert len(fine[profile]) == 50
    assert np.median(fine[profile]) < 10 * np.median(fine["harmonic"])


# Kinks ------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(
    x=st.from_type(State),
    start=st.floats(0.0, 0.1),
    omega=st.floats(40.0, 400.0),
    gap=st.floats(0.0, 2.0),
)
@example(x=REST, start=0.1, omega=400.0, gap=0.0)  # the first kink ends the interval
@example(x=REST, start=math.nextafter(0.1, 0.0), omega=400.0, gap=0.0)
@example(x=REST, start=0.1 - math.pi / 400.0, omega=400.0, gap=0.0)
def test_an_interval_may_hold_many_kinks(x, start, omega, gap):
    """However the kinks lie, an interval of 0.1 s ends where the exact pieces end."""
    road = roads.train(h=0.1, omega=omega, start=start, count=4, gap=gap)
    force = ExternalForce(f=10.0, Omega=30.0)
    found = drive(MATHWORKS, road, force, x, 0.1, 200)
    exact = np.array(x)
    edges = [0.0, *road.kinks(0.0, 0.1), 0.1]
    for begin, end in itertools.pairwise(edges):
        if end > begin:
            middle = 0.5 * (begin + end)
            inside = road.height(middle) or road.rate(middle)
            local = (0.0, 1.0) if inside else (0.0, 0.0)
            transition = linear.exact_transition(MATHWORKS, road, force, end - begin)
            exact = apply(transition, exact, local, force.phasor(begin))
    # steps of 400 rad/s * 0.5 ms = 0.2 at most: 0.2^5 / 120 each of a road's share in the motion
    scale = np.max(np.abs(x)) + 5.0
    assert found == pytest.approx(exact, abs=1e-5 * scale)


def apply(transition, x, road, force):
    return (
        transition.A @ x
        + transition.road @ np.array([float(each) for each in road])
        + transition.force @ np.array([float(each) for each in force])
    )


@pytest.mark.parametrize("start", [0.0, 0.05, 0.1])
def test_a_kink_at_an_edge_of_the_interval_is_met_once(start):
    """A hump that begins with the interval or ends it, to the last bit."""
    road = roads.hump(h=0.1, omega=math.pi / 0.05, start=start)
    x, t = drive(MATHWORKS, road, NO_FORCE, REST, 0.2, 200), 0.2
    exact = np.zeros(4)
    exact = apply(linear.exact_transition(MATHWORKS, road, NO_FORCE, 0.05), exact, (0, 1), (0, 1))
    rest = t - road.end
    if rest > 0.0:
        exact = apply(
            linear.exact_transition(MATHWORKS, road, NO_FORCE, rest), exact, (0, 0), (0, 1)
        )
    # RK4's phase error: z^4 / 120 of the angle turned, z = 63 rad/s * 1 ms, angle 63 rad/s * 0.2 s,
    # of velocities of some m/s: 5e-6; a step across the kink would cost 63 * 0.1 m * z = 0.4
    assert x == pytest.approx(exact, abs=1e-5)


angles = st.floats(-7.0, 7.0)


@given(t=angles, T=angles, theta=angles, Theta=angles, h=st.floats(-1, 1), f=st.floats(-9, 9))
def test_a_step_turns_by_two_halves_and_looks_half_a_step_ahead(t, T, theta, Theta, h, f):
    functions, c, omega = PAPER.functions, PAPER.numbers, 30.0
    phasors = Phasors(motion.angle(t), motion.angle(T))
    road_s, road_c = functions.road_input(h, 0.0, c), functions.road_input(0.0, h * omega, c)
    # frequencies theta and Theta over a step of 2 s
    prepared = motion.turning(road_s, road_c, f, theta, Theta, 2.0)
    road, force = motion.angle(t + theta), motion.angle(T + Theta)
    expected = functions.road_input(h * road.s, h * omega * road.c, c).specific
    scale = abs(road_s.specific) + abs(road_c.specific)
    found = motion.combine(
        prepared.middle_s, phasors.road.s, prepared.middle_c, phasors.road.c
    ).specific
    # angles of 14 are rounded to 1.8e-15; below 1e-300 numbers have fewer digits
    assert found == pytest.approx(expected, abs=4e-15 * scale + 1e-300)
    assert motion.middle_force(phasors.force, prepared) == pytest.approx(
        f * force.c, abs=4e-15 * abs(f) + 1e-300
    )
    end = motion.turn_both(phasors, prepared.by)
    for turned, twice in zip(end, (t + 2.0 * theta, T + 2.0 * Theta), strict=True):
        # the same, and the angles' double, of up to 21
        assert turned == pytest.approx(motion.angle(twice), abs=8e-15)


# Printed peaks ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("L", "V", "x_max", "x_min", "a_max", "a_min"),
    [  # of the body [m], [m/s^2]; the car of the MathWorks example, one hump 0.1 m high
        (3.0, 5.0, 0.1014, -0.0162, 1.026, -0.635),
        (3.0, 10.0, 0.1365, -0.0424, 2.622, -2.054),
        (9.0, 30.0, 0.1365, -0.0424, 2.622, -2.054),
        (3.0, 30.0, 0.1162, -0.0610, 5.795, -7.820),
        (5.0, 20.0, 0.1417, -0.0608, 3.557, -2.803),
        (9.0, 5.0, 0.1005, -0.0054, 0.338, -0.158),
    ],
)
def test_peaks_over_a_half_sine_hump(L, V, x_max, x_min, a_max, a_min):
    road = roads.hump(h=0.1, V=V, L=L)
    # three periods of the body: its peaks are past
    found = simulate(MATHWORKS, road, NO_FORCE, Passive(), duration=road.end + 3.0, step=0.002)
    plant = linear.matrices(MATHWORKS)
    x = np.array([found.x1, found.x2, found.v1, found.v2])
    body, acceleration = found.x2, plant.A[3] @ x  # the road does not touch the body
    # printed to four decimals and to three; a peak is missed by (58 rad/s * 1 ms)^2 / 2 = 0.17 %
    # of the wheel's share in an acceleration
    assert (body.max(), body.min()) == pytest.approx((x_max, x_min), abs=0.6e-4)
    assert (acceleration.max(), acceleration.min()) == pytest.approx(
        (a_max, a_min), abs=0.6e-3, rel=2e-3
    )


# Energy -----------------------------------------------------------------------------------------


def energy(x, car):
    """Energy over half the wheel's mass."""
    travel = x[1] - x[0]
    masses = x[2] ** 2 + car.m2 / car.m1 * x[3] ** 2
    return masses + (car.tyre.k * x[0] ** 2 + car.spring.k * travel**2) / car.m1


parts = dict(
    m1=st.floats(20.0, 500.0),
    m2=st.floats(150.0, 3_000.0),
    k1=st.floats(5e4, 6e5),
    k2=st.floats(5e3, 1e5),
    c1=st.floats(0.0, 2e3),
    c2=st.floats(0.0, 1e4),
)


@given(car=st.builds(QuarterCar.from_physical, **parts), x=st.from_type(State))
def test_energy_never_grows_in_an_undriven_reciprocal_car(car, x):
    assume(any(x))
    step = 0.25 / float(np.max(np.abs(linear.poles(car))))
    found = simulate(car, FLAT, NO_FORCE, Passive(), duration=100 * step, step=step, start=x)
    path = energy(np.array([found.x1, found.x2, found.v1, found.v2]), car)
    # RK4 itself may add its local error, z^5 / 120 = 8e-6 at z = 0.25, where no damper works
    assert np.all(path[1:] <= path[:-1] * (1.0 + 1.6e-5))
    assert path[-1] <= path[0] * (1.0 + 1e-12)


@given(
    car=st.builds(QuarterCar.from_physical, **parts), x=st.from_type(State), t=st.floats(1e-3, 1)
)
def test_energy_never_grows_over_an_exact_transition(car, x, t):
    transition = linear.exact_transition(car, FLAT, NO_FORCE, t)
    # rounding of the exponential, 1e-13 of the state, enters twice
    assert energy(transition.A @ np.array(x), car) <= energy(np.array(x), car) * (1.0 + 1e-11)


@pytest.mark.parametrize("t", [0.05, 0.2, 0.5, 1.0])
def test_a_car_with_the_printed_coupling_can_gain_energy_without_a_source(t):
    """Erratum 6: the largest gain over all starts, the norm of the transition in energy."""
    gains = []
    for reciprocal in (False, True):
        car = PaperCar.from_physical(60.0, 300.0, 190e3, 16e3, 0.0, 1e3, reciprocal=reciprocal)
        springs = np.array([[car.mu1 + car.E1, -car.E1], [-car.E1, car.E1]])
        metric = np.zeros((4, 4))
        metric[:2, :2], metric[2:, 2:] = springs, np.diag([1.0, 300.0 / 60.0])
        root = np.linalg.cholesky(metric).T
        transition = linear.exact_transition(car, FLAT, NO_FORCE, t)
        gains.append(np.linalg.norm(root @ transition.A @ np.linalg.inv(root), 2) ** 2)
    printed, newton = gains
    assert printed > 1.5
    assert newton <= 1.0


def test_a_car_with_the_printed_coupling_can_flutter():
    """Softer tyre than suspension and light body: the motion grows for ever, though damped."""
    parts = (30.0, 20.0, 1e4, 9e5, 0.0, 4e3)
    assert np.max(linear.poles(PaperCar.from_physical(*parts, reciprocal=False)).real) > 1.0
    assert np.max(linear.poles(PaperCar.from_physical(*parts)).real) < 0.0


# One source -------------------------------------------------------------------------------------


def test_floats_arrays_and_tensors_give_the_same_bits(same_bits):
    rng = np.random.default_rng(1)
    n = 101
    x = State(*rng.normal(size=(4, n)))
    phasors = [Phasor(np.sin(each), np.cos(each)) for each in rng.uniform(0.0, 6.0, size=(4, n))]
    now, by = Phasors(*phasors[:2]), Phasors(*phasors[2:])
    functions = PAPER.functions
    car = type(PAPER.numbers)(*(np.full(n, each) for each in PAPER.numbers))
    parts = [functions.road_input(*rng.normal(size=(2, n)), car) for _ in range(4)]
    F, F_s, F_c = rng.normal(size=(3, n))
    prepared = Turning(parts[0], parts[1], F, parts[2], parts[3], F_s, F_c, by)
    step = step_fractions(rng.uniform(1e-3, 5e-3, size=n))
    u1, u2 = rng.normal(size=(2, n))

    def turned(x, phasors, prepared, step, u1, u2, car):
        return motion.turning_step(functions.rate, x, phasors, prepared, step, u1, u2, car)

    def given(x, phasors, prepared, step, u1, u2, car):
        return motion.given_step(
            functions.rate, x, phasors, prepared, step, *parts_of(prepared), u1, u2, car
        )

    def parts_of(prepared):
        return prepared.road_s, prepared.middle_s, prepared.middle_c

    same_bits(motion.input_of, now, prepared)
    same_bits(motion.turn_both, now, by)
    same_bits(turned, x, now, prepared, step, u1, u2, car)
    same_bits(given, x, now, prepared, step, u1, u2, car)
