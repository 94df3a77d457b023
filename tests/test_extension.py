"""A user's own parts, defined here and nowhere else, work everywhere; CONTRIBUTING shows the same.

A spring, a damper, a tyre, an actuator with memory, a sensor with noise, a road from a function, a
signal, a reward term, a law and a randomised number: nothing of the library is touched.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

from qcar_env.analysis.optimum import period_optimum
from qcar_env.analysis.simulate import simulate
from qcar_env.baselines.law_policy import LawPolicy
from qcar_env.control.law import Law
from qcar_env.control.lqr import sampled_plant
from qcar_env.envs.reward import Term, WheelAmplitude
from qcar_env.evaluation.rollouts import rollout
from qcar_env.parts.actuator import Actuator
from qcar_env.parts.damper import Damper
from qcar_env.parts.part import clamp, most, number
from qcar_env.parts.sensor import Sensor
from qcar_env.parts.spring import Spring
from qcar_env.parts.tyre import Tyre
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.signals import Signal, signal
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.shapes import Sine
from qcar_env.scenarios import Scenario, Uniform, Vary
from qcar_env.validation import non_negative, positive

N = 3


@dataclass(frozen=True, kw_only=True)
class TanhSpring(Spring):
    """A spring that gives way, ``F = F0 tanh(k d / F0)``."""

    k: float = number("stiffness", "N/m", positive)
    F0: float = number("largest force", "N", positive)

    @staticmethod
    def force(travel: Any, p: Any) -> Any:
        return p.F0 * np.tanh(p.k * travel / p.F0)


@dataclass(frozen=True, kw_only=True)
class QuadraticDamper(Damper):
    """A damper whose force grows with the square of the speed."""

    c: float = number("damping", "N s/m", positive)
    c2: float = number("quadratic damping", "N s^2/m^2", non_negative)

    @staticmethod
    def force(rate: Any, p: Any) -> Any:
        return (p.c + p.c2 * abs(rate)) * rate


@dataclass(frozen=True, kw_only=True)
class HertzTyre(Tyre):
    """A tyre that stiffens when it is compressed and cannot pull."""

    k: float = number("stiffness", "N/m", positive)

    @staticmethod
    def force(compression: Any, rate: Any, load: Any, p: Any) -> Any:
        return most(p.k * compression * (1.0 + 5.0 * abs(compression)), -load)

    @staticmethod
    def kick(jump: Any, p: Any) -> Any:
        return 0.0 * jump


class Valve(NamedTuple):
    """Memory of `TwoStage`."""

    pressure: Any  # [N]
    F: Any  # [N]


@dataclass(frozen=True, kw_only=True)
class TwoStage(Actuator):
    """A hydraulic actuator between the masses: a valve and a chamber, each with its lag."""

    limit: tuple[float, ...] = (800.0,)
    valve: float = number("time constant", "s", positive, 0.01)
    chamber: float = number("time constant", "s", positive, 0.02)

    State = Valve

    @staticmethod
    def command(action: Any, p: Any) -> Any:
        return (p.limit[0] * clamp(action[0], -1.0, 1.0),)

    @staticmethod
    def rate(memory: Any, command: Any, travel_rate: Any, p: Any) -> Any:
        return Valve(
            (command[0] - memory.pressure) / p.valve, (memory.pressure - memory.F) / p.chamber
        )

    @staticmethod
    def force(memory: Any, command: Any, travel_rate: Any, p: Any) -> Any:
        return -memory.F, memory.F


@dataclass(frozen=True, kw_only=True)
class DriftingSensor(Sensor):
    """A sensor whose noise grows with what it reads."""

    @staticmethod
    def measure(value: Any, draw: Any, p: Any) -> Any:
        return value + p.bias + p.noise * draw * (1.0 + abs(value))


def washboard(s: float) -> float:
    """Return the height of a washboard that begins at 2 m [m]."""
    return 0.01 * (1.0 - math.cos(3.0 * (s - 2.0))) if s > 2.0 else 0.0


def jounce(m: Any, p: Any) -> Any:
    """Return how fast the body moves away from the road [m/s]."""
    return m.x.v2 - m.y_dot


JOUNCE = Signal("jounce", "m/s", "body over road", jounce)


def comfort(now: Any, before: Any, p: Any) -> Any:
    return p.weight * (now[0] * now[0] + p.jerk * (now[0] - before[0]) * (now[0] - before[0]))


@dataclass(frozen=True, kw_only=True)
class Comfort(Term):
    """Squared acceleration of the body, and of its change."""

    name = "comfort"
    reads = (signal("body_acceleration"),)
    cost = staticmethod(comfort)

    weight: float = number("weight", "-", positive, 1.0)
    jerk: float = number("weight of the change", "-", non_negative, 0.5)


@dataclass(frozen=True, kw_only=True)
class Signum(Law):
    """Push against the body's velocity, softened: ``u2 = -G v2 / (|v2| + v0)``."""

    G: float = number("gain G", "m/s^2", non_negative, 2.0)
    v0: float = number("velocity", "m/s", positive, 0.1)
    name = "signum"

    @staticmethod
    def command(x: Any, eta: Any, p: Any) -> tuple[Any, Any]:
        return 0.0 * x.v1, -p.G * x.v2 / (abs(x.v2) + p.v0)


CAR = QuarterCar(
    m1=40.0,
    m2=300.0,
    spring=TanhSpring(k=20e3, F0=4e3),
    damper=QuadraticDamper(c=900.0, c2=400.0),
    tyre=HertzTyre(k=2e5),
)
OBSERVED = ("x1", "x2", "v1", "v2", "body_acceleration", "tyre_load", JOUNCE)
REWARD = (WheelAmplitude(), Comfort())


