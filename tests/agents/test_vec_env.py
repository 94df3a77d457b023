"""The Stable-Baselines3 vector environment: the same cars, with SB3's customs."""

import pickle

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from agents.vec_env import QuarterCarHumpVecEnv
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv

SHORT = 0.3  # [s] 60 intervals


def test_equals_single_environments_bit_for_bit():
    env = QuarterCarHumpVecEnv(5, duration=SHORT)
    single = [QuarterCarHumpEnv(duration=SHORT) for _ in range(5)]
    env.seed(4)
    observation = env.reset()
    expected = [each.reset(seed=4 + i)[0] for i, each in enumerate(single)]
    rng = np.random.default_rng(0)
    finished = 0
    for _ in range(200):
        assert np.array_equal(observation, expected)
        action = rng.uniform(-1, 1, (5, 2)).astype(np.float32)
        observation, rewards, dones, infos = env.step(action)
        assert rewards.dtype == np.float32
        for i, each in enumerate(single):
            expected[i], reward, terminated, truncated, info = each.step(action[i])
            assert rewards[i] == np.float32(reward)
            assert dones[i] == (terminated or truncated)
            if dones[i]:
                finished += 1
                assert np.array_equal(infos[i]["terminal_observation"], expected[i])
                assert infos[i]["TimeLimit.truncated"] == truncated
                assert np.array_equal(infos[i]["force"], info["force"])
                assert infos[i]["reward_x1"] == info["reward_x1"]
                expected[i] = each.reset()[0]
    assert finished >= 10


def test_leaving_the_travel_limit_is_no_time_limit():
    env = QuarterCarHumpVecEnv(1)
    env.set_options({"state": [3.3, 0.0, 60.0, 0.0]})  # 1 % within the limit of 3.349 m, outward
    env.reset()
    _, _, dones, infos = env.step(np.zeros((1, 2), np.float32))
    assert dones[0]
    assert not infos[0]["TimeLimit.truncated"]


def test_options_and_seeds_hold_for_one_reset():
    env = QuarterCarHumpVecEnv(2)
    env.set_options([{"phase": 0.1}, {"phase": 0.2}])
    env.seed(1)
    first = env.reset()
    assert not np.array_equal(env.reset(), first)


def test_attributes_of_single_cars():
    env = QuarterCarHumpVecEnv(3)
    assert [each.name for each in env.get_attr("scenario")] == ["paper"] * 3
    env.set_attr("force_scale", 0.5, indices=[1])
    env.reset()
    assert [limit[0] for limit in env.get_attr("force_limit")] == [280.0, 140.0, 280.0]
    assert env.get_attr("force_scale", indices=1) == [0.5]
    assert env.env_method("get_wrapper_attr", "dt", indices=[2]) == [0.005]
    assert env.env_is_wrapped(VecMonitor) == [False] * 3
    assert np.array_equal(env.get_attr("state")[0], env.vector.states[0])


def test_ppo_learns_through_sb3s_wrappers():
    env = VecNormalize(VecMonitor(QuarterCarHumpVecEnv(8, duration=SHORT)))
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, n_epochs=1, seed=0)
    model.learn(1024)
    assert len(model.ep_info_buffer) > 0
    assert model.ep_info_buffer[0]["l"] == 60
    mean, _ = evaluate_policy(model, env, n_eval_episodes=2, warn=False)
    assert np.isfinite(mean)


def test_pickles():
    env = QuarterCarHumpVecEnv(2)
    env.seed(0)
    env.reset()
    twin = pickle.loads(pickle.dumps(env))
    action = np.full((2, 2), 0.1, np.float32)
    assert np.array_equal(env.step(action)[0], twin.step(action)[0])
