"""The state of the quarter car, its signs, and what is read from it.

Signs
-----
Displacements `x1` (wheel) and `x2` (car body) are measured upward from the static equilibrium on
a flat road; `v1` and `v2` are their rates; the road height `y` is positive upward; every force,
the actuator's and the external one, is positive upward. All other files refer to this one.

Equations of this package work on `State` whatever its entries are: floats, arrays ``(n,)``,
torch tensors or numba scalars.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class State(NamedTuple):
    """State of the plant."""

    x1: Any  # wheel displacement [m]
    x2: Any  # body displacement [m]
    v1: Any  # wheel velocity [m/s]
    v2: Any  # body velocity [m/s]


class Filter(NamedTuple):
    """State of the two second-order control filters (PPF, NDF), one per mass."""

    eta1: Any  # filter coordinate of the wheel's controller [m]
    eta2: Any  # filter coordinate of the body's controller [m]
    eta1_dot: Any  # its rate [m/s]
    eta2_dot: Any  # its rate [m/s]


def suspension_travel(x: State) -> Any:
    """Return the body's displacement relative to the wheel, ``x2 - x1`` [m]."""
    return x.x2 - x.x1


def tyre_deflection(x: State, y: Any) -> Any:
    """Return the wheel's displacement relative to the road, ``x1 - y`` [m]."""
    return x.x1 - y


def squared_amplitudes(x: Any, inverse_omega: Any) -> tuple[Any, Any]:
    """Return the squared envelope amplitudes ``a_i^2 = x_i^2 + (v_i / omega)^2``.

    Parameters
    ----------
    x : State
        State of the plant.
    inverse_omega : float or array (n,)
        Reciprocal of the frequency of the motion, ``1 / omega`` [s].

    Returns
    -------
    tuple
        ``(a1^2, a2^2)`` [m^2].

    Notes
    -----
    The paper writes ``x_i = a_i cos(psi_i)``, ``v_i = -omega_i a_i sin(psi_i)`` (5)-(8), so `a_i`
    is the amplitude that the motion has at this instant. The square root is left to the caller,
    because it is the one operation that the batch engine applies to whole blocks.
    """
    r1 = x.v1 * inverse_omega
    r2 = x.v2 * inverse_omega
    return x.x1 * x.x1 + r1 * r1, x.x2 * x.x2 + r2 * r2
