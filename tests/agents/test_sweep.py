"""Sweeps: what is trained, through every executor, and what a lost machine does to it."""

import contextlib
import dataclasses
import json
import math
import os
import shutil
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxruntime")

from qcar_env.agents import trial_runs
from qcar_env.agents.load import PRETRAINED
from qcar_env.agents.recipes import as_dict, recipe
from qcar_env.agents.sweep import Range, Search, Sweep, Trial
from qcar_env.commands import sweep as command
from qcar_env.evaluation import ray_workers, slurm, workers

ROOT = Path(__file__).parents[2]
TWELVE = Sweep(seeds=(0, 1), settings={"gamma": "0.9..0.99"}, points=6, steps=4096)


def executed(score, ran=None, backwards=False):
    """Return an executor that trains nothing: `score` gives rho of a trial, or raises."""

    def execute(trials, out, tell):
        for trial in reversed(trials) if backwards else trials:
            if ran is not None:
                ran.append(trial.name)
            try:
                rho = score(trial)
            except ArithmeticError as error:
                tell(trial_runs.failed(trial, error))
            else:
                tell(trial_runs._row(trial, status="done", steps=1, rho=rho, x1=0.1, x2=0.2))

    return execute


def bowl(trial):
    return (dict(trial.settings)["gamma"] - 0.95) ** 2 + 0.01 * trial.seed


# ---- what is swept --------------------------------------------------------------------------


@given(
    ends=st.tuples(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9)).filter(
        lambda each: each[0] < each[1]
    ),
    log=st.booleans(),
)
def test_a_range_is_read_as_it_is_written(ends, log):
    low, high = ends
    found = Range.read("gamma", f"{low!r}..{high!r}" + (":log" if log else ""), 0.9)
    assert (found.low, found.high, found.log, found.whole) == (low, high, log, False)


@given(values=st.lists(st.integers(-(10**6), 10**6), min_size=1))
def test_choices_of_whole_numbers_stay_whole(values):
    found = Range.read("batch", ",".join(map(str, values)), 512)
    assert found.choices == tuple(values)
    assert all(isinstance(each, int) for each in found.choices)


@pytest.mark.parametrize(
    ("text", "like"),
    [
        *[(text, 0.9) for text in ("", "a", "2..1", "1..1", "0..1:log", "1..2:exp", "nan..1")],
        *[(text, 64) for text in ("1.5..3", "0.5", "1e400..2", "1,2:log", "1..", "..2")],
        ("1..1e400", 0.9),
    ],
)
def test_a_range_that_is_none_is_refused(text, like):
    with pytest.raises(ValueError, match=r"setting x must be (whole|finite) numbers LOW\.\.HIGH"):
        Range.read("x", text, like)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"settings": {"gama": "0.9..0.99"}}, "unknown setting 'gama'; did you mean 'gamma'"),
        ({"settings": {"learning_rate": "1..2"}}, "unknown setting 'learning_rate'"),
        ({"algorithms": ("pppo",)}, "unknown algorithm"),
        ({"tasks": ("papers",)}, "unknown track"),
        ({"search": "grid"}, "unknown search"),
        ({"seeds": (-1,)}, "seed must be"),
        ({"seeds": ()}, "seeds must not be empty"),
        ({"points": 0}, "points must be"),
        ({"steps": 0}, "steps must be"),
        ({"algorithms": ("td3",), "tasks": ("feedback",)}, "no recipe is for td3 on feedback"),
    ],
)
def test_what_is_no_sweep_is_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        Sweep(**changes)


def test_a_setting_varies_for_those_that_have_it():
    found = Sweep(algorithms=("ppo", "cma"), settings={"clip_range": "0.1..0.3"}, points=4)
    assert list(found.ranges("ppo", "paper")) == ["clip_range"]
    assert not found.ranges("cma", "paper")
    assert found.trials == 4 + 1


