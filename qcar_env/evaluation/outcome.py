"""What a policy did in an episode, in the paper's metrics and the field's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qcar_env.evaluation import metrics
from qcar_env.evaluation.rollouts import Rollout


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a policy did: the paper's metrics and the field's."""

    policy: str
    amplitudes: tuple[float, float]  # largest |x1|, |x2| of the rows that are measured [m]
    uncontrolled: tuple[float, float]  # the same without control [m]
    peak_force: tuple[float, ...]  # of the same rows [m/s^2] or [N]
    rms_force: tuple[float, ...]  # of the same rows [m/s^2] or [N]
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
        """The larger of the two relative amplitudes, see `metrics.rho`."""
        return metrics.rho(self.amplitudes, self.uncontrolled)


def outcome(
    policy: str,
    rollout: Rollout,
    uncontrolled: tuple[float, float] | None = None,
    *,
    periods: int | None,
) -> Outcome:
    """Evaluate a rollout.

    Parameters
    ----------
    policy : str
        The policy's name.
    rollout : Rollout
        Long enough to have become steady, where a steady motion is measured.
    uncontrolled : tuple of float, optional
        Amplitudes of x1 and x2 without control [m]; the scenario's own if left out.
    periods : int or None
        Whole periods at the end that are measured; the whole episode if None, and of an episode
        that broke off (see `Rollout.window`).

    Returns
    -------
    Outcome
    """
    force = rollout.force[rollout.window(periods)]
    return Outcome(
        policy=policy,
        amplitudes=rollout.amplitudes(periods),
        uncontrolled=uncontrolled or rollout.scenario.reference_amplitudes,
        peak_force=tuple(float(value) for value in np.max(np.abs(force), axis=0)),
        rms_force=tuple(metrics.rms(column) for column in force.T),
        terminated=rollout.terminated,
    )
