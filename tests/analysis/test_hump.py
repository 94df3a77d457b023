import dataclasses
import itertools
import math
import sys

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal
from scipy.integrate import solve_ivp, trapezoid

from qcar_env.analysis.optimum import hump_certificate, hump_optimum
from qcar_env.control import lqr
from qcar_env.control.skyhook import Skyhook
from qcar_env.parts.actuator import (
    IndependentActuators,
    LaggedSuspensionActuator,
    SemiActiveDamper,
    SuspensionActuator,
)
from qcar_env.parts.damper import BilinearDamper
from qcar_env.parts.spring import Stops
from qcar_env.parts.tyre import LiftOffTyre
from qcar_env.physics import linear
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads.enveloping import moving_average
from qcar_env.roads.flat_tops import FlatTop
from qcar_env.roads.shapes import CircularArc, OneMinusCosine, SquareBar
from qcar_env.roads.train import Train
from qcar_env.scenarios import Scenario, scenario

pytest.importorskip("clarabel")

G = 9.81
# (m1, m2, k1, k2, c1, c2): front corners from the CommonRoad vehicle models 3.0.2 (TUM, BSD-3),
# the Megane of Poussot-Vassal and others (damping recalled), and a heavy axle end.
ESCORT = QuarterCar.from_physical(32.84, 345.1, 189_785.6, 21_898.0, 0.0, 1_459.4)
VANAGON = QuarterCar.from_physical(40.57, 351.8, 212_641.6, 33_577.0, 0.0, 2_405.6)
MEGANE = QuarterCar.from_physical(37.5, 315.0, 210_000.0, 29_500.0, 0.0, 1_500.0)
HEAVY = QuarterCar.from_physical(906.5, 5_333.0, 2_440_000.0, 430_000.0, 0.0, 20_000.0)
WATTS = CircularArc(h=0.1, L=3.7)  # UK practice, IRC 99-1988
BELGIAN = OneMinusCosine(h=0.12, L=4.8)  # decree of 1998
TABLE = FlatTop(h=0.075, ramp=0.975, top=7.0)  # UK, 1:13
BRAZIL_B = CircularArc(h=0.08, L=1.5)  # CONTRAN 600/2016
RUBBER = CircularArc(h=0.05, L=0.9)  # Italy, DPR 495/92
LEAD = 0.3  # flat road before the hump [s]


def case(car, shape, km_h, *, contact=0.25, limit=1_000.0, duration=2.5):
    """A car that meets a hump after 0.3 s; its tyre averages the road over the contact [m]."""
    speed = km_h / 3.6
    road = dataclasses.replace(shape, start=LEAD * speed)
    if contact:
        road = moving_average(road, contact=contact)
    return Scenario(
        car=car,
        road=road,
        speed=speed,
        actuator=SuspensionActuator(limit=limit),
        duration=duration,
        substeps=16,
        travel_limit=100.0,
    )


SMALL = case(ESCORT, BRAZIL_B, 25.0, contact=0.0, duration=0.8)  # half the holds: quicker
COARSE = dataclasses.replace(SMALL, dt=0.02, substeps=64)


@pytest.mark.parametrize(
    ("car", "shape", "km_h", "passive", "left"),
    [
        (ESCORT, WATTS, 30.0, 0.79, (0.409, 0.148, 0.039, 0.037)),
        (MEGANE, BELGIAN, 30.0, 1.03, (0.632, 0.327, 0.075, 0.029)),
        (ESCORT, TABLE, 40.0, 0.58, (0.253, 0.096, 0.043, 0.037)),
        (VANAGON, BRAZIL_B, 20.0, 1.15, (0.782, 0.429, 0.137, 0.058)),
        (ESCORT, RUBBER, 40.0, 0.95, (0.706, 0.548, 0.302, 0.174)),
        (HEAVY, WATTS, 20.0, 0.62, (0.217, 0.083, 0.032, 0.026)),
    ],
)
def test_the_table_of_an_independent_program(car, shape, km_h, passive, left):
    """Peaks [g] at +-0.5, 1, 2 and 4 kN for 345 kg of body, read at the ends of the holds.

    Made with HiGHS from matrices of its own, the whole road known from 0.3 s before the hump, 80 mm
    of travel, the tyre in contact.
    """
    hump = case(car, shape, km_h)
    for force, expected in zip((500.0, 1_000.0, 2_000.0, 4_000.0), left, strict=True):
        found = hump_optimum(hump, force=force * car.m2 / 345.0, preview=None, inside=1)
        assert found.value / G == pytest.approx(expected, rel=0.02)
        assert found.passive / G == pytest.approx(passive, rel=0.02)
        assert found.bound <= found.value
        assert found.gap < 1e-6 * found.passive


