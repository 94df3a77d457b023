"""Outcomes: what is measured, over which window, against what."""

import dataclasses
import math

import numpy as np
import pytest

from qcar_env import scenario
from qcar_env.evaluation import metrics
from qcar_env.evaluation.outcome import Outcome, outcome
from qcar_env.evaluation.rollouts import Rollout

PAPER = scenario("paper")
HUMP = scenario("mathworks-hump")


def record(nominal, seconds, terminated=False):
    """Return a rollout whose first half is ten times larger than its second."""
    t = nominal.dt * np.arange(1, round(seconds / nominal.dt) + 1)
    size = np.where(t <= t[-1] / 2, 10.0, 1.0)
    omega = nominal.reference_frequency
    x, v = size * np.cos(omega * t), -size * omega * np.sin(omega * t)
    force = np.outer(x, [3.0, 7.0][: nominal.actuator.size])
    return Rollout(
        t=t, x1=0.1 * x, x2=-0.2 * x, v1=0.1 * v, v2=-0.2 * v, force=force, reward=x,
        terminated=terminated, scenario=nominal, before=(1.0, -2.0, 0.0, 0.0),
    )  # fmt: skip


def test_on_an_endless_road_the_last_periods_count():
    found = outcome("mine", record(PAPER, 5.0), periods=5)
    # a cubic over 0.275 rad misses a peak by 0.275^4 / 384
    assert found.amplitudes == pytest.approx((0.1, 0.2), rel=2e-5)
    assert found.peak_force == pytest.approx((3.0, 7.0), rel=0.01)
    # 115 samples of five periods of 114.2: the rest of a sample
    assert found.rms_force == pytest.approx((3.0 / math.sqrt(2), 7.0 / math.sqrt(2)), rel=0.01)
    assert (found.policy, found.terminated) == ("mine", False)


def test_over_a_hump_the_whole_crossing_counts():
    found = outcome("mine", record(HUMP, 4.0), periods=None)
    assert found.amplitudes == pytest.approx((1.0, 2.0), rel=0.01)
    assert len(found.peak_force) == 1


def test_an_episode_that_broke_off_counts_whole():
    found = outcome("mine", record(PAPER, 0.1, terminated=True), periods=5)
    assert found.terminated
    assert found.amplitudes == pytest.approx((1.0, 2.0), rel=0.04)  # one period's samples


def test_the_measures_follow_from_the_amplitudes():
    found = Outcome(
        policy="p", amplitudes=(0.1, 0.5), uncontrolled=(1.0, 1.5), peak_force=(1.0,),
        rms_force=(1.0,), terminated=False,
    )  # fmt: skip
    assert found.percentage_errors == pytest.approx((900.0, 200.0))
    assert found.reductions == pytest.approx((20.0, metrics.reduction_db(3.0, 1.0)))
    assert found.rho == pytest.approx(1.0 / 3.0)
    idle = dataclasses.replace(found, amplitudes=found.uncontrolled)
    assert (idle.rho, idle.percentage_errors, idle.reductions) == (1.0, (0.0, 0.0), (0.0, 0.0))


def test_a_record_too_short_to_be_steady_is_refused():
    with pytest.raises(ValueError, match=r"record must hold 5 periods .* simulate longer"):
        outcome("mine", record(PAPER, 0.1), periods=5)
