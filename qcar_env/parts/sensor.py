"""Sensors: from the true value of a signal to what a controller reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from qcar_env.parts.part import UNLIMITED, Part, clamp, number, text
from qcar_env.validation import finite, non_negative, positive, shown

TURN = 6.283185307179586  # 2 pi [rad]
HALVES = 6755399441055744.0  # 1.5 * 2^52: added and taken away, it rounds to whole numbers


class Filtered(NamedTuple):
    """Memory of a sensor with a cutoff."""

    value: Any  # in the signal's unit


@dataclass(frozen=True, kw_only=True)
class Sensor(Part):
    """A sensor of one signal.

        reading = round(clamp(z + bias + noise draw, -range, range) / resolution) resolution
        z' = 2 pi cutoff (value - z)

    Parameters
    ----------
    signal : str
        Name of the signal, e.g. "body_acceleration".
    noise : float
        Standard deviation of a reading's white noise, in the signal's unit; not negative.
    bias : float
        What every reading has too much, in the signal's unit.
    range : float
        Largest reading either way, in the signal's unit; positive. By default there is none.
    resolution : float
        Step between readings, in the signal's unit; 0 for none. A half goes to the even step.
    delay : float
        Age of a reading [s].
    period : float
        Time between readings [s]; 0 for one in each control interval.
    cutoff : float
        Corner frequency [Hz] of a first-order low-pass before the noise; 0 for none.

    Raises
    ------
    ValueError
        If a number is outside its range. Whether there is such a signal is seen by its car.

    Notes
    -----
    Delay and period are held by whoever steps the car, in whole control intervals, the filter where
    `cutoff` is not 0. A range that is no multiple of the resolution is passed by up to half a step.
    Typical: an accelerometer on the body 0.03 m/s^2, bias within 0.3 m/s^2, 50 Hz; a height sensor
    0.5 mm in steps of 0.2 mm, 200 Hz. Not validated: scale error, drift, coloured noise, drop-outs.
    """

    signal: str = text()
    noise: float = number("standard deviation of the", "-", non_negative, 0.0)
    bias: float = number("", "-", finite, 0.0)
    range: float = number("", "-", positive, UNLIMITED)
    resolution: float = number("", "-", non_negative, 0.0)
    delay: float = number("", "s", non_negative, 0.0)
    period: float = number("", "s", non_negative, 0.0)
    cutoff: float = number("frequency", "Hz", non_negative, 0.0)

    State = Filtered

    def __post_init__(self) -> None:
        """Check name and numbers."""
        if not isinstance(self.signal, str) or not self.signal:
            raise ValueError(
                f"signal must be the name of one, got {shown(self.signal)}; "
                'give a text such as "body_acceleration"'
            )
        super().__post_init__()

    @staticmethod
    def rate(memory: Any, value: Any, p: Any) -> Filtered:
        """Return the rate of the filtered value, in the signal's unit per second."""
        return Filtered(TURN * p.cutoff * (value - memory.value))

    @staticmethod
    def measure(value: Any, draw: Any, p: Any) -> Any:
        """Return the reading of a (filtered) value; `draw` is a standard normal one."""
        held = clamp(value + p.bias + p.noise * draw, -p.range, p.range)
        exact = p.resolution == 0.0
        steps = held / (p.resolution + exact)
        return exact * held + p.resolution * ((steps + HALVES) - HALVES)