# The certificate ---------------------------------------------------------------------------------


def free_motion(hump, t):
    """States of the uncontrolled car at rising times `t`, by DOP853 between the kinks."""
    plant, road = linear.matrices(hump.car), hump.excitation

    def rate(time, x):
        inside = min(max(time, low + 1e-13), high - 1e-13)  # on the piece's own side of a kink
        w = np.array([road.height(inside), road.rate(inside), 0.0]).ravel()
        return plant.A @ x + plant.R @ w

    found, x = [], np.zeros(4)
    ends = [t[0], *road.kinks(t[0], t[-1]), t[-1]]
    for low, high in itertools.pairwise(ends):
        here = t[(t >= low) & (t < high)]
        each = solve_ivp(rate, (low, high), x, "DOP853", [*here, high], rtol=1e-12, atol=1e-14)
        found.append(each.y[:, :-1])
        x = each.y[:, -1]
    return np.column_stack([*found, x]).T


@pytest.mark.parametrize("rate", [None, 20_000.0])
def test_the_proof_holds_when_it_is_computed_by_other_means(rate):
    """The Lagrangian's least value from pulse responses and an integrated free motion, in SI."""
    force, travel = 800.0, 0.05
    found = hump_optimum(SMALL, force=force, travel=travel, rate=rate, inside=1)
    prices, t = found.multipliers, found.t
    n, car = len(t) - 1, SMALL.car
    reference = found.car.reference
    y, tau, kappa, rho = (
        prices.objective,
        reference * prices.travel[:, 0] / travel,
        reference * np.maximum(prices.load[:, 0], 0.0),
        reference * prices.rate / force,
    )
    norm = np.abs(prices.objective).sum()
    assert norm <= 1.0 + 1e-6
    rest = (car.m1 + car.m2) * G
    plant = linear.matrices(car)
    push = plant.B @ [-1.0 / car.m1, 1.0 / car.m2]
    a, b = linear.held_transition(car, SMALL.dt)
    b = b @ [-1.0 / car.m1, 1.0 / car.m2]
    pulse = np.zeros((n + 1, 4))  # of a force of 1 N over the first interval
    pulse[1] = b
    for k in range(1, n):
        pulse[k + 1] = a @ pulse[k]
    free = free_motion(SMALL, t)

    def priced(x, u, at_rest):
        """Multipliers times outputs, for states (n + 1, 4), forces (n,) and the road or none."""
        acceleration = y[:, 0] @ (x[:-1] @ plant.A[3] + push[3] * u)
        acceleration += y[:, 1] @ (x[1:] @ plant.A[3] + push[3] * u)
        height = SMALL.excitation.height(t[1:]) * (not at_rest)
        load = car.tyre.k * (height - x[1:, 0]) / rest
        before = np.concatenate([[0.0], u[:-1]])
        return acceleration + tau @ (x[1:, 1] - x[1:, 0]) - kappa @ load + rho @ (u - before)

    total = priced(free, np.zeros(n), at_rest=False)
    total -= np.abs(tau).sum() * travel + kappa.sum()
    total -= np.abs(rho).sum() * (0.0 if rate is None else rate * SMALL.dt)
    for k in range(n):
        moved = np.zeros((n + 1, 4))
        moved[k:] = pulse[: n + 1 - k]
        total -= force * abs(priced(moved, np.eye(n)[k], at_rest=True))
    # The certificate takes 1e-10 of all its terms off itself, for rounding; they agree to 1e-12.
    total /= max(1.0, norm)
    assert found.bound <= total == pytest.approx(found.bound, rel=1e-8)


