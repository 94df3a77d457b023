import dataclasses

import numpy as np
import pytest

from qcar_env.baselines import catalogue
from qcar_env.evaluation import tracks
from qcar_env.evaluation.score import score
from qcar_env.evaluation.standings import standings
from qcar_env.evaluation.tracks import TRACKS, Track, episodes, track
from qcar_env.parts.spring import CubicSpring
from qcar_env.scenarios import Uniform, Vary, scenario

PAPER_EPISODE = (
    -0.028035910828983154,
    -0.1498915737976206,
    8.681360364792353,
    1.002978777907892,
    3.627106450440241,
)
RANDOMISED_EPISODE = (
    -0.028035910828983154,
    -0.1498915737976206,
    8.681360364792353,
    1.002978777907892,
    0.9820432110915398,
    1.1838073607727797,
    1.0664303691119001,
    1.0889958437737453,
    1.0679945986258397,
    3.627106450440241,
)

# Gains tuned from rest alone: from there the best of the linear laws, but with a second steady
# motion that one start in fifteen ends in.
FROM_REST_ALONE = {
    "k11": -8.1080591,
    "k12": 75.446057,
    "k13": -56.88911,
    "k14": 116.61457,
    "k21": -0.45915054,
    "k22": -122.33068,
    "k23": -5.4801455,
    "k24": -122.33235,
    "w11": -0.95770623,
    "w12": -0.46525037,
    "w13": 0.024785945,
    "w14": -0.05527676,
    "w21": 0.00059503895,
    "w22": -0.023028521,
    "w23": -0.74476639,
    "w24": -0.099446083,
}


@pytest.mark.parametrize("name", list(TRACKS))
@pytest.mark.parametrize("split", tracks.SPLITS)
def test_a_set_is_the_same_every_time_and_differs_from_the_other_sets(name, split):
    each = track(name)
    scale = each.force_scales[-1]
    first = episodes(each, split, force_scale=scale)
    assert first == episodes(each, split, force_scale=scale)
    assert first != episodes(each, split, force_scale=scale, seed=each.seed + 1)
    for other in tracks.SPLITS:
        if other != split:
            phases = {episode.phase for episode in episodes(each, other, force_scale=scale)}
            drawn = [episode.phase for episode in first if episode.phase != 0.0]
            assert drawn
            assert phases.isdisjoint(drawn)


def test_draws_are_the_same_at_every_force_limit():
    each = track("randomised")
    high, low = (episodes(each, force_scale=scale) for scale in (1.0, 0.5))
    for a, b in zip(high, low, strict=True):
        assert (a.phase, a.state, a.scenario.car, a.scenario.road) == (
            b.phase,
            b.state,
            b.scenario.car,
            b.scenario.road,
        )
        np.testing.assert_allclose(
            a.scenario.actuator.limit, 2.0 * np.array(b.scenario.actuator.limit), rtol=1e-15
        )


def test_a_latin_hypercube_has_one_value_in_each_cell():
    each = track("randomised")
    heights = [e.drawn["road.h"] for e in episodes(each, force_scale=1.0)]
    cells = np.floor((np.array(heights) - 0.5) * each.episodes).astype(int)
    assert sorted(cells) == list(range(each.episodes))


def test_sets_are_frozen_under_their_version():
    # The second episode of each held-out set; that of the paper is the one of version 0.1.0.
    case = episodes(track("paper"), force_scale=1.0)[1]
    assert (*case.state, case.phase) == PAPER_EPISODE
    case = episodes(track("randomised"), force_scale=0.25)[1]
    assert (*case.state, *case.drawn.values(), case.phase) == RANDOMISED_EPISODE
    assert list(case.drawn) == ["road.h", "force.f", "speed", "car.omega2", "car.omega1"]
    height, force, speed, load, wheel = case.drawn.values()
    nominal, found = track("randomised").at(0.25), case.scenario
    assert found.excitation.h == pytest.approx(0.1 * height, rel=1e-15)
    assert found.excitation.omega == pytest.approx(55.0 * speed, rel=1e-15)
    assert found.force.Omega == pytest.approx(55.0 * speed, rel=1e-15)
    assert found.force.f == pytest.approx(24.8 * force / load, rel=1e-15)
    assert found.car.mu1 == pytest.approx(2510.0 / wheel, rel=1e-15)
    limits = (70.0 / wheel, 8.25 / load)
    assert found.actuator.limit == pytest.approx(limits, rel=1e-15)
    assert nominal.actuator.limit == (70.0, 8.25)


@pytest.mark.parametrize("name", list(TRACKS))
def test_a_set_starts_from_rest_and_from_drawn_motions(name):
    each = track(name)
    moving = [any(case.state) for case in episodes(each, force_scale=each.force_scales[0])]
    drawn = moving[1::2] if each.nominal.randomisation else moving[1:]
    assert sum(moving) == sum(drawn)  # the others are at rest
    assert 0.5 < np.mean(drawn) < 1.0  # a share of the environment's own starts is at rest too


