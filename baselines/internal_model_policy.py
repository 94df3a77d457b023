"""The regulator with an internal model of the sinusoidal disturbance, from the state alone."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from qcar_env.control import lqr
from qcar_env.control.lqr import Weights
from qcar_env.envs import episode as task
from qcar_env.scenarios import Scenario, scenario as find_scenario

from .actuation import check_two
from .linear_policy import sampled_plant
from .observation import entries_of


class InternalModelPolicy:
    """``u = clip(-K x - d)``, d found by a filter with an oscillator for each mass.

    Parameters
    ----------
    scenario : str or Scenario
        Car, control interval, force limit, and the frequency of the oscillators: that of the road.
    weights : Weights
        Of the regulator.
    drift : float
        How fast the filter follows (see `qcar_env.control.lqr.internal_model`) [-].

    Raises
    ------
    ValueError
        If the plant is not linear, the scenario has one actuator for two masses, or a number is
        out of range.

    Notes
    -----
    The policy's `state` is the estimate (n, 8) of the next sample; it holds the force that was
    really given, within its limit.
    """

    reads: Literal["feedback"] = "feedback"
    name = "LQR + internal model"

    def __init__(self, scenario: str | Scenario, weights: Weights, *, drift: float = 1.0) -> None:
        scenario = find_scenario(scenario)
        check_two(scenario, "the internal model", "lqr")
        plant = sampled_plant(scenario)
        self._model = lqr.internal_model(plant, scenario.reference_frequency, drift=drift)
        self._gain = -lqr.regulator(plant, weights)

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...]]:
        """Return the actions and the estimate (see `qcar_env.evaluation.policy.Policy`).

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), or has fewer than four entries.
        """
        entries = entries_of(observation, task.FEEDBACK_SIZE)
        x = np.atleast_2d(entries)[:, : task.FEEDBACK_SIZE]
        model = self._model
        fresh = np.hstack([x, np.zeros((len(x), len(model.transition) - 4))])
        if state is None:
            z = fresh
        else:
            z = state[0]
            if episode_start is not None:
                z = np.where(np.asarray(episode_start)[:, np.newaxis], fresh, z)
        z = z + (x - z[:, :4]) @ model.correction.T
        action = np.clip(x @ self._gain.T + z @ model.cancel.T, -1.0, 1.0)
        following = z @ model.transition.T + action @ model.into.T
        shaped = action.astype(np.float32).reshape((*entries.shape[:-1], action.shape[1]))
        return shaped, (following,)
