"""Enter a policy of your own into the benchmark.

python docs/tutorials/enter_benchmark.py
"""

# %% [markdown]
# # Enter the benchmark
#
# A policy is anything with the `predict` of Stable-Baselines3: it takes observations of n cars
# and returns forces over their limits. Here is one in ten lines, scored beside CNVC and the
# optimum.

# %%
import dataclasses
import sys

import numpy as np

from qcar_env import baselines
from qcar_env.evaluation.benchmark import run
from qcar_env.evaluation.entry import Entry
from qcar_env.evaluation.tracks import TRACKS

SHORT = "--short" in sys.argv

# %% [markdown]
# ## The policy
#
# Entries 2 and 3 of the observation are the velocities in units of the uncontrolled motion.
# `reads` says what the policy must be shown: `feedback` is the state, `full` has road and
# external force as well. The one argument of `__init__` is the scenario with its force limit, for
# policies that want to know it.


# %%
class Sign:
    """Push against each velocity, as hard as a soft sign function says."""

    name = "soft sign"
    reads = "feedback"

    def __init__(self, scenario):
        self.width = 0.01  # of the uncontrolled velocity

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Return forces over their limits, and no memory."""
        velocity = np.asarray(observation)[..., 2:4]
        return -np.tanh(velocity / self.width).astype(np.float32), None


# %% [markdown]
# ## The score
#
# What enters is an `Entry`: a name, what it reads, and how the policy is made for a scenario with
# its force limit. A track fixes episodes, force limits, what is shown and how long it lasts. rho is
# the larger of the two steady amplitudes over those without control; the optimum is certified: no
# force within the limit does better.

# %%
mine = Entry(
    name="soft sign",
    kind="yours",
    title="soft sign",
    make=lambda scenario, track, force_scale: Sign(scenario),
    reads="feedback",
)
track = TRACKS["budget"]
if SHORT:
    track = dataclasses.replace(track, episodes=2, duration=10.0, force_scales=(1.0,))
outcome = run([track], [mine, *baselines.entries(["cnvc"])])
for each in outcome.standings:
    print(
        f"force limit x {each.force_scale:g}: optimum {each.optimum:.4f}, "
        f"{each.policy} {each.rho.value:.4f}"
    )

# %% [markdown]
# ## The leaderboard
#
# With the class in a file `my_policy.py` the command scores it on every track that it may enter,
# beside every baseline and shipped agent, with intervals, and writes tables, figures and a page:
#
# ```sh
# qcar benchmark --policy my_policy:Sign --report
# ```
#
# A trained network enters as an ONNX file (observation in, action out), or as the run folder of
# `qcar train`:
#
# ```sh
# qcar benchmark --policy runs/sac-paper-seed0 --tracks paper budget
# ```
