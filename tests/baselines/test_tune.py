import dataclasses
import json
from functools import partial

import numpy as np
import pytest

from qcar_env.baselines import catalogue, tune
from qcar_env.commands import tune as command
from qcar_env.evaluation.rollouts import rollouts
from qcar_env.evaluation.tracks import episodes, track
from qcar_env.evaluation.workers import each_done

BUDGET = track("budget")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Episodes of a second and few candidates: the machinery, not the gains."""
    monkeypatch.setattr(tune, "DURATION", 1.0)
    monkeypatch.setattr(tune, "VARIED_DURATION", 1.0)
    monkeypatch.setattr(tune, "VARIED", 4)
    monkeypatch.setattr(tune, "PERIODS", 3)
    monkeypatch.setattr(tune, "SETTLED", 1.0)
    few = {
        name: dataclasses.replace(search, generations=2) for name, search in tune.SEARCHES.items()
    }
    monkeypatch.setattr(tune, "SEARCHES", few)


@pytest.mark.parametrize("name", list(tune.SEARCHES))
def test_a_candidate_scores_in_the_batch_as_the_policy_does_alone(name):
    # The search evaluates what is stored: the same gains through the policy and its environment.
    search = tune.SEARCHES[name]
    point = np.array(search.low) + 0.6 * (np.array(search.high) - np.array(search.low))
    nominal = BUDGET.at(0.5)
    cases = [tune._on_optimum(e) for e in episodes(BUDGET, "training", force_scale=0.5, count=2)]
    gains = search.gains(point)
    policy = tune._candidates(name, [gains, gains], nominal, 2)
    window = tune._window(cases, 3)
    rolled = rollouts(policy, cases * 2, duration=1.0, observe=policy.reads, last=window)
    batch = rolled.rho(3).reshape(2, 2).mean(axis=1)
    assert batch[0] == batch[1]
    policy = catalogue.make(name, nominal, **gains)
    alone = rollouts(policy, cases, duration=1.0, observe=policy.reads).rho(3)
    # sums of another order; the internal model is searched through its twin, without a transient
    assert batch[0] == pytest.approx(alone.mean(), rel=0.05 if name == "lqr-model" else 1e-6)


def test_a_seed_decides_and_the_search_improves():
    first = tune.tune("lnvc", BUDGET, 0.5, population=8)
    assert first == tune.tune("lnvc", BUDGET, 0.5, population=8)
    assert first != tune.tune("lnvc", BUDGET, 0.5, population=8, seed=1)
    published = tune.validate("lnvc", {}, BUDGET, 0.5)
    assert first.validation_rho < published
    assert set(first.gains) == {"G1", "G2"}


def put(path, names):
    """Store gains of some names, many times, from another process."""
    for k in range(5):
        for name in names:
            tune.store(dataclasses.replace(STORED, baseline=name, seed=k), path)


STORED = tune.Tuned(
    baseline="lnvc",
    track="budget",
    track_version=2,
    force_scale=1.0,
    gains={"G1": 1.0},
    training_rho=0.1,
    validation_rho=0.1,
    evaluations=8,
    seed=0,
    command="",
)


def test_two_searches_of_one_file_lose_no_gains(tmp_path):
    path = tmp_path / "tuned.json"
    tasks = [partial(put, path, names) for names in (("a", "b"), ("c", "d"))]
    assert [error for *_, error in each_done(tasks, 2)] == [None, None]
    assert [(each.baseline, each.seed) for each in tune.load(path)] == [(x, 4) for x in "abcd"]


def test_gains_are_tuned_on_a_road_without_periods_too():
    hump = dataclasses.replace(
        BUDGET, name="hump", scenario="mathworks-hump", duration=1.5, periods=None, episodes=2
    )
    found = tune.tune("skyhook", hump, 1.0, population=5)
    assert found.validation_rho <= tune.validate("skyhook", {"G": 0.1}, hump, 1.0)


def test_training_never_sees_the_held_out_episodes(monkeypatch):
    asked = []
    original = tune.episodes

    def spy(where, split, **options):
        asked.append(split)
        return original(where, split, **options)

    monkeypatch.setattr(tune, "episodes", spy)
    few = dataclasses.replace(track("randomised"), episodes=4)
    tune.tune("skyhook", few, 0.5, population=6)
    assert set(asked) == {"training", "validation"}


def test_the_command_stores_gains_and_leaves_them_alone_without_force(tmp_path):
    out = tmp_path / "tuned.json"
    arguments = ["--track", "budget", "--force-scale", "0.5", "--baselines", "skyhook"]
    arguments += ["--population", "6", "--out", str(out)]
    assert command.main(arguments) == 0
    stored = json.loads(out.read_text(encoding="utf-8"))
    assert stored[0]["baseline"] == "skyhook"
    assert "--force-scale 0.5" in stored[0]["command"]
    assert stored[0]["track_version"] == BUDGET.version
    before = out.read_bytes()
    assert command.main([*arguments, "--seed", "3"]) == 0
    assert out.read_bytes() == before
    assert command.main([*arguments, "--seed", "3", "--force"]) == 0
    assert out.read_bytes() != before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--baselines", "mpc"], "unknown baseline to tune 'mpc'"),
        (["--track", "papr"], "unknown track 'papr'"),
        (["--population", "2", "--baselines", "lnvc"], "population must be at least 5"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, capsys, arguments, message):
    assert command.main([*arguments, "--out", str(tmp_path / "tuned.json")]) == 2
    assert message in capsys.readouterr().err


def test_the_store_is_of_the_tracks_of_today():
    for each in tune.load():
        assert each.track_version == track(each.track).version
        assert each.force_scale in track(each.track).force_scales
        assert set(each.gains) == set(tune.SEARCHES[each.baseline].names)


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("seed", -1, "seed must be at least 0, got -1; give 0 or more"),
        ("population", 4, "population must be at least 5, got 4; give 5 or more"),
    ],
)
def test_a_search_of_nothing_is_refused(argument, value, message):
    with pytest.raises(ValueError, match=message):
        tune.tune("lnvc", BUDGET, 0.5, **{argument: value})
