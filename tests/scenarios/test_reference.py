"""The uncontrolled motion: what observations, rewards and scores are divided by."""

import dataclasses
import itertools

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from qcar_env import SCENARIOS, scenario
from qcar_env.physics import linear
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.signals import SIGNALS, signal
from qcar_env.roads import excitation
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.shapes import HalfSine, Sine, Step
from qcar_env.roads.train import Train

PAPER, HUMP = scenario("paper"), scenario("mathworks-hump")


def _rise(s):
    return 0.01 * (s - 1.0) if s > 1.0 else 0.0


def peaks(found):
    """Return max |x1|, |x2|, |v1|, |v2| of a crossing from rest without control, by DOP853."""
    m, road = linear.matrices(found.car), found.excitation
    ends = [0.0, *road.kinks(0.0, found.duration), found.duration]
    x, most = np.zeros(4), np.zeros(4)
    for a, b in itertools.pairwise(ends):

        def f(t, x, a=a, b=b):
            t = min(max(t, a), np.nextafter(b, a))
            outside = [float(road.height(t)), float(road.rate(t)), float(found.force.value(t))]
            return m.A @ x + m.R @ outside

        t = np.linspace(a, b, 2000)
        y = solve_ivp(f, (a, b), x, "DOP853", t, rtol=1e-9, atol=1e-11, max_step=0.01).y
        x, most = y[:, -1], np.maximum(most, np.abs(y).max(axis=1))
    return most


def test_amplitudes_of_a_hump_are_the_peaks_of_a_crossing_from_rest():
    # peaks between two control instants are missed by (58 rad/s * 5 ms)^2 / 8 = 1 % at most
    assert HUMP.reference.amplitudes == pytest.approx(tuple(peaks(HUMP)[:2]), rel=0.01)


STEP = scenario("paper-step")


@pytest.mark.parametrize("f", [0.0, 24.8])
@pytest.mark.parametrize("start", [0.0, 0.25])
def test_a_step_is_measured_with_where_it_leaves_the_car_however_short_the_episode(start, f):
    h, w = 0.1, 55.0
    road, force = Step(h=h, start=start * STEP.speed), ExternalForce(f=f, Omega=w)
    step = dataclasses.replace(STEP, road=road, force=force, duration=0.5)
    found = np.array(step.reference.amplitudes)
    m = linear.matrices(step.car)
    static = np.linalg.solve(-m.A, m.R[:, 0] * h)
    shaken = np.linalg.solve(1j * w * np.eye(4) - m.A, m.R[:, 2] * f)
    comes_to = (np.abs(static) + np.abs(shaken))[:2]
    # 1e-6 of the transient is left, and 10 000 phases have been seen
    assert np.all(found >= comes_to * (1.0 - 1e-4))

    def rate(t, x, y):
        return m.A @ x + m.R[:, 0] * y + m.R[:, 2] * f * np.cos(w * t)

    x, most = np.zeros(4), np.zeros(2)
    for a, b, y in ((0.0, start, 0.0), (start, 70.0, h)):
        x = x + m.R[:, 1] * y  # the rate of a step is infinite for no time
        t = np.linspace(a, b, 2 + round((b - a) / 5e-4))
        if a < b:
            moved = solve_ivp(rate, (a, b), x, "DOP853", t, args=(y,), rtol=1e-10, atol=1e-12).y
            x, most = moved[:, -1], np.maximum(most, np.abs(moved[:2]).max(axis=1))
    # peaks between two control instants are missed by (55 rad/s * 5 ms)^2 / 8 = 1 % at most
    assert np.all(most <= 1.01 * found)
    assert np.all(most >= 0.999 * found)


def test_the_amplitudes_on_a_step_do_not_depend_on_the_length_of_the_episode():
    longer = dataclasses.replace(STEP, duration=20.0)
    assert longer.reference.amplitudes == STEP.reference.amplitudes


def test_a_road_that_ends_after_the_episode_or_goes_on_is_measured_in_the_episode():
    late = dataclasses.replace(STEP, road=Step(h=0.1, start=100.0))  # met after 12.5 s
    flat = dataclasses.replace(STEP, road=Step(h=0.0, start=100.0))
    assert late.reference.amplitudes == flat.reference.amplitudes
    rising = FunctionRoad(profile=_rise, kinks_at=(1.0,))
    found = dataclasses.replace(HUMP, road=rising, duration=1.0)
    assert found.reference.amplitudes[1] < 0.01 * found.speed * found.duration


