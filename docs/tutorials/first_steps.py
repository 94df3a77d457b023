"""First steps: drive the car, look at it, measure it.

python docs/tutorials/first_steps.py
"""

# %% [markdown]
# # First steps
#
# A car, a road that shakes it, and a law that keeps it still: run an episode, measure what was
# left of the motion, and look at a frame of it.

# %%
import sys

import gymnasium as gym
import numpy as np

import qcar_env  # noqa: F401 - registers QuarterCarHump-v0
from qcar_env.baselines import catalogue
from qcar_env.evaluation.metrics import reduction_db
from qcar_env.evaluation.rollouts import rollout
from qcar_env.scenarios import scenario

SHORT = "--short" in sys.argv

# %% [markdown]
# ## The scenario
#
# `paper` is the worst case of the paper: the road, the external force, the wheel and the body all
# have one frequency. Without control the motion grows for half a minute, until the body swings by
# more than a metre and a half.

# %%
paper = scenario("paper")
print(f"{paper.title}")
print(f"without control: wheel {paper.reference_amplitudes[0]:.3f} m, ", end="")
print(f"body {paper.reference_amplitudes[1]:.3f} m")
print(f"actuators: up to {paper.actuator.limit} {paper.actuator.unit} on wheel and body")

# %% [markdown]
# ## Step by step
#
# The environment is Gymnasium's. An action is a force over its limit; the observation is scaled
# so that the uncontrolled motion is of order one. Here is linear velocity feedback by hand:
# entries 2 and 3 of the observation are the velocities.

# %%
env = gym.make("QuarterCarHump-v0", scenario=paper, render_mode="rgb_array")
observation, info = env.reset(seed=0, options={"state": (0.0, 0.0, 0.0, 0.0), "phase": 0.0})
rewards = []
for _ in range(200):
    action = np.clip(-2.0 * observation[2:4], -1.0, 1.0)
    observation, reward, terminated, truncated, info = env.step(action)
    rewards.append(reward)
print(f"mean reward {np.mean(rewards):.3f}; -10 is the uncontrolled motion, 0 is stillness")
print(f"force now {info['force']} m/s^2")

# %% [markdown]
# ## A frame
#
# `render` returns an array, on a machine without a display too.

# %%
env.unwrapped.caption = ("by hand", "#D55E00")
frame = env.render()
print(f"a frame of {frame.shape[1]} x {frame.shape[0]} pixels")

# %% [markdown]
# ## Measure laws
#
# `rollout` runs a whole episode and keeps the time histories. The slow mode of this car needs 4.8
# s for a factor of e, so it takes 40 s from rest before the motion is steady; amplitudes are the
# largest displacements over the last five periods.

# %%
duration = 2.0 if SHORT else 60.0
for name in ("none", "lnvc", "cnvc"):
    episode = rollout(catalogue.make(name, paper), paper, duration=duration)
    parts = []
    found = episode.amplitudes(periods=5)
    for amplitude, without in zip(found, paper.reference_amplitudes, strict=True):
        parts.append(f"{amplitude:.4f} m ({-reduction_db(without, amplitude):+.1f} dB)")
    print(f"{name:5s} wheel {parts[0]}, body {parts[1]}")
