import dataclasses

import numpy as np
import pytest

from qcar_env.baselines import catalogue
from qcar_env.evaluation import benchmark, leaderboard
from qcar_env.evaluation.benchmark import Failure, run
from qcar_env.evaluation.bounds import optimum_of
from qcar_env.evaluation.score import Row, for_track, score
from qcar_env.evaluation.standings import findings, standings
from qcar_env.evaluation.tracks import Track, track
from qcar_env.evaluation.workers import WorkerDiedError
from qcar_env.parts.spring import CubicSpring
from qcar_env.scenarios import scenario

SHORT = dataclasses.replace(track("budget"), duration=1.0, periods=3, episodes=3)
BLANK = {
    field.name: (0 if field.type in ("int", "float") else "full" if field.name == "reads" else "")
    for field in dataclasses.fields(Row)
}


def rows(policy, kind, values, where="budget", scale=0.5):
    return [
        Row(
            **{
                **BLANK,
                "policy": policy,
                "kind": kind,
                "track": where,
                "force_scale": scale,
                "episode": j,
                "rho": value,
                "terminated": False,
            }
        )
        for j, value in enumerate(values)
    ]


def test_a_row_holds_the_metrics_of_its_crossing():
    nominal = SHORT.at(0.5)
    found = score(catalogue.make("cnvc", nominal), SHORT, 0.5, name="cnvc", kind="published")
    assert [row.episode for row in found.rows] == [0, 1, 2]
    a1, a2 = nominal.reference_amplitudes
    for row in found.rows:
        assert row.rho == max(row.x1 / a1, row.x2 / a2)
        assert row.percentage_error_x1 == pytest.approx(100.0 * (a1 / row.x1 - 1.0))
        assert row.reduction_db_x2 == pytest.approx(20.0 * np.log10(a2 / row.x2))
        assert 0.0 < row.rms_force_1 <= row.peak_force_1 <= nominal.actuator.limit[0]
        assert 0.0 <= row.settling_time <= SHORT.duration
        assert not row.terminated
    assert found.history.x.shape == (len(found.history.t), 4)
    renamed = for_track(found, track("paper"))
    assert {row.track for row in renamed.rows} == {"paper"}


def test_a_policy_that_reads_more_than_is_shown_is_refused():
    blind = dataclasses.replace(SHORT, observe="feedback")
    with pytest.raises(ValueError, match="shows the state alone, policy 'x' reads 'full'"):
        score(catalogue.make("lqr-feedforward"), blind, 1.0, name="x", kind="yours")


def test_standings_are_ranked_and_against_cnvc():
    data = [
        *rows("cnvc", "published", [0.3, 0.31, 0.32, 0.33]),
        *rows("good", "tuned", [0.2, 0.21, 0.22, 0.23]),
        *rows("bad", "learned", [0.5, 0.5, 0.5, 0.5]),
    ]
    found = standings(data, {("budget", 0.5): [0.2] * 4})
    assert [each.policy for each in found] == ["good", "cnvc", "bad"]
    assert found[0].improvement.value == 1.0
    assert found[1].improvement is None
    assert found[2].improvement.value == 0.0
    assert found[0].over_optimum == pytest.approx(found[0].rho.value / 0.2)
    assert found[0].rho.low <= found[0].rho.value <= found[0].rho.high


def test_another_policy_changes_nobody_elses_interval():
    data = rows("cnvc", "published", [0.3, 0.31, 0.4, 0.33])
    bounds = {("budget", 0.5): [0.2] * 4}
    alone = standings(data, bounds)[0]
    beside = standings([*rows("other", "yours", [0.1, 0.2, 0.3, 0.1]), *data], bounds)
    assert alone in beside


@pytest.mark.parametrize(
    ("linear", "cubic", "said"),
    [
        ([0.20, 0.21, 0.22, 0.21], [0.30, 0.31, 0.32, 0.31], "lnvc (tuned), beats the cubic"),
        ([0.30, 0.31, 0.32, 0.31], [0.20, 0.21, 0.22, 0.21], "beats linear velocity feedback"),
        ([0.30, 0.31, 0.32, 0.31], [0.30, 0.31, 0.32, 0.31], "leave the same"),
    ],
)
def test_what_is_found_is_said_whichever_way_it_goes(linear, cubic, said):
    data = [*rows("cnvc (tuned)", "tuned", cubic), *rows("lnvc (tuned)", "tuned", linear)]
    sentences = findings(standings(data, {("budget", 0.5): [0.2] * 4}))
    assert any(said in sentence for sentence in sentences)
    best = min(np.median(linear), np.median(cubic))
    assert any(f"{best:.4f}" in sentence for sentence in sentences)


