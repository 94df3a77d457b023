"""Train SAC on the paper's worst case and compare it with CNVC.

python docs/tutorials/train_sac.py
"""

# %% [markdown]
# # Train SAC and beat CNVC
#
# A soft actor-critic learns to hold the car still with the force that CNVC uses, within minutes
# on a laptop. It is then an ONNX file that runs without torch.

# %%
import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np

from qcar_env.agents.load import load
from qcar_env.agents.recipes import recipe
from qcar_env.agents.train import train
from qcar_env.baselines import catalogue
from qcar_env.evaluation.metrics import reduction_db
from qcar_env.evaluation.rollouts import rollout
from qcar_env.scenarios import scenario

SHORT = "--short" in sys.argv

# %% [markdown]
# ## The recipe
#
# A recipe is a frozen record of how an agent is trained: the network, its features, the reward's
# scale, the number of cars. Each number has its reason in `agents/recipes.py`. Change one with
# `dataclasses.replace`.

# %%
how = recipe("sac", "paper")
if SHORT:
    how = dataclasses.replace(how, steps=1024)
print(f"{how.name}: {how.cars} cars, {how.steps} control intervals")

# %% [markdown]
# ## Train
#
# While it trains, the policy is scored after 40 s, beside CNVC. The run folder explains
# itself: recipe, command, versions, progress, checkpoint, and the policy. A run that was killed
# goes on with `resume=True`.


# %%
def say(progress, beside):
    """Print one line of progress."""
    now = " and ".join(f"{value:.1f}" for value in progress.reductions)
    print(f"{progress.steps:8d} steps, {progress.wall:5.0f} s: {now} dB below no control")


folder = Path(tempfile.mkdtemp()) / "sac" if SHORT else Path("runs/tutorial-sac")
train(how, seed=0, folder=folder, force=True, report=say)

# %% [markdown]
# ## Compare
#
# 60 s from rest, at the same force limit, both acting every 5 ms.

# %%
paper = scenario("paper")
for name, policy in (("CNVC", catalogue.make("cnvc", paper)), ("SAC", load(folder))):
    episode = rollout(policy, paper, duration=5.0 if SHORT else 60.0)
    parts = []
    found = episode.amplitudes(periods=5)
    for amplitude, without in zip(found, paper.reference_amplitudes, strict=True):
        parts.append(f"{amplitude:.5f} m ({-reduction_db(without, amplitude):+.1f} dB)")
    peak = np.abs(episode.force).max(axis=0)
    print(f"{name:5s} wheel {parts[0]}, body {parts[1]}, peak force {peak[0]:.0f} / {peak[1]:.0f}")

# %% [markdown]
# ## With Stable-Baselines3 alone
#
# The environment needs no wrapper. The recipe above is faster because its reward counts what the
# actuator can remove, and because many cars share one compiled engine; this is all that is needed
# for less:
#
# ```python
# import gymnasium as gym
# import qcar_env
# from stable_baselines3 import SAC
#
# model = SAC("MlpPolicy", gym.make("QuarterCarHump-v0"))
# model.learn(50_000)
# ```
