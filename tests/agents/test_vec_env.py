"""The Stable-Baselines3 vector environment: the same cars, with SB3's customs."""

import pickle

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from qcar_env.agents.recipes import RECIPES
from qcar_env.agents.vec_env import QuarterCarHumpVecEnv
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.envs.reward import removed_reward
from qcar_env.scenarios import SCENARIOS

SHORT = 0.3  # [s] 60 intervals


@pytest.mark.parametrize("reward", ["amplitudes", "removed"])
def test_equals_single_environments_bit_for_bit(reward):
    env = QuarterCarHumpVecEnv(5, duration=SHORT, reward=reward)
    single = [QuarterCarHumpEnv(duration=SHORT, reward=reward) for _ in range(5)]
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
            assert np.array_equal(infos[i]["force"], info["force"])
            assert {k: v for k, v in infos[i].items() if k.startswith("reward_")} == {
                k: v for k, v in info.items() if k.startswith("reward_")
            }
            if dones[i]:
                finished += 1
                assert np.array_equal(infos[i]["terminal_observation"], expected[i])
                assert infos[i]["TimeLimit.truncated"] == truncated
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


def test_options_that_some_cars_have_leave_the_others_as_a_single_environment_has_them():
    options = [{"phase": 1.0}, {}, {"phase": 3.0, "force_scale": 0.5}, {"force_scale": 0.25}]
    env = QuarterCarHumpVecEnv(4)
    env.seed(7)
    env.set_options(options)
    found = env.reset()
    for i, each in enumerate(options):
        assert np.array_equal(found[i], QuarterCarHumpEnv().reset(seed=7 + i, options=each)[0])
    assert env.get_attr("force_scale") == [1.0, 1.0, 0.5, 0.25]
    # the second reset goes on with the cars' own draws, and keeps their force limits
    singles = [QuarterCarHumpEnv() for _ in options]
    for i, (single, each) in enumerate(zip(singles, options, strict=True)):
        single.reset(seed=7 + i, options=each)
    assert np.array_equal(env.reset(), [single.reset()[0] for single in singles])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([{}, {"phas": 1.0}], "unknown reset option 'phas'; did you mean 'phase'"),
        ([{}, {"reset_mask": True}], "unknown reset option 'reset_mask'"),
        (3, "options must be one dict or 2 of them, got 3; give one for each car"),
        ([{}, None], r"options must be one dict or 2 of them, got \[\{\}, None\]; give one"),
        ([{}], "options must be one dict or 2 of them, got 1; give one for each car"),
    ],
)
def test_options_that_fit_no_car_are_refused_before_one_begins(options, message):
    env = QuarterCarHumpVecEnv(2)
    env.reset()
    states = env.vector.states.copy()
    env.set_options(options)
    with pytest.raises(ValueError, match=message):
        env.reset()
    assert np.array_equal(env.vector.states, states)


@pytest.mark.parametrize("seed", [np.ones((2, 2)), b"abc", "1", -1, 0.5])
def test_a_seed_that_is_no_whole_number_is_refused(seed):
    env = QuarterCarHumpVecEnv(2)
    with pytest.raises(ValueError, match="seed must be"):
        env.seed(seed)
    assert env.seed(3) == [3, 4]


def test_an_index_out_of_range_changes_no_car():
    env = QuarterCarHumpVecEnv(3)
    for indices in ([0, 7], [0, 1.5], 7):
        with pytest.raises(ValueError, match=r"indices must be .* 0 to 2, got .*; give indices"):
            env.set_attr("force_scale", 0.25, indices)
        with pytest.raises(ValueError, match="indices must be"):
            env.get_attr("force_scale", indices)
    assert env.get_attr("force_scale") == [1.0] * 3


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("force_scale", None, "force_scale must be a number, got None"),
        ("force_scale", 0.0, "force_scale must be positive, got 0"),
        ("dt", 0.01, "unknown attribute to set 'dt'. Known: force_scale, scenario"),
        ("force_scal", 0.5, "unknown attribute to set 'force_scal'; did you mean 'force_scale'"),
        ("scenario", None, "unknown scenario None"),
        ("scenario", "papr", "unknown scenario 'papr'; did you mean 'paper'"),
    ],
)
def test_an_attribute_that_cannot_be_is_refused(name, value, message):
    env = QuarterCarHumpVecEnv(2)
    with pytest.raises(ValueError, match=message):
        env.set_attr(name, value)


def test_a_step_needs_actions():
    env = QuarterCarHumpVecEnv(1)
    env.reset()
    with pytest.raises(ValueError, match=r"actions must be given .* call step_async"):
        env.step_wait()


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


