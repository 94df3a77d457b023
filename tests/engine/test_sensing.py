"""Sensors and delays of a fleet: noise that belongs to an episode, readings that are late."""

import dataclasses

import gymnasium as gym
import numpy as np
from scipy import stats

from qcar_env import scenario
from qcar_env.engine.sensing import hashed
from qcar_env.parts.sensor import Sensor

PAPER = scenario("paper")
STEPS = 60


def readings(seed: int = 0, **sensor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what a sensor of x2 shows and what is true, one row for each control interval."""
    scale = PAPER.reference.scales["x2"]
    sensed = dataclasses.replace(PAPER, sensors=(Sensor(signal="x2", **sensor),))
    found = []
    for each in (sensed, PAPER):
        env = gym.make("QuarterCarHump-v0", scenario=each, observe=("x2",))
        rows = [env.reset(seed=seed, options={"state": (0.1, 0.2, 1.0, 1.0), "phase": 0.0})[0]]
        rows += [env.step(np.zeros(2, np.float32))[0] for _ in range(STEPS)]
        found.append(np.array(rows)[:, 0].astype(float) * scale)
    return found[0], found[1]


def test_the_noise_of_sensors_is_uniform_and_of_one_episode_each():
    pairs = [(u, s) for u in (0.1, 0.7) for s in (0, 1)]
    with np.errstate(over="ignore"):  # products of 64 bits wrap around, as they should
        drawn = np.array([[hashed(u, k, s) for k in range(400)] for u, s in pairs])
    assert len(np.unique(drawn)) == drawn.size
    assert stats.kstest(drawn.ravel(), "uniform").pvalue > 1e-3
    correlation = np.corrcoef(drawn)
    assert np.abs(correlation[np.triu_indices(4, 1)]).max() < 0.2  # 4 of 1 / sqrt(400)


def test_a_sensor_without_faults_shows_the_truth():
    shown, true = readings()
    np.testing.assert_allclose(shown, true, atol=1e-6)


def test_noise_has_its_standard_deviation_and_bias_its_size():
    shown, true = readings(noise=0.1, bias=0.5)
    error = shown - true
    assert abs(error.mean() - 0.5) < 5 * 0.1 / np.sqrt(STEPS)
    assert 0.07 < error.std() < 0.13  # 0.1 (1 +- 3 / sqrt(2 STEPS))
    again, _ = readings(noise=0.1, bias=0.5)
    np.testing.assert_array_equal(shown, again)
    other, _ = readings(seed=1, noise=0.1, bias=0.5)
    assert not np.array_equal(shown, other)


def test_a_late_reading_is_the_one_of_so_many_intervals_before():
    shown, true = readings(delay=3 * PAPER.dt)
    np.testing.assert_allclose(shown[3:], true[:-3], atol=1e-6)
    np.testing.assert_allclose(shown[:3], true[0], atol=1e-6)


def test_a_sampled_reading_is_held():
    shown, true = readings(period=4 * PAPER.dt)
    held = np.repeat(true[::4], 4)[: len(true)]
    np.testing.assert_allclose(shown, held, atol=1e-6)


def test_an_action_that_is_late_acts_so_many_intervals_later():
    late = dataclasses.replace(
        PAPER, actuator=dataclasses.replace(PAPER.actuator, delay=2 * PAPER.dt)
    )
    action = np.random.default_rng(0).uniform(-1, 1, (STEPS, 2)).astype(np.float32)
    forces = []
    for each in (late, PAPER):
        env = gym.make("QuarterCarHump-v0", scenario=each)
        env.reset(seed=0, options={"state": (0.0, 0.0, 0.0, 0.0)})
        forces.append(np.array([env.step(a)[4]["force"] for a in action]))
    np.testing.assert_array_equal(forces[0][2:], forces[1][:-2])
    np.testing.assert_array_equal(forces[0][:2], 0.0)
