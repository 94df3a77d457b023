"""The least vibration that any force within the limit can leave, with a proof.

The controlled plant is linear in state and force, so the smallest amplitude under ``|u_j| <= L_j``
is a convex problem: a linear program (`program`) with a certificate (`certificate`), over a period
of the steady motion (`period`) or over an episode (`episode`). `hump` asks for the least
acceleration of the body on a hump, under limits of force, rate, travel and contact.
"""

from qcar_env.analysis.optimum.episode import episode_optimum
from qcar_env.analysis.optimum.hump import Headroom, hump_optimum
from qcar_env.analysis.optimum.period import period_optimum
from qcar_env.analysis.optimum.result import OBJECTIVES, Objective, Optimum

__all__ = [
    "OBJECTIVES",
    "Headroom",
    "Objective",
    "Optimum",
    "episode_optimum",
    "hump_optimum",
    "period_optimum",
]
