"""How the preset `paper` was found: the paper states no parameter values, Table 1 constrains them.

The unknowns are fitted to twelve ratios of Table 1 (uncontrolled over controlled amplitude) and
the two uncontrolled amplitudes that its NDF, LNVC and CNVC rows imply (its PPF rows imply others,
which no single car can match). Residuals are logarithms, so that 0.1 is 10 %.

The fit is flat: fourteen numbers cannot fix a dozen parameters. `profile` refits with the
frequency held at several values, `directions` gives the combinations of parameters that the
table does not see. Treat the preset as one car out of many, never as the authors'.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.fixed_points import balanced_start, fixed_points
from qcar_env.analysis.paper.forced_car import ForcedCar, stack
from qcar_env.analysis.paper.table1 import PRINTED, PrintedRow
from qcar_env.control import CNVC, NDF, PPF, Passive
from qcar_env.control.law import Law
from qcar_env.physics.car import PaperCar
from qcar_env.validation import entries, finite, non_negative, positive, shown, store

Array = NDArray[np.float64]

COEFFICIENTS = ("b1", "b2", "E1", "E2", "E3", "mu1", "mu2")  # of the car, its frequencies apart


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """What the calibration chooses: a worst-case car, its forcing and the filters' damping.

    All natural and forcing frequencies are `omega`; the filters are tuned to it.
    """

    omega: float  # [rad/s]
    b1: float  # [1/s]
    b2: float  # [1/s]
    E1: float  # [1/s^2]
    E2: float  # [1/s]
    E3: float  # [1/s^2]
    mu1: float  # [1/s^2]
    mu2: float  # [1/s]
    f: float  # [m/s^2]
    zeta_ndf: float  # both masses [-]
    zeta_ppf1: float  # wheel [-]
    zeta_ppf2: float  # body [-]
    h: float = 0.1  # [m]; acts only through mu1 h and mu2 h, so it is not fitted

    def __post_init__(self) -> None:
        """Check every number."""
        for name in ("omega", "zeta_ndf", "zeta_ppf1", "zeta_ppf2"):
            store(self, **{name: positive(name, getattr(self, name))})
        for name in COEFFICIENTS:
            store(self, **{name: non_negative(name, getattr(self, name))})
        store(self, f=finite("f", self.f), h=finite("h", self.h))

    def under(self, law: Law) -> ForcedCar:
        """Return the car under a law of Table 1, filters as calibrated."""
        if isinstance(law, (NDF, PPF)):
            ndf = isinstance(law, NDF)
            law = dataclasses.replace(
                law,
                omega_f1=self.omega,
                omega_f2=self.omega,
                zeta1=self.zeta_ndf if ndf else self.zeta_ppf1,
                zeta2=self.zeta_ndf if ndf else self.zeta_ppf2,
            )
        shared = {name: getattr(self, name) for name in COEFFICIENTS}
        car = PaperCar(omega1=self.omega, omega2=self.omega, **shared)
        return ForcedCar(car=car, h=self.h, f=self.f, omega=self.omega, law=law)


def candidate_of(car: ForcedCar) -> Candidate:
    """Return the candidate that a worst-case car is, with the filters' default damping."""
    return Candidate(
        omega=car.omega,
        **{name: getattr(car.car, name) for name in COEFFICIENTS},
        f=car.f, h=car.h, zeta_ndf=NDF().zeta1, zeta_ppf1=PPF().zeta1, zeta_ppf2=PPF().zeta2,
    )  # fmt: skip


FITTED = ("b1", "b2", "E2", "mu1", "mu2", "f", "zeta_ndf", "zeta_ppf1", "zeta_ppf2")
# Bounds of the fit: two decades about a car of this size, and dampings that a filter can have.
BOUNDS = {
    "b1": (1.0, 100.0), "b2": (0.05, 10.0), "E1": (0.01, 1e3), "E2": (0.1, 50.0),
    "E3": (0.01, 1e3), "mu1": (100.0, 1e4), "mu2": (0.1, 500.0), "f": (1.0, 500.0),
    "zeta_ndf": (0.02, 5.0), "zeta_ppf1": (0.02, 5.0), "zeta_ppf2": (0.02, 5.0),
}  # fmt: skip


def targets(rows: Sequence[PrintedRow] = PRINTED) -> Array:
    """Return what is fitted: twelve ratios, then the two uncontrolled amplitudes [m], (14,)."""
    ratios = [ratio for row in rows for ratio in row.ratios]
    agreeing = [row.uncontrolled for row in rows if row.law.name != "PPF"]
    return np.array([*ratios, *np.mean(agreeing, axis=0)])


def predictions(candidate: Candidate, rows: Sequence[PrintedRow] = PRINTED) -> Array:
    """Return a candidate's values of `targets`, from harmonic balance, (14,)."""
    cars = [candidate.under(Passive()), *(candidate.under(row.law) for row in rows)]
    peaks = np.empty((len(cars), 2))
    kinds = [type(each.law) for each in cars]
    for kind in set(kinds):  # one batch for each kind of law
        chosen = [index for index, each in enumerate(kinds) if each is kind]
        peaks[chosen] = _peaks([cars[index] for index in chosen])
    return np.array([*(peaks[0] / peaks[1:]).ravel(), *peaks[0]])


