"""No control: ``u_i = 0``, the paper's uncontrolled system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.control.law import Command, FilterRate
from qcar_env.physics.car import QuarterCar


class NoGains(NamedTuple):
    """Gains of `command`."""

    zero: Any = 0.0  # [1/s]


def command(x: Any, eta: Any, gains: Any) -> tuple[Any, Any]:
    """Return ``(0, 0)`` in the state's own kind (arguments: `qcar_env.control.law.Law`)."""
    return gains.zero * x.v1, gains.zero * x.v2


@dataclass(frozen=True, kw_only=True)
class Passive:
    """No control."""

    name = "none"

    @property
    def gains(self) -> NoGains:
        """No gains."""
        return NoGains()

    @property
    def command(self) -> Command:
        """Zero force."""
        return command

    @property
    def filter_rate(self) -> FilterRate | None:
        """None: there is no memory."""
        return None

    def check(self, car: QuarterCar) -> None:
        """Accept every car."""