def amplitudes(seen):
    seen = np.asarray(seen, dtype=np.float64)
    return np.hypot(seen[:, 0:2], seen[:, 2:4])


@pytest.mark.parametrize("limit", [1.0, 0.25])
def test_the_reward_is_the_removed_amplitude_in_units_of_full_force(limit):
    scenario = SCENARIOS["paper"]
    weights = {"removed2": 0.5, "remaining1": 0.3, "remaining2": 0.1, "worst": 2.0}
    env = QuarterCarHumpVecEnv(
        4, scenario=scenario, force_scale=limit, reward=removed_reward(scenario, **weights)
    )
    env.seed(3)
    before = amplitudes(env.reset())
    full = (
        limit
        * np.array(scenario.actuator.limit)
        * scenario.dt
        / (scenario.excitation.omega * np.array(scenario.reference_amplitudes))
    )
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (20, 4, 2)):
        seen, reward, _, infos = env.step(action.astype(np.float32))
        now = amplitudes(seen)
        expected = ((before - now) / full) @ (1.0, 0.5) - now @ (0.3, 0.1) - 2.0 * now.max(axis=1)
        # float32 observations, over what full force removes: about 1e-7 / 0.01
        np.testing.assert_allclose(reward, expected, rtol=0.0, atol=2e-4)
        assert [each["reward_removed"] for each in infos] == pytest.approx(reward, rel=1e-6)
        before = now


def test_leaving_the_travel_costs_ten():
    env = QuarterCarHumpVecEnv(1, reward="removed")
    env.set_options({"state": [3.3, 0.0, 60.0, 0.0]})
    env.reset()
    infos = env.step(np.zeros((1, 2), np.float32))[3]
    assert infos[0]["reward_travel"] == pytest.approx(-10.0)


def test_one_policy_sees_a_limit_for_each_episode():
    recipe = RECIPES["ppo-budget"]
    env = QuarterCarHumpVecEnv(
        1400, scenario=recipe.scenario, observe_limit=True, reward=recipe.reward, duration=0.05
    )
    env.seed(0)
    seen = env.reset()
    first = seen[:, -1].copy()
    for _ in range(10):
        seen, _, dones, infos = env.step(np.ones((1400, 2), np.float32))
    assert dones.all()
    for i, info in enumerate(infos):
        force = np.array([280.0, 33.0]) * first[i]
        np.testing.assert_allclose(info["force"], force, rtol=1e-6)  # float32 of the entry
    assert np.any(seen[:, -1] != first)
    limits, counts = np.unique(seen[:, -1], return_counts=True)
    np.testing.assert_allclose(limits, sorted(recipe.force_scales), rtol=1e-6)
    assert counts.min() > 66  # of 100 expected: 3.5 standard deviations


def test_one_seed_one_history_and_another_seed_another():
    def history(seed):
        env = QuarterCarHumpVecEnv(
            5, staggered=True, scenario="paper-randomised", duration=0.1, reward="removed"
        )
        env.seed(seed)
        found = [env.reset()]
        return np.array(found + [env.step(np.full((5, 2), 0.1, "f"))[0] for _ in range(50)])

    np.testing.assert_array_equal(history(1), history(1))
    assert np.any(history(1) != history(2))


def test_staggered_episodes_do_not_end_together():
    env = QuarterCarHumpVecEnv(40, staggered=True, duration=SHORT)
    env.seed(0)
    env.reset()
    ends = [int(env.step(np.zeros((40, 2), np.float32))[2].sum()) for _ in range(60)]
    assert sum(ends) >= 40
    assert max(ends) < 8


def test_a_snapshot_brings_the_cars_back():
    env = QuarterCarHumpVecEnv(5, scenario="paper-randomised", duration=0.1)
    env.seed(0)
    env.reset()
    push = np.full((5, 2), 0.2, np.float32)
    for _ in range(25):
        env.step(push)
    kept = env.snapshot()
    first = [env.step(push)[0] for _ in range(30)]
    env.restore(kept)
    np.testing.assert_array_equal(first, [env.step(push)[0] for _ in range(30)])
    fresh = QuarterCarHumpVecEnv(5, scenario="paper-randomised", duration=0.1)
    fresh.restore(kept)
    np.testing.assert_array_equal(first, [fresh.step(push)[0] for _ in range(30)])


def test_negative_weights_and_no_cars_are_refused():
    with pytest.raises(ValueError, match="weight worst must not be negative"):
        removed_reward(SCENARIOS["paper"], worst=-1.0)
    with pytest.raises(ValueError, match="num_envs"):
        QuarterCarHumpVecEnv(0)
