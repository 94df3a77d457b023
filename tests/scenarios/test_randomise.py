"""What varies: distributions, paths, and draws that do not compound."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from qcar_env import scenario
from qcar_env.engine.random import standard
from qcar_env.engine.sensing import hashed
from qcar_env.scenarios import Choice, LogUniform, Normal, Uniform, Vary

PAPER, VARIED = scenario("paper"), scenario("paper-randomised")
share = st.floats(0.0, 1.0, exclude_max=True)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Uniform(low=0.5, high=1.5), stats.uniform(0.5, 1.0)),
        (LogUniform(low=0.1, high=10.0), stats.loguniform(0.1, 10.0)),
        (Normal(mean=2.0, sd=0.3), stats.norm(2.0, 0.3)),
    ],
)
def test_a_distribution_is_scipys(ours, theirs):
    shares = np.linspace(0.001, 0.999, 97)
    np.testing.assert_allclose([ours.value(u) for u in shares], theirs.ppf(shares), rtol=1e-12)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=6), share)
def test_a_choice_takes_one_of_its_values(values, u):
    assert Choice(values=tuple(values)).value(u) in values


def test_the_normal_distribution_reaches_its_tails():
    for u in (1e-300, 1e-20, 1e-6, 0.5, 1.0 - 1e-12):
        assert standard(u) == pytest.approx(stats.norm.ppf(u), rel=1e-13, abs=1e-15)


def test_the_noise_of_sensors_is_uniform_and_of_one_episode_each():
    pairs = [(u, s) for u in (0.1, 0.7) for s in (0, 1)]
    with np.errstate(over="ignore"):  # products of 64 bits wrap around, as they should
        drawn = np.array([[hashed(u, k, s) for k in range(400)] for u, s in pairs])
    assert len(np.unique(drawn)) == drawn.size
    assert stats.kstest(drawn.ravel(), "uniform").pvalue > 1e-3
    correlation = np.corrcoef(drawn)
    assert np.abs(correlation[np.triu_indices(4, 1)]).max() < 0.2  # 4 of 1 / sqrt(400)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Uniform(low=2.0, high=1.0), "must rise"),
        (lambda: LogUniform(low=0.0, high=1.0), "positive"),
        (lambda: Normal(mean=0.0, sd=-1.0), "not be negative|negative"),
        (lambda: Choice(values=()), "needs values"),
        (lambda: Vary(by=1.0, numbers="speed"), "distribution"),
        (lambda: Vary(by=Uniform(low=0.0, high=1.0), numbers=()), "paths"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@given(st.lists(share, min_size=5, max_size=5))
def test_draws_stay_in_their_ranges_and_do_not_compound(uniforms):
    once = VARIED.drawn(uniforms)
    assert once == VARIED.drawn(uniforms)
    assert once.randomisation == ()
    assert 0.05 <= once.road.h <= 0.15
    assert 0.9 <= once.speed / VARIED.speed <= 1.1
    assert once.drawn(uniforms) is once


@given(load=st.floats(0.9, 1.1), wheel=st.floats(0.9, 1.1))
def test_forces_keep_their_newtons_when_masses_vary(load, wheel):
    """Specific forces fall with the mass that they are divided by; a spring's do likewise."""
    u = [0.5, 0.5, 0.5, (load - 0.9) / 0.2, (wheel - 0.9) / 0.2]
    u = [min(each, np.nextafter(1.0, 0.0)) for each in u]
    found, base = VARIED.drawn(u), PAPER
    close = lambda a, b: a == pytest.approx(b, rel=1e-9)  # noqa: E731 - one word for it
    assert close(found.actuator.limit[0] * wheel, base.actuator.limit[0])
    assert close(found.actuator.limit[1] * load, base.actuator.limit[1])
    assert close(found.force.f * load, base.force.f)
    assert close(found.car.mu1 * wheel, base.car.mu1)
    assert close(found.car.omega2**2 * load, base.car.omega2**2)


def test_a_drawn_number_replaces_or_multiplies():
    by = Uniform(low=2.0, high=4.0)
    multiplied = dataclasses.replace(PAPER, randomisation=Vary(by=by, numbers={"road.h": 1.0}))
    replaced = dataclasses.replace(PAPER, randomisation=Vary(by=by, numbers={"speed": 0.0}))
    assert multiplied.drawn([0.5]).road.h == pytest.approx(0.3)
    assert replaced.drawn([0.5]).speed == 3.0
