"""What every environment of this library promises, one car or many.

A kind is a way to make several cars with the same interface; a new one joins `KINDS`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from qcar_env import scenario
from qcar_env.envs import episode as task
from qcar_env.envs.vector import QuarterCarHumpVectorEnv

ID = "QuarterCarHump-v0"
PAPER = scenario("paper")
REST = (0.0, 0.0, 0.0, 0.0)
N = 3


class Scalar:
    """One car with the interface of many."""

    num_envs = 1

    def __init__(self, **kwargs: Any) -> None:
        self.env = gym.make(ID, **kwargs)
        self.single_observation_space = self.env.observation_space
        self.single_action_space = self.env.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        observation, info = self.env.reset(seed=seed, options=options)
        return observation[np.newaxis], many(info)

    def step(self, actions: Any):
        assert len(actions) == 1
        observation, reward, terminated, truncated, info = self.env.step(actions[0])
        flags = (np.array([terminated]), np.array([truncated]))
        return observation[np.newaxis], np.array([reward]), *flags, many(info)

    def close(self) -> None:
        self.env.close()


def many(info: dict[str, Any]) -> dict[str, Any]:
    return {key: np.array([value]) for key, value in info.items()}


def sync(autoreset: AutoresetMode = AutoresetMode.DISABLED, **kwargs: Any):
    vector = {"autoreset_mode": autoreset}
    return gym.make_vec(ID, N, vectorization_mode="sync", vector_kwargs=vector, **kwargs)


def native(autoreset: AutoresetMode = AutoresetMode.DISABLED, **kwargs: Any):
    return QuarterCarHumpVectorEnv(N, autoreset_mode=autoreset, **kwargs)


KINDS = {"scalar": Scalar, "sync": sync, "native": native}
VECTORS = {"sync": sync, "native": native}


@pytest.fixture(params=list(KINDS))
def make(request):
    made = []

    def build(**kwargs: Any):
        made.append(KINDS[request.param](**kwargs))
        return made[-1]

    yield build
    for env in made:
        env.close()


def actions_of(env: Any, rng: np.random.Generator) -> np.ndarray:
    shape = (env.num_envs, *env.single_action_space.shape)
    return rng.uniform(-1.2, 1.2, shape).astype(np.float32)


def idle(env: Any) -> np.ndarray:
    return np.zeros((env.num_envs, *env.single_action_space.shape), dtype=np.float32)


class TestContract:
    def test_the_spaces_are_those_of_one_car(self, make):
        for observe, size in (("full", task.FULL_SIZE), ("feedback", task.FEEDBACK_SIZE)):
            env = make(observe=observe)
            assert env.single_observation_space.shape == (size,)
            assert env.single_observation_space.dtype == np.float32
            assert np.all(np.isfinite(env.single_observation_space.high))
            low, high = env.single_action_space.low, env.single_action_space.high
            assert (low.tolist(), high.tolist()) == ([-1.0, -1.0], [1.0, 1.0])

    def test_observations_stay_in_their_space(self, make):
        env, rng = make(duration=0.5), np.random.default_rng(1)
        observation, _ = env.reset(seed=1)
        for _ in range(100):
            for row in observation:
                assert row in env.single_observation_space
            observation, reward, terminated, _, _ = env.step(actions_of(env, rng))
            assert observation.dtype == np.float32
            assert observation.shape == (env.num_envs, task.FULL_SIZE)
            assert reward.shape == (env.num_envs,)
            if np.any(terminated):
                break

    def test_a_seed_gives_one_trajectory_and_another_seed_another(self, make):
        def trajectory(seed):
            env, rng = make(scenario="paper-randomised"), np.random.default_rng(1)
            seen = [env.reset(seed=seed)[0]]
            seen += [env.step(actions_of(env, rng))[0] for _ in range(10)]
            return np.array(seen)

        assert np.array_equal(trajectory(4), trajectory(4))
        assert not np.array_equal(trajectory(4), trajectory(5))

    def test_cars_of_one_seed_start_apart(self, make):
        starts, _ = make().reset(seed=0)
        again, _ = make(scenario="paper-randomised").reset(seed=0)
        for found in (starts, again):
            assert len({row.tobytes() for row in found}) == len(found)

    def test_every_car_moves_as_one_alone(self, make):
        env, alone = make(), Scalar()
        options = {"state": (0.3, -0.2, 5.0, 9.0), "phase": 1.0}
        observation, _ = env.reset(seed=0, options=options)
        expected, _ = alone.reset(seed=9, options=options)
        rng = np.random.default_rng(1)
        for _ in range(50):
            # float32 rounds entries of order one to 6e-8; integration may differ by 1e-12
            assert observation == pytest.approx(np.repeat(expected, env.num_envs, 0), abs=1e-6)
            action = actions_of(alone, rng)
            observation, reward, _, _, info = env.step(np.repeat(action, env.num_envs, 0))
            expected, one, _, _, its = alone.step(action)
            assert reward == pytest.approx(np.repeat(one, env.num_envs), rel=1e-9)
            assert info["force"] == pytest.approx(np.repeat(its["force"], env.num_envs, 0))

    def test_the_terms_of_the_reward_add_up_for_each_car(self, make):
        env, rng = make(duration=0.5), np.random.default_rng(2)
        env.reset(seed=2)
        for _ in range(20):
            _, reward, terminated, _, info = env.step(actions_of(env, rng))
            terms = sum(info[name] for name in ("reward_x1", "reward_x2", "reward_travel"))
            assert terms == pytest.approx(reward, rel=1e-12)  # the order of the sum
            if np.any(terminated):
                break

    def test_the_force_is_the_clipped_action_times_the_limit(self, make):
        env, rng = make(force_scale=0.5), np.random.default_rng(3)
        env.reset(seed=3)
        for _ in range(5):
            action = actions_of(env, rng)
            info = env.step(action)[-1]
            expected = np.clip(action.astype(float), -1.0, 1.0) * [140.0, 16.5]
            assert np.stack(list(info["force"])) == pytest.approx(expected, rel=1e-12)

    def test_time_truncates_and_travel_terminates(self, make):
        env = make(duration=0.05)
        env.reset(seed=0, options={"state": REST})
        for k in range(10):
            _, _, terminated, truncated, _ = env.step(idle(env))
            assert not np.any(terminated)
            assert np.all(truncated) if k == 9 else not np.any(truncated)
        limit = PAPER.travel_limit * PAPER.reference_amplitudes[1]
        env.reset(seed=0, options={"state": (0.0, 0.99 * limit, 0.0, 99.0)})
        _, _, terminated, truncated, info = env.step(idle(env))
        assert np.all(terminated)
        assert not np.any(truncated)
        assert np.all(info["reward_travel"] < 0.0)

    def test_what_is_returned_belongs_to_its_receiver(self, make):
        env = make()
        observation, _ = env.reset(seed=0)
        kept = [(observation, observation.copy())]
        for value in (0.5, -0.5):
            observation, reward, *_ = env.step(idle(env) + np.float32(value))
            kept += [(observation, observation.copy()), (reward, reward.copy())]
        env.step(idle(env))
        assert all(np.array_equal(now, then) for now, then in kept)

    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_an_action_that_is_not_a_number_is_refused(self, make, value):
        env = make()
        env.reset(seed=0)
        bad = idle(env)
        bad[-1, 0] = value
        with pytest.raises(ValueError, match=r"actions? must be finite, got .*\[-1, 1\]"):
            env.step(bad)

    def test_an_action_of_the_wrong_shape_is_refused(self, make):
        env = make()
        env.reset(seed=0)
        with pytest.raises(ValueError, match=r"actions? must have shape"):
            env.step(np.zeros((env.num_envs, 3), dtype=np.float32))


@pytest.mark.parametrize("kind", list(VECTORS))
class TestAutoreset:
    """The last observation of an episode reaches the learner in every mode."""

    def final(self) -> np.ndarray:
        alone = Scalar(duration=0.02)
        alone.reset(seed=0, options={"state": REST, "phase": 0.0})
        for _ in range(4):
            observation, *_ = alone.step(idle(alone))
        return observation[0]

    def run(self, kind, mode):
        env = VECTORS[kind](autoreset=mode, duration=0.02)
        env.reset(seed=0, options={"state": REST, "phase": 0.0})
        for _ in range(4):
            found = env.step(idle(env))
        assert np.all(found[3])
        return env, found

    def test_the_same_step_returns_the_new_start_and_keeps_the_end(self, kind):
        env, (observation, _, _, _, info) = self.run(kind, AutoresetMode.SAME_STEP)
        for row, last in zip(observation, info["final_obs"], strict=True):
            assert last == pytest.approx(self.final(), abs=1e-6)  # float32
            assert not np.array_equal(row, last)
        _, _, terminated, truncated, _ = env.step(idle(env))
        assert not np.any(terminated | truncated)
        env.close()

    def test_the_next_step_returns_the_new_start_without_reward(self, kind):
        env, (observation, *_) = self.run(kind, AutoresetMode.NEXT_STEP)
        for row in observation:
            assert row == pytest.approx(self.final(), abs=1e-6)  # float32
        observation, reward, terminated, truncated, _ = env.step(idle(env))
        assert not np.any(terminated | truncated)
        assert np.all(reward == 0.0)
        assert not any(np.array_equal(row, self.final()) for row in observation)
        env.close()

    def test_without_autoreset_the_end_stays_until_reset(self, kind):
        env, (observation, *_) = self.run(kind, AutoresetMode.DISABLED)
        for row in observation:
            assert row == pytest.approx(self.final(), abs=1e-6)  # float32
        with pytest.raises((ValueError, AssertionError)):  # Gymnasium's own SyncVectorEnv asserts
            env.step(idle(env))
        env.close()
