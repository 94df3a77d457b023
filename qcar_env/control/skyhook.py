"""Skyhook, groundhook and their blend: dampers that seem to hang from the sky or stand on ground.

    skyhook:     the body is damped against the sky       F2 = -G2 m2 v2
    groundhook:  the wheel is damped against the ground   F1 = -G1 m1 v1
    hybrid:      both

An actuator between wheel and body pushes on both: what it does for one mass it does to the other
with the opposite sign. Actuators against the ground, as the paper's, do not.

Source: D. Karnopp, M. J. Crosby, R. A. Harwood, Vibration control using semi-active force
generators, ASME Journal of Engineering for Industry 96(2), 1974 (skyhook); M. Valasek, M. Novak,
Z. Sika, O. Vaculin, Extended ground-hook, Vehicle System Dynamics 27(5-6), 1997.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import non_negative, positive, store


class HybridGains(NamedTuple):
    """Gains of `command`."""

    G1: Any  # groundhook on the wheel [1/s]
    G2: Any  # skyhook on the body [1/s]
    onto1: Any  # what the skyhook does to the wheel, G2 m2 / m1 or 0 [1/s]
    onto2: Any  # what the groundhook does to the body, G1 m1 / m2 or 0 [1/s]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return the specific forces [m/s^2] (arguments: `qcar_env.control.law.Law`)."""
    return gains.onto1 * x.v2 - gains.G1 * x.v1, gains.onto2 * x.v1 - gains.G2 * x.v2


@dataclass(frozen=True, kw_only=True)
class Hybrid:
    """Skyhook on the body and groundhook on the wheel.

    Parameters
    ----------
    G1, G2 : float
        Damping of the wheel against the ground and of the body against the sky [1/s]; not
        negative. Chosen here: 10, well above the paper's passive damping of body and wheel.
    mass_ratio : float or None
        ``m2 / m1`` [-] for one actuator between the masses; None for actuators against the ground,
        with which the hybrid is linear velocity feedback.

    Raises
    ------
    ValueError
        If a gain is negative or the ratio not positive.

    Notes
    -----
    Against the ground both laws take energy out. Between the masses the groundhook can feed the
    body and the skyhook the wheel: no general claim of stability is made.
    """

    G1: float = 10.0
    G2: float = 10.0
    mass_ratio: float | None = None
    name = "hybrid"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(
            self,
            G1=non_negative("gain G1", self.G1, "1/s"),
            G2=non_negative("gain G2", self.G2, "1/s"),
            mass_ratio=_ratio(self.mass_ratio),
        )

    @property
    def gains(self) -> HybridGains:
        """The gains as plain floats."""
        if self.mass_ratio is None:
            return HybridGains(float(self.G1), float(self.G2), 0.0, 0.0)
        return HybridGains(
            float(self.G1),
            float(self.G2),
            self.G2 * self.mass_ratio,
            self.G1 / self.mass_ratio,
        )

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: the law has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car (see Notes)."""


@dataclass(frozen=True, kw_only=True)
class Skyhook:
    """The body damped against the sky, the wheel left to itself.

    Parameters
    ----------
    G : float
        Damping [1/s]; not negative. Chosen here: 10 (see `Hybrid`).
    mass_ratio : float or None
        See `Hybrid`.

    Raises
    ------
    ValueError
        See `Hybrid`.
    """

    G: float = 10.0
    mass_ratio: float | None = None
    name = "skyhook"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(self, G=non_negative("gain G", self.G, "1/s"), mass_ratio=_ratio(self.mass_ratio))

    @property
    def gains(self) -> HybridGains:
        """The gains as plain floats."""
        return Hybrid(G1=0.0, G2=self.G, mass_ratio=self.mass_ratio).gains

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: the law has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car (see `Hybrid`)."""


@dataclass(frozen=True, kw_only=True)
class Groundhook:
    """The wheel damped against the ground, the body left to itself.

    Parameters
    ----------
    G : float
        Damping [1/s]; not negative. Chosen here: 10 (see `Hybrid`).
    mass_ratio : float or None
        See `Hybrid`.

    Raises
    ------
    ValueError
        See `Hybrid`.
    """

    G: float = 10.0
    mass_ratio: float | None = None
    name = "groundhook"

    def __post_init__(self) -> None:
        """Check the gains."""
        store(self, G=non_negative("gain G", self.G, "1/s"), mass_ratio=_ratio(self.mass_ratio))

    @property
    def gains(self) -> HybridGains:
        """The gains as plain floats."""
        return Hybrid(G1=self.G, G2=0.0, mass_ratio=self.mass_ratio).gains

    @property
    def command(self) -> Command:
        """The law's formula."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: the law has no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car (see `Hybrid`)."""


def _ratio(given: float | None) -> float | None:
    return None if given is None else positive("mass_ratio", given)