def residuals(candidate: Candidate) -> Array:
    """Return the logarithms of prediction over target, (14,) [-]."""
    return np.log(predictions(candidate) / targets())


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fitted candidate."""

    candidate: Candidate
    residuals: Array  # (14,) [-]
    fitted: tuple[str, ...]  # names of the parameters that were free
    jacobian: Array  # (14, free) of the residuals by the logarithms of the parameters
    success: bool
    message: str

    @property
    def cost(self) -> float:
        """Root mean square of the residuals [-]."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def worst(self) -> float:
        """Largest residual, as a ratio minus one [-]."""
        return float(np.exp(np.max(np.abs(self.residuals))) - 1.0)


def fit(start: Candidate, *, fitted: Sequence[str] = FITTED) -> Fit:
    """Fit some parameters of a candidate to Table 1 by least squares.

    Parameters
    ----------
    start : Candidate
        Where to start; what is not fitted stays.
    fitted : sequence of str, optional
        Names of the free parameters, each with bounds in `BOUNDS`.

    Returns
    -------
    Fit
        With `success` false and the solver's message if it ran out of steps.

    Raises
    ------
    ValueError
        If there is no name, a name has no bounds, or the start's value is not positive.
    """
    names = entries(fitted)
    if not names:
        raise ValueError(
            f"nothing to fit, got {shown(fitted)}; give names out of {', '.join(BOUNDS)}"
        )
    for name in names:
        if not isinstance(name, str) or name not in BOUNDS:
            raise ValueError(f"cannot fit {name!r}; free parameters are {', '.join(BOUNDS)}")
    low, high = np.log(np.array([BOUNDS[name] for name in names])).T
    x0 = np.clip(
        np.log([positive(name, getattr(start, name)) for name in names]), low + 1e-6, high - 1e-6
    )

    def at(x: Array) -> Candidate:
        values = {name: float(value) for name, value in zip(names, np.exp(x), strict=True)}
        return dataclasses.replace(start, **values)

    found: Any = least_squares(
        lambda x: residuals(at(x)), x0, bounds=(low, high), xtol=1e-7, ftol=1e-9, max_nfev=60
    )
    return Fit(
        candidate=at(found.x),
        residuals=np.asarray(found.fun),
        fitted=names,
        jacobian=np.asarray(found.jac),
        success=bool(found.success),
        message=str(found.message),
    )


def profile(
    start: Candidate, omegas: Sequence[float], *, fitted: Sequence[str] = FITTED
) -> tuple[Fit, ...]:
    """Refit with the common frequency held at each of `omegas` [rad/s].

    Parameters
    ----------
    start : Candidate
        A fitted candidate.
    omegas : sequence of float
        Frequencies [rad/s].
    fitted : sequence of str, optional
        Names of the free parameters.

    Returns
    -------
    tuple of Fit
        In the order of `omegas`. The fits go outward from the start's own frequency, each from
        its inner neighbour, with the forcing scaled so that all terms keep their proportions.

    Raises
    ------
    ValueError
        If a frequency is not positive, or as `fit`.
    """
    asked = [positive("omega", omega, "rad/s") for omega in entries(omegas)]
    if not asked:
        raise ValueError(f"omegas must be frequencies [rad/s], got {shown(omegas)}; give some")
    found: dict[float, Fit] = {}
    outward = sorted(set(asked), key=lambda omega: abs(np.log(omega / start.omega)))
    for omega in outward:
        inner = min(found, key=lambda done: abs(np.log(omega / done)), default=None)
        last = start if inner is None else found[inner].candidate
        scale = omega / last.omega
        moved = dataclasses.replace(last, omega=omega, mu1=last.mu1 * scale, f=last.f * scale)
        found[omega] = fit(moved, fitted=fitted)
    return tuple(found[omega] for omega in asked)


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A combination of parameters, and how much the table's cells change along it."""

    sensitivity: float  # change of all residuals together for a parameter change by e [-]
    weights: dict[str, float]  # share of each parameter's logarithm, unit length [-]


def directions(found: Fit) -> tuple[Direction, ...]:
    """Return the principal directions of the fit, the one that the table sees least first."""
    _, singular, rows = np.linalg.svd(found.jacobian, full_matrices=False)
    return tuple(
        Direction(
            sensitivity=float(value),
            weights={name: float(w) for name, w in zip(found.fitted, row, strict=True)},
        )
        for value, row in sorted(zip(singular, rows, strict=True), key=lambda pair: pair[0])
    )


def _peaks(cars: Sequence[ForcedCar]) -> Array:
    """Return the largest displacements (n, 2) of cars with one kind of law."""
    stacked = stack(cars)
    if isinstance(stacked.law, CNVC):
        return balance(stacked, harmonics=5, start=balanced_start(stacked)).peaks[:2].T
    points = fixed_points(stacked, form="rotating")  # exact for a linear loop
    return np.array([points.a1, points.a2]).T