def test_a_trial_has_the_recipe_with_its_settings():
    settings = (("learning_rate.1", 1e-6), ("cars", 8), ("batch", 128))
    trial = Trial(algorithm="ppo", task="paper", point=0, settings=settings, seed=0, steps=100)
    own = recipe("ppo", "paper")
    assert trial.recipe == dataclasses.replace(
        own,
        steps=100,
        cars=8,
        settings=dataclasses.replace(
            own.settings, batch=128, learning_rate=(own.settings.learning_rate[0], 1e-6)
        ),
    )
    others = [
        dataclasses.replace(trial, **changes)
        for changes in ({"seed": 1}, {"steps": 101}, {"settings": settings[:2]}, {"task": "budget"})
    ]
    assert len({each.name for each in (trial, *others)}) == 5
    assert dataclasses.replace(trial, point=3).name == trial.name


# ---- who is first changes nothing -----------------------------------------------------------


@pytest.mark.parametrize("search", ["random", "tpe"])
def test_the_order_of_the_results_changes_nothing(tmp_path, search):
    pytest.importorskip("optuna")
    swept = dataclasses.replace(TWELVE, points=20, search=search)
    one = trial_runs.run(swept, tmp_path, executed(bowl))
    assert len(one) == swept.trials
    assert one == trial_runs.run(swept, tmp_path, executed(bowl, backwards=True))
    other = trial_runs.run(dataclasses.replace(swept, search_seed=1), tmp_path, executed(bowl))
    assert {row.run for row in one} != {row.run for row in other}


def test_tpe_draws_nearer_to_the_best_and_random_does_not_look(tmp_path):
    pytest.importorskip("optuna")
    swept = dataclasses.replace(TWELVE, points=40, search="tpe", settings={"gamma": "0.1..0.99"})

    def distances(execute):
        rows = trial_runs.run(swept, tmp_path, execute)
        return [abs(json.loads(row.settings)["gamma"] - 0.95) for row in rows]

    found = distances(executed(bowl))
    assert sum(found[40:]) < 0.5 * sum(found[:40])
    random = Search(dataclasses.replace(swept, search="random"))
    assert len(random.ask()) == 80
    assert random.ask() == []


def test_a_setting_that_is_drawn_twice_is_trained_once(tmp_path):
    pytest.importorskip("optuna")
    ran = []
    swept = dataclasses.replace(TWELVE, settings={"batch": "256,512"}, points=9, seeds=(0,))
    rows = trial_runs.run(swept, tmp_path, executed(lambda trial: 0.5, ran))
    assert sorted(ran) == sorted({row.run for row in rows})
    assert len(rows) == 2


@pytest.mark.parametrize("search", ["random", "tpe"])
def test_a_trial_that_fails_is_told_and_the_others_go_on(tmp_path, search):
    pytest.importorskip("optuna")

    def score(trial):
        if trial.seed and trial.point == 2:
            raise ZeroDivisionError("too | little")
        return bowl(trial)

    rows = trial_runs.run(dataclasses.replace(TWELVE, search=search), tmp_path, executed(score))
    assert [row.status for row in rows].count("failed") == 1
    assert len(rows) == 12
    text = trial_runs.write(tmp_path, rows)
    assert "11 done, 0 stopped, 1 failed" in text
    assert "ZeroDivisionError" in text
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 13


def test_a_trial_that_nobody_tells_of_is_a_failure(tmp_path):
    rows = trial_runs.run(Sweep(), tmp_path, lambda trials, out, tell: None)
    assert [row.status for row in rows] == ["failed"]


# ---- run folders ----------------------------------------------------------------------------


@pytest.fixture
def trained(monkeypatch):
    """Write what a training would, and take note of how it was asked for."""
    asked = []

    def train(recipe, seed, folder, *, resume=False, force=False, report=None, command=""):
        asked.append("resume" if resume else "force" if force else "new")
        if resume and (folder / "checkpoint.pt").read_text() != "good":
            raise ValueError("damaged")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "recipe.json").write_text(json.dumps(as_dict(recipe)))
        found = {"1": {"rho": 0.5, "x1": 0.1, "x2": 0.2}, "0.5": {"rho": 0.7, "x1": 0.2, "x2": 0.1}}
        (folder / "result.json").write_text(json.dumps({"validation": found, "steps": 7}))

    monkeypatch.setattr("qcar_env.agents.train.train", train)
    return asked


