"""A semi-active law as a policy that sets a damping once every control interval."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.semi_active import Motion, SemiActiveLaw
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import instance

from .actuation import Actuation, check_valve
from .observation import entries_of, scales_of


class SemiActivePolicy:
    """A law of `qcar_env.control.semi_active`, sampled.

    Parameters
    ----------
    law : SemiActiveLaw
        The law with its numbers.
    scenario : str or Scenario
        Gives the units of the observation, and the range of the damper.

    Raises
    ------
    ValueError
        If the scenario's actuator is no semi-active damper, or the law is none.
    """

    def __init__(self, law: SemiActiveLaw, scenario: str | Scenario) -> None:
        instance("law", law, SemiActiveLaw)
        scenario = find_scenario(scenario)
        check_valve(scenario, law.name)
        self.law = law
        self.name = law.name
        self.reads = law.signals
        self._numbers = law.numbers
        self._scales = scales_of(scenario, self.reads)
        self._actuation = Actuation(scenario)
        actuator: Any = scenario.actuator
        self._range = actuator.c_min, actuator.c_max

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
        count = len(self.reads)
        entries = entries_of(observation, count, self.reads)
        read = np.atleast_2d(entries)[:, :count] * self._scales
        motion = Motion(**dict(zip(self.reads, read.T, strict=True)))
        c = self.law.damping(motion, *self._range, self._numbers)
        actions = self._actuation.of_damping(c).astype(np.float32)
        return actions.reshape((*entries.shape[:-1], 1)), None
