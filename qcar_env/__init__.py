"""Quarter car over a speed hump: environments, control laws, analysis and evaluation.

Importing the package registers ``QuarterCarHump-v0`` with Gymnasium.
"""

from gymnasium.envs.registration import register, registry

from qcar_env.scenarios import SCENARIOS, Scenario, scenario

__version__ = "0.1.0"

if "QuarterCarHump-v0" not in registry:
    register(
        id="QuarterCarHump-v0",
        entry_point="qcar_env.envs.quarter_car_hump:QuarterCarHumpEnv",
        vector_entry_point="qcar_env.envs.vector:QuarterCarHumpVectorEnv",
    )

__all__ = ["SCENARIOS", "Scenario", "__version__", "scenario"]