def test_amplitudes_of_an_endless_sine_are_the_steady_ones():
    steady = linear.steady_state(PAPER.car, PAPER.excitation, PAPER.force).amplitudes
    assert PAPER.reference_amplitudes == steady
    assert PAPER.reference.amplitudes == steady


def test_each_signal_is_scaled_by_its_own_largest_value_from_rest_and_from_drawn_starts():
    most = peaks(HUMP)
    scales = HUMP.reference.scales
    for name, value in zip(("x1", "x2", "v1", "v2"), most, strict=True):
        assert scales[name] >= 0.99 * value
    assert scales["y"] == pytest.approx(0.1, rel=1e-3)
    assert scales["y_dot"] == pytest.approx(HUMP.excitation.omega * 0.1, rel=1e-3)
    assert scales["F"] == 0.0


def test_the_presets_of_version_0_1_0_state_the_scales_that_they_had():
    for name in ("paper", "paper-randomised"):
        found = SCENARIOS[name].reference
        steady = linear.steady_state(PAPER.car, PAPER.excitation, PAPER.force).amplitudes
        assert found.start == pytest.approx(steady, rel=1e-12)
        assert found.scales["v1"] == 55.0 * found.start[0]
    hump = SCENARIOS["paper-hump"]
    alone = excitation.harmonic(h=0.0, omega=1.0)
    steady = linear.steady_state(hump.car, alone, hump.force).amplitudes
    assert hump.reference.start == pytest.approx(steady, rel=1e-12)


def test_scales_do_not_depend_on_the_force_limit():
    assert HUMP.with_force_scale(0.5).reference.scales["x1"] == HUMP.reference.scales["x1"]
    assert HUMP.with_force_scale(0.5).reference.scales["limit"] == 750.0


def test_a_stated_scale_is_taken_and_one_that_is_not_is_found():
    assert PAPER.reference.scale(signal("y"), PAPER) == 0.1
    assert PAPER.reference.scale(signal("body_acceleration"), PAPER) > 100.0
    assert PAPER.reference.scale(signal("u2"), PAPER) == 33.0


@pytest.mark.parametrize("gap", [0.0, 1e-12, 0.5])
def test_humps_may_touch(gap):
    """Without a gap the end of a hump and the beginning of the next fall on one instant."""
    for wavenumber in (3.0, 17.5):
        shape = HalfSine(h=0.1, wavenumber=wavenumber, start=0.3)
        found = dataclasses.replace(HUMP, road=Train(shape=shape, count=4, gap=gap), speed=1.0)
        assert min(found.reference.amplitudes) > 0.0


@pytest.mark.parametrize("name", ["mathworks-hump", "paper-step"])
def test_no_signal_of_an_idle_car_exceeds_its_scale(name):
    """From rest and from starts that the scales have not seen, with a margin for the latter."""
    masses = SCENARIOS[name].car.has_masses
    names = [each.name for each in SIGNALS.values() if masses or not each.needs_masses]
    env = gym.make("QuarterCarHump-v0", scenario=name, observe=names)
    idle = np.zeros(env.action_space.shape, np.float32)
    at_rest = {"state": (0.0, 0.0, 0.0, 0.0)}
    for seed, most, options in ((0, 1.0 + 1e-6, at_rest), (1, 1.6, None), (2, 1.6, None)):
        seen, _ = env.reset(seed=seed, options=options)
        largest, done = np.abs(seen), False
        while not done:
            seen, _, terminated, truncated, _ = env.step(idle)
            largest, done = np.maximum(largest, np.abs(seen)), terminated or truncated
        assert largest.max() <= most


def test_a_car_that_does_not_move_is_refused():
    still = dataclasses.replace(PAPER, road=Sine(h=0.0, wavenumber=1.0), force=ExternalForce())
    with pytest.raises(ValueError, match=r"car must move, got amplitudes \(0.0, 0.0\) m"):
        _ = still.reference
    early = dataclasses.replace(HUMP, duration=0.1)
    with pytest.raises(ValueError, match=r"must move, .*or the episode a longer duration"):
        _ = early.reference


def test_the_reference_frequency_is_the_roads_else_the_bodys_own():
    assert dataclasses.replace(PAPER, force=ExternalForce(f=1, Omega=9)).reference_frequency == 55.0
    assert HUMP.reference_frequency == HUMP.reference.frequencies[1]
