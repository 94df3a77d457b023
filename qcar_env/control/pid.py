"""Proportional, integral and derivative control of one signal towards zero.

    F = -(Kp r + Ki int r dt + Kd r'),     r' through the filter 1 / (1 + s Td / Nd), Td = Kd / Kp

sampled: the integral by forward differences, the derivative by backward ones. Where the actuator
saturates, the integral gets ``(f - F) / Tt`` [N/s] of the force that was not given.

Of the body's velocity, which is what it acts on by default, the three parts are a damper to the
sky, a spring to the sky and an added mass.

Source: K. J. Astrom, T. Hagglund, PID Controllers: Theory, Design, and Tuning, 2nd ed., 1995,
sections 3.2, 3.5 and 3.6.
"""

from __future__ import annotations

import numpy as np

from qcar_env.control.controller import Controller
from qcar_env.validation import non_negative, positive

FILTER = 10.0  # [-] Nd; Astrom and Hagglund: 8 to 20


def pid(
    dt: float,
    *,
    Kp: float,
    Ki: float,
    Kd: float,
    signal: str = "v2",
    Tt: float = 0.1,
    unit: str = "m/s",
) -> Controller:
    """Return the controller.

    Parameters
    ----------
    dt : float
        Control interval [s].
    Kp, Ki, Kd : float
        Gains [N, N/s and N s per unit of the signal]; not negative.
    signal : str
        What is held at zero.
    Tt : float
        Time in which the integral follows a saturated actuator [s].
    unit : str
        Of the signal, for messages.

    Raises
    ------
    ValueError
        If a gain is negative or a time not positive.
    """
    dt, Tt = positive("dt", dt, "s"), positive("Tt", Tt, "s")
    Kp = non_negative("gain Kp", Kp, f"N/({unit})")
    Ki = non_negative("gain Ki", Ki, f"N/s/({unit})")
    Kd = non_negative("gain Kd", Kd, f"N s/({unit})")
    Tf = max(Kd / Kp, dt) / FILTER if Kp else dt  # [s] of the derivative's filter
    keep = Tf / (Tf + dt)
    slope = Kd / (Tf + dt)
    # Memory: the integral's force I, the derivative's force P, and the last reading.
    # P_k = keep P_{k-1} - slope (r_k - r_{k-1}),   F_k = -Kp r_k + I_k + P_k
    C = np.array([1.0, keep, slope])
    D = np.array([-Kp - slope])
    back = dt / Tt if Ki else 0.0
    A = np.array([[1.0 - back * C[0], -back * C[1], -back * C[2]], [0.0, keep, slope], [0, 0, 0]])
    B = np.array([[-Ki * dt - back * D[0]], [-slope], [1.0]])
    E = np.array([back, 0.0, 0.0])
    return Controller(name="PID", signals=(signal,), A=A, B=B, C=C, D=D, E=E)
