import dataclasses

import numpy as np
import pytest

from qcar_env.evaluation import tracks
from qcar_env.evaluation.tracks import TRACKS, episodes, track


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
    heights = [e.factors.height for e in episodes(each, force_scale=1.0)]
    cells = np.floor((np.array(heights) - 0.5) * each.episodes).astype(int)
    assert sorted(cells) == list(range(each.episodes))


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
    ],
)
def test_a_track_of_nothing_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(track("paper"), **change)


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
