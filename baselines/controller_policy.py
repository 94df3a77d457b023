"""A linear controller of `qcar_env.control.controller` as a policy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.controller import Controller
from qcar_env.scenarios import Scenario, scenario as find_scenario

from .actuation import Actuation, check_one
from .observation import entries_of, scales_of

Array = NDArray[np.float64]


class ControllerPolicy:
    """One force between the masses, by a linear controller and, where given, a plan over time.

    Parameters
    ----------
    controller : Controller
        The controller.
    scenario : str or Scenario
        Gives the units of the observation and the actuator.
    plan : ndarray (k,), optional
        Force [N] that is added in each control interval since the episode began; zero after it.

    Raises
    ------
    ValueError
        If the scenario has no actuator between the masses.

    Notes
    -----
    A semi-active damper gives of the force what a damping within its range can ("clipped"); it is
    read with the travel's rate, which then stands last in `reads`. The policy's `state` is the
    controller's memory (n, m) and the number of intervals passed (n,). It takes the actuator for
    one that acts at once: what a lag or a delay changes is not known to it.
    """

    def __init__(
        self, controller: Controller, scenario: str | Scenario, *, plan: Array | None = None
    ) -> None:
        scenario = find_scenario(scenario)
        check_one(scenario, controller.name)
        self.controller = controller
        self.name = controller.name
        self.plan = np.append(np.empty(0) if plan is None else np.asarray(plan, np.float64), 0.0)
        self._actuation = Actuation(scenario)
        self._count = len(controller.signals)
        self.reads = controller.signals
        if self._actuation.valve:
            self.reads = (*self.reads, "travel_rate")
        self._scales = scales_of(scenario, self.reads)

    @property
    def clips(self) -> bool:
        """Whether a semi-active damper gives the force, as far as it can."""
        return self._actuation.valve

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...]]:
        """Return the actions and the memory (see `qcar_env.evaluation.policy.Policy`).

        Raises
        ------
        ValueError
            If the observation is not (n, k) or (k,), or has too few entries.
        """
        count = len(self.reads)
        entries = entries_of(observation, count, self.reads)
        read = np.atleast_2d(entries)[:, :count] * self._scales
        n, controller = len(read), self.controller
        z, k = np.zeros((n, controller.memory)), np.zeros(n, dtype=np.intp)
        if state is not None:
            fresh = np.zeros(n, dtype=bool) if episode_start is None else np.asarray(episode_start)
            z, k = np.where(fresh[:, np.newaxis], z, state[0]), np.where(fresh, k, state[1])
        r, rate = read[:, : self._count], read[:, -1]
        F = controller.asked(z, r) + self.plan[np.minimum(k, len(self.plan) - 1)]
        action = self._actuation.of_force(F, rate)
        following = controller.following(z, r, self._actuation.force(action, rate))
        shaped = action.astype(np.float32).reshape((*entries.shape[:-1], 1))
        return shaped, (following, k + 1)
