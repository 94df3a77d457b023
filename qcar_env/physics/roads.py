"""Road profiles: the height y(t) under the tyre and its rate y'(t), as the car drives over them.

Every profile is made of pieces on which ``y = h s`` and ``y' = h omega c``, where the phasor
``(s, c)`` turns at the constant rate `omega`, or is at rest:

harmonic   one piece: ``y = h sin(omega t)``, for ever (the paper's road)
hump       flat, then half a sine of duration ``T = pi / omega``, then flat
train      `count` such humps, their beginnings ``(1 + gap) T`` apart
step       flat, then ``y = h`` (the paper's Fig. 11)

At a piece's end the profile has a kink (a jump in y', for the step in y). An integrator that stops
at `Road.kinks` and starts again meets no discontinuity inside a step.

A hump of length L [m] crossed at V [km/h] lasts ``T = 3.6 L / V``: ``omega = pi V / (3.6 L)``,
the paper's section 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.validation import (
    finite,
    finite_array,
    known,
    non_negative,
    positive,
    store,
    whole,
)

Profile = Literal["harmonic", "hump", "train", "step"]
ENDLESS = 1e30  # [s] duration of a step; finite, so that 0 * ENDLESS is 0
PROFILES: tuple[Profile, ...] = ("harmonic", "hump", "train", "step")
MOST_HUMPS = 1_000_000  # of a train, chosen here: its two million kinks are listed in a second
COUNTS: dict[str, int] = {"harmonic": 0, "hump": 1, "step": 1}  # a train has any number


class Phasor(NamedTuple):
    """Sine and cosine of an angle that turns at a constant rate; ``(0, 0)`` is a road at rest."""

    s: Any  # sine [-]
    c: Any  # cosine [-]


def turn(phasor: Any, by: Any) -> Phasor:
    """Return `phasor` turned by the angle whose sine and cosine are `by`.

    Both are `Phasor`, entries float or array (n,). A phasor at rest stays at rest.
    """
    return Phasor(
        phasor.s * by.c + phasor.c * by.s,
        phasor.c * by.c - phasor.s * by.s,
    )


class RoadPieces(NamedTuple):
    """A road for compiled code: amplitude, frequency, and when the pieces begin."""

    h: Any  # height [m]
    omega: Any  # angular frequency of the pieces that turn [rad/s], 0 for a step
    start: Any  # time of the first kink [s]
    length: Any  # duration of a hump [s], endless for a step
    pitch: Any  # from the beginning of one hump to that of the next [s]
    count: Any  # number of humps [-]


def kink_time(index: Any, road: Any) -> Any:
    """Return when kink `index` (0, 1, 2, ...) of a road happens.

    Parameters
    ----------
    index : int
        Even kinks begin a hump, odd ones end it.
    road : RoadPieces
        The road.

    Returns
    -------
    float
        Time [s]; infinite past the last kink.

    Notes
    -----
    ``index - 2 * hump`` is 0 where a hump begins and 1 where it ends. Scalars only: integrators
    call it at a kink and at the start, never in a loop over time.
    """
    hump = index // 2
    time = road.start + hump * road.pitch + (index - hump - hump) * road.length
    return time if hump < road.count else math.inf


@dataclass(frozen=True, kw_only=True)
class Road:
    """One road profile; make it with `harmonic`, `hump`, `train` or `step`.

    Parameters
    ----------
    profile : {"harmonic", "hump", "train", "step"}
        Kind of road, see the module's description.
    h : float
        Height [m].
    omega : float
        Angular frequency [rad/s]: positive, 0 for a step.
    start : float
        When the tyre meets the first hump or the step [s]; 0 for a harmonic road.
    gap : float
        Flat stretch between the humps of a train, in lengths of a hump [-].
    count : int
        Number of humps: 0 for a harmonic road, 1 for a hump or a step, 1 to 1 000 000 for a train.

    Raises
    ------
    ValueError
        If a value is not finite or out of range.
    """

    profile: Profile
    h: float
    omega: float
    start: float = 0.0
    gap: float = 0.0
    count: int = 0

    def __post_init__(self) -> None:
        """Check every argument."""
        profile = known("road profile", self.profile, PROFILES)
        count = whole("count", self.count, 1 if profile == "train" else 0, MOST_HUMPS)
        if count != COUNTS.get(profile, count):
            raise ValueError(
                f"count of a {profile} road must be {COUNTS[profile]}, "
                f"got {count}; make the road with roads.{profile}"
            )
        omega = finite("omega", self.omega, "rad/s")
        if profile != "step":
            positive("omega", omega, "rad/s")
        elif omega != 0.0:
            raise ValueError(f"a step has no frequency, got omega={omega} rad/s; give 0")
        store(
            self,
            profile=profile,
            h=finite("hump height h", self.h, "m"),
            omega=omega,
            start=finite("start", self.start, "s"),
            gap=non_negative("gap", self.gap),
            count=count,
        )
        if profile in ("hump", "train") and not math.isfinite(self.end):
            raise ValueError(
                f"the last hump must end at a finite time, got omega={omega:g} rad/s, "
                f"gap={self.gap:g}, start={self.start:g} s; give a larger omega or a smaller gap"
            )

    @property
    def duration(self) -> float:
        """Time that one hump takes, ``pi / omega`` [s]; infinite for a step."""
        return math.pi / self.omega if self.omega > 0.0 else math.inf

    @property
    def end(self) -> float:
        """When the last hump ends [s]; infinite for a road that does not end."""
        if self.profile in ("harmonic", "step"):
            return math.inf
        pieces = self.pieces
        return pieces.start + (pieces.count - 1) * pieces.pitch + pieces.length

    @property
    def pieces(self) -> RoadPieces:
        """The road as plain floats, for compiled code."""
        if self.profile == "harmonic":
            return RoadPieces(self.h, self.omega, 0.0, ENDLESS, 0.0, 0.0)
        if self.profile == "step":
            return RoadPieces(self.h, 0.0, self.start, ENDLESS, 0.0, 1.0)
        pitch = (1.0 + self.gap) * self.duration
        return RoadPieces(self.h, self.omega, self.start, self.duration, pitch, float(self.count))

    def kinks(self, t_start: float, t_end: float) -> list[float]:
        """Return the times in ``(t_start, t_end)`` [s] at which a piece begins or ends."""
        finite("t_start", t_start, "s")
        finite("t_end", t_end, "s")
        found: list[float] = []
        pieces = self.pieces
        index = 0
        while (time := kink_time(index, pieces)) < t_end:
            if time > t_start:
                found.append(time)
            index += 1
        return found

    def next_kink(self, t: float) -> int:
        """Return the index of the first kink later than `t` [s] (see `kink_time`)."""
        finite("t", t, "s")
        pieces = self.pieces
        index = 0
        while kink_time(index, pieces) <= t:
            index += 1
        return index

    def phasor(self, t: ArrayLike) -> Phasor:
        """Return the phasor at `t` [s], array (n,): that of the piece which holds or begins then.

        Notes
        -----
        The piece is found by the same `kink_time` that the integrators stop at, so that a hump's
        end is the first instant of the flat road to the last bit.
        """
        time = finite_array("t", t, "s")
        if self.profile == "harmonic":
            angle = self.omega * time
            return Phasor(np.sin(angle), np.cos(angle))
        if self.profile == "step":
            return Phasor(np.where(time >= self.start, 1.0, 0.0), np.zeros_like(time))
        pieces = self.pieces
        edges = np.array([kink_time(i, pieces) for i in range(2 * self.count)])
        index = np.searchsorted(edges, time, side="right")  # kinks that have happened
        on = index % 2 == 1
        local = time - edges[np.maximum(index - 1, 0)]
        angle = np.where(on, self.omega * local, 0.0)
        return Phasor(np.where(on, np.sin(angle), 0.0), np.where(on, np.cos(angle), 0.0))

    def height(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return y at `t` [s], array (n,) [m]."""
        return self.h * self.phasor(t).s

    def rate(self, t: ArrayLike) -> NDArray[np.float64]:
        """Return y' at `t` [s], array (n,) [m/s]; at a kink that of the piece which begins."""
        return self.h * self.omega * self.phasor(t).c


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
) -> Road:
    """Return the paper's road ``y = h sin(omega t)``.

    Parameters
    ----------
    h : float
        Height [m].
    omega : float, optional
        Angular frequency [rad/s].
    V, L : float, optional
        Instead of `omega`: the car's speed [km/h] and the length of half a wave [m].

    Raises
    ------
    ValueError
        Unless exactly one of `omega` and (`V`, `L`) is given, or if a value is out of range.
    """
    return Road(profile="harmonic", h=h, omega=_frequency(omega, V, L))


