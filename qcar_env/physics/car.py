"""The quarter car: a wheel on its tyre, and the body on its suspension.

omega1^2 = (k1 + k2) / m1    omega2^2 = k2 / m2    b1 = (c1 + c2) / m1    b2 = c2 / m2
E1 = k2 / m1    E2 = c2 / m1    E3 = k2 / m2 (Newton) or k1 / m2 (as the paper prints it)
mu1 = k1 / m1    mu2 = c1 / m1

after Alluhydan et al., Mathematics 2024, 12(19), 3046, section 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from qcar_env.physics.dynamics import Coefficients
from qcar_env.validation import finite, non_negative, positive, store

UNITS = {  # of every coefficient, for checks and labels
    "omega1": "rad/s",
    "omega2": "rad/s",
    "b1": "1/s",
    "b2": "1/s",
    "E1": "1/s^2",
    "E2": "1/s",
    "E3": "1/s^2",
    "mu1": "1/s^2",
    "mu2": "1/s",
    "m1": "kg",
    "m2": "kg",
}


@dataclass(frozen=True, kw_only=True)
class QuarterCar:
    """Coefficients of equations (3)-(4).

    Parameters
    ----------
    omega1, omega2 : float
        Natural frequency of wheel and body with the other mass held [rad/s]; positive.
    b1, b2 : float
        Damping of wheel and body [1/s]; not negative.
    E1, E3 : float
        Coupling of the masses through the spring, on wheel and body [1/s^2]; not negative.
    E2 : float
        Coupling through the damper, on the wheel [1/s]; not negative. On the body it is `b2`.
    mu1, mu2 : float
        Stiffness [1/s^2] and damping [1/s] of the tyre per wheel mass; not negative.
    m1, m2 : float or None
        Masses of wheel and body [kg], where they are known. They do not enter (3)-(4); an
        actuator rated in newtons and the tyre load need them.

    Raises
    ------
    ValueError
        If a coefficient is not finite or has the wrong sign, or if only one mass is given.

    Notes
    -----
    The coefficients are independent here, as in the paper, whose worst case
    ``omega1 = omega2 = omega = Omega`` with ``m1 < m2`` is not a car with a passive tyre
    (it would need k1 < 0). `from_physical` makes the coefficients of a real one.
    """

    omega1: float
    omega2: float
    b1: float
    b2: float
    E1: float
    E2: float
    E3: float
    mu1: float
    mu2: float
    m1: float | None = None
    m2: float | None = None

    def __post_init__(self) -> None:
        """Check every coefficient."""
        for name in ("omega1", "omega2"):
            store(self, **{name: positive(name, getattr(self, name), UNITS[name])})
            finite(f"{name}^2", getattr(self, name) * getattr(self, name), "1/s^2")
        for name in ("b1", "b2", "E1", "E2", "E3", "mu1", "mu2"):
            store(self, **{name: non_negative(name, getattr(self, name), UNITS[name])})
        if (self.m1 is None) != (self.m2 is None):
            raise ValueError(
                f"m1 and m2 must be given together or not at all, got m1={self.m1}, m2={self.m2}"
            )
        for name in ("m1", "m2"):
            if getattr(self, name) is not None:
                store(self, **{name: positive(name, getattr(self, name), UNITS[name])})

    @classmethod
    def from_physical(
        cls,
        m1: float,
        m2: float,
        k1: float,
        k2: float,
        c1: float,
        c2: float,
        *,
        reciprocal: bool = True,
    ) -> QuarterCar:
        """Make the coefficients from masses, springs and dampers.

        Parameters
        ----------
        m1, m2 : float
            Mass of wheel and body [kg]; positive.
        k1, k2 : float
            Stiffness of tyre and suspension [N/m]; positive.
        c1, c2 : float
            Damping of tyre and suspension [N s/m]; not negative.
        reciprocal : bool, optional
            ``True`` (default): ``E3 = k2 / m2``, so that the suspension pulls on both masses
            with opposite and equal forces (Newton's third law). ``False``: ``E3 = k1 / m2``,
            as equation (2) of the paper is printed; such a car can gain energy at rest.

        Returns
        -------
        QuarterCar

        Raises
        ------
        ValueError
            If a value is not finite or has the wrong sign.
        """
        m1, m2 = positive("m1", m1, "kg"), positive("m2", m2, "kg")
        k1, k2 = positive("k1", k1, "N/m"), positive("k2", k2, "N/m")
        c1, c2 = non_negative("c1", c1, "N s/m"), non_negative("c2", c2, "N s/m")
        return cls(
            omega1=math.sqrt((k1 + k2) / m1),
            omega2=math.sqrt(k2 / m2),
            b1=(c1 + c2) / m1,
            b2=c2 / m2,
            E1=k2 / m1,
            E2=c2 / m1,
            E3=(k2 if reciprocal else k1) / m2,
            mu1=k1 / m1,
            mu2=c1 / m1,
            m1=m1,
            m2=m2,
        )

    @property
    def coefficients(self) -> Coefficients:
        """The nine coefficients as a named tuple, for compiled code."""
        return Coefficients(*(float(getattr(self, name)) for name in Coefficients._fields))

    @property
    def damping_ratios(self) -> tuple[float, float]:
        """Damping ratio of wheel and body, each with the other mass held, ``b / (2 omega)``."""
        return self.b1 / (2.0 * self.omega1), self.b2 / (2.0 * self.omega2)
