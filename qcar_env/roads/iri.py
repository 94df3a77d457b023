"""The International Roughness Index: how far a standard car's suspension moves on a profile.

The Golden Car is a quarter car at 80 km/h whose stiffnesses, damping and wheel mass are given for
1 kg of body. It is driven by the slope of the profile, and its states are slopes too:

    Z' = A Z + B u,   Z = (z2', z2'', z1', z1''),   IRI = mean |z2' - z1'|                    [m/km]

stepped exactly from sample to sample: ``Z <- S Z + P u``, ``S = exp(A dt)``,
``P = A^-1 (S - I) B``, with ``u`` the slope over the step, which is that of the profile after a
moving average over 250 mm where the samples are closer than that. It begins with the mean slope of
the first 11 m.

Source: M. W. Sayers, On the calculation of International Roughness Index from longitudinal road
profile, Transportation Research Record 1501 (1995) 1, and its program; ASTM E1926.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_env.validation import finite_array, positive

Floats = NDArray[np.float64]

# Sayers 1995, for 1 kg of body; index 1 is the wheel, 2 the body
K1 = 653.0  # tyre stiffness [1/s^2]
K2 = 63.3  # spring stiffness [1/s^2]
C2 = 6.0  # damping [1/s]
M1 = 0.15  # wheel mass [-]
SPEED = 80.0 / 3.6  # [m/s]

BASE = 0.25  # [m] of the moving average
LEAD = 11.0  # [m] whose mean slope the car begins with: half a second at 80 km/h
WIDEST = 1.0  # [m] spacing from which on Sayers' program refuses a profile

A = np.array(
    [
        [0.0, 1.0, 0.0, 0.0],
        [-K2, -C2, K2, C2],
        [0.0, 0.0, 0.0, 1.0],
        [K2 / M1, C2 / M1, -(K1 + K2) / M1, -C2 / M1],
    ]
)
B = np.array([0.0, 0.0, 0.0, K1 / M1])


@dataclass(frozen=True, kw_only=True, eq=False)
class GoldenCar:
    """The exact step of the Golden Car over one spacing.

    Parameters
    ----------
    S : ndarray (4, 4)
        State transition matrix.
    P : ndarray (4,)
        Response to a slope that is held.
    """

    S: Floats
    P: Floats


def golden_car(spacing: float) -> GoldenCar:
    """Return the step of the Golden Car over a `spacing` [m].

    Raises
    ------
    ValueError
        If the spacing is not above 0 and below 1 m.
    """
    from scipy.linalg import expm  # slow to import

    if positive("spacing", spacing, "m") >= WIDEST:
        raise ValueError(
            f"spacing must be below {WIDEST:g} m, got {spacing:g} m; the index is not defined for "
            "samples as wide as that: measure closer, 0.25 m or less"
        )
    S: Floats = expm(A * (spacing / SPEED))
    P: Any = np.linalg.solve(A, (S - np.eye(4)) @ B)
    return GoldenCar(S=S, P=P)


def suspension_slopes(heights: ArrayLike, *, spacing: float) -> Floats:
    """Return the rate of the Golden Car's suspension over its speed, ``z2' - z1'``.

    Parameters
    ----------
    heights : array (n,)
        The profile [m], evenly sampled.
    spacing : float
        Distance between two samples [m], below 1 m.

    Returns
    -------
    ndarray (n - k,)
        [-], at the end of each step; k samples are the base of a slope.

    Raises
    ------
    ValueError
        If a height is no number, the profile is shorter than 11 m, or its samples are too wide.
    """
    y = finite_array("heights", heights, "m")
    step = golden_car(spacing)
    base = max(1, math.floor(BASE / spacing + 0.5))  # [samples]
    lead = math.floor(LEAD / spacing + 0.5)
    if y.ndim != 1 or y.size <= max(lead, base):
        raise ValueError(
            f"heights must be the samples of at least {LEAD:g} m, got shape {y.shape} at "
            f"{spacing:g} m; give a longer profile"
        )
    slopes = (y[base:] - y[:-base]) / (base * spacing)
    first = (y[lead] - y[0]) / (lead * spacing)
    z = np.array([first, 0.0, first, 0.0])
    moved = np.empty_like(slopes)
    for i, driven in enumerate(np.outer(slopes, step.P)):
        z = step.S @ z + driven
        moved[i] = z[0] - z[2]
    return moved


def international_roughness_index(heights: ArrayLike, *, spacing: float) -> float:
    """Return the IRI [m/km] of a profile; times 63.36 it is in inches per mile.

    Parameters
    ----------
    heights : array (n,)
        The profile [m], evenly sampled: of a `SampledRoad` that was measured evenly its `samples`,
        of any road ``road.heights(s)``.
    spacing : float
        Distance between two samples [m], below 1 m.

    Raises
    ------
    ValueError
        If a height is no number, the profile is shorter than 11 m, or its samples are too wide.

    Notes
    -----
    Of one wheel path; the mean of two is that of a lane. A profile that is already smoothed over
    250 mm by the profilometer is smoothed again where it has closer samples.
    """
    return 1000.0 * float(np.abs(suspension_slopes(heights, spacing=spacing)).mean())
