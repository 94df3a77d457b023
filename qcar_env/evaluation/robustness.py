"""What becomes of a policy where car, road, sensors or timing are not those it was made for.

Each case is a track that changes one thing in the scenario of another, whose policies enter as
they are. Its rho is relative to its own uncontrolled motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from qcar_env.envs.episode import observed
from qcar_env.evaluation.tracks import Episode, Track, track
from qcar_env.parts.sensor import Sensor
from qcar_env.physics.car import PaperCar
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.randomise import (
    Choice,
    Distribution,
    Vary,
    body_mass_of_paper_car,
    speed_and_force_frequency,
    wheel_mass_of_paper_car,
)

EPISODES = 16  # starts of each case
MARGIN = 0.03  # [-] of the speed, either way, at which what is tuned must not end above no control
Change = Callable[[Scenario], Scenario]


def _scaled(scenario: Scenario, factor: float, *what: Callable[[Distribution], Vary]) -> Scenario:
    if scenario.randomisation:
        raise ValueError(
            f"scenario {scenario.name!r} must not vary, as it is changed by a factor; give one "
            "that is drawn already"
        )
    varied = tuple(each(Choice(values=(factor,))) for each in what)
    return dataclasses.replace(scenario, randomisation=varied).drawn([0.0] * len(varied))


def speed(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario with `factor` [-] times the speed and the external force's frequency."""
    return _scaled(scenario, factor, speed_and_force_frequency)


def height(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario with `factor` [-] times the road's height."""
    return _scaled(scenario, factor, lambda by: Vary(by=by, numbers={"road.h": 1.0}))


def masses(scenario: Scenario, body: float, wheel: float = 1.0) -> Scenario:
    """Return a scenario with the masses times these factors [-]; forces keep their newtons."""
    if not isinstance(scenario.car, PaperCar):
        found = scenario.car.numbers
        force = {"force.f": scenario.force.f / body}
        return scenario.replaced({"car.m1": wheel * found.m1, "car.m2": body * found.m2, **force})
    return _scaled(_scaled(scenario, body, body_mass_of_paper_car), wheel, wheel_mass_of_paper_car)


def noise(scenario: Scenario, share: float) -> Scenario:
    """Return a scenario with white noise of `share` [-] of its scale on every reading."""
    scales = scenario.reference.scales
    noisy = (Sensor(signal=each.name, noise=share * scales[each.name]) for each in observed("full"))
    return dataclasses.replace(scenario, sensors=tuple(noisy))


def delay(scenario: Scenario, intervals: int) -> Scenario:
    """Return a scenario whose actuator acts so many control intervals later."""
    late = dataclasses.replace(scenario.actuator, delay=intervals * scenario.dt)
    return dataclasses.replace(scenario, actuator=late)


def interval(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario with `factor` [-] times the control interval, and steps as they were."""
    substeps = max(1, round(factor * scenario.substeps))
    return dataclasses.replace(scenario, dt=factor * scenario.dt, substeps=substeps)


CASES: Mapping[str, Change] = MappingProxyType(
    {
        "nominal": lambda scenario: scenario,
        "speed -10 %": partial(speed, factor=0.9),
        "speed +10 %": partial(speed, factor=1.1),
        "body mass -20 %": partial(masses, body=0.8),
        "body mass +20 %": partial(masses, body=1.2),
        "both masses +20 %": partial(masses, body=1.2, wheel=1.2),
        "height x 0.5": partial(height, factor=0.5),
        "height x 1.5": partial(height, factor=1.5),
        "noise 1 %": partial(noise, share=0.01),
        "noise 5 %": partial(noise, share=0.05),
        "delay 1 interval": partial(delay, intervals=1),
        "delay 2 intervals": partial(delay, intervals=2),
        "interval x 0.5": partial(interval, factor=0.5),
        "interval x 2": partial(interval, factor=2.0),
    }
)


def tracks(home: str | Track = "budget", force_scale: float = 1.0) -> tuple[Track, ...]:
    """Return the cases as tracks.

    Parameters
    ----------
    home : str or Track
        Whose policies enter, and whose scenario is changed.
    force_scale : float
        Force limit over the scenario's own [-].

    Raises
    ------
    ValueError
        If there is no such track, or its scenario varies.
    """
    found = track(home)
    return tuple(
        dataclasses.replace(
            found,
            name=name,
            title=f"Policies of track {found.name!r}, {name}",
            scenario=change(found.lasting),
            force_scales=(force_scale,),
            episodes=EPISODES,
            made_for=found,
        )
        for name, change in CASES.items()
    )


def beside(cases: Sequence[Episode]) -> list[Episode]:
    """Return the same episodes, by turns at a speed `MARGIN` lower and higher."""
    return [
        dataclasses.replace(each, nominal=speed(each.nominal, 1.0 + MARGIN * (-1.0) ** (i + 1)))
        for i, each in enumerate(cases)
    ]


def loss_beside(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a search counts of rho (..., n) beside its scenario, shape (...) [-].

    Nothing but what ends above no control, and that at twice its size: a margin, and no other aim.
    """
    return np.mean(np.where(rho > 1.0, 2.0 * rho - 1.0, 0.0), axis=-1)
