"""The slow flow: how amplitudes and phases drift, averaged over one period (paper, eqs 5-27).

    x_i = a_i cos(psi_i)    v_i = -omega_i a_i sin(psi_i)                             (5)-(8)
    theta1 = psi1 - omega t    theta2 = psi2 - Omega t    omega1 = omega + sigma1
    omega2 = Omega + sigma2    omega = Omega                                             (19)

    a1'        = -b1 a1/2 + E2 omega2 a2 c/(2 omega1) - E1 a2 s/(2 omega1)
                 - mu1 h cos(theta1)/(2 omega1) - mu2 omega h sin(theta1)/(2 omega1) + r1     (24)
    a1 theta1' = sigma1 a1 - E2 omega2 a2 s/(2 omega1) - E1 a2 c/(2 omega1)
                 + mu1 h sin(theta1)/(2 omega1) - mu2 omega h cos(theta1)/(2 omega1) + q1     (25)
    a2'        = -b2 a2/2 + omega1 b2 a1 c/(2 omega2) + E3 a1 s/(2 omega2)
                 - f sin(theta2)/(2 omega2) + r2                                              (26)
    a2 theta2' = sigma2 a2 + omega1 b2 a1 s/(2 omega2) - E3 a1 c/(2 omega2)
                 - f cos(theta2)/(2 omega2) + q2                                              (27)

with ``c, s = cos, sin(theta1 - theta2)``, after Alluhydan et al., Mathematics 2024, 12(19), 3046.
The law acts through its describing function ``D_i``, the complex amplitude of its force over that
of the displacement: ``r_i + i q_i = a_i D_i / (2 i omega_i)``. CNVC's is
``D = -(3/4) i G omega^3 a^2``, so ``r = -(3/8) G omega^2 a^3``, the last term of (24) and (26).

The paper prints E3/omega2 in (26) for E3/(2 omega2), and its steady motions (29), (31) have
``sigma a`` on the left where (25), (27) leave ``-sigma a``; `SlowFlow` takes what is printed on
demand, for comparison only.

Validity. First order in damping, coupling, force and detuning over frequency. Against long
simulations of the full equations with the calibrated preset: 1-2 % for ``|sigma| <= 1``, below 5 %
to 5, 10 % at 10, 19 % at 20 rad/s (`form="frozen"`). A law with a filter (PPF, NDF) enters with
its filter in steady state: the fixed points are right, the averaged stability says nothing about
the filter's own modes (Floquet multipliers do, see `qcar_env.analysis.periodic_orbit`).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from qcar_env.analysis.newton import numerical_jacobian
from qcar_env.analysis.paper.describing_functions import average_force, described_force
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, stack
from qcar_env.validation import entries, finite_array, known, shown

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Form = Literal["frozen", "natural", "rotating"]
FORMS: tuple[Form, ...] = ("frozen", "natural", "rotating")


@dataclass(frozen=True, kw_only=True)
class SlowFlow:
    """Equations (24)-(27) for n cars.

    Parameters
    ----------
    cars : ForcedCars
        The cars, (n,).
    form : {"frozen", "natural", "rotating"}
        Which frequency stands in the coefficients. ``"frozen"``: `omega` for both natural
        frequencies, consistent to first order since ``sigma`` is itself small. ``"natural"``:
        ``omega_i = omega + sigma_i``, as the paper prints them; less accurate off resonance, with
        a spurious maximum far from it. ``"rotating"``: averaged in the frame that turns with the
        forcing, with the exact detuning ``(omega_i^2 - omega^2)/(2 omega)`` for `sigma`; its
        fixed points are the harmonic balance at the forcing frequency.
    printed : bool
        ``True``: E3/omega2 in (26), and fixed points that solve (29) and (31), as the paper prints
        them; for the fidelity report only.
    numerical : bool
        ``True``: average every law numerically, also those with a known describing function.
    """

    cars: ForcedCars
    form: Form = "frozen"
    printed: bool = False
    numerical: bool = False

    def __post_init__(self) -> None:
        """Check the form's name."""
        known("form of averaging", self.form, FORMS)

    @property
    def frequencies(self) -> tuple[Array, Array]:
        """The frequencies that stand for `omega1` and `omega2` in the coefficients, (n,)."""
        if self.form == "natural":
            return self.cars.car.omega1, self.cars.car.omega2
        return self.cars.omega, self.cars.omega

    @property
    def detunings(self) -> tuple[Array, Array]:
        """`sigma1` and `sigma2` of (24)-(27) [rad/s], (n,)."""
        car, omega = self.cars.car, self.cars.omega
        if self.form == "rotating":
            return (
                (car.omega1 * car.omega1 - omega * omega) / (2.0 * omega),
                (car.omega2 * car.omega2 - omega * omega) / (2.0 * omega),
            )
        return car.omega1 - omega, car.omega2 - omega  # (19)

    def rates(
        self, a1: Array, theta1: Array, a2: Array, theta2: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return ``a1', a1 theta1', a2', a2 theta2'`` [m/s], each (n,).

        Parameters
        ----------
        a1, a2 : ndarray (n,)
            Amplitudes [m].
        theta1, theta2 : ndarray (n,)
            Phases [rad].
        """
        car, h, f, omega = self.cars.car, self.cars.h, self.cars.f, self.cars.omega
        w1, w2 = self.frequencies
        sigma1, sigma2 = self.detunings
        c, s = np.cos(theta1 - theta2), np.sin(theta1 - theta2)
        c1, s1, c2, s2 = np.cos(theta1), np.sin(theta1), np.cos(theta2), np.sin(theta2)
        A1: ComplexArray = (a1 * np.exp(1j * theta1)).astype(np.complex128)
        A2: ComplexArray = (a2 * np.exp(1j * theta2)).astype(np.complex128)
        U1, U2 = self.force(A1, A2)
        u1 = U1 * np.exp(-1j * theta1) / (2j * w1)
        u2 = U2 * np.exp(-1j * theta2) / (2j * w2)
        e3 = car.E3 if self.printed else car.E3 / 2.0  # erratum of (17), (22), (26), (30)
        sign = -1.0 if self.printed else 1.0  # erratum of (29), (31)
        da1 = (
            -car.b1 * a1 / 2.0
            + (car.E2 * w2 * a2 * c - car.E1 * a2 * s) / (2.0 * w1)
            - (car.mu1 * h * c1 + car.mu2 * omega * h * s1) / (2.0 * w1)
            + u1.real
        )  # (24)
        turn1 = (
            sign * sigma1 * a1
            - (car.E2 * w2 * a2 * s + car.E1 * a2 * c) / (2.0 * w1)
            + (car.mu1 * h * s1 - car.mu2 * omega * h * c1) / (2.0 * w1)
            + u1.imag
        )  # (25)
        da2 = (
            -car.b2 * a2 / 2.0
            + w1 * car.b2 * a1 * c / (2.0 * w2)
            + e3 * a1 * s / w2
            - f * s2 / (2.0 * w2)
            + u2.real
        )  # (26)
        turn2 = (
            sign * sigma2 * a2
            + (w1 * car.b2 * a1 * s - car.E3 * a1 * c) / (2.0 * w2)
            - f * c2 / (2.0 * w2)
            + u2.imag
        )  # (27)
        return da1, turn1, da2, turn2

    def force(self, A1: ComplexArray, A2: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the complex amplitudes of the law's forces [m/s^2] for those of x1, x2 [m]."""
        w1, w2 = self.frequencies
        law, gains = type(self.cars.law), self.cars.gains
        found = described_force(law, gains, A1, A2, omega1=w1, omega2=w2)
        if found is None or self.numerical:
            return average_force(gains, A1, A2, omega1=w1, omega2=w2)
        return found

    def flow(self, z: Array) -> Array:
        """Return the rate of ``z = (Re A1, Im A1, Re A2, Im A2)`` with ``A = a exp(i theta)``.

        Parameters
        ----------
        z : ndarray (4, n)
            Amplitudes in Cartesian form [m], without the polar form's singularity at ``a = 0``.

        Returns
        -------
        ndarray (4, n)
        """
        a1, theta1, a2, theta2 = polar(z)
        da1, turn1, da2, turn2 = self.rates(a1, theta1, a2, theta2)
        dA1 = (da1 + 1j * turn1) * np.exp(1j * theta1)
        dA2 = (da2 + 1j * turn2) * np.exp(1j * theta2)
        return np.array([dA1.real, dA1.imag, dA2.real, dA2.imag])

    def jacobian(self, z: Array) -> Array:
        """Return the derivative of `flow`, shape (n, 4, 4) (central differences)."""
        return numerical_jacobian(self._flow_of_repeated, z)

    def _flow_of_repeated(self, z: Array) -> Array:
        repeats = z.shape[1] // len(self.cars)
        index = np.tile(np.arange(len(self.cars)), repeats)
        return dataclasses.replace(self, cars=self.cars.select(index)).flow(z)


@dataclass(frozen=True, kw_only=True)
class SlowMotion:
    """A transient of the slow flow of one car."""

    t: Array  # (k,) [s]
    a1: Array  # (k,) [m]
    theta1: Array  # (k,) [rad]
    a2: Array  # (k,) [m]
    theta2: Array  # (k,) [rad]
    omega: float  # frequency of road and force [rad/s]

    @property
    def x1(self) -> Array:
        """Wheel displacement that the averaged motion stands for, ``a1 cos(omega t + theta1)``."""
        return self.a1 * np.cos(self.omega * self.t + self.theta1)  # (5)

    @property
    def x2(self) -> Array:
        """Body displacement, ``a2 cos(omega t + theta2)``."""
        return self.a2 * np.cos(self.omega * self.t + self.theta2)  # (6)


def slow_motion(
    car: ForcedCar,
    t: ArrayLike,
    *,
    start: tuple[complex, complex] = (0j, 0j),
    form: Form = "frozen",
) -> SlowMotion:
    """Integrate the slow flow from an initial amplitude.

    Parameters
    ----------
    car : ForcedCar
        The car.
    t : array_like (k,)
        Times at which the solution is wanted [s], increasing; the first is the start.
    start : tuple of complex, optional
        ``A_i = x_i(0) + v_i(0)/(i omega)`` times ``exp(-i omega t(0))`` [m]; rest by default.
    form : {"frozen", "natural", "rotating"}
        See `SlowFlow`.

    Returns
    -------
    SlowMotion

    Raises
    ------
    ValueError
        If the integration does not reach the end; the message says at which time. If the times do
        not increase, or the start is not two numbers.
    """
    times = finite_array("t", t, "s")
    if times.ndim != 1 or times.size < 2 or np.any(np.diff(times) <= 0.0):
        raise ValueError(f"t must be two or more rising times [s], got {shown(t)}; give such")
    A1, A2 = two_amplitudes("start", start)
    flow = SlowFlow(cars=stack([car]), form=form)

    def rate(_: float, z: Array) -> Array:
        return flow.flow(z[:, None])[:, 0]

    z0 = np.array([A1.real, A1.imag, A2.real, A2.imag])
    solution: Any = solve_ivp(
        rate, (times[0], times[-1]), z0, t_eval=times, rtol=1e-8, atol=1e-10, method="LSODA"
    )
    if not solution.success:
        raise ValueError(
            f"slow flow not integrated beyond t = {solution.t[-1]:g} s: {solution.message}; "
            "check the gains"
        )
    a1, theta1, a2, theta2 = polar(solution.y)
    return SlowMotion(t=times, a1=a1, theta1=theta1, a2=a2, theta2=theta2, omega=car.omega)


def two_amplitudes(name: str, value: Any) -> tuple[complex, complex]:
    """Return complex amplitudes ``(A1, A2)`` [m].

    Raises
    ------
    ValueError
        If `value` is not two finite numbers.
    """
    try:
        found = np.array(entries(value))
    except ValueError:  # entries of different lengths
        found = np.array(None)
    if found.shape != (2,) or found.dtype.kind not in "iufc" or not np.isfinite(found).all():
        raise ValueError(
            f"{name} must be two finite amplitudes (A1, A2) in m, got {shown(value)}; "
            "give two complex numbers"
        )
    return complex(found[0]), complex(found[1])


def polar(z: Array) -> tuple[Array, Array, Array, Array]:
    """Return ``a1, theta1, a2, theta2`` of ``z = (Re A1, Im A1, Re A2, Im A2)``, (4, ...)."""
    return (
        np.hypot(z[0], z[1]),
        np.arctan2(z[1], z[0]),
        np.hypot(z[2], z[3]),
        np.arctan2(z[3], z[2]),
    )
