"""Linear cars: an interval is one matrix, and nothing is approximated beyond rounding.

See `qcar_env.engine.exact` for the matrix. Each car has its own, made anew when an episode begins
with other numbers; cars that are alike share one.
"""

from __future__ import annotations

from typing import Any, Protocol

from qcar_env.engine.cars import Cars
from qcar_env.engine.storage import Plan


class LinearPlan(Plan, Protocol):
    """What a fleet of linear cars is made for."""

    @property
    def scenario(self) -> Any:
        """A `qcar_env.scenarios.Scenario`."""
        ...


class LinearCars(Cars):
    """A fleet of linear cars on roads made of sines; arguments as of `qcar_env.engine.cars.Cars`.

    Raises
    ------
    ValueError
        If something is not linear, see `check_linear`.
    """

    def __init__(self, n: int, plan: LinearPlan, *, single: bool = False, threads: int = 1) -> None:
        check_linear(plan.scenario)
        super().__init__(n, plan, single=single, threads=threads, exact=True)


def check_linear(scenario: Any) -> None:
    """Refuse a scenario whose intervals are not linear maps.

    Parameters
    ----------
    scenario : qcar_env.scenarios.Scenario
        What cars are to draw their episodes from.

    Raises
    ------
    ValueError
        If car or actuator are not linear, with the scenario's numbers or with drawn ones, or the
        road is not made of sines.
    """
    if not scenario.excitation.turning:
        raise _refusal("road", "made of sines", scenario.road)
    varied = {path.partition(".")[0] for each in scenario.randomisation for path in each.numbers}
    drawn = scenario.extremes() if varied & {"car", "actuator"} else ()
    for each in (scenario, *drawn):
        for name in ("car", "actuator"):
            part = getattr(each, name)
            if not part.linear:
                raise _refusal(name, "linear", part)


def _refusal(name: str, what: str, part: Any) -> ValueError:
    return ValueError(
        f"the {name} must be {what} for the exact method, got {part}; give another one, or take "
        "method 'rk4'"
    )