@pytest.fixture(scope="module")
def own() -> Scenario:
    return Scenario(
        name="own",
        car=CAR,
        road=FunctionRoad(profile=washboard, kinks_at=(2.0,)),
        speed=8.0,
        actuator=TwoStage(delay=0.01),
        sensors=(DriftingSensor(signal="body_acceleration", noise=0.1, delay=0.005),),
        randomisation=(
            Vary(by=Uniform(low=0.8, high=1.2), numbers={"car.spring.k": 1.0}),
            Vary(by=Uniform(low=250.0, high=350.0), numbers={"car.m2": 0.0}),
        ),
        duration=1.0,
    )


def actions(steps: int = 150) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.2, 1.2, (steps, N, 1)).astype(np.float32)


def test_one_environment_and_many_agree_to_the_last_bit(own):
    vector = gym.make_vec(
        "QuarterCarHump-v0", num_envs=N, scenario=own, observe=OBSERVED, reward=REWARD
    )
    seen, _ = vector.reset(seed=5)
    single = [
        gym.make("QuarterCarHump-v0", scenario=own, observe=OBSERVED, reward=REWARD)
        for _ in range(N)
    ]
    alone = np.array([env.reset(seed=5 + i)[0] for i, env in enumerate(single)])
    np.testing.assert_array_equal(seen, alone)
    for each in actions():
        seen, reward, _, _, info = vector.step(each)
        rows = [env.step(action) for env, action in zip(single, each, strict=True)]
        np.testing.assert_array_equal(seen, np.array([row[0] for row in rows]))
        np.testing.assert_array_equal(reward, np.array([row[1] for row in rows]))
        for name in ("reward_x1", "reward_comfort", "reward_travel"):
            np.testing.assert_array_equal(info[name], np.array([row[4][name] for row in rows]))
    masses = {env.unwrapped.episode.car.m2 for env in single}
    assert len(masses) == N
    assert all(250.0 <= mass <= 350.0 for mass in masses)


def test_each_of_them_acts(own):
    def run(scenario: Scenario) -> np.ndarray:
        env = gym.make("QuarterCarHump-v0", scenario=scenario, observe=OBSERVED, reward=REWARD)
        env.reset(seed=1, options={"state": (0.0, 0.0, 0.0, 0.0)})
        return np.array([env.step(action[0])[0] for action in actions()])

    plain = dataclasses.replace(own, randomisation=())
    base = run(plain)
    assert np.array_equal(base, run(plain))
    parts = {
        "spring": dataclasses.replace(CAR, spring=TanhSpring(k=25e3, F0=4e3)),
        "damper": dataclasses.replace(CAR, damper=QuadraticDamper(c=900.0, c2=0.0)),
        "tyre": dataclasses.replace(CAR, tyre=HertzTyre(k=1.5e5)),
    }
    changed = {name: dataclasses.replace(plain, car=car) for name, car in parts.items()}
    changed["actuator"] = dataclasses.replace(plain, actuator=TwoStage(delay=0.01, valve=0.03))
    changed["delay"] = dataclasses.replace(plain, actuator=TwoStage())
    changed["sensor"] = dataclasses.replace(plain, sensors=())
    changed["speed"] = dataclasses.replace(plain, speed=6.0)
    for name, scenario in changed.items():
        assert not np.array_equal(base, run(scenario)), name


def test_stable_baselines_drives_and_learns(own):
    sb3 = pytest.importorskip("stable_baselines3")
    from qcar_env.agents.vec_env import QuarterCarHumpVecEnv

    env = QuarterCarHumpVecEnv(N, scenario=own, observe=OBSERVED, reward=REWARD)
    alone = gym.make("QuarterCarHump-v0", scenario=own, observe=OBSERVED, reward=REWARD)
    env.seed(7)
    first = env.reset()
    np.testing.assert_array_equal(first[0], alone.reset(seed=7)[0])
    for each in actions(20):
        seen, reward, _, infos = env.step(each)
        row = alone.step(each[0])
        np.testing.assert_array_equal(seen[0], row[0])
        assert reward[0] == np.float32(row[1])
        assert infos[0]["reward_comfort"] == row[4]["reward_comfort"]
    model = sb3.PPO("MlpPolicy", env, n_steps=32, batch_size=48, seed=0)
    before = [each.detach().clone() for each in model.policy.parameters()]
    model.learn(N * 64)
    assert any(
        not np.array_equal(a.numpy(), b.detach().numpy())
        for a, b in zip(before, model.policy.parameters(), strict=True)
    )


def test_simulation_runs_it_with_a_law(own):
    idle = simulate(CAR, own.excitation, own.force, Signum(G=0.0), duration=1.0)
    damped = simulate(CAR, own.excitation, own.force, Signum(G=3.0), duration=1.0)
    assert np.isfinite(damped.x2).all()
    assert np.abs(damped.v2).max() < np.abs(idle.v2).max()


def test_a_law_is_a_policy_that_is_rolled_out(own):
    plain = dataclasses.replace(own, randomisation=(), sensors=())
    idle = rollout(LawPolicy(Signum(G=0.0), plain), plain)
    damped = rollout(LawPolicy(Signum(G=3.0), plain), plain)
    assert np.abs(damped.force).max() > 0.0
    assert not np.array_equal(idle.x2, damped.x2)


def test_linear_tools_refuse_it_by_name(own):
    with pytest.raises(ValueError, match="linear"):
        period_optimum(dataclasses.replace(own, road=Sine(h=0.01, wavenumber=3.0)))
    with pytest.raises(ValueError, match="linear"):
        sampled_plant(CAR, np.ones(4), np.eye(2), 0.005)
