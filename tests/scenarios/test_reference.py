"""The uncontrolled motion, which observations, rewards and scores are divided by."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from qcar_env import SCENARIOS, scenario
from qcar_env.analysis.simulate import simulate
from qcar_env.control import Passive
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.signals import SIGNALS
from qcar_env.roads.shapes import Sine

HUMP = scenario("mathworks-hump")


def test_reference_amplitudes_of_a_hump_are_the_peaks_of_an_episode_from_rest():
    found = simulate(HUMP.car, HUMP.excitation, HUMP.force, Passive(), duration=4.0, step=1e-3)
    peaks = np.abs(found.x1).max(), np.abs(found.x2).max()
    assert HUMP.reference_amplitudes == pytest.approx(peaks, rel=1e-3)  # read every 5 ms


def test_reference_amplitudes_of_a_harmonic_road_are_the_steady_ones():
    paper = scenario("paper")
    scales = paper.scales
    assert paper.reference_amplitudes == pytest.approx((scales.A1, scales.A2), rel=1e-12)


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
    still = dataclasses.replace(HUMP, road=Sine(h=0.0, wavenumber=1.0), force=ExternalForce())
    with pytest.raises(ValueError, match="must move"):
        _ = still.reference
