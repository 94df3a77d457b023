"""From what a law asks of wheel and body to actions: as much of it as the actuator can give.

Two actuators give u1 and u2 within their limits. One between the masses gives F = m2 u2 - m1 u1,
what both masses ask for, within its own; a semi-active damper the same force, as the damping
c = -F / (v2 - v1) within its range.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.actuator import LaggedSemiActiveDamper, SemiActiveDamper
from qcar_env.scenarios import Scenario

Array = NDArray[np.float64]


class Actuation:
    """What an actuator makes of specific forces on wheel and body.

    Parameters
    ----------
    scenario : Scenario
        Its actuator, and for one between the masses its car's masses.
    """

    def __init__(self, scenario: Scenario) -> None:
        actuator: Any = scenario.actuator
        self.size: int = actuator.size
        self._limit = np.array(actuator.limit)
        self.valve = is_valve(scenario)
        if self.valve:
            self._middle = 0.5 * (actuator.c_max + actuator.c_min)
            self._half = 0.5 * (actuator.c_max - actuator.c_min)
        if self.size == 1:
            functions = scenario.car.functions
            inverse = functions.by_mass(1.0, 1.0, functions.prepare(scenario.car.numbers))
            self._masses = 1.0 / inverse[0], 1.0 / inverse[1]  # [kg]

    def actions(self, u1: Array, u2: Array, travel_rate: Array) -> Array:
        """Return the actions (n, m) within [-1, 1].

        Parameters
        ----------
        u1, u2 : ndarray (n,)
            Specific forces that wheel and body ask for [m/s^2].
        travel_rate : ndarray (n,)
            ``v2 - v1`` [m/s].
        """
        if self.size == 2:
            return np.clip(np.stack([u1, u2], axis=1) / self._limit, -1.0, 1.0)
        m1, m2 = self._masses
        return self.of_force(m2 * u2 - m1 * u1, travel_rate)

    def of_force(self, F: Array, travel_rate: Array) -> Array:
        """Return the actions (n, 1) of one actuator that is asked for the force F [N] on the body.

        Parameters
        ----------
        F : ndarray (n,)
            Force [N]; the wheel gets ``-F``.
        travel_rate : ndarray (n,)
            ``v2 - v1`` [m/s], which only a damper needs.
        """
        if not self.valve:
            return np.clip(F[:, np.newaxis] / self._limit, -1.0, 1.0)
        # Where the masses move together no damping gives a force, and none is asked for.
        c = np.divide(-F, travel_rate, out=np.zeros_like(F), where=travel_rate != 0.0)
        return self.of_damping(c)

    def of_damping(self, c: Array) -> Array:
        """Return the actions (n, 1) of a semi-active damper that is asked for `c` (n,) [N s/m]."""
        away = c - self._middle
        asked = np.divide(away, self._half, out=np.zeros_like(c), where=self._half > 0.0)
        return np.clip(asked, -1.0, 1.0)[:, np.newaxis]

    def force(self, actions: Array, travel_rate: Array) -> Array:
        """Return the force on the body [N] (n,) that one actuator at once gives for actions."""
        if not self.valve:
            return actions[:, 0] * self._limit[0]
        return -(self._middle + self._half * actions[:, 0]) * travel_rate


def check_two(scenario: Scenario, what: str, instead: str) -> None:
    """Raise ValueError where a scenario has one actuator for two masses."""
    if scenario.actuator.size != 2:
        raise ValueError(
            f"{what} needs an actuator on each mass, got {type(scenario.actuator).__name__}; "
            f"use {instead}"
        )


def is_valve(scenario: Scenario) -> bool:
    """Return whether a scenario's actuator is a semi-active damper."""
    return isinstance(scenario.actuator, (SemiActiveDamper, LaggedSemiActiveDamper))


def check_valve(scenario: Scenario, what: str) -> None:
    """Raise ValueError where a scenario's actuator is no semi-active damper."""
    if not is_valve(scenario):
        raise ValueError(
            f"{what} needs a semi-active damper, got {type(scenario.actuator).__name__}; give the "
            "scenario a SemiActiveDamper"
        )


def check_one(scenario: Scenario, what: str) -> None:
    """Raise ValueError where a scenario has no actuator between the masses of a car with masses."""
    if scenario.actuator.size != 1 or scenario.actuator.unit != "N":
        raise ValueError(
            f"{what} needs one actuator between the masses, got "
            f"{type(scenario.actuator).__name__}; give the scenario a SuspensionActuator or a "
            "SemiActiveDamper, and a car with masses"
        )
