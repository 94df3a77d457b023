"""Trainings: minutes each, run by `make test-learning`."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import gymnasium as gym  # noqa: E402
from stable_baselines3 import PPO, SAC  # noqa: E402

import qcar_env  # noqa: E402, F401 - registers the environment
from qcar_env.agents.recipes import RECIPES  # noqa: E402
from qcar_env.agents.scoring import reference, run  # noqa: E402
from qcar_env.agents.train import train  # noqa: E402
from qcar_env.agents.vec_env import QuarterCarHumpVecEnv  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, episodes  # noqa: E402

pytestmark = pytest.mark.learning
CNVC = (0.1152, 0.0547)  # amplitudes of x1, x2 in continuous time at the same limit [m]


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def below_cnvc(model):
    drawn = episodes(TRACKS["paper"], "validation", force_scale=1.0, count=1)
    found = run(model, TRACKS["paper"], drawn)
    beside = reference("cnvc", TRACKS["paper"], 1.0)
    return np.all(found.amplitudes[0] < np.minimum(CNVC, beside.amplitudes[0]))


def test_sac_with_its_defaults_ends_below_cnvc():
    model = SAC("MlpPolicy", gym.make("QuarterCarHump-v0"), seed=0, device="cpu")
    assert below_cnvc(model.learn(50_000))


def test_ppo_with_its_defaults_ends_below_cnvc():
    model = PPO("MlpPolicy", QuarterCarHumpVecEnv(8), seed=0, device="cpu")
    assert below_cnvc(model.learn(1_000_000))


@pytest.mark.parametrize("name", ["ppo-paper", "sac-paper"])
def test_the_recipes_end_ten_times_below_cnvc(name, tmp_path):
    result = train(RECIPES[name], 0, tmp_path / "run")
    found = result.validation["1"]
    assert found["x1"] < CNVC[0] / 10.0
    assert found["x2"] < CNVC[1] / 10.0
