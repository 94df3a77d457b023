"""The static limit of laws that soften a spring (PPF, or PD with a negative gain)."""

from __future__ import annotations

from qcar_env.physics.car import Car
from qcar_env.physics.linear import jacobian, matrices


def check_static_stiffness(
    car: Car, *, softening: tuple[float, float], gains: tuple[str, str]
) -> None:
    """Refuse gains under which the car has no stable rest.

    Parameters
    ----------
    car : Car
        The plant.
    softening : tuple of float
        What the law takes off the specific stiffness of wheel and body [1/s^2].
    gains : tuple of str
        Names of the two gains, for the message.

    Raises
    ------
    ValueError
        If the static stiffness ``[[omega1^2 - G1, -E1], [-E3, omega2^2 - G2]]`` is not positive
        definite in its leading minors; the message gives the limit. The stiffness of a car
        that is not linear is that about its rest.

    Notes
    -----
    With a vanishing determinant the closed loop has a pole at zero, past it a positive real one.
    Without coupling (``E1 E3 = 0``) the limit is the literature's ``G_i < omega_i^2``.
    """
    slope = matrices(car).A if car.linear else jacobian(car)
    (k1, e1), (e3, k2) = -slope[2:, :2]  # static stiffness per mass
    g1, g2 = softening
    if g1 >= k1:
        raise ValueError(
            f"gain {gains[0]} must be below omega1^2 = {k1:g} 1/s^2 (static stability), "
            f"got {g1:g} 1/s^2; give a smaller gain"
        )
    limit = k2 - e1 * e3 / (k1 - g1)
    if g2 >= limit:
        raise ValueError(
            f"gain {gains[1]} must be below {limit:g} 1/s^2 (static stability: "
            f"omega2^2 - E1 E3 / (omega1^2 - {gains[0]})), got {g2:g} 1/s^2; give a smaller gain"
        )
