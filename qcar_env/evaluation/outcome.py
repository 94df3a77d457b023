"""What a policy did in an episode, in the paper's metrics and the field's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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
        return self._both(metrics.percentage_error)

    @property
    def reductions(self) -> tuple[float, float]:
        """Reductions of x1 and x2 [dB]."""
        return self._both(metrics.reduction_db)

    @property
    def measures(self) -> dict[str, Any]:
        """All measures by name; forces are those of wheel and body, or twice the one there is."""
        found = {"rho": self.rho}
        for i, mass in ((0, "1"), (-1, "2")):
            found |= {
                f"x{mass}": self.amplitudes[i],
                f"percentage_error_x{mass}": self.percentage_errors[i],
                f"reduction_db_x{mass}": self.reductions[i],
                f"peak_force_{mass}": self.peak_force[i],
                f"rms_force_{mass}": self.rms_force[i],
            }
        return found

    def _both(self, metric: Callable[[float, float], float]) -> tuple[float, float]:
        (a1, a2), (b1, b2) = self.uncontrolled, self.amplitudes
        return metric(a1, b1), metric(a2, b2)

    @property
    def rho(self) -> float:
        """The larger of the two relative amplitudes, see `metrics.rho`."""
        return metrics.rho(self.amplitudes, self.uncontrolled)


def outcome(policy: str, rollout: Rollout, *, periods: int | None) -> Outcome:
    """Evaluate a rollout.

    Parameters
    ----------
    policy : str
        The policy's name.
    rollout : Rollout
        Long enough to have become steady, where a steady motion is measured.
    periods : int or None
        Whole periods at the end that are measured; the whole episode if None, and of an episode
        that broke off (see `Rollout.window`).
    """
    force = rollout.force[rollout.window(periods)]
    return Outcome(
        policy=policy,
        amplitudes=rollout.amplitudes(periods),
        uncontrolled=rollout.scenario.reference_amplitudes,
        peak_force=tuple(float(value) for value in np.max(np.abs(force), axis=0)),
        rms_force=tuple(metrics.rms(column) for column in force.T),
        terminated=rollout.terminated,
    )
