"""RK4 of a car over an interval: against DOP853, across kinks, and against printed peaks."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from qcar_env.physics import linear, motion, roads
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.dynamics import accelerations, forcing_by
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.forcing import (
    Amplitudes,
    World,
    amplitudes_of,
    forcing,
    forcing_in_the_middle,
    passage_of,
    turn_world,
)
from qcar_env.physics.rk4 import step_fractions
from qcar_env.physics.roads import Phasor, Road
from qcar_env.physics.state import State

MATHWORKS = QuarterCar.from_physical(
    m1=60.0, m2=300.0, k1=190_000.0, k2=16_000.0, c1=0.0, c2=1_000.0
)
REST = State(0.0, 0.0, 0.0, 0.0)
NO_FORCE = ExternalForce()
FLAT = roads.step(h=0.0, start=1e9)


def drive(car, road, force, x, t, dt, substeps, u=(0.0, 0.0)):
    """Return state and world at ``t + dt``."""
    plant = motion.plant(car, road, force, dt / substeps)
    world = motion.world_at(t, road, force)
    x, world, _ = motion.interval(x, world, road.next_kink(t), t, dt, substeps, *u, plant)
    return x, world


# Against DOP853 ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def errors(crossings):
    """Errors with steps of at most 0.2 rad and of half that, over the size of the motion."""
    found = np.empty((len(crossings), 2))
    for each, row in zip(crossings, found, strict=True):
        x0, end = State(*each.x0), each.edges[-1]
        count = math.ceil(end * each.fastest / 0.2)
        for i, substeps in enumerate((count, 2 * count)):
            x, _ = drive(each.car, each.road, each.force, x0, 0.0, end, substeps, each.u)
            row[i] = np.max(np.abs(np.array(x) - each.truth) / each.scale)
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
    fine = {name: [] for name in roads.PROFILES}
    for each, (_, error) in zip(crossings, errors, strict=True):
        fine[each.road.profile].append(error)
    assert len(fine[profile]) == 50
    assert np.median(fine[profile]) < 10 * np.median(fine["harmonic"])


# Kinks ------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(
    x=st.from_type(State),
    start=st.floats(0.0, 0.1),
    omega=st.floats(40.0, 400.0),
    gap=st.floats(0.0, 2.0),
    cut=st.floats(0.001, 0.099),
)
def test_an_interval_may_hold_many_kinks(x, start, omega, gap, cut):
    """However the kinks lie, one interval of 0.1 s ends where the exact pieces end."""
    road = roads.train(h=0.1, omega=omega, start=start, count=4, gap=gap)
    force = ExternalForce(f=10.0, Omega=30.0)
    found, world = drive(MATHWORKS, road, force, x, 0.0, 0.1, 200)
    exact = np.array(x)
    edges = [0.0, *road.kinks(0.0, 0.1), 0.1]
    for begin, end in itertools.pairwise(edges):
        if end > begin:
            inside = road.phasor(0.5 * (begin + end))
            local = (0.0, 1.0) if inside.s or inside.c else (0.0, 0.0)
            transition = linear.exact_transition(MATHWORKS, road, force, end - begin)
            exact = apply(transition, exact, local, force.phasor(begin))
    # steps of 400 rad/s * 0.5 ms = 0.2 at most: 0.2^5 / 120 each of a road's share in the motion
    scale = np.max(np.abs(x)) + 5.0
    assert np.array(found) == pytest.approx(exact, abs=1e-5 * scale)
    later = motion.world_at(0.1, road, force)
    assert np.array(world.road) == pytest.approx(np.array(later.road), abs=1e-11)
    assert np.array(world.force) == pytest.approx(np.array(later.force), abs=1e-11)
    # two intervals that meet anywhere make the same way
    plant = motion.plant(MATHWORKS, road, force, cut / 200)
    start_world = motion.world_at(0.0, road, force)
    half, middle, kink = motion.interval(
        x, start_world, road.next_kink(0.0), 0.0, cut, 200, 0.0, 0.0, plant
    )
    plant = motion.plant(MATHWORKS, road, force, (0.1 - cut) / 200)
    whole, _, _ = motion.interval(half, middle, kink, cut, 0.1 - cut, 200, 0.0, 0.0, plant)
    assert np.array(whole) == pytest.approx(exact, abs=1e-5 * scale)


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
    x, t, kink = REST, 0.0, road.next_kink(0.0)
    plant = motion.plant(MATHWORKS, road, NO_FORCE, 0.05 / 50)
    world = motion.world_at(0.0, road, NO_FORCE)
    for _ in range(4):
        x, world, kink = motion.interval(x, world, kink, t, 0.05, 50, 0.0, 0.0, plant)
        t += 0.05
    exact = np.zeros(4)
    exact = apply(linear.exact_transition(MATHWORKS, road, NO_FORCE, 0.05), exact, (0, 1), (0, 1))
    rest = t - road.end
    if rest > 0.0:
        exact = apply(
            linear.exact_transition(MATHWORKS, road, NO_FORCE, rest), exact, (0, 0), (0, 1)
        )
    # RK4's phase error: z^4 / 120 of the angle turned, z = 63 rad/s * 1 ms, angle 63 rad/s * 0.2 s,
    # of velocities of some m/s: 5e-6; a step across the kink would cost 63 * 0.1 m * z = 0.4
    assert np.array(x) == pytest.approx(exact, abs=1e-5)
    assert world.road == (0.0, 0.0)


@pytest.mark.parametrize(
    ("kink", "road", "expected"),
    [
        (0, roads.hump(h=0.1, omega=5.0), (0.0, 1.0)),
        (1, roads.hump(h=0.1, omega=5.0), (0.0, 0.0)),
        (2, roads.train(h=0.1, omega=5.0, count=2, gap=1.0), (0.0, 1.0)),
        (0, roads.step(h=0.1), (1.0, 0.0)),
    ],
)
def test_a_piece_begins_as_the_road_says(kink, road, expected):
    assert motion.piece_phasor(kink, road.pieces) == expected


@given(...)
def test_the_world_turns_with_the_road(road: Road, force: ExternalForce):
    """Phasors that were turned for a second are those of the later time."""
    plant = motion.plant(MATHWORKS, road, force, 0.005 / 4)
    world = motion.world_at(0.0, road, force)
    kink, x = road.next_kink(0.0), REST
    for k in range(200):
        x, world, kink = motion.interval(x, world, kink, k * 0.005, 0.005, 4, 0.0, 0.0, plant)
    assume(not road.kinks(1.0 - 1e-9, 1.0 + 1e-9))
    later = motion.world_at(1.0, road, force)
    # 1600 turns, each rounded to 2e-16 of a phasor of length 1
    assert np.array(world.road) == pytest.approx(np.array(later.road), abs=1e-12)
    assert np.array(world.force) == pytest.approx(np.array(later.force), abs=1e-12)


angles = st.floats(-7.0, 7.0)


@given(t=angles, T=angles, theta=angles, Theta=angles, h=st.floats(-1, 1), f=st.floats(-9, 9))
def test_a_passage_is_two_halves_and_looks_half_a_step_ahead(t, T, theta, Theta, h, f):
    car, omega = MATHWORKS.coefficients, 30.0
    world = World(motion.angle(t), motion.angle(T))
    half = World(motion.angle(theta), motion.angle(Theta))
    amplitudes = amplitudes_of(h, omega, f, car)
    passage = passage_of(half, amplitudes)
    later = World(motion.angle(t + theta), motion.angle(T + Theta))
    expected = forcing_by(h * later.road.s, h * omega * later.road.c, f * later.force.c, car)
    scale = abs(amplitudes.road_s) + abs(amplitudes.road_c) + abs(f)
    # angles of 14 are rounded to 1.8e-15
    assert forcing_in_the_middle(world, passage.middle) == pytest.approx(
        expected, abs=4e-15 * scale
    )
    end = turn_world(world, passage.by)
    for found, twice in zip(end, (t + 2.0 * theta, T + 2.0 * Theta), strict=True):
        # the same, and the angles' double, of up to 21
        assert found == pytest.approx(motion.angle(twice), abs=8e-15)


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
    dt = 0.002
    plant = motion.plant(MATHWORKS, road, NO_FORCE, dt)
    x, world, kink = REST, motion.world_at(0.0, road, NO_FORCE), road.next_kink(0.0)
    found = []
    for k in range(round((road.end + 3.0) / dt)):  # three periods of the body: its peaks are past
        x, world, kink = motion.interval(x, world, kink, k * dt, dt, 1, 0.0, 0.0, plant)
        found.append(
            (x.x2, accelerations(x, 0.0, 0.0, forcing(world, plant.amplitudes), plant.car)[1])
        )
    body, acceleration = np.array(found).T
    # printed to four decimals and to three; a peak is missed by (58 rad/s * 1 ms)^2 / 2 = 0.17 %
    # of the wheel's share in an acceleration
    assert (body.max(), body.min()) == pytest.approx((x_max, x_min), abs=0.6e-4)
    assert (acceleration.max(), acceleration.min()) == pytest.approx(
        (a_max, a_min), abs=0.6e-3, rel=2e-3
    )


# Energy -----------------------------------------------------------------------------------------


def energy(x, car):
    """Energy over half the wheel's mass; the springs follow from E1 = k2 / m1, mu1 = k1 / m1."""
    travel = x[1] - x[0]
    masses = x[2] ** 2 + car.m2 / car.m1 * x[3] ** 2
    return masses + car.mu1 * x[0] ** 2 + car.E1 * travel**2


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
    plant = motion.plant(car, FLAT, NO_FORCE, step)
    world, now = motion.world_at(0.0, FLAT, NO_FORCE), energy(x, car)
    first = now
    for _ in range(100):
        x, world = motion.substep(
            x, world, plant.passage, plant.amplitudes, plant.step, 0.0, 0.0, plant.car
        )
        before, now = now, energy(x, car)
        # RK4 itself may add its local error, z^5 / 120 = 8e-6 at z = 0.25, where no damper works
        assert now <= before * (1.0 + 1.6e-5)
    assert now <= first * (1.0 + 1e-12)


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
        car = QuarterCar.from_physical(60.0, 300.0, 190e3, 16e3, 0.0, 1e3, reciprocal=reciprocal)
        springs = np.array([[car.mu1 + car.E1, -car.E1], [-car.E1, car.E1]])
        metric = np.zeros((4, 4))
        metric[:2, :2], metric[2:, 2:] = springs, np.diag([1.0, car.m2 / car.m1])
        root = np.linalg.cholesky(metric).T
        transition = linear.exact_transition(car, FLAT, NO_FORCE, t)
        gains.append(np.linalg.norm(root @ transition.A @ np.linalg.inv(root), 2) ** 2)
    printed, newton = gains
    assert printed > 1.5
    assert newton <= 1.0