def hump(
    *,
    h: float,
    omega: float | None = None,
    V: float | None = None,
    L: float | None = None,
    start: float = 0.0,
) -> Road:
    """Return a flat road with a single half-sine hump (arguments as `harmonic`).

    Parameters
    ----------
    start : float, optional
        When the tyre meets it [s].
    """
    return Road(profile="hump", h=h, omega=_frequency(omega, V, L), start=start, count=1)


def train(
    *,
    h: float,
    count: int,
    gap: float,
    omega: float | None = None,
    V: float | None = None,
    L: float | None = None,
    start: float = 0.0,
) -> Road:
    """Return a flat road with several half-sine humps (arguments as `hump`).

    Parameters
    ----------
    count : int
        Number of humps.
    gap : float
        Flat stretch between two humps, in lengths of a hump [-].
    """
    return Road(
        profile="train", h=h, omega=_frequency(omega, V, L), start=start, gap=gap, count=count
    )


def step(*, h: float, start: float = 0.0) -> Road:
    """Return a road that rises by `h` [m] at `start` [s] and stays there (the paper's Fig. 11)."""
    return Road(profile="step", h=h, omega=0.0, start=start, count=1)


def _frequency(omega: float | None, V: float | None, L: float | None) -> float:
    if omega is not None and V is None and L is None:
        return positive("omega", omega, "rad/s")
    if omega is None and V is not None and L is not None:
        return hump_frequency(V, L)
    raise ValueError(
        f"give either omega [rad/s] or both V [km/h] and L [m], got omega={omega}, V={V}, L={L}"
    )