TRIAL = Trial(algorithm="ppo", task="paper", point=0, settings=(), seed=0, steps=4096)


def test_a_trial_that_is_whole_is_not_trained_again(tmp_path, trained):
    first = trial_runs.run_trial(TRIAL, tmp_path)
    assert (first.rho, first.x1, first.x2, first.steps) == (0.6, 0.2, 0.2, 7)
    assert trial_runs.run_trial(TRIAL, tmp_path) == first
    assert trained == ["force"]


@pytest.mark.parametrize(("kept", "asked"), [("good", ["resume"]), ("bad", ["resume", "force"])])
def test_a_killed_trial_goes_on_from_its_checkpoint(tmp_path, trained, kept, asked):
    folder = tmp_path / "runs" / TRIAL.name
    folder.mkdir(parents=True)
    (folder / "checkpoint.pt").write_text(kept)
    assert trial_runs.run_trial(TRIAL, tmp_path).status == "done"
    assert trained == asked


def test_a_trial_of_another_recipe_is_trained_again(tmp_path, trained):
    trial_runs.run_trial(TRIAL, tmp_path)
    path = tmp_path / "runs" / TRIAL.name / "recipe.json"
    path.write_text(path.read_text().replace('"gamma": 0.93', '"gamma": 0.5'))
    assert trial_runs.finished(TRIAL, tmp_path) is None
    trial_runs.run_trial(TRIAL, tmp_path)
    assert trained == ["force", "force"]


def test_a_stopped_trial_stays_stopped(tmp_path, trained):
    folder = tmp_path / "runs" / TRIAL.name
    folder.mkdir(parents=True)
    (folder / "recipe.json").write_text(json.dumps(as_dict(TRIAL.recipe)))
    last = {"steps": 512, "rho": 0.8, "x1": 1.0, "x2": 2.0, "evaluation": 3}
    row = trial_runs.stop(TRIAL, tmp_path, last)
    assert (row.status, row.steps, row.rho) == ("stopped", 512, 0.8)
    assert trial_runs.run_trial(TRIAL, tmp_path) == row
    assert trained == []


def test_a_rho_that_is_no_number_is_a_failure(tmp_path, trained):
    trial_runs.run_trial(TRIAL, tmp_path)
    path = tmp_path / "runs" / TRIAL.name / "result.json"
    path.write_text(path.read_text().replace('"rho": 0.5', '"rho": null'))
    row = trial_runs.finished(TRIAL, tmp_path)
    assert row is not None
    assert math.isnan(row.rho)
    assert row.status == "failed"
    assert "rho must be finite" in row.error


# ---- the command ----------------------------------------------------------------------------


