"""Every shipped agent loads without torch, drives, and stays above what is possible."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxruntime")

from qcar_env.agents.load import PRETRAINED, load, names
from qcar_env.agents.publish import FILES, LARGEST
from qcar_env.agents.recipes import RECIPES
from qcar_env.agents.scoring import optimum, run
from qcar_env.evaluation.tracks import episodes


def test_agents_are_shipped():
    assert {"ppo-paper", "sac-paper"} <= set(names())


@pytest.mark.parametrize("name", names())
def test_a_shipped_agent_scores_as_reported_and_above_the_optimum(name):
    policy, recipe = load(name), RECIPES[name]
    reported = json.loads((PRETRAINED / name / "result.json").read_text())
    for scale in recipe.force_scales:
        drawn = episodes(recipe.track, "held-out", force_scale=scale)
        found = run(policy, recipe.track, drawn[:2], observe_limit=recipe.observe_limit)
        for one, rho in zip(drawn[:2], found.rho, strict=True):
            assert rho >= optimum(one.scenario) * (1.0 - 2e-5)  # a cubic over 0.275 rad
        at = reported["held_out"][f"{scale:g}"]
        assert np.max(found.rho) <= at["rho_largest"] * 1.01 + 1e-4
        assert np.max(found.rho) < 1.0


@pytest.mark.parametrize("name", [each for each in names() if "randomised" not in each])
def test_a_shipped_agent_leaves_of_the_papers_vibration_what_was_reported(name):
    policy, recipe = load(name), RECIPES[name]
    reported = json.loads((PRETRAINED / name / "result.json").read_text())
    for scale in recipe.force_scales:
        drawn = episodes(recipe.track, "held-out", force_scale=scale)
        found = run(policy, recipe.track, drawn, observe_limit=recipe.observe_limit)
        at = reported["held_out"][f"{scale:g}"]
        # reported with exact maps; the Runge-Kutta steps of the environment differ by 1e-5
        assert np.mean(found.rho) == pytest.approx(at["rho"], rel=0.02, abs=1e-5)


@pytest.mark.parametrize("name", names())
def test_a_shipped_agent_is_small_safe_and_explains_itself(name):
    folder = PRETRAINED / name
    held = {each.name for each in folder.iterdir()}
    assert held == {*FILES, "result.json"}
    for each in folder.iterdir():
        assert each.stat().st_size < LARGEST
    result = json.loads((folder / "result.json").read_text())
    assert result["shipped_seed"] in [each["seed"] for each in result["seeds"]]
    best = min(
        result["seeds"],
        key=lambda run: np.mean([each["rho"] for each in run["validation"].values()]),
    )
    assert best["seed"] == result["shipped_seed"]


def test_an_agent_loads_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None; sys.modules['stable_baselines3'] = None\n"
        "import numpy as np; from qcar_env.agents.load import load\n"
        "print(load('ppo-paper').predict(np.zeros(8))[0].shape)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        cwd=PRETRAINED.parent.parent,
    )
    assert done.stdout.strip() == "(2,)", done.stderr


@pytest.mark.parametrize("name", names())
def test_a_shipped_policy_says_nothing_of_the_machine_that_made_it(name):
    content = (PRETRAINED / name / "policy.onnx").read_bytes()
    assert b"stack_trace" not in content
    assert b'File "' not in content


@pytest.mark.parametrize("agent", [None, 3, "sac-papr", "nowhere/sac"])
def test_what_is_no_agent_is_refused_with_the_list(agent):
    with pytest.raises(ValueError, match=rf"{agent!s}.*sac-paper"):
        load(agent)


def test_no_cars_get_no_actions():
    assert load("sac-paper").predict(np.zeros((0, 8)))[0].shape == (0, 2)


@pytest.mark.parametrize("observation", [None, "none", np.zeros(3), np.zeros((1, 2, 8))])
def test_what_is_no_observation_is_refused(observation):
    with pytest.raises(ValueError, match=r"observation of .* must .*, got"):
        load("sac-paper").predict(observation)