def test_a_car_with_the_printed_coupling_can_flutter():
    """Softer tyre than suspension and light body: the motion grows for ever, though damped."""
    parts = (30.0, 20.0, 1e4, 9e5, 0.0, 4e3)
    assert np.max(linear.poles(QuarterCar.from_physical(*parts, reciprocal=False)).real) > 1.0
    assert np.max(linear.poles(QuarterCar.from_physical(*parts)).real) < 0.0


# One source -------------------------------------------------------------------------------------


def test_floats_arrays_and_tensors_give_the_same_bits(same_bits):
    rng = np.random.default_rng(1)
    n = 101
    x = State(*rng.normal(size=(4, n)))
    angles = rng.uniform(0.0, 6.0, size=(4, n))
    phasors = [Phasor(np.sin(each), np.cos(each)) for each in angles]
    world, half = World(*phasors[:2]), World(*phasors[2:])
    amplitudes = Amplitudes(*rng.normal(size=(3, n)))
    passage = passage_of(half, amplitudes)
    step = step_fractions(rng.uniform(1e-3, 5e-3, size=n))
    car = MATHWORKS.coefficients._replace(b1=rng.uniform(1.0, 9.0, size=n))
    car = type(car)(*(np.broadcast_to(each, n).copy() for each in car))
    u1, u2 = rng.normal(size=(2, n))
    same_bits(forcing, world, amplitudes)
    same_bits(forcing_in_the_middle, world, passage.middle)
    same_bits(turn_world, world, half)
    same_bits(passage_of, half, amplitudes)
    same_bits(motion.substep, x, world, passage, amplitudes, step, u1, u2, car)
