import math

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("ray")
pytest.importorskip("torch")
pytest.importorskip("tree")  # of ray[rllib]
pytest.importorskip("lz4")

# what Ray itself warns of is not ours
pytestmark = [pytest.mark.filterwarnings("default"), pytest.mark.slow]


@pytest.fixture(scope="module")
def rllib():
    from qcar_env.agents import rllib
    from qcar_env.evaluation import ray_workers

    with ray_workers.cluster(cores=2):
        yield rllib


def test_a_worker_makes_what_gymnasium_makes(rllib):
    vector = rllib.make({"num_envs": 3, "reward": "removed"})
    own = gym.make_vec("QuarterCarHump-v0", num_envs=3, reward="removed")
    action = np.full((3, 2), 0.5, dtype=np.float32)
    for made in (vector, own):
        made.reset(seed=4)
    for mine, theirs in zip(vector.step(action)[:4], own.step(action)[:4], strict=True):
        np.testing.assert_array_equal(mine, theirs)
    one = rllib.make({"reward": "removed"})
    assert one.observation_space == vector.single_observation_space


@pytest.mark.parametrize("workers", [0, 1])
def test_ppo_learns_on_the_native_vector_environment(rllib, workers):
    settings = rllib.ppo(cars=8, workers=workers, reward="removed", duration=0.25)
    settings.training(train_batch_size_per_learner=512, minibatch_size=128).debugging(seed=0)
    algorithm = settings.build_algo()
    try:

        def native(runner):
            if runner.env is None:  # of the process that learns, beside workers
                return None
            return type(runner.env.unwrapped).__name__, runner.num_envs

        kinds = algorithm.env_runner_group.foreach_env_runner(native)
        assert ("QuarterCarHumpVectorEnv", 8) in kinds
        before = weights(algorithm)
        result = algorithm.train()
        assert result["env_runners"]["num_env_steps_sampled_lifetime"] >= 512
        assert math.isfinite(result["env_runners"]["episode_return_mean"])
        assert any((a != b).any() for a, b in zip(before, weights(algorithm), strict=True))
    finally:
        algorithm.stop()


def weights(algorithm):
    found = algorithm.get_module().get_state()
    return [np.array(each) for each in found.values()]