def test_a_track_takes_a_scenario_of_any_parts():
    hump = scenario("mathworks-hump")
    drawn = dataclasses.replace(
        hump,
        car=dataclasses.replace(hump.car, spring=CubicSpring(k=16_000.0, k3=2e6)),
        randomisation=(Vary(by=Uniform(low=0.5, high=1.5), numbers=("car.m2",)),),
    )
    for own in (hump, drawn):
        mine = Track(
            name="mine", version=1, title="", scenario=own, force_scales=(1.0,), episodes=4,
            duration=2.0, periods=None,
        )  # fmt: skip
        assert hash(mine) == hash(dataclasses.replace(mine))
        cases = episodes(mine, force_scale=0.5)
        assert {each.phase for each in cases} == {0.0}  # humps come when they come
        assert cases[0].scenario.duration == 2.0
        policy = catalogue.make("skyhook", mine.at(0.5))
        found = score(policy, mine, 0.5, name="skyhook", kind="published")
        assert len(found.rows) == 4
        assert all(0.0 < row.rho < 3.0 for row in found.rows)
        assert [row.drawn.startswith("car.m2 ") for row in found.rows] == [own is drawn] * 4
    masses = sorted(each.scenario.car.m2 / 300.0 for each in cases)
    assert np.floor((np.array(masses) - 0.5) * 4).tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_length_and_a_limit_of_its_own_leave_the_scales_as_they_are():
    hump = scenario("mathworks-hump")
    mine = Track(
        name="mine", version=1, title="", scenario=hump, force_scales=(1.0,), duration=1.0,
        periods=None,
    )  # fmt: skip
    scales = hump.reference.scales
    assert mine.at(0.25).reference.scales == scales


def test_periods_are_refused_by_name_where_there_are_none():
    message = r"track 'mine' takes amplitudes over its last 20 periods.*'mathworks-hump' is not har"
    with pytest.raises(ValueError, match=message):
        Track(name="mine", version=1, title="", scenario="mathworks-hump", force_scales=(1.0,))


def test_the_first_crossing_of_a_fixed_scenario_starts_from_rest():
    first = episodes(track("paper"), force_scale=1.0)[0]
    assert first.state == (0.0, 0.0, 0.0, 0.0)
    assert first.phase == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force_scales": 1.0}, "force_scales must be a tuple of numbers, got 1.0"),
        ({"force_scales": {0.5}}, r"force_scales must be a tuple of numbers, got \{0.5\}"),
        ({"force_scales": (1.0, 0.0)}, "force scale must be positive, got 0"),
        ({"episodes": 0}, "episodes must be at least 1, got 0"),
        ({"duration": -1.0}, "duration must be positive, got -1 s"),
        ({"seed": np.ones((2, 2))}, "seed must be a whole number, got array"),
        ({"seed": b"abc"}, "seed must be a whole number, got b'abc'; give 0 or more"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
    ],
)
def test_a_track_of_nothing_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(track("paper"), **change)


@pytest.mark.parametrize("seed", [np.ones((2, 2)), b"abc", "1", -1, 0.5, None])
def test_a_seed_of_standings_is_a_whole_number(seed):
    with pytest.raises(ValueError, match="seed must be"):
        standings([], {}, seed=seed)


def test_a_track_keeps_plain_numbers():
    given = dataclasses.replace(
        track("paper"), force_scales=[np.float32(0.5), 1], episodes=4.0, duration=np.array(60.0)
    )
    same = dataclasses.replace(track("paper"), force_scales=(0.5, 1.0), episodes=4, duration=60.0)
    assert given == same
    assert hash(given) == hash(same)


def test_unknown_names_list_what_there_is():
    with pytest.raises(ValueError, match=r"unknown track 'papr'; did you mean 'paper'"):
        track("papr")
    with pytest.raises(ValueError, match="unknown split 'test'"):
        episodes(track("paper"), "test", force_scale=1.0)  # type: ignore[arg-type]


def test_a_law_with_a_second_steady_motion_does_not_hide_behind_starts_from_rest():
    each = track("randomised")
    policy = catalogue.make("linear", each.at(1.0), **FROM_REST_ALONE)
    rho = np.array([row.rho for row in score(policy, each, 1.0, name="", kind="yours").rows])
    assert rho[::2].mean() < 0.03
    assert np.mean(rho > 1.0) > 0.01
    best = catalogue.make_tuned("linear", "randomised", 1.0, each.at(1.0))
    assert max(row.rho for row in score(best, each, 1.0, name="", kind="tuned").rows) < 1.0