def test_the_optimum_of_episodes_that_are_alike_knows_the_control_interval():
    alike = optimum_of(SHORT, 0.5)
    assert len(alike) == 3
    assert alike[0].lower <= alike[0].upper <= alike[0].held * 1.01
    varied = dataclasses.replace(track("randomised"), episodes=2)
    assert [bound.held for bound in optimum_of(varied, 0.5)] == [None, None]


CROSSING = Track(
    name="hump",
    version=1,
    title="A passenger car over a hump",
    scenario="mathworks-hump",
    force_scales=(0.5,),
    episodes=3,
    duration=1.5,
    periods=None,
)


def test_a_hump_has_the_optimum_of_its_whole_crossing():
    outcome = run([CROSSING], [catalogue.entry("none"), catalogue.entry("skyhook")])
    assert not outcome.failures
    bounds = outcome.bounds[("hump", 0.5)]
    assert len(bounds) == 3
    for row in outcome.rows:
        bound = bounds[row.episode]
        assert bound.lower <= bound.upper
        # RK4 and the exact map of the program agree to 1e-6 of the motion
        assert row.rho >= bound.lower * (1.0 - 1e-4)
    text = leaderboard.leaderboard(outcome)
    assert "amplitudes over the whole episode" in text
    assert "*optimum*" in text


def test_a_car_that_is_not_linear_is_ranked_without_an_optimum():
    hump = scenario("mathworks-hump")
    spring = CubicSpring(k=16_000.0, k3=2e6)
    stiff = dataclasses.replace(hump, car=dataclasses.replace(hump.car, spring=spring))
    own = dataclasses.replace(CROSSING, scenario=stiff)
    names = ("none", "cnvc", "groundhook", "lqr")
    outcome = run([own], [catalogue.entry(name) for name in names])
    assert [each.policy for each in outcome.failures] == ["lqr"]  # it is designed on a linear car
    assert "must be linear" in outcome.failures[0].error
    assert outcome.bounds[("hump", 0.5)] == ()
    assert all(np.isnan(each.optimum) for each in outcome.standings)
    assert "*optimum*" not in leaderboard.leaderboard(outcome)
    assert any("no optimum is known" in each for each in leaderboard.summary(outcome))


def test_the_optimum_is_found_here_if_its_worker_died(monkeypatch):
    """The system kills whichever process is large; what policies have done was lost with it."""

    def each_done(tasks, jobs):
        yield 0, None, WorkerDiedError("its process ended with -9")
        yield 1, tasks[1](), None

    monkeypatch.setattr(benchmark, "each_done", each_done)
    found = run([CROSSING], [catalogue.entry("none")], jobs=2)
    assert len(found.bounds[("hump", 0.5)]) == 3
    assert {row.policy for row in found.rows} == {"none"}


def test_the_words_of_an_error_do_not_hide_the_rest_of_a_leaderboard():
    words = {"policy": "mine", "track": "hump", "error": "E: <!-- `|", "details": ""}
    failed = Failure(force_scale=1.0, **words)
    found = dataclasses.replace(run([CROSSING], [catalogue.entry("none")]), failures=(failed,))
    assert "<!--" not in leaderboard.leaderboard(found).replace("\\<", "")
    assert f"- {failed}" in leaderboard.summary(found)


def test_a_grid_gives_what_a_run_gives_and_merges_what_is_there(tmp_path):
    def here(tasks):
        for index, task in enumerate(tasks):
            yield index, task(), None

    blind = dataclasses.replace(SHORT, name="blind", observe="feedback", force_scales=(1.0,))
    mine = dataclasses.replace(
        catalogue.entry("none"), name="fails", make=lambda scenario, track, scale: 3
    )
    tracks = (dataclasses.replace(SHORT, force_scales=(1.0, 0.5)), blind)
    entries = (catalogue.entry("lqr-feedforward"), mine, catalogue.entry("cnvc"))
    plain = run(tracks, entries, seed=7)
    assert plain.failures
    (found,) = benchmark.run_grid(tracks, entries, tmp_path, here, seeds=(7,))
    for name in ("tracks", "seed", "rows", "bounds", "standings"):
        assert getattr(found, name) == getattr(plain, name)
    assert list(map(str, found.failures)) == list(map(str, plain.failures))
    for key, each in plain.histories.items():
        assert found.histories[key].x.tobytes() == each.x.tobytes()
    assert list(found.histories) == list(plain.histories)
    merged, other = benchmark.run_grid(tracks, entries, tmp_path, None, seeds=(7, 8))
    assert merged.rows == plain.rows
    assert not other.rows
    assert {each.policy for each in other.failures} == {"lqr-feedforward", "fails", "cnvc"}
