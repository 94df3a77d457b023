"""A matrix times the observation, held within the limit: saturated linear feedback."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.control import lqr
from qcar_env.control.lqr import Weights
from qcar_env.envs import episode as task
from qcar_env.physics import linear
from qcar_env.scenarios import Scenario

from .actuation import check_two
from .observation import entries_of, scales_of

Array = NDArray[np.float64]


class LinearPolicy:
    """Actions ``clip(K observation, -1, 1)``.

    Parameters
    ----------
    gain : array_like (m, k)
        K, in scaled units: forces in limits, observation as the environment gives it. With k = 4
        the policy reads the state, with k = 8 also road and external force.
    name : str
        Name of the policy.

    Raises
    ------
    ValueError
        If the gain is not a finite matrix with 4 or 8 columns.
    """

    def __init__(self, gain: ArrayLike, name: str) -> None:
        self.gain = np.atleast_2d(np.asarray(gain, dtype=np.float64))
        sizes = (task.FEEDBACK_SIZE, task.FULL_SIZE)
        if (
            self.gain.ndim != 2
            or self.gain.shape[1] not in sizes
            or not np.all(np.isfinite(self.gain))
        ):
            raise ValueError(
                f"gain must be a finite matrix with {sizes[0]} or {sizes[1]} columns, got shape "
                f"{self.gain.shape}; give one column for each entry of the observation"
            )
        self.name = name
        full = self.gain.shape[1] == task.FULL_SIZE
        self.reads: Literal["full", "feedback"] = "full" if full else "feedback"

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], None]:
        """Return the actions (see `qcar_env.evaluation.policy.Policy`); nothing is remembered.

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), or has too few entries.
        """
        count = self.gain.shape[1]
        entries = entries_of(observation, count)
        action = np.clip(entries[..., :count] @ self.gain.T, -1.0, 1.0)
        return action.astype(np.float32), None


def sampled_plant(scenario: Scenario) -> lqr.SampledPlant:
    """Return the scenario's car in the units of observation and action.

    Raises
    ------
    ValueError
        If car or actuator is not linear; the message names what is not.
    """
    push = linear.actuation(scenario.car, scenario.actuator)
    return lqr.sampled_plant(scenario.car, scales_of(scenario, "feedback"), push, scenario.dt)


def lqr_policy(scenario: Scenario, weights: Weights) -> LinearPolicy:
    """Return the linear-quadratic regulator of the scenario's car (errors: `sampled_plant`)."""
    return LinearPolicy(-lqr.regulator(sampled_plant(scenario), weights), "LQR")


def lqr_feedforward_policy(scenario: Scenario, weights: Weights) -> LinearPolicy:
    """Return the regulator that also cancels the road and the external force that it reads.

    Raises
    ------
    ValueError
        If the scenario has one actuator for two masses, which cannot cancel both, or a plant that
        is not linear, or a road that is not made of sines.
    """
    check_two(scenario, "feedforward", "lqr")
    feedback = -lqr.regulator(sampled_plant(scenario), weights)
    return LinearPolicy(np.hstack([feedback, ahead(scenario)]), "LQR + feedforward")


def ahead(scenario: Scenario) -> Array:
    """Return the gain on scaled road and force that cancels both, shape (2, 4)."""
    car, force = scenario.car, scenario.force
    push = linear.actuation(car, scenario.actuator)
    gain = lqr.feedforward(car, push, scenario.excitation.omega, force.Omega, scenario.dt)
    return gain * scales_of(scenario)[task.FEEDBACK_SIZE :]