def test_any_multipliers_give_a_bound_and_the_found_ones_the_best():
    rng = np.random.default_rng(0)
    for shape in ("held", "any"):
        found = hump_optimum(SMALL, shape=shape)
        value, any_shape = found.value / found.car.reference, shape == "any"
        for size in (1e-6, 1e-3, 0.1):
            moved = {
                name: value * (1.0 + size * rng.normal(size=value.shape))
                for name, value in vars(found.multipliers).items()
            }
            other = hump_certificate.Multipliers(**moved)
            assert hump_certificate.least(found.car, other, any_shape=any_shape) <= value


def test_brute_force_over_a_short_crossing_finds_nothing_better():
    levels = np.linspace(-1.0, 1.0, 13)
    forces = np.array(list(itertools.product(levels, repeat=4)))
    short = dataclasses.replace(COARSE, duration=0.38)  # the hump begins at 0.3 s
    for objective in ("peak_acceleration", "rms_acceleration", "vdv"):
        found = hump_optimum(short, objective, preview=0.0, travel=None, contact=False)
        car, n = found.car, len(found.u)
        assert n == 4
        measured = []
        for u in forces:
            e = car.objective.at(car.motion(u)[:-1], u)
            measured.append(np.linalg.norm(e.ravel(), car.norm))
        best = min(measured) * car.reference
        assert found.value <= best * (1.0 + 1e-9)
        # rounding the best force to the levels moves it by 1/12 at most, in each interval
        response = np.stack([car.objective.at(car.motion(u)[:-1], u) for u in np.eye(4)])
        nothing = car.objective.at(car.motion(np.zeros(4))[:-1], np.zeros(4))
        step = sum(np.linalg.norm((each - nothing).ravel(), car.norm) for each in response)
        if objective != "vdv":
            assert best <= found.value + step / 12.0 * car.reference


def test_the_maps_are_those_of_the_integrated_car():
    """With no force: state, and mean weighted acceleration over each cell."""
    found = hump_optimum(SMALL, "rms_acceleration", force=1e-9, travel=None, contact=False)
    free = free_motion(SMALL, found.t)
    size = np.abs(free).max(axis=0)
    np.testing.assert_allclose(found.x / size, free / size, atol=1e-10)  # of the integrator
    middle = found.t[:-1] + 0.5 * SMALL.dt
    fine = free_motion(SMALL, np.sort(np.concatenate([found.t, middle])))
    means = np.diff(fine[:, 3]) / (0.5 * SMALL.dt)
    expected = math.sqrt(np.sum(means**2) * 0.5 * SMALL.dt / SMALL.duration)
    assert found.value == pytest.approx(expected, rel=1e-9)


# Laws --------------------------------------------------------------------------------------------

LIMITS = st.floats(0.3, 1.0)


@settings(max_examples=8)
@given(
    force=st.floats(100.0, 3_000.0),
    travel=st.floats(0.02, 0.12),
    rate=st.floats(2e3, 2e5),
    preview=st.floats(0.0, 0.3),
    less=LIMITS,
    which=st.sampled_from(["force", "travel", "rate", "preview"]),
    objective=st.sampled_from(["peak_acceleration", "rms_acceleration", "vdv"]),
)
def test_more_force_rate_travel_and_preview_never_leave_more(
    force, travel, rate, preview, less, which, objective
):
    limits = {"force": force, "travel": travel, "rate": rate, "preview": preview}
    smaller = {**limits, which: less * limits[which]}
    more, fewer = (hump_optimum(COARSE, objective, **each) for each in (limits, smaller))
    assert more.bound <= fewer.value
    assert fewer.value == math.inf or more.value <= fewer.value + 1e-5 * more.passive  # the solver


