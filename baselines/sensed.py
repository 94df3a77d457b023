"""What a controller can measure in a scenario, and with what noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from qcar_env.control.suspension import OUTPUTS
from qcar_env.scenarios import Scenario

# Standard deviations of production sensors: a body's accelerometer of 3 mg, a wheel's ten times
# that, a height sensor of 0.5 mm and its difference over 50 ms; chosen here after data sheets.
TYPICAL = {
    "body_acceleration": 0.03,
    "wheel_acceleration": 0.3,
    "travel": 0.5e-3,
    "travel_rate": 0.01,
    "tyre_deflection": 0.5e-3,
    "v1": 0.01,
    "v2": 0.01,
}
USUAL = ("body_acceleration", "travel")  # where a scenario names no sensors
LEAST = 0.1  # of the typical noise, chosen here: what stands for the model's errors


def sensed(scenario: Scenario) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Return what is measured (k,), and the standard deviations of the readings (k,).

    They are the scenario's sensors of signals that a suspension has; where it names none, the
    acceleration of the body and the travel. Noise and steps are known; bias, delay, period and
    low-pass of a sensor are not.
    """
    sensors = {each.signal: each for each in scenario.sensors if each.signal in OUTPUTS}
    signals = tuple(sensors) or USUAL
    noise: list[float] = []
    for name in signals:
        steps = sensors[name].resolution / math.sqrt(12.0) if name in sensors else 0.0
        drawn = sensors[name].noise if name in sensors else 0.0
        noise.append(math.hypot(drawn, steps, LEAST * TYPICAL[name]))
    return signals, np.array(noise)