def test_without_ray_the_command_says_how_to_install_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command.importlib.util, "find_spec", lambda name: None)
    assert command.main(["--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "pip install 'qcar_env[cluster]'" in said
    assert "--runner pool" in said
    assert command.main(["--set", "gamma=0..1", "--runner", "pool", "--out", str(tmp_path)]) == 2
    assert "Optuna" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--set", "gama=1..2"], "unknown setting 'gama'"),
        (["--set", "gamma"], "--set must be NAME=RANGE"),
        (["--set", "gamma=0.1,0.2", "--set", "gamma=0.3"], "given twice"),
        (["--runner", "cloud"], "unknown runner"),
        (["--early-stop"], "--early-stop needs results"),
        (["--address", "127.0.0.1:1"], "is of a Ray cluster"),
        (["--jobs", "0"], "jobs must be"),
        (["--resume", "{out}"], "holds no sweep that can be resumed"),
    ],
)
def test_what_the_command_refuses(tmp_path, capsys, arguments, words):
    out = tmp_path / "out"
    given = [each.format(out=out) for each in arguments]
    assert command.main(["--runner", "pool", "--out", str(out), *given]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_an_address_where_nothing_answers_leaves_nothing_behind(tmp_path, capsys):
    pytest.importorskip("ray")
    out = tmp_path / "out"
    assert command.main(["--address", "127.0.0.1:9", "--out", str(out)]) == 2
    assert "no Ray cluster answers" in capsys.readouterr().err
    assert not out.exists()


def test_a_sweep_that_is_there_is_not_begun_anew(tmp_path, monkeypatch, capsys):
    def run(swept, out, execute, progress):
        return [trial_runs.failed(TRIAL, ValueError(str(swept.seeds)))]

    monkeypatch.setattr(command.trial_runs, "run", run)
    given = ["--runner", "pool", "--no-benchmark"]
    assert command.main([*given, "--seeds", "4", "5", "--out", str(tmp_path)]) == 1
    assert command.main([*given, "--out", str(tmp_path)]) == 2
    assert f"go on with --resume {tmp_path}" in capsys.readouterr().err
    assert command.main([*given, "--resume", str(tmp_path)]) == 1
    assert "(4, 5)" in capsys.readouterr().out


def test_the_best_settings_enter_the_benchmark_with_all_their_seeds(tmp_path):
    """Of three settings, one of which failed; runs are copies of the agent that is shipped."""
    trials = [
        dataclasses.replace(TRIAL, point=i, settings=(("gamma", 0.9 + 0.01 * i),))
        for i in (0, 1, 2)
    ]
    rows = []
    for trial, rho in zip(trials, (0.5, 0.01, float("nan")), strict=True):
        for seed in (0, 1):
            each = dataclasses.replace(trial, seed=seed)
            status = "done" if rho == rho else "failed"
            rows.append(trial_runs._row(each, status=status, steps=1, rho=rho, x1=0.1, x2=0.2))
            shutil.copytree(PRETRAINED / "ppo-paper", tmp_path / "runs" / each.name)
    assert "leaderboard.md" in trial_runs.score_best(tmp_path, rows)
    found = json.loads((tmp_path / "benchmark" / "result.json").read_text(encoding="utf-8"))
    best = {row.run for row in rows if row.rho == 0.01}
    assert {each["policy"] for each in found["standings"]} == best
    assert all(each["rho"]["value"] < 0.01 for each in found["standings"])  # those of the agent
    assert trial_runs.score_best(tmp_path, rows[4:]) == []


# ---- real trainings -------------------------------------------------------------------------

COMMAND = [
    *("--seeds", "0", "1", "--set", "gamma=0.9..0.99", "--points", "6", "--steps", "4096"),
    *("--jobs", "2", "--no-benchmark"),
]


def table(out):
    return (out / "table.csv").read_text(encoding="utf-8")


def start(out, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "qcar_env.commands.main", "sweep", *arguments],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def whole_runs(out):
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("runs/*/result.json")}


