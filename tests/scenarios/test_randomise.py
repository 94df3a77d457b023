"""What varies: distributions as the engine draws them, and what they change."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from qcar_env import SCENARIOS, scenario
from qcar_env.engine.sensing import hashed
from qcar_env.physics.car import PaperCar
from qcar_env.physics.tree import flat
from qcar_env.scenarios import Choice, LogUniform, Normal, Uniform, Vary
from qcar_env.scenarios.randomise import body_mass_of_paper_car, wheel_mass_of_paper_car

PAPER, HUMP = scenario("paper"), scenario("mathworks-hump")
RANDOMISED = SCENARIOS["paper-randomised"]
share = st.floats(0.0, 1.0, exclude_max=True)


@given(u=share)
@pytest.mark.parametrize(
    ("mine", "scipys"),
    [
        (Uniform(low=-2.0, high=3.0), stats.uniform(-2.0, 5.0)),
        (LogUniform(low=0.1, high=20.0), stats.loguniform(0.1, 20.0)),
        (Normal(mean=5.0, sd=0.3), stats.norm(5.0, 0.3)),
    ],
    ids=["uniform", "log-uniform", "normal"],
)
def test_values_are_scipys_quantiles(mine, scipys, u):
    low, high = mine.ends  # of a normal number four standard deviations away, not at infinity
    assert mine.value(u) == pytest.approx(min(max(scipys.ppf(u), low), high), rel=1e-13, abs=1e-13)


@pytest.mark.parametrize(
    "mine", [Uniform(low=1.0, high=2.0), LogUniform(low=1.0, high=9.0), Normal(mean=0.0, sd=2.0)]
)
def test_values_are_finite_at_both_ends(mine):
    assert all(math.isfinite(mine.value(u)) for u in (0.0, 5e-324, 1.0 - 2**-53))


@given(u=share)
@pytest.mark.parametrize(
    "mine",
    [
        Uniform(low=1.0, high=2.0),
        LogUniform(low=1.0, high=9.0),
        Normal(mean=5.0, sd=2.0),
        Choice(values=(3.0, 1.0, 4.0)),
    ],
)
def test_no_value_lies_beyond_the_ends(mine, u):
    assert min(mine.ends) <= mine.value(u) <= max(mine.ends)


def test_the_ends_are_what_the_distribution_says():
    assert Uniform(low=1.0, high=2.0).ends == pytest.approx((1.0, 2.0))
    assert LogUniform(low=1.0, high=9.0).ends == pytest.approx((1.0, 9.0))
    assert Normal(mean=5.0, sd=2.0).ends == (-3.0, 13.0)
    assert Choice(values=(3.0, 1.0, 4.0)).ends == (3.0, 1.0, 4.0)


@pytest.mark.parametrize(
    ("varied", "message"),
    [
        (Vary(by=Normal(mean=1.0, sd=0.3), numbers=("car.m2",)), "car.m2 by -0.2: .*m2 must be"),
        (Vary(by=Choice(values=(1.0, -1.0)), numbers=("car.m1",)), "car.m1 by -1: .*m1 must be"),
        (Vary(by=Uniform(low=-1.0, high=1.0), numbers={"speed": 0.0}), "speed by -1: speed V? ?m"),
        (Vary(by=Uniform(low=1.0, high=1e9), numbers=("car.tyre.k",)), "tyre.k by 1e.09: integr"),
        (
            (
                Vary(by=Uniform(low=1.0, high=100.0), numbers=("car.tyre.k",)),
                Vary(by=Uniform(low=0.05, high=1.0), numbers=("car.m1",)),
            ),
            "tyre.k by 100, car.m1 by 0.05: integration step must be below",
        ),
    ],
)
def test_a_number_that_makes_no_car_is_refused_before_it_is_drawn(varied, message):
    """A negative mass was driven without a word, in one episode of many."""
    with pytest.raises(ValueError, match=f"^every drawn number must make a scenario, .*{message}"):
        dataclasses.replace(HUMP, randomisation=varied)


@pytest.mark.parametrize("preset", [each for each in SCENARIOS.values() if each.randomisation])
@given(data=st.data())
def test_what_is_drawn_lies_between_the_extremes(preset, data):
    rows = np.array([flat(each.numbers) for each in preset.extremes()])
    us = data.draw(st.lists(share, min_size=(n := len(preset.randomisation)), max_size=n))
    row = np.array(flat(preset.drawn(us).numbers))
    slack = 1e-12 * np.abs(row)
    assert np.all(rows.min(axis=0) - slack <= row)
    assert np.all(row <= rows.max(axis=0) + slack)


@given(u=share)
def test_a_choice_takes_each_value_alike(u):
    values = (3.0, 1.0, 4.0, 1.5)
    assert Choice(values=values).value(u) == values[int(4 * u)]


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
        (lambda: Uniform(low=2.0, high=1.0), "a range must rise, got 2 to 1; swap the two"),
        (lambda: LogUniform(low=0.0, high=1.0), "lowest value low must be positive, got 0"),
        (lambda: Normal(mean=0.0, sd=-1.0), "standard deviation sd must not be negative, got -1"),
        (lambda: Uniform(low=math.nan, high=1.0), "lowest value low must be finite, got nan"),
        (lambda: Choice(values=()), r"a choice needs values, got \(\); give a tuple"),
        (lambda: Choice(values=(1.0, math.inf)), "value of a choice must be finite, got inf"),
        (lambda: Vary(by=1.0, numbers=("speed",)), "distribution must be of class Distribution"),
        (lambda: Vary(by=Uniform(low=1, high=2), numbers=()), "numbers must be paths such as"),
        (
            lambda: Vary(by=Uniform(low=1, high=2), numbers={"speed": math.inf}),
            "power of speed must be finite, got inf",
        ),
    ],
)
def test_distributions_and_paths_are_checked(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@given(u=share, power=st.sampled_from([1.0, -1.0, -0.5, 2.0, 0.0]))
def test_a_drawn_number_multiplies_by_its_power_or_replaces(u, power):
    by = Uniform(low=0.5, high=1.5) if power else Uniform(low=200.0, high=400.0)
    found = dataclasses.replace(HUMP, randomisation=Vary(by=by, numbers={"car.m2": power}))
    drawn = by.value(u)
    expected = 300.0 * drawn**power if power else drawn
    assert found.drawn([u]).car.m2 == pytest.approx(expected, rel=1e-15)
    assert found.drawn([u]).randomisation == ()


def test_paths_alone_are_powers_of_one():
    by = Uniform(low=0.5, high=1.5)
    for given_as in ("speed", ("speed",), ["speed"], {"speed": 1.0}):
        assert dict(Vary(by=by, numbers=given_as).numbers) == {"speed": 1.0}


@given(factor=st.floats(0.5, 2.0))
def test_masses_of_the_papers_car_leave_its_newtons_as_they_are(factor):
    """Springs, dampers, external force and actuators, times the mass they act on."""
    by = Choice(values=(factor,))
    parts = dict(m1=60.0, m2=300.0, k1=190e3, k2=16e3, c1=50.0, c2=1e3)
    nominal = dataclasses.replace(PAPER, car=PaperCar.from_physical(**parts), dt=0.002)
    for vary, mass, index in (
        (wheel_mass_of_paper_car(by), "m1", 0),
        (body_mass_of_paper_car(by), "m2", 1),
    ):
        found = dataclasses.replace(nominal, randomisation=vary).drawn([0.5])
        expected = PaperCar.from_physical(**parts | {mass: parts[mass] * factor})
        assert tuple(found.car.numbers) == pytest.approx(tuple(expected.numbers), rel=1e-15)
        limit = PAPER.actuator.limit[index] / factor
        assert found.actuator.limit[index] == pytest.approx(limit, rel=1e-15)
        f = PAPER.force.f / factor if mass == "m2" else PAPER.force.f
        assert found.force.f == pytest.approx(f, rel=1e-15)


@given(seed=st.integers(0, 2**32 - 1))
def test_draws_stay_in_their_ranges_and_do_not_compound(seed):
    rng = np.random.default_rng(seed)
    for _ in range(5):
        found = RANDOMISED.drawn(rng.random(5))
        factors = {
            "height": (found.road.h / 0.1, 0.5, 1.5),
            "frequency": (found.excitation.omega / 55.0, 0.9, 1.1),
            "body": (0.71 / found.car.b2, 0.9, 1.1),
            "wheel": (8.7 / found.car.b1, 0.9, 1.1),
        }
        for name, (factor, low, high) in factors.items():
            assert low * (1 - 1e-15) <= factor <= high * (1 + 1e-15), name
        assert found.force.Omega == found.excitation.omega


def test_equal_draws_are_equal_scenarios_and_others_are_not():
    rng = np.random.default_rng(7)
    a, b = rng.random(5), rng.random(5)
    assert RANDOMISED.drawn(a) == RANDOMISED.drawn(a)
    assert RANDOMISED.drawn(a) != RANDOMISED.drawn(b)
    assert PAPER.drawn(a) is PAPER
