"""From a scenario to a fleet: what is compiled for it, and the numbers that its cars draw from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from qcar_env.engine.composition import Composition
from qcar_env.engine.course import road_functions
from qcar_env.engine.sensing import Sensed
from qcar_env.engine.starts import (
    FIRST_DRAWS,
    MOTION_DRAWS,
    NOISE_DRAWS,
    Nominal,
    Reference as Amplitudes,
)
from qcar_env.engine.storage import Source
from qcar_env.physics import tree
from qcar_env.physics.signals import Signal
from qcar_env.scenarios.randomise import arrays
from qcar_env.scenarios.reference import TINY
from qcar_env.scenarios.scenario import Scenario

UNSCALED = (1.0, 1.0, 1.0, 1.0)  # amplitudes and frequencies where none are known yet
BEYOND = 1e300  # [-] travel that nothing reaches


@dataclass(frozen=True)
class Plan:
    """What a fleet is made for.

    Parameters
    ----------
    scenario : Scenario
        What its cars draw their episodes from, at first.
    observed : tuple of Signal
        Entries of the observation.
    terms : tuple of Term
        Of the reward (see `qcar_env.envs.reward`).
    penalty : float
        What leaving the travel costs, for each reference amplitude of the limit [-].
    own : Scenario, optional
        The scenario before its force limit was scaled; its limit is 1 in the observation, and its
        uncontrolled motion gives the scales.
    unscaled : tuple of float, optional
        For the search of scales: amplitudes and frequencies of the starts; readings are shown in
        millionths and no travel ends an episode.
    """

    scenario: Scenario
    observed: tuple[Signal, ...]
    terms: tuple[Any, ...] = ()
    penalty: float = 0.0
    own: Scenario | None = None
    unscaled: tuple[float, float, float, float] | None = None

    @property
    def dt(self) -> float:
        """Control interval [s]."""
        return self.scenario.dt

    @property
    def substeps(self) -> int:
        """RK4 steps in a control interval."""
        return self.scenario.substeps

    @cached_property
    def nominal(self) -> Nominal:
        """The scenario as plain numbers."""
        scenario = self.scenario
        if self.unscaled is None:
            found = (self.own or scenario).reference
            limit = scenario.travel_limit
            amplitudes = Amplitudes(
                *found.start,
                *found.frequencies,
                found.scales["x1"],
                found.scales["x2"],
                limit,
                self.penalty * limit,
            )
        else:
            amplitudes = Amplitudes(*self.unscaled, 1.0, 1.0, BEYOND, 0.0)
        return Nominal(
            numbers=scenario.numbers,
            reference=amplitudes,
            steps=float(scenario.steps),
            endless=float(scenario.excitation.harmonic),
            scales=tuple(self._inverse(each) for each in self.observed),
            terms=tuple(each.numbers for each in self.terms),
            term_scales=tuple(
                tuple(self._inverse(each) for each in term.reads) for term in self.terms
            ),
        )

    def _inverse(self, signal: Signal) -> float:
        """Return what a signal is multiplied by; 0 where the scenario has none of it."""
        if self.unscaled is not None:
            return TINY
        scenario = self.own or self.scenario
        if signal.needs_masses and not scenario.car.has_masses:
            raise ValueError(
                f"signal {signal.name!r} needs a car with masses, got a PaperCar; make the car "
                "with QuarterCar"
            )
        scale = scenario.reference.scale(signal, scenario)
        return 1.0 / scale if scale > 0.0 else 0.0

    @property
    def composition(self) -> Composition:
        """What is compiled."""
        return self._composition

    @property
    def source(self) -> Source:
        """The numbers that cars draw from."""
        return self._source

    @cached_property
    def _composition(self) -> Composition:
        return Composition(
            car=self.scenario.car.functions,
            road=road_functions(type(self.scenario.road)),
            actuator=type(self.scenario.actuator),
            observed=self.observed,
            terms=tuple(type(each) for each in self.terms),
            delay=self.scenario.intervals("delay", self.scenario.actuator.delay),
            sensed=tuple(self._sensed(each) for each in self.observed),
            like=self.nominal,
        )

    def _sensed(self, signal: Signal) -> Sensed | None:
        """Return the sensor through which a signal is read, if the scenario has one for it."""
        scenario = self.scenario
        for which, each in enumerate(scenario.sensors):
            if each.signal == signal.name and self.unscaled is None:
                return Sensed(
                    which,
                    type(each),
                    scenario.intervals("delay", each.delay),
                    max(1, scenario.intervals("period", each.period)),
                    each.cutoff > 0.0,
                )
        return None

    @cached_property
    def _source(self) -> Source:
        index = tree.paths(self.nominal)
        inside = {
            path.removeprefix("numbers."): place
            for path, place in index.items()
            if path.startswith("numbers.")
        }
        draws, targets = arrays(self.scenario.randomisation, inside)
        noise = NOISE_DRAWS if any(self.composition.sensed) else 0
        first = max(FIRST_DRAWS, len(self.scenario.randomisation)) + noise
        return Source(
            row=np.array(tree.flat(self.nominal), dtype=np.float64) + 0.0,  # no negative zero
            draws=draws if len(draws) else np.zeros((1, 3)),
            targets=targets,
            uniforms=first + MOTION_DRAWS,
            table=np.array(self.scenario.road.table, dtype=np.float64).ravel(),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave what is derived behind: compiled functions cannot be pickled."""
        derived = ("nominal", "_composition", "_source")
        return {name: value for name, value in vars(self).items() if name not in derived}
