"""Semi-active laws: which damping c of a valve, from what its sensors read.

With ``w = v2 - v1``, the rate of the suspension travel, and a2 the acceleration of the body:

    skyhook, on-off      c = c_max where  v2 w >= 0,  else c_min                         (1)
    groundhook, on-off   c = c_max where -v1 w >= 0,  else c_min                         (2)
    ADD                  c = c_max where  a2 w >= 0,  else c_min                         (3)
    SH-ADD               (1) where a2^2 - alpha^2 v2^2 <= 0, else (3)                    (4)
    mix-1                c = c_max where a2^2 - alpha^2 v2^2 <= 0, else c_min            (5)
    hybrid, linear       c w = c_hook (share s + (1 - share) g), within c_min to c_max,  (6)
                         s = v2 where v2 w > 0, g = -v1 where -v1 w > 0, else 0

A damper's force on the body is ``-c w``: (6) is the force ``-c_hook v2`` of a damper to the sky,
and on the wheel ``-c_hook v1`` of one to the ground, wherever a damper can give it. Of (6) the
linear skyhook has share 1, the linear groundhook share 0.

Source: (1) D. Karnopp, M. J. Crosby, R. A. Harwood, ASME J. Engineering for Industry 96(2), 1974;
(2) M. Valasek et al., Vehicle System Dynamics 27(5-6), 1997; (3) S. M. Savaresi, E. Silani,
S. Bittanti, Acceleration-driven-damper, ASME J. Dynamic Systems, Measurement and Control 127(2),
2005; (4) S. M. Savaresi, C. Spelta, Mixed skyhook and ADD, the same 129(4), 2007; (5) the same, A
single-sensor control strategy for semi-active suspensions, IEEE Trans. Control Systems Technology
17(1), 2009; (6) F. D. Goncalves, M. Ahmadian, A hybrid control policy for semi-active vehicle
suspensions, Shock and Vibration 10(1), 2003. The formulas are those of the literature that cites
these papers, which were not at hand.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from qcar_env.parts.part import Part, clamp, number, positive_part
from qcar_env.validation import finite, non_negative, positive


class Motion(NamedTuple):
    """What a semi-active law can read; None where it does not."""

    v1: Any = None  # velocity of the wheel [m/s]
    v2: Any = None  # velocity of the body [m/s]
    travel_rate: Any = None  # v2 - v1 [m/s]
    body_acceleration: Any = None  # [m/s^2]


@dataclass(frozen=True, kw_only=True)
class SemiActiveLaw(Part):
    """Base of the laws: numbers, and one pure function of them (see `qcar_env.parts.part`)."""

    name: ClassVar[str] = "own"
    signals: ClassVar[tuple[str, ...]] = ()  # what it reads, fields of `Motion`

    @staticmethod
    @abstractmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m] of a `Motion`, from `c_min` to `c_max`."""


@dataclass(frozen=True, kw_only=True)
class OnOffSkyhook(SemiActiveLaw):
    """Hard where a damper can brake the body, soft elsewhere."""

    name = "skyhook, on-off"
    signals = ("v2", "travel_rate")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        return c_min + (c_max - c_min) * (m.v2 * m.travel_rate >= 0.0)  # (1)


@dataclass(frozen=True, kw_only=True)
class OnOffGroundhook(SemiActiveLaw):
    """Hard where a damper can brake the wheel, soft elsewhere."""

    name = "groundhook, on-off"
    signals = ("v1", "travel_rate")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        return c_min + (c_max - c_min) * (-m.v1 * m.travel_rate >= 0.0)  # (2)


@dataclass(frozen=True, kw_only=True)
class ADD(SemiActiveLaw):
    """Acceleration-driven damper: hard where a damper can lessen the acceleration of the body."""

    name = "ADD"
    signals = ("body_acceleration", "travel_rate")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        return c_min + (c_max - c_min) * (m.body_acceleration * m.travel_rate >= 0.0)  # (3)


CROSSOVER = 1.9  # [Hz] chosen here, within the 1.6 to 2.2 Hz usual for cars


def _crossover(name: str, value: Any, unit: str) -> float:
    return non_negative(f"{name} of skyhook and ADD", value, unit)


@dataclass(frozen=True, kw_only=True)
class Mix1(SemiActiveLaw):
    """One sensor on the body: hard in slow motion, soft in fast.

    Parameters
    ----------
    crossover : float
        Frequency ``alpha / (2 pi)`` at which slow ends [Hz]; not negative.
    """

    crossover: float = number("", "Hz", _crossover, CROSSOVER)

    name = "mix-1"
    signals = ("body_acceleration", "v2")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        return c_min + (c_max - c_min) * _slow(m, p)  # (5)


@dataclass(frozen=True, kw_only=True)
class SHADD(SemiActiveLaw):
    """Skyhook in slow motion, ADD in fast.

    Parameters
    ----------
    crossover : float
        Frequency ``alpha / (2 pi)`` at which slow ends [Hz]; not negative.
    """

    crossover: float = number("", "Hz", _crossover, CROSSOVER)

    name = "SH-ADD"
    signals = ("body_acceleration", "v2", "travel_rate")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        slow = _slow(m, p)
        skyhook = OnOffSkyhook.damping(m, c_min, c_max, p)
        add = ADD.damping(m, c_min, c_max, p)
        return skyhook * slow + add * (1 - slow)  # (4)


def _slow(m: Any, p: Any) -> Any:
    """Return 1 where ``a2^2 - alpha^2 v2^2 <= 0``, else 0."""
    alpha = 2.0 * math.pi * p.crossover
    a2, v2 = m.body_acceleration, alpha * m.v2
    return 1 * (a2 * a2 - v2 * v2 <= 0.0)


def _share(name: str, value: Any, unit: str) -> float:
    share = finite(name, value, unit)
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"{name} must be from 0 to 1, got {share:g}; give 1 for skyhook alone")
    return share


@dataclass(frozen=True, kw_only=True)
class LinearHybrid(SemiActiveLaw):
    """Linear skyhook and groundhook, each where a damper can give it.

    Parameters
    ----------
    c_hook : float
        Damping of body against the sky and wheel against the ground [N s/m]; positive. Chosen here:
        3000 N s/m, a critically damped body of 300 kg on 16 kN/m has 4400.
    share : float
        1 for skyhook alone, 0 for groundhook alone [-]. Chosen here: 0.75, with which the
        acceleration of a Megane's body on a road of class C is below that with any passive damper.
    """

    c_hook: float = number("damping", "N s/m", positive, 3000.0)
    share: float = number("of the skyhook", "-", _share, 0.75)

    name = "hybrid, linear"
    signals = ("v1", "v2", "travel_rate")

    @staticmethod
    def damping(m: Any, c_min: Any, c_max: Any, p: Any) -> Any:
        """Return the damping [N s/m]."""
        w = m.travel_rate
        power = p.share * positive_part(m.v2 * w) + (1.0 - p.share) * positive_part(-m.v1 * w)
        square = w * w
        # Where the masses move together no damping gives a force, and none is asked for.
        return clamp(p.c_hook * power / (square + (square == 0.0)), c_min, c_max)  # (6)


SEMI_ACTIVE_LAWS = {
    "skyhook-on-off": OnOffSkyhook,
    "groundhook-on-off": OnOffGroundhook,
    "add": ADD,
    "sh-add": SHADD,
    "mix-1": Mix1,
    "hybrid-linear": LinearHybrid,
}
