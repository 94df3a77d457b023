"""Compare policies in one scenario at one force limit, in true steady state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qcar_env.evaluation import metrics
from qcar_env.evaluation.rollouts import Rollout


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a policy did: the paper's metrics and the field's."""

    policy: str
    amplitudes: tuple[float, float]  # largest |x1|, |x2| over the last periods [m]
    uncontrolled: tuple[float, float]  # the same without control [m]
    peak_force: tuple[float, ...]  # over the last periods [m/s^2] or [N]
    rms_force: tuple[float, ...]  # over the last periods [m/s^2] or [N]
    terminated: bool  # whether a displacement left its limit before the end

    @property
    def percentage_errors(self) -> tuple[float, float]:
        """The paper's percentage errors of x1 and x2 [%]."""
        (a1, a2), (b1, b2) = self.uncontrolled, self.amplitudes
        return metrics.percentage_error(a1, b1), metrics.percentage_error(a2, b2)

    @property
    def reductions(self) -> tuple[float, float]:
        """Reductions of x1 and x2 [dB]."""
        (a1, a2), (b1, b2) = self.uncontrolled, self.amplitudes
        return metrics.reduction_db(a1, b1), metrics.reduction_db(a2, b2)

    @property
    def rho(self) -> float:
        """The larger of the two relative amplitudes, ``max_i(a_i / A_i)`` [-]."""
        return max(b / a for a, b in zip(self.uncontrolled, self.amplitudes, strict=True))


def outcome(policy: str, rollout: Rollout, uncontrolled: tuple[float, float]) -> Outcome:
    """Evaluate the end of a rollout.

    Parameters
    ----------
    policy : str
        The policy's name.
    rollout : Rollout
        Long enough to have become steady.
    uncontrolled : tuple of float
        Amplitudes of x1 and x2 without control [m].

    Returns
    -------
    Outcome
        Over the last five periods on a harmonic road, over the whole episode elsewhere, where a
        crossing has no steady state.
    """
    if rollout.scenario.road.profile == "harmonic" and not rollout.terminated:
        window = metrics.last_periods(rollout.t, rollout.scenario.reference_frequency)
    else:
        window = slice(None)
    force = rollout.force[window]
    return Outcome(
        policy=policy,
        amplitudes=(
            float(np.max(np.abs(rollout.x1[window]))),
            float(np.max(np.abs(rollout.x2[window]))),
        ),
        uncontrolled=uncontrolled,
        peak_force=tuple(float(value) for value in np.max(np.abs(force), axis=0)),
        rms_force=tuple(metrics.rms(column) for column in force.T),
        terminated=rollout.terminated,
    )