@settings(max_examples=6)
@given(car=st.from_type(QuarterCar), seed=st.integers(0, 2**32 - 1), km_h=st.floats(10.0, 60.0))
def test_no_random_force_is_below_the_bound_on_any_car(car, seed, km_h):
    hump = case(car, BRAZIL_B, km_h, contact=0.0, limit=5.0 * car.m2, duration=0.6)
    hump = dataclasses.replace(hump, dt=0.01, substeps=200)
    held = hump_optimum(hump, travel=None, contact=False)
    free = hump_optimum(hump, travel=None, contact=False, shape="any")
    assert held.gap <= 1e-5 * held.passive
    assert free.bound <= held.value * (1.0 + 1e-9)
    rng = np.random.default_rng(seed)
    sampled = held.car
    for width in (1, 3, 10, 50):
        u = np.repeat(rng.uniform(-1.0, 1.0, sampled.count), width)[: sampled.count]
        e = sampled.every.at(sampled.motion(u)[:-1], u)
        assert np.abs(e).max() >= held.bound


def test_without_contact_and_travel_less_is_left():
    free = hump_optimum(SMALL, travel=None, contact=False)
    short = hump_optimum(SMALL, travel=0.04)
    assert free.bound < short.bound
    assert short.travel <= 0.04 * (1.0 + 2e-3)  # between the nodes
    assert short.load >= -1e-3 * G * (ESCORT.m1 + ESCORT.m2)
    rubber = case(ESCORT, RUBBER, 40.0)
    assert hump_optimum(rubber, force=1.0, contact=False, travel=None).load < 0.0
    kept = hump_optimum(rubber)
    assert kept.load > -0.01 * G * (ESCORT.m1 + ESCORT.m2)


def test_limits_that_no_force_keeps_are_proved_to_be():
    found = hump_optimum(SMALL, force=50.0, travel=0.02)
    assert not found.feasible
    assert (found.value, found.upper, found.bound, found.gap) == (math.inf, math.inf, math.inf, 0.0)
    assert hump_certificate.least(found.car, found.multipliers, any_shape=False) > 0.0


def test_a_rate_of_the_force_is_kept_and_a_slow_one_does_nothing():
    found = hump_optimum(SMALL, rate=20_000.0)
    changes = np.abs(np.diff(found.u, prepend=0.0))
    assert changes.max() <= 20_000.0 * SMALL.dt * (1.0 + 1e-6)
    slow = hump_optimum(SMALL, rate=1e-3, travel=None, contact=False)
    assert slow.value == pytest.approx(slow.passive, rel=1e-3)  # of the peak between the nodes


def test_preview_begins_where_it_is_said_to():
    for preview in (0.0, 0.1, 0.25):
        found = hump_optimum(SMALL, preview=preview)
        assert found.t[0] == pytest.approx(LEAD - preview)
    assert hump_optimum(SMALL, preview=None).t[0] == 0.0
    assert hump_optimum(SMALL, preview=5.0).t[0] == 0.0
    # a force that is held begins no earlier, one of every shape no later
    assert hump_optimum(SMALL, preview=0.1023).t[0] == pytest.approx(0.2)
    assert hump_optimum(SMALL, preview=0.1023, shape="any").t[0] == pytest.approx(0.195)


@pytest.mark.parametrize("objective", ["peak_acceleration", "rms_acceleration", "vdv"])
def test_the_bracket_of_forces_of_every_shape_closes(objective):
    held = hump_optimum(SMALL, objective)
    coarse, fine = (hump_optimum(SMALL, objective, shape="any", inside=n) for n in (4, 16))
    assert coarse.bound <= fine.bound <= fine.value * (1.0 + 1e-6)
    assert fine.gap < 0.5 * coarse.gap  # it falls in proportion: 1/4
    assert fine.bound <= held.value
    assert coarse.bound > 0.9 * held.bound  # what 200 Hz costs is less


@pytest.mark.parametrize("objective", ["peak_acceleration", "rms_acceleration", "vdv"])
@pytest.mark.parametrize("rate", [None, 50_000.0])
def test_forces_held_for_a_millisecond_stay_above_the_bound_of_every_shape(objective, rate):
    every = hump_optimum(SMALL, objective, rate=rate, shape="any")
    quick = hump_optimum(SMALL, objective, rate=rate, dt=0.001, inside=1)
    assert every.bound <= quick.value
    assert quick.value <= hump_optimum(SMALL, objective, rate=rate).value * 1.001  # dose: cells


def test_a_rate_limit_binds_forces_of_every_shape_too():
    held, free = (hump_optimum(SMALL, rate=20_000.0, shape=each) for each in ("held", "any"))
    unlimited = hump_optimum(SMALL, shape="any")
    assert unlimited.bound < free.bound <= held.value


