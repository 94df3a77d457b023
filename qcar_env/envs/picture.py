"""What a frame shows, as data: one car at one instant, and how metres become pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_env.parts.actuator import Actuator
from qcar_env.physics.signals import signal
from qcar_env.physics.state import State
from qcar_env.roads.profile import Road, Shape
from qcar_env.roads.shapes import Sine
from qcar_env.roads.train import Train
from qcar_env.scenarios import Scenario
from qcar_env.validation import finite

# Lengths in a frame of 640 x 480 [px].
WHEEL = 46.0  # radius of the tyre
TYRE_TRAVEL = 0.75 * WHEEL  # of the uncontrolled wheel
BODY_TRAVEL = 54.0  # of the uncontrolled body
HUMP_SEEN = 13.0  # least height of the largest unevenness
HUMP_LENGTH = 150.0  # of a hump, or of half a wave
LONGEST_BAR = 60.0
ACROSS = 80.0  # of a metre of a road without humps: 8 m in a frame, as a car is long


@dataclass(frozen=True, kw_only=True)
class Picture:
    """What a frame shows: one car at one instant.

    Parameters
    ----------
    name : str
        Name of what controls the car.
    colour : str
        Its colour, ``#rrggbb``.
    nominal : Scenario
        Gives the uncontrolled amplitudes that the chart refers to.
    episode : Scenario
        The car, road and force of this episode.
    time : float
        Time on the road [s].
    elapsed : float
        Time since the start of the episode [s].
    state : State
        Plant, four floats in SI units.
    force : tuple of float
        Force of the actuators on wheel and body, upward [m/s^2] or [N], see `forces`.
    note : str
        What else the second line says.
    """

    name: str
    colour: str
    nominal: Scenario
    episode: Scenario
    time: float
    elapsed: float
    state: State
    force: tuple[float, float]
    note: str = ""

    def __post_init__(self) -> None:
        """Check that the car is somewhere."""
        finite("distance on the road", self.distance, "m")

    @property
    def levels(self) -> tuple[float, float]:
        """Envelope amplitudes of wheel and body over the uncontrolled ones [-]."""
        reference, x = self.nominal.reference, self.state
        (a1, a2), (omega1, omega2) = reference.amplitudes, reference.frequencies
        return math.hypot(x.x1, x.v1 / omega1) / a1, math.hypot(x.x2, x.v2 / omega2) / a2

    @property
    def shares(self) -> tuple[float, float]:
        """Force of the actuators over the largest one, on wheel and body [-]."""
        most1, most2 = largest_forces(self.nominal)
        return self.force[0] / most1, self.force[1] / most2

    @property
    def distance(self) -> float:
        """Where the tyre is on the road [m]."""
        return self.time * self.episode.speed


def forces(
    actuator: Actuator, command: Sequence[float], memory: Sequence[float], state: State
) -> tuple[float, float]:
    """Return the forces of the actuators on wheel and body, in their unit.

    Parameters
    ----------
    actuator : Actuator
        The actuator.
    command : sequence of float (m,)
        What it has been asked for, in its own unit.
    memory : sequence of float
        Entries of its `State`.
    state : State
        Of the car.
    """
    kind: Any = type(actuator)
    travel_rate = state.v2 - state.v1
    u1, u2 = kind.force(kind.State(*memory), tuple(command), travel_rate, actuator.numbers)
    return float(u1), float(u2)


def largest_forces(nominal: Scenario) -> tuple[float, float]:
    """Return what arrows of full length stand for, on wheel and body, in the actuator's unit.

    An actuator that takes only energy out has no force of its own: the largest damping at the
    largest travel rate of the uncontrolled car.
    """
    actuator: Any = nominal.actuator
    limit = actuator.limit
    if hasattr(actuator, "c_max"):
        limit = (limit[0] * nominal.reference.scale(signal("travel_rate"), nominal),)
    return limit[0], limit[-1]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How metres become pixels in a frame of 640 x 480."""

    displacement: float  # [px/m] of wheel and body
    road: float  # road height over its true one at that scale [-]
    bar: float  # length that the scale bar stands for [m]
    along: float  # [px/m] along the road


def sizes(nominal: Scenario) -> Sizes:
    """Return scales at which the uncontrolled motion fills the frame and the road can be seen.

    Parameters
    ----------
    nominal : Scenario
        Its uncontrolled motion and its road decide.
    """
    a1, a2 = nominal.reference.amplitudes
    displacement = min(TYRE_TRAVEL / a1, BODY_TRAVEL / a2)
    seen = displacement * nominal.reference.scale(signal("y"), nominal)
    road = float(max(1, math.ceil(HUMP_SEEN / seen))) if seen > 0.0 else 1.0
    longest = LONGEST_BAR / displacement
    decade = 10.0 ** math.floor(math.log10(longest))
    bar = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= longest)
    length = hump_length(nominal.road)
    along = ACROSS if length is None else HUMP_LENGTH / length
    return Sizes(displacement=displacement, road=road, bar=bar, along=along)


def hump_length(road: Road) -> float | None:
    """Return the length of a hump, or of half a wave [m]; None for a road without either."""
    if isinstance(road, Sine):
        return math.pi / road.wavenumber
    shape = road.shape if isinstance(road, Train) else road
    return shape.extent if isinstance(shape, Shape) and shape.extent > 0.0 else None


def profile(road: Road, low: float, high: float, count: int) -> tuple[NDArray[np.float64], ...]:
    """Return distances [m] and heights [m] of a stretch of road, with both sides of every kink.

    Parameters
    ----------
    road : Road
        The road.
    low, high : float
        The stretch [m].
    count : int
        Number of even samples.
    """
    after = np.array(road.kinks(low, high))
    before = np.nextafter(after, -math.inf)
    s = np.sort(np.concatenate([np.linspace(low, high, count), before, after]))
    return s, road.heights(s)
