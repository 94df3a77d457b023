"""Rewards: minus the costs of some terms, each of which reads scaled signals.

A term is a part: numbers, the signals that it reads, and a pure function of their values now and
one control interval before. A signal is scaled as in the observation: 1 is its largest value
without control. A reward of one's own is a tuple of terms.

The default reward is minus ten times the mean of the envelope amplitudes over the uncontrolled
ones,

    a_i / A_i = sqrt((x_i / A_i)^2 + (v_i / (omega_i A_i))^2),

the paper's (5)-(8). ``"removed"`` is for training (`Removed`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from qcar_env.parts.part import Part, number
from qcar_env.physics.signals import Signal, signal
from qcar_env.scenarios.scenario import Scenario
from qcar_env.validation import finite, known, non_negative, positive, shown

# Cost of a step of the uncontrolled motion [-]. SAC with Stable-Baselines3's defaults ended with
# the body at 0.010 m with 10, and at 0.048 m, just below CNVC, with 1 (one seed); PPO's learn with
# both.
UNCONTROLLED_COST = 10.0
WEIGHT = 0.5 * UNCONTROLLED_COST  # [-] of each relative amplitude in the cost: of their mean
STEPS_LOST = 100.0  # [-] steps at the travel limit that leaving it costs: 1 / (1 - 0.99)
TRAVEL_PENALTY = STEPS_LOST * UNCONTROLLED_COST  # [-] for each amplitude of the limit


@dataclass(frozen=True, kw_only=True)
class Term(Part):
    """Base of the terms of a reward.

    A subclass has a `name`, under which `info` has the term as ``reward_<name>``, the signals that
    it `reads`, and ``cost(now, before, p)``: of the scaled readings at the end of an interval and
    at the end of the one before, tuples in the order of `reads`, and of the term's numbers.
    """

    name: ClassVar[str] = ""
    reads: ClassVar[tuple[Signal, ...]] = ()

    @staticmethod
    @abstractmethod
    def cost(now: Any, before: Any, p: Any) -> Any:
        """Return the cost [-]."""


def envelope(now: Any, before: Any, p: Any) -> Any:
    """Return the cost of an envelope amplitude over its reference."""
    return np.sqrt(now[0] * now[0] + now[1] * now[1]) * p.weight


@dataclass(frozen=True, kw_only=True)
class WheelAmplitude(Term):
    """Envelope amplitude of the wheel over the uncontrolled one."""

    name = "x1"
    reads = (signal("x1"), signal("v1"))
    cost = staticmethod(envelope)

    weight: float = number("weight", "-", non_negative, WEIGHT)


@dataclass(frozen=True, kw_only=True)
class BodyAmplitude(Term):
    """Envelope amplitude of the body over the uncontrolled one."""

    name = "x2"
    reads = (signal("x2"), signal("v2"))
    cost = staticmethod(envelope)

    weight: float = number("weight", "-", non_negative, WEIGHT)


NAMES = {"travel": "suspension_travel"}  # of terms, as `reward_travel` is the limit's penalty


def squared(name: str | Signal, weight: float = 1.0) -> Term:
    """Return a term ``weight * z^2`` of a signal z, scaled (errors: as `signal`)."""
    return _of_signal(signal(name), _square)(weight=weight)


def absolute(name: str | Signal, weight: float = 1.0) -> Term:
    """Return a term ``weight * |z|`` of a signal z, scaled (errors: as `signal`)."""
    return _of_signal(signal(name), _size)(weight=weight)


def _square(now: Any, before: Any, p: Any) -> Any:
    return now[0] * now[0] * p.weight


def _size(now: Any, before: Any, p: Any) -> Any:
    return abs(now[0]) * p.weight


@cache
def _of_signal(read: Signal, function: Any) -> Any:
    @dataclass(frozen=True, kw_only=True)
    class OfSignal(Term):
        """A term of one signal."""

        name = NAMES.get(read.name, read.name)
        reads = (read,)
        cost = staticmethod(function)

        weight: float = number("weight", "-", non_negative, 1.0)

    return OfSignal


def removed(now: Any, before: Any, p: Any) -> Any:
    """Return the cost of `Removed`."""
    a1 = np.sqrt(now[0] * now[0] + now[2] * now[2])
    a2 = np.sqrt(now[1] * now[1] + now[3] * now[3])
    lost1 = np.sqrt(before[0] * before[0] + before[2] * before[2]) - a1
    lost2 = np.sqrt(before[1] * before[1] + before[3] * before[3]) - a2
    limit = now[4]
    gain = p.removed1 * lost1 / (p.full1 * limit) + p.removed2 * lost2 / (p.full2 * limit)
    largest = a1 * (a1 >= a2) + a2 * (a2 > a1)
    return p.remaining1 * a1 + p.remaining2 * a2 + p.worst * largest - gain


@dataclass(frozen=True, kw_only=True)
class Removed(Term):
    """The amplitude removed, in units of what the actuator's full force can remove in phase.

        r = sum_i  w_i (a_i - a_i') / d_i  -  c_i a_i'  -  worst max_i a_i'

    with the envelope amplitudes over the uncontrolled ones before and after the interval. Every
    actuator's terms are then of order one, however strong it is. The first term telescopes:
    discounted with gamma it is the cost ``(1 - gamma) w_i a_i / d_i`` with the potential
    ``w_i a_i / d_i`` (A. Y. Ng, D. Harada, S. Russell, Policy invariance under reward
    transformations, ICML 1999), so that a horizon of half a period of the forcing suffices where
    the force can remove everything.

    Parameters
    ----------
    full1, full2 : float
        What full force removes in an interval, ``d_i = u_i dt / (omega_i A_i)`` [-].
    removed1, removed2 : float
        Weights `w` [-].
    remaining1, remaining2 : float
        Weights `c` [-].
    worst : float
        Weight of the larger relative amplitude, which is what the benchmark scores [-].
    """

    name = "removed"
    reads = tuple(signal(each) for each in ("x1", "x2", "v1", "v2", "limit"))
    cost = staticmethod(removed)

    full1: float = number("", "-", positive)
    full2: float = number("", "-", positive)
    removed1: float = number("weight", "-", non_negative, 1.0)
    removed2: float = number("weight", "-", non_negative, 1.0)
    remaining1: float = number("weight", "-", non_negative, 0.0)
    remaining2: float = number("weight", "-", non_negative, 0.0)
    worst: float = number("weight", "-", non_negative, 0.0)


@dataclass(frozen=True, kw_only=True)
class Reward(Part):
    """Terms, and what leaving the travel limits costs.

    Parameters
    ----------
    terms : tuple of Term
        At least one.
    penalty : float
        Cost of leaving the travel limits, for each reference amplitude of the limit [-].

    Raises
    ------
    ValueError
        If there is no term, two have one name, or the penalty is not a number.
    """

    terms: tuple[Term, ...]
    penalty: float = number("travel penalty", "-", finite, TRAVEL_PENALTY)

    def __post_init__(self) -> None:
        """Check the terms."""
        super().__post_init__()
        names = [getattr(each, "name", "") for each in self.terms]
        if not names or not all(isinstance(each, Term) for each in self.terms):
            raise ValueError(f"a reward needs terms, got {shown(self.terms)}; give Term objects")
        if len(set(names)) != len(names) or not all(names) or "travel" in names:
            raise ValueError(
                f"terms of a reward need names of their own, got {', '.join(names)}; "
                "'travel' is the penalty's"
            )


AMPLITUDES = Reward(terms=(WheelAmplitude(), BodyAmplitude()))


def removed_reward(scenario: Scenario, **weights: float) -> Reward:
    """Return the reward `Removed` for a scenario with an actuator on each mass.

    Raises
    ------
    ValueError
        If the scenario has one actuator for both masses, or a weight is negative.
    """
    actuator: Any = scenario.actuator
    limit = actuator.limit
    if len(limit) != 2:
        raise ValueError(
            f"reward 'removed' needs an actuator on each mass, got {len(limit)}; take 'amplitudes'"
        )
    found = scenario.reference
    full = (
        force * scenario.dt / (omega * amplitude)
        for force, omega, amplitude in zip(limit, found.frequencies, found.start, strict=True)
    )
    full1, full2 = full
    terms = (Removed(full1=full1, full2=full2, **weights),)
    return Reward(terms=terms, penalty=10.0 / scenario.travel_limit)


REWARDS = ("amplitudes", "removed")


def reward_of(given: str | Reward | Term | Sequence[Term], scenario: Scenario) -> Reward:
    """Return a reward by name, from terms, or as it is.

    Raises
    ------
    ValueError
        If there is no such reward, or what is given has no terms.
    """
    if isinstance(given, Reward):
        return given
    if isinstance(given, Term):
        return Reward(terms=(given,))
    if isinstance(given, str):
        name = known("reward", given, REWARDS)
        return AMPLITUDES if name == "amplitudes" else removed_reward(scenario)
    return Reward(terms=tuple(given))