def test_roads_of_every_kind_with_jumps_and_trains():
    damped = QuarterCar.from_physical(32.84, 345.1, 189_785.6, 21_898.0, 500.0, 1_459.4)
    bar = case(damped, SquareBar(h=0.02, L=0.3), 20.0, contact=0.0, duration=0.8)
    found = hump_optimum(bar, force=1e-6, travel=None, contact=False)
    # A jump of the road throws the damped wheel: both sides of it are integrated.
    plant, x, t = linear.matrices(damped), np.zeros(4), found.t[0]
    for kink, jump in zip(bar.excitation.kinks(0.0, 0.8), (0.02, -0.02), strict=True):
        x = linear.held_transition(damped, kink - t)[0] @ (x - _rest(t, bar)) + _rest(t, bar)
        x = x + plant.R[:, 1] * jump
        t = kink
    x = linear.held_transition(damped, found.t[-1] - t)[0] @ x
    np.testing.assert_allclose(found.x[-1], x, atol=1e-9)
    one = dataclasses.replace(WATTS, start=LEAD * 30.0 / 3.6)
    two = dataclasses.replace(case(ESCORT, WATTS, 30.0), road=Train(shape=one, count=2, gap=5.0))
    alone = hump_optimum(dataclasses.replace(two, road=one))
    assert hump_optimum(two).bound >= alone.bound * (1.0 - 1e-6)  # the solver


def _rest(t, bar):
    height = float(bar.excitation.height(t)[()]) if t else 0.0
    return np.array([height, height, 0.0, 0.0])


# Weighting ---------------------------------------------------------------------------------------


def wk():
    """Wk of ISO 8041-1, analogue: zeros, poles, gain [rad/s]."""
    w1, w2 = 2.0 * math.pi * 0.4, 2.0 * math.pi * 100.0
    w3 = w4 = 2.0 * math.pi * 12.5
    w5, w6 = 2.0 * math.pi * 2.37, 2.0 * math.pi * 3.35

    def roots(w, q):
        return np.roots([1.0, w / q, w * w])

    zeros = np.concatenate([[0.0, 0.0], [-w3], roots(w5, 0.91)])
    poles = np.concatenate(
        [roots(w1, math.sqrt(0.5)), roots(w2, math.sqrt(0.5)), roots(w4, 0.63), roots(w6, 0.91)]
    )
    # (s + w3) / w3 over the transition, (w5/w6)^2 (s/w5)^2 of the step, w2^2 of the low pass
    return zeros, poles, w2 * w2 * w4 * w4 / w3


def test_the_weighting_of_the_test_is_wk():
    _, gain = signal.freqs_zpk(*wk(), worN=2.0 * math.pi * np.array([1.0, 8.0, 16.0]))
    # ISO 8041-1:2017 Annex B
    np.testing.assert_allclose(np.abs(gain), [0.4825, 1.036, 0.7687], rtol=2e-3)


def test_a_weighted_optimum_is_that_of_the_filtered_acceleration():
    hump = case(ESCORT, WATTS, 30.0)
    found = hump_optimum(hump, "rms_acceleration", weighting=wk())
    plain = hump_optimum(hump, "rms_acceleration")
    assert found.gap < 1e-6 * found.passive
    assert found.bound < plain.bound  # Wk is below 1 but near 8 Hz
    # Uncontrolled: the integrated acceleration through the filter by other means
    t = np.linspace(0.0, 2.5, 25_001)
    acceleration = free_motion(hump, t) @ linear.matrices(ESCORT).A[3]
    sections = signal.zpk2sos(*signal.bilinear_zpk(*wk(), fs=1e4))
    rms = math.sqrt(np.mean(signal.sosfilt(sections, acceleration) ** 2))
    assert found.passive == pytest.approx(rms, rel=1e-3)
    free = hump_optimum(hump, "vdv", weighting=wk(), shape="any")
    held = hump_optimum(hump, "vdv", weighting=wk())
    assert free.bound <= held.value


