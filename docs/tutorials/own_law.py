"""Write your own control law and compare it with the paper's.

python docs/tutorials/own_law.py
"""

# %% [markdown]
# # Write your own law
#
# A law is a frozen record of its gains and a pure function that gives two forces. Written that
# way it runs in the continuous-time simulation, as a sampled policy in the environment, and
# beside the paper's laws. Here: velocity feedback of the fifth power, which fades even faster at
# small amplitudes than the paper's cubic one.

# %%
import sys
from dataclasses import dataclass

import numpy as np

from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.baselines.law_policy import LawPolicy
from qcar_env.control import CNVC
from qcar_env.control.law import Law
from qcar_env.evaluation.rollouts import rollout
from qcar_env.parts.part import number
from qcar_env.scenarios import scenario
from qcar_env.validation import non_negative

SHORT = "--short" in sys.argv

# %% [markdown]
# ## The law
#
# Each gain is declared with its unit and its check. The formula is arithmetic alone, without `**`
# and without library calls, so that the same function runs on numbers, on arrays of many cars, and
# inside compiled code. `x` is the state with the entries `x1`, `x2`, `v1`, `v2`; `eta` is the law's
# filter, which this law does not have; `p` are its gains. It only takes energy out, as its power
# `G v^6` is never negative; a law that can destabilise a car says so in `check(car)`.


# %%
@dataclass(frozen=True, kw_only=True)
class Quintic(Law):
    """Quintic negative velocity control."""

    G1: float = number("gain", "s^3/m^4", non_negative, 0.02)
    G2: float = number("gain", "s^3/m^4", non_negative, 0.2)
    name = "quintic"

    @staticmethod
    def command(x, eta, p):
        """Return ``(-G1 v1^5, -G2 v2^5)`` [m/s^2]."""
        square1, square2 = x.v1 * x.v1, x.v2 * x.v2
        return -p.G1 * (square1 * square1 * x.v1), -p.G2 * (square2 * square2 * x.v2)


# %% [markdown]
# ## In continuous time
#
# The law acts at every instant, with whatever force it asks for, as in the paper's experiments.

# %%
paper = scenario("paper")
laws = [CNVC(), Quintic(), Quintic(G1=0.1, G2=1.0)]
for law in laws:
    found = steady_amplitudes(paper.car, paper.excitation, paper.force, law)
    print(f"{law}: wheel {float(found.x1):.4f} m, body {float(found.x2):.4f} m")

# %% [markdown]
# ## As a policy, at the same force limit
#
# Sampled at 200 Hz with the actuators' limits, which is where laws can be compared fairly.

# %%
duration = 2.0 if SHORT else 60.0
for law in laws:
    episode = rollout(LawPolicy(law, paper), paper, duration=duration)
    last = slice(-200, None)
    x1, x2 = np.abs(episode.x1[last]).max(), np.abs(episode.x2[last]).max()
    peak = np.abs(episode.force[last]).max(axis=0)
    print(
        f"{law}: wheel {x1:.4f} m, body {x2:.4f} m, peak force {peak[0]:.0f} / {peak[1]:.1f} m/s^2"
    )

# %% [markdown]
# To make it part of the library, put it into `qcar_env/control` with a test, and add it to `LAWS`
# there: `CONTRIBUTING.md` has the steps.
