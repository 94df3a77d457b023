"""What `import qcar_env` gives."""

import importlib
import subprocess
import sys

import gymnasium as gym

import qcar_env
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv

ID = "QuarterCarHump-v0"


def test_importing_registers_the_environment():
    assert isinstance(gym.make(ID).unwrapped, QuarterCarHumpEnv)


def test_the_name_with_a_module_needs_no_import():
    code = f"import gymnasium; print(gymnasium.make('qcar_env:{ID}').spec.id)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == ID


def test_an_environment_can_be_made_again_from_its_spec():
    env = gym.make(ID, scenario="paper-step", observe="feedback", force_scale=0.5)
    again = gym.make(gym.spec(ID), **env.spec.kwargs)
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert again.observation_space == env.observation_space


def test_importing_twice_registers_once():
    importlib.reload(qcar_env)  # gymnasium warns of a second registration
    assert ID in gym.registry


def test_importing_is_light():
    """No learner, plot, window or compiler: what a worker does not need, it does not load."""
    heavy = ("torch", "stable_baselines3", "matplotlib", "pygame", "numba", "pandas")
    code = f"import sys, qcar_env; print(*[name for name in {heavy!r} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_the_public_names_exist():
    assert all(hasattr(qcar_env, name) for name in qcar_env.__all__)
    assert set(qcar_env.__all__) >= {"SCENARIOS", "Scenario", "scenario"}