def test_a_weighting_of_one_changes_nothing():
    one = (np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)))
    given_one = hump_optimum(SMALL, weighting=one)
    assert given_one.value == pytest.approx(hump_optimum(SMALL).value, rel=1e-9)


# The environment ---------------------------------------------------------------------------------


def driven(hump, act):
    """Drive through the environment; largest |a| at the holds' ends, travel, least load, states."""
    env = gym.make("QuarterCarHump-v0", scenario=hump).unwrapped
    env.reset(seed=0, options={"state": np.zeros(4)})
    plant, limit = linear.matrices(hump.car), hump.actuator.limit[0]
    into = plant.B @ [-1.0 / hump.car.m1, 1.0 / hump.car.m2]
    x, states, peak, travel, load = np.zeros(4), [np.zeros(4)], 0.0, 0.0, math.inf
    for k in range(hump.steps):
        *_, info = env.step(np.array([act(k, x) / limit], dtype=np.float32))
        force = info["force"][0]
        before, x = x, np.array(env.state)
        ends = np.array([before, x]) @ plant.A[3] + into[3] * force
        peak = max(peak, np.abs(ends).max())
        travel = max(travel, abs(x[1] - x[0]))
        tyre = hump.car.tyre.k * (hump.excitation.height((k + 1) * hump.dt) - x[0])
        load = min(load, float(tyre) + (hump.car.m1 + hump.car.m2) * G)
        states.append(x)
    return peak, travel, load, np.array(states)


@pytest.mark.parametrize(
    ("car", "shape", "km_h"), [(ESCORT, WATTS, 30.0), (VANAGON, BRAZIL_B, 20.0)]
)
def test_the_environment_confirms_the_force_of_an_optimum(car, shape, km_h):
    hump = case(car, shape, km_h)
    found = hump_optimum(hump, inside=1)
    first = round(found.t[0] / hump.dt)
    peak, travel, load, states = driven(
        hump, lambda k, _: found.u[k - first] if k >= first else 0.0
    )
    # RK4 with 16 substeps and actions of 24 bits
    assert peak == pytest.approx(found.value, rel=1e-4)
    assert travel <= 0.08 * (1.0 + 1e-4)
    assert load >= -1.0
    np.testing.assert_allclose(states[first:], found.x, atol=1e-4 * np.abs(states).max())


def skyhook(hump):
    law = Skyhook(G=6.0)
    return lambda _, x: hump.car.m2 * -law.G * x[3]


def regulator(hump):
    scale = np.array([0.1, 0.1, 1.0, 1.0])
    limit = hump.actuator.limit[0]
    push = np.array([[-limit / hump.car.m1], [limit / hump.car.m2]])
    plant = lqr.sampled_plant(hump.car, scale, push, hump.dt)
    gain = lqr.regulator(plant, lqr.Weights(q1=0.1, q2=10.0, r1=0.1, r2=0.1))[0]
    return lambda _, x: -limit * float(gain @ (x / scale))


@pytest.mark.parametrize("law", ["passive", "skyhook", "lqr"])
@pytest.mark.parametrize(("car", "shape", "km_h"), [(ESCORT, WATTS, 30.0), (MEGANE, BELGIAN, 20.0)])
def test_no_policy_is_below_its_bound(law, car, shape, km_h):
    hump = case(car, shape, km_h)
    policies = {"passive": lambda _: lambda k, x: 0.0, "skyhook": skyhook, "lqr": regulator}
    peak, travel, load, _ = driven(hump, policies[law](hump))
    blind = hump_optimum(hump, travel=None, contact=False, preview=0.0, inside=1)
    assert peak >= blind.bound
    if load > 0.0:  # a bound of its own, from the travel that it takes; RK4 errs by 1e-6
        own = hump_optimum(hump, travel=travel * (1.0 + 1e-4), preview=0.0, inside=1)
        assert blind.bound <= own.bound * (1.0 + 1e-6) <= peak * (1.0 + 1e-4)


# What is refused ---------------------------------------------------------------------------------

