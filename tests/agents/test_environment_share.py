"""The environment's share of a training's time."""

import pytest

pytest.importorskip("stable_baselines3")

from qcar_env.agents.environment_share import environment_share


def test_the_share_is_a_part_of_the_whole():
    assert 0.0 < environment_share(cars=8, intervals=32, batch=64, updates=1) < 1.0
