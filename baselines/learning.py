"""Iterative learning over a hump that is crossed again and again, by trial in the scenario."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.ilc import learner
from qcar_env.control.preview import WEIGHTED, Acceptable, regulator
from qcar_env.control.suspension import suspension
from qcar_env.evaluation.rollouts import rollout
from qcar_env.physics.car import Car
from qcar_env.scenarios import Scenario, scenario as find_scenario
from qcar_env.validation import whole

from .actuation import check_one
from .controller_policy import ControllerPolicy
from .road_ahead import check_same_road

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """What crossings have taught."""

    policy: ControllerPolicy  # regulator and plan
    costs: tuple[float, ...]  # of each crossing, outputs and plan, the first without a plan [-]


def learn(
    scenario: str | Scenario,
    *,
    acceptable: Acceptable | None = None,
    crossings: int = 5,
    caution: float = 1.0,
    model: Car | None = None,
) -> Learned:
    """Learn a plan of forces from crossings of a scenario's road, each from rest.

    Parameters
    ----------
    scenario : str or Scenario
        Car, road and actuator; it must not vary.
    acceptable : Acceptable, optional
        What is weighed: sizes of acceleration, travel, tyre deflection and force.
    crossings : int
        How often the road is crossed before the plan is kept.
    caution : float
        How slowly is learned (see `qcar_env.control.ilc`) [-].
    model : Car, optional
        What the learner takes the car for; the scenario's otherwise.

    Raises
    ------
    ValueError
        If the road varies, the scenario has no actuator between the masses, or a number is out of
        range.

    Notes
    -----
    The plan that cost least is kept, so that a learner which fails does no harm, as it may after
    some crossings with a model that is wrong: how a wheel hops is hardest to know. It reads
    acceleration, travel and tyre deflection without noise, at the ends of the control intervals;
    the regulator beside the plan reads the state.
    """
    found = find_scenario(scenario)
    check_one(found, "learning")
    check_same_road(found, "learning")
    limits = Acceptable() if acceptable is None else acceptable
    feedback = regulator(suspension(model or found.car, found.dt), limits)
    own = dataclasses.replace(feedback.controller, name="ILC")
    teach = learner(feedback, limits, found.steps, caution=caution)
    size = np.array([limits.acceleration, limits.travel, limits.tyre])
    plan = np.zeros(found.steps)
    costs: list[float] = []
    best = plan
    for _ in range(whole("crossings", crossings)):
        policy = ControllerPolicy(own, found, plan=plan)
        run = rollout(policy, found, observe=policy.reads, signals=WEIGHTED)
        if run.terminated:
            break
        outputs = np.stack([run.signals[name] for name in WEIGHTED])
        weighed = np.append(outputs / size[:, np.newaxis], plan / limits.force)
        costs.append(float(np.sum(weighed * weighed)))
        if costs[-1] == min(costs):
            best = plan
        plan = teach.improved(plan, outputs)
        if not policy.clips:
            plan = np.clip(plan, -found.actuator.limit[0], found.actuator.limit[0])
    return Learned(policy=ControllerPolicy(own, found, plan=best), costs=tuple(costs))
