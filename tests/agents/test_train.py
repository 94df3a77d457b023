import dataclasses
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxruntime")

from qcar_env.agents import train as training  # noqa: E402
from qcar_env.agents.load import load, names  # noqa: E402
from qcar_env.agents.recipes import RECIPES, GradientSettings, OffPolicySettings, PPOSettings  # noqa: E402
from qcar_env.agents.train import make_trainer, resumed_recipe, train  # noqa: E402
from qcar_env.evaluation.agent import Agent  # noqa: E402

TINY = {
    "ppo": dataclasses.replace(
        RECIPES["ppo-paper"], cars=4, steps=128, settings=PPOSettings(n_steps=8, batch=16)
    ),
    "sac": dataclasses.replace(
        RECIPES["sac-paper"],
        cars=4,
        steps=80,
        settings=OffPolicySettings(batch=8, learning_starts=16),
    ),
    "td3": dataclasses.replace(
        RECIPES["td3-paper"],
        cars=4,
        steps=80,
        settings=OffPolicySettings(batch=8, learning_starts=16),
    ),
    "gradient": dataclasses.replace(
        RECIPES["gradient-randomised"],
        cars=4,
        steps=4 * 10 * 6,
        settings=GradientSettings(horizon=10),
    ),
    "cma-randomised": dataclasses.replace(
        RECIPES["cma-randomised"],
        cars=3,
        steps=24 * 3 * 40 * 30,
        settings=dataclasses.replace(
            RECIPES["cma-randomised"].settings,
            length=0.2,
            settle=0.3,
            generations=12,
            refine_generations=18,
        ),
    ),
    "cma": dataclasses.replace(
        RECIPES["cma-budget"],
        cars=2,
        steps=24 * 2 * 40 * 5 * 4,
        settings=dataclasses.replace(RECIPES["cma-budget"].settings, length=0.2, generations=4),
    ),
}


@pytest.fixture
def exported(monkeypatch):
    """Take note of what is exported instead of tracing it, which takes seconds."""
    found = []

    def note(actor, size, path):
        with torch.no_grad():
            found.append(actor(torch.full((1, size), 0.1)).numpy()[0])

    monkeypatch.setattr(training, "export_checked", note)
    monkeypatch.setattr(training, "Agent", lambda folder: None)
    return found


@pytest.fixture(autouse=True)
def short_evaluations(monkeypatch):
    monkeypatch.setattr(training, "LIVE", 0.5)
    monkeypatch.setattr(
        training, "score_all", lambda policy, recipe, split: {"1": {"rho": 0.5, "x1": 0, "x2": 0}}
    )


def weights(trainer):
    return {name: each.clone() for name, each in trainer.actor().state_dict().items()}


def same(first, second):
    return all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("algorithm", TINY)
def test_one_seed_gives_one_policy_and_a_resumed_training_the_same(algorithm):
    recipe = TINY[algorithm]
    whole = make_trainer(recipe, 5)
    whole.learn(lambda: True)
    assert whole.steps >= recipe.steps * 0.9

    calls = []

    def stop_halfway():
        calls.append(None)
        return broken.steps < recipe.steps / 2

    broken = make_trainer(recipe, 5)
    broken.learn(stop_halfway)
    assert 0 < broken.steps < recipe.steps
    kept = broken.snapshot()
    resumed = make_trainer(recipe, 5)
    resumed.restore(kept)
    assert resumed.steps == broken.steps
    resumed.learn(lambda: True)
    assert resumed.steps == whole.steps
    assert same(weights(whole), weights(resumed))

    other = make_trainer(recipe, 6)
    other.learn(lambda: True)
    assert not same(weights(whole), weights(other))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "ppo-paper-seed1"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "LIVE", 0.5)
        patch.setattr(training, "score_all", lambda *_: {"1": {"rho": 0.5, "x1": 0, "x2": 0}})
        train(TINY["ppo"], 1, folder)
    return folder


@pytest.fixture
def run(finished, tmp_path):
    import shutil

    return shutil.copytree(finished, tmp_path / "run")


def test_a_run_folder_explains_itself(finished):
    held = {each.name for each in finished.iterdir()}
    assert held >= {
        "recipe.json",
        "command.txt",
        "versions.json",
        "progress.csv",
        "checkpoint.pt",
        "policy.onnx",
        "result.json",
    }
    described = json.loads((finished / "recipe.json").read_text())
    assert described["name"] == "ppo-paper"
    assert described["seed"] == 1
    header = (finished / "progress.csv").read_text().splitlines()[0]
    assert header == "steps,wall,cpu,x1,x2,rho"
    assert resumed_recipe(finished) == ("ppo", "paper", 1, 128)