BENT = dataclasses.replace(
    ESCORT,
    damper=BilinearDamper(c_compression=1e3, c_rebound=1.5e3, knee=0.2, fast=0.3),
    tyre=LiftOffTyre(k=189_785.6),
    stops=Stops(bump=0.08, rebound=0.08, k=4e4, k3=1e7),
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"car": BENT}, "car must be linear, got damper BilinearDamper, tyre LiftOffTyre, stops S"),
        (
            {"actuator": LaggedSuspensionActuator(limit=1e3, lag=0.01)},
            "actuator must push between the masses, linear and without a lag, got Lagged",
        ),
        ({"actuator": SemiActiveDamper(c_min=1.0, c_max=2.0)}, "got SemiActiveDamper"),
        ({"actuator": IndependentActuators(limit=(1.0, 1.0))}, "got IndependentActuators"),
        ({"actuator": SuspensionActuator(limit=1e3, delay=0.01)}, "got a delay of 0.01 s"),
    ],
)
def test_what_is_not_linear_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        hump_optimum(dataclasses.replace(SMALL, **change))


def test_the_papers_car_is_refused():
    with pytest.raises(ValueError, match="must have masses, got a PaperCar"):
        hump_optimum("paper-hump")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"objective": "travel"}, "unknown objective 'travel'"),
        ({"shape": "square"}, "unknown shape 'square'"),
        ({"force": 0.0}, "force must be positive"),
        ({"travel": -0.08}, "travel must be positive"),
        ({"rate": math.nan}, "rate must be finite"),
        ({"preview": -0.1}, "preview must not be negative"),
        ({"inside": 0}, "inside must be at least 1"),
        ({"dt": 1e-9}, "duration must be 1 to 1000000 nodes long"),
        ({"dt": 0.5}, "dt must be at most"),
        ({"duration": 0.2, "preview": 0.05}, "duration must reach beyond"),
        ({"duration": 0.25}, "nothing moves the car"),
        ({"weighting": 3.0}, "weighting must be a filter"),
        ({"weighting": ([1.0], [1.0, -1.0])}, "weighting must be stable"),
        ({"weighting": (np.eye(2), np.eye(2), np.eye(2), np.eye(2))}, "one finite input"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        hump_optimum(SMALL, **arguments)


def test_a_missing_solver_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(ImportError, match=r"pip install 'qcar_env\[headroom\]'"):
        hump_optimum(SMALL)


def test_a_road_that_is_known_from_its_beginning():
    pushed = dataclasses.replace(SMALL, force=ExternalForce(f=1.0, Omega=10.0))
    assert hump_optimum(pushed, preview=0.1).t[0] == 0.0
    sine = dataclasses.replace(
        scenario("mathworks-hump"), road=scenario("paper").road, speed=1.0, duration=0.3
    )
    assert hump_optimum(sine, preview=0.1, travel=None, contact=False).t[0] == 0.0


def test_the_external_force_enters():
    """A constant force of f alone: without control the body sags towards f m2 / k2."""
    pushed = dataclasses.replace(SMALL, force=ExternalForce(f=1.0, Omega=0.0))
    flat = dataclasses.replace(pushed, road=dataclasses.replace(BRAZIL_B, h=1e-12, start=2.0))
    found = hump_optimum(flat, force=3.0 * ESCORT.m2, travel=None, contact=False, duration=0.5)
    assert found.passive == pytest.approx(1.0, rel=1e-6)  # at once
    # The force that holds the body throws the wheel, whose damper pushes on the body by the end of
    # the hold: c2 / m2 times m2 / m1 f dt = 0.22 m/s^2, half of it to either side.
    assert found.value == pytest.approx(0.5 * 1_459.4 / ESCORT.m1 * flat.dt, rel=0.02)
    assert found.u[0] == pytest.approx(-ESCORT.m2 * (1.0 + found.value), rel=1e-3)


def test_a_dose_and_a_mean_square_integrate_their_powers():
    found = hump_optimum(SMALL, "vdv", force=1e-9, travel=None, contact=False)
    plant = linear.matrices(ESCORT)
    t = np.linspace(0.0, SMALL.duration, 8_001)
    a = free_motion(SMALL, t) @ plant.A[3]
    assert found.passive == pytest.approx(float(trapezoid(a**4, t)) ** 0.25, rel=1e-4)
    assert found.value <= found.passive * (1.0 + 1e-6)  # means over cells, by Jensen