def wait_for_runs(out, count, limit=240.0):
    end = time.monotonic() + limit
    while len(whole_runs(out)) < count:
        assert time.monotonic() < end, f"{len(whole_runs(out))} of {count} runs in {limit:g} s"
        time.sleep(0.2)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Twelve trials through a process pool."""
    pytest.importorskip("optuna")
    out = tmp_path_factory.mktemp("undisturbed")
    rows = trial_runs.run(
        TWELVE, out, partial(trial_runs.in_workers, partial(workers.each_done, jobs=2))
    )
    trial_runs.write(out, rows)
    assert [row.status for row in rows] == ["done"] * 12
    return out


@pytest.mark.learning
@pytest.mark.filterwarnings("default")
def test_a_lost_raylet_and_a_killed_driver_change_nothing(tmp_path, undisturbed):
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    raylets = [cluster.add_node(num_cpus=1) for _ in range(2)]
    driver = start(tmp_path, *COMMAND, "--address", cluster.address, "--out", str(tmp_path))
    try:
        wait_for_runs(tmp_path, 2)
        cluster.remove_node(raylets[0], allow_graceful=False)
        cluster.add_node(num_cpus=1)
        wait_for_runs(tmp_path, 5)
        driver.kill()
        driver.communicate()
        before = whole_runs(tmp_path)
        assert len(before) < 12
        again = start(
            tmp_path,
            *("--resume", str(tmp_path), "--address", cluster.address, "--no-benchmark"),
        )
        _, said = again.communicate(timeout=300)
        assert again.returncode == 0, said
    finally:
        driver.kill()
        cluster.shutdown()
    after = whole_runs(tmp_path)
    assert len(after) == 12
    assert {name: after[name] for name in before} == before  # none was trained a second time
    assert table(tmp_path) == table(undisturbed)
    assert {path.name for path in (tmp_path / "runs").iterdir()} == set(after)


@pytest.mark.learning
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("runner", ["pool", "ray"])
def test_bad_trials_are_told_and_the_good_ones_are_trained(tmp_path, runner):
    pytest.importorskip("optuna")
    settings = {"n_steps": "0,64", "gamma": "0.93,1e200"}  # returns of 1e200 make weights nan
    swept = Sweep(settings=settings, points=12, steps=4096)
    with contextlib.ExitStack() as stack:
        execute = partial(trial_runs.in_workers, partial(workers.each_done, jobs=2))
        if runner == "ray":
            pytest.importorskip("ray")
            from qcar_env.agents import ray_sweep

            execute = ray_sweep.execute
            stack.enter_context(ray_workers.cluster(cores=2))
        rows = trial_runs.run(swept, tmp_path, execute)
    found = {}
    for row in rows:
        kinds = json.loads(row.settings)
        kind = "zero" if not kinds["n_steps"] else "nan" if kinds["gamma"] > 1 else "good"
        found.setdefault(kind, []).append(row)
    assert [row.status for row in found["good"]] == ["done"]
    assert all(row.status == "failed" for row in [*found["zero"], *found["nan"]])
    assert "n_steps" in found["zero"][0].error
    assert "nan" in found["nan"][0].error


@pytest.mark.learning
@pytest.mark.skipif(shutil.which("mount") is None, reason="needs mount")
@pytest.mark.filterwarnings("default")
def test_a_full_disk_is_told_for_each_trial_and_the_sweep_ends(tmp_path):
    """A run folder takes about 200 kB, the first file of it 1 kB."""
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", small]
    mounted = subprocess.run(mount, capture_output=True, text=True)
    if mounted.returncode:  # whatever else mount complains of is a failure
        assert "permi" in mounted.stderr or "superuser" in mounted.stderr, mounted.stderr
        pytest.skip("no right to mount a small disk")
    try:
        swept = Sweep(seeds=(0, 1, 2), steps=4096)
        execute = partial(trial_runs.in_workers, partial(workers.each_done, jobs=2))
        rows = trial_runs.run(swept, small, execute)
        assert len(rows) == 3
        full = [row for row in rows if row.status == "failed"]
        assert full
        assert all("No space left" in row.error for row in full)
    finally:
        subprocess.run(["umount", small], check=True)


@pytest.mark.learning
@pytest.mark.filterwarnings("default")
def test_submitit_trains_the_same(tmp_path, undisturbed):
    pytest.importorskip("submitit")
    out = tmp_path / "out"
    swept = dataclasses.replace(TWELVE, points=1, seeds=(0, 1))
    each_done = partial(slurm.each_done, jobs=2, folder=out / "slurm", local=True)
    rows = trial_runs.run(swept, out, partial(trial_runs.in_workers, each_done))
    trial_runs.write(out, rows)
    assert table(out).splitlines() == table(undisturbed).splitlines()[:3]


@pytest.mark.learning
@pytest.mark.filterwarnings("default")
def test_asha_stops_what_is_behind(tmp_path):
    """Trials that do not learn end their rungs behind the one that does."""
    pytest.importorskip("ray")
    pytest.importorskip("optuna")
    from qcar_env.agents import ray_sweep

    settings = {"learning_rate.0": "1e-12,1e-3", "learning_rate.1": "1e-12"}
    swept = Sweep(seeds=(0, 1, 2), settings=settings, points=6, steps=40_960)
    with ray_workers.cluster(cores=2):
        execute = partial(ray_sweep.execute, early_stop=True)
        rows = trial_runs.run(swept, tmp_path, execute)
    assert len(rows) == 6
    states = {row.status for row in rows}
    assert states == {"done", "stopped"}
    for row in rows:
        if row.status == "stopped":
            assert row.steps < 40_960
            assert (tmp_path / "runs" / row.run / "stopped.json").exists()
    best = min(rows, key=lambda row: row.rho)
    assert best.status == "done"
