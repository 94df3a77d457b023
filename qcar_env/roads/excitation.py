"""A road driven over at a speed: height y(t) under the tyre and its rate y'(t).

The paper's roads are given by the frequency ``omega = pi V / (3.6 L)`` [rad/s] of a hump of length
L [m] that is met at V [km/h]; `harmonic`, `hump`, `train` and `step` make them so.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.roads.profile import Road
from qcar_env.roads.shapes import HalfSine, Sine, Step
from qcar_env.roads.train import Train
from qcar_env.validation import finite, finite_array, instance, positive, store


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """A road and the speed at which it is driven over; at time 0 the car is at distance 0.

    Parameters
    ----------
    road : Road
        The road.
    speed : float
        Speed of the car [m/s]; positive.

    Raises
    ------
    ValueError
        If the speed is not positive, or a frequency is too small or too large to be one.
    """

    road: Road
    speed: float

    def __post_init__(self) -> None:
        """Check road and speed."""
        instance("road", self.road, Road)
        store(self, speed=positive("speed", self.speed, "m/s"))
        if self.turning and not isinstance(self.road, Step):
            positive("frequency of the road", self.omega, "rad/s")
            finite("period of the road", 2.0 * math.pi / self.omega, "s")

    @property
    def turning(self) -> bool:
        """Whether its pieces are sines, or at rest, which turn phasors in compiled code."""
        return bool(self.road.turning)

    @property
    def harmonic(self) -> bool:
        """Whether it is an endless sine: the paper's road."""
        return isinstance(self.road, Sine)

    @property
    def _shape(self) -> Any:
        return self.road.shape if isinstance(self.road, Train) else self.road

    @property
    def h(self) -> float:
        """Height of a turning road [m]."""
        return self._turns("h")

    @property
    def omega(self) -> float:
        """Angular frequency of a turning road [rad/s]; 0 of a step."""
        return self._turns("wavenumber") * self.speed

    def _turns(self, name: str) -> float:
        if not self.turning:
            raise ValueError(
                f"the road must be made of sines, got {self.road}; give a Sine, a HalfSine, a "
                "train of these, or a Step"
            )
        return float(getattr(self._shape, name))

    @property
    def end(self) -> float:
        """When the last kink is passed [s]; infinite for a road that has no end."""
        return self.road.length / self.speed

    def varied(self, *, h: float | None = None, omega: float | None = None) -> Excitation:
        """Return the same turning road with another height [m] or frequency [rad/s]."""
        changes: dict[str, float] = {} if h is None else {"h": h}
        if omega is not None:
            changes["wavenumber"] = positive("omega", omega, "rad/s") / self.speed
        shape = dataclasses.replace(self._shape, **changes)
        if isinstance(self.road, Train):
            return dataclasses.replace(self, road=dataclasses.replace(self.road, shape=shape))
        return dataclasses.replace(self, road=shape)

    def kinks(self, t_start: float, t_end: float) -> list[float]:
        """Return the times in ``(t_start, t_end)`` [s] at which a piece begins or ends."""
        finite("t_start", t_start, "s")
        finite("t_end", t_end, "s")
        return [s / self.speed for s in self.road.kinks(t_start * self.speed, t_end * self.speed)]

    def height(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return y at `t` [s], array (n,) [m]."""
        return self.road.heights(finite_array("t", t, "s") * self.speed)

    def rate(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return y' at `t` [s], array (n,) [m/s]; at a kink that of the piece which begins."""
        return self.road.slopes(finite_array("t", t, "s") * self.speed) * self.speed


def hump_frequency(V: float, L: float) -> float:
    """Return the frequency of a hump of length `L` [m] met at `V` [km/h], ``pi V / (3.6 L)``.

    Returns
    -------
    float
        [rad/s].

    Raises
    ------
    ValueError
        If a value is not positive.
    """
    return math.pi * positive("speed V", V, "km/h") / (3.6 * positive("hump length L", L, "m"))


def harmonic(
    *, h: float, omega: float | None = None, V: float | None = None, L: float | None = None
) -> Excitation:
    """Return the paper's road ``y = h sin(omega t)``.

    Parameters
    ----------
    h : float
        Height [m].
    omega : float, optional
        Angular frequency [rad/s]; the speed is 1 m/s then, and the road as long as that needs.
    V, L : float, optional
        Instead of `omega`: the car's speed [km/h] and the length of half a wave [m].

    Raises
    ------
    ValueError
        Unless exactly one of `omega` and (`V`, `L`) is given, or if a value is out of range.
    """
    wavenumber, speed = _driven(omega, V, L)
    return Excitation(road=Sine(h=h, wavenumber=wavenumber), speed=speed)


def hump(
    *,
    h: float,
    omega: float | None = None,
    V: float | None = None,
    L: float | None = None,
    start: float = 0.0,
) -> Excitation:
    """Return a flat road with a single half-sine hump (arguments as `harmonic`).

    Parameters
    ----------
    start : float, optional
        When the tyre meets it [s].
    """
    wavenumber, speed = _driven(omega, V, L)
    road = HalfSine(h=h, wavenumber=wavenumber, start=finite("start", start, "s") * speed)
    return Excitation(road=road, speed=speed)


def train(
    *,
    h: float,
    count: int,
    gap: float,
    omega: float | None = None,
    V: float | None = None,
    L: float | None = None,
    start: float = 0.0,
) -> Excitation:
    """Return a flat road with several half-sine humps (arguments as `hump`).

    Parameters
    ----------
    count : int
        Number of humps.
    gap : float
        Flat stretch between two humps, in lengths of a hump [-].
    """
    one = hump(h=h, omega=omega, V=V, L=L, start=start)
    shape: Any = one.road
    length = math.pi / shape.wavenumber
    return Excitation(road=Train(shape=shape, count=count, gap=gap * length), speed=one.speed)


def step(*, h: float, start: float = 0.0) -> Excitation:
    """Return a road that rises by `h` [m] at `start` [s] and stays there (the paper's Fig. 11)."""
    return Excitation(road=Step(h=h, start=start), speed=1.0)


def _driven(omega: float | None, V: float | None, L: float | None) -> tuple[float, float]:
    """Return wavenumber [rad/m] and speed [m/s]."""
    if omega is not None and V is None and L is None:
        return positive("omega", omega, "rad/s"), 1.0
    if omega is None and V is not None and L is not None:
        hump_frequency(V, L)
        return math.pi / L, V / 3.6
    raise ValueError(
        f"give either omega [rad/s] or both V [km/h] and L [m], got omega={omega}, V={V}, L={L}"
    )