def test_a_run_folder_loads_as_a_policy(finished):
    policy = load(finished)
    assert policy.name == "ppo-paper"
    one, _ = policy.predict(np.zeros(8))
    many, _ = policy.predict(np.zeros((5, 8)))
    assert one.shape == (2,)
    assert many.shape == (5, 2)
    with pytest.raises(ValueError, match="must have 8 entries"):
        policy.predict(np.zeros(7))
    with pytest.raises(ValueError, match="must have 8 entries"):
        policy.predict(np.zeros((2, 3, 8)))


def test_nothing_is_overwritten_without_force(run, exported):
    before = (run / "policy.onnx").read_bytes()
    with pytest.raises(ValueError, match="--force"):
        train(TINY["ppo"], 1, run)
    assert (run / "policy.onnx").read_bytes() == before
    train(TINY["ppo"], 2, run, force=True)
    assert len(exported) == 1
    assert not (run / "policy.onnx").exists()
    assert resumed_recipe(run) == ("ppo", "paper", 2, 128)


def test_a_finished_run_resumed_stays_as_it_is(run, exported):
    before = load(run).predict(np.full(8, 0.1))[0]
    train(TINY["ppo"], 1, run, resume=True)
    np.testing.assert_allclose(exported[0], before, rtol=0.0, atol=1e-6)


def test_a_run_of_another_version_is_not_resumed(run):
    made_with = json.loads((run / "versions.json").read_text())
    (run / "versions.json").write_text(json.dumps({**made_with, "torch": "1.0"}))
    with pytest.raises(ValueError, match=r"made with torch 1\.0"):
        train(TINY["ppo"], 1, run, resume=True)


def test_a_run_of_another_recipe_or_format_is_not_resumed(run):
    with pytest.raises(ValueError, match=r"another recipe \(different: seed\)"):
        train(TINY["ppo"], 2, run, resume=True)
    described = json.loads((run / "recipe.json").read_text())
    (run / "recipe.json").write_text(json.dumps({**described, "format": 0}))
    with pytest.raises(ValueError, match="format 0"):
        train(TINY["ppo"], 1, run, resume=True)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_checkpoint_that_is_cut_off_is_named(run, share):
    path = run / "checkpoint.pt"
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match="damaged or cut off"):
        train(TINY["ppo"], 1, run, resume=True)


def test_a_checkpoint_that_would_run_code_is_refused(run):
    import pickle

    (run / "checkpoint.pt").write_bytes(pickle.dumps(print))
    with pytest.raises(ValueError, match="damaged or cut off"):
        train(TINY["ppo"], 1, run, resume=True)


def test_folders_that_are_no_runs_are_named(tmp_path):
    with pytest.raises(ValueError, match="no run folder"):
        resumed_recipe(tmp_path)
    with pytest.raises(ValueError, match="resumed"):
        train(TINY["ppo"], 1, tmp_path, resume=True)
    with pytest.raises(ValueError, match=r"no recipe\.json"):
        load(tmp_path)
    with pytest.raises(ValueError, match="unknown agent 'sacpaper'"):
        load("sacpaper")
    with pytest.raises(ValueError, match="no folder runs/absent"):
        load("runs/absent")


def test_a_policy_file_that_is_cut_off_is_named(run):
    path = run / "policy.onnx"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match="cut off"):
        Agent(run)
    path.unlink()
    with pytest.raises(ValueError, match="training has not ended"):
        Agent(run)
    assert isinstance(names(), tuple)


def test_training_stops_at_a_target(tmp_path, monkeypatch, exported):
    def reached(self):
        self.history.append(training.Progress(steps=1, wall=0, cpu=0, x1=0.1, x2=0.05, rho=0.1))

    monkeypatch.setattr(training._Run, "evaluate", reached)
    assert train(TINY["ppo"], 1, tmp_path / "run", target_db=19.0).steps == 0
    assert train(TINY["ppo"], 1, tmp_path / "more", target_db=25.0).steps == TINY["ppo"].steps
    with pytest.raises(ValueError, match="target must be positive"):
        train(TINY["ppo"], 1, tmp_path / "other", target_db=-3.0)
