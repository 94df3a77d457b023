"""Periodic motions as Fourier series with any number of harmonics.

    s(t) = c_0 + sum_{k=1..H} c_k cos(k omega t) + d_k sin(k omega t)

For a periodically forced system ``s' = F(s, omega t)`` the coefficients are chosen so that the
first H harmonics of ``s' - F`` vanish. F is evaluated in time and analysed by a discrete Fourier
sum (alternating frequency-time): T. M. Cameron, J. H. Griffin, Journal of Applied Mechanics 56,
1989; M. Krack, J. Gross, Harmonic Balance for Nonlinear Vibration Problems, Springer 2019. With
``H = 1`` this is the classical harmonic balance at the forcing frequency: the check on averaging.

Everything is vectorised over n systems.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_env.analysis.newton import newton
from qcar_env.validation import shown, store, whole

Array = NDArray[np.float64]

MOST_HARMONICS = 1000  # chosen here: with a filter their Jacobian fills 2 GiB for each system
MOST_SAMPLES = 1_000_000  # of a period, chosen here
DENSE = 1024  # samples of a period that a peak is read from: error below 5e-6 of it


class PeriodicSystem(Protocol):
    """n systems ``s' = F(s, omega t)``, 2 pi-periodic in the phase ``omega t``."""

    @property
    def dimension(self) -> int:
        """Number of states m of one system."""
        ...

    @property
    def omega(self) -> Array:
        """Forcing frequency [rad/s], (n,)."""
        ...

    @property
    def scale(self) -> Array:
        """Typical size of each state, (m, n): makes the unknowns comparable."""
        ...

    def rate(self, state: Array, phase: Array) -> Array:
        """Return F, (m, n, k), for states (m, n, k) and phases (k,) or (n, k)."""
        ...


@dataclass(frozen=True, kw_only=True)
class HarmonicBalance:
    """The equations for the Fourier coefficients of n periodic motions.

    Parameters
    ----------
    system : PeriodicSystem
        The systems.
    harmonics : int
        Highest harmonic H; 1 to 1000.
    samples : int or None, optional
        Samples of a period for the Fourier sum; more than ``4 H`` are exact for cubic laws.
        Default: the first power of two above that, at least 16.

    Notes
    -----
    Unknowns ``z`` are ordered (m (2 H + 1), n): for each state ``c_0, c_1, d_1, c_2, d_2, ...``,
    over the state's `scale`.

    Raises
    ------
    ValueError
        If `harmonics` or `samples` is no whole number within its range.
    """

    system: PeriodicSystem
    harmonics: int
    samples: int | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        store(self, harmonics=whole("harmonics", self.harmonics, most=MOST_HARMONICS))
        if self.samples is not None:
            least = 2 * self.harmonics + 2
            store(self, samples=whole("samples", self.samples, least, MOST_SAMPLES))

    @property
    def coefficients(self) -> int:
        """Fourier coefficients of one state, ``2 H + 1``."""
        return 2 * self.harmonics + 1

    @property
    def phase(self) -> Array:
        """Phases of the samples [rad], (samples,)."""
        if self.samples is not None:
            count = self.samples
        else:
            count = max(16, 1 << (4 * self.harmonics).bit_length())
        return 2.0 * np.pi * np.arange(count) / count

    def residual(self, z: Array) -> Array:
        """Return the Fourier coefficients of ``s' - F`` over ``omega * scale``, as `z`."""
        system = self.system
        series, slope, analysis = self._matrices()
        scale = system.scale[:, :, None]
        c = self._per_state(z)  # (m, n, K)
        rates = system.rate((c @ series) * scale, self.phase)
        omega = system.omega[:, None]
        defect = c @ slope - rates / (scale * omega)
        return self._as_columns(defect @ analysis)

    def jacobian(self, z: Array) -> Array:
        """Return the derivative of `residual`, (n, m (2 H + 1), m (2 H + 1))."""
        system = self.system
        m, n, k = system.dimension, z.shape[1], self.coefficients
        series, slope, analysis = self._matrices()
        scale = system.scale[:, :, None]
        states = (self._per_state(z) @ series) * scale
        slopes = rate_jacobian(system, states, self.phase)  # (m, m, n, t)
        slopes = slopes * scale[None, :] / (scale[:, None] * system.omega[:, None])
        shape = (m, m, n, k, k)
        inner = np.empty(shape)
        for a in range(m):
            for b in range(m):
                inner[a, b] = -(series * slopes[a, b][:, None, :]) @ analysis  # (n, l, k)
            inner[a, a] += slope @ analysis
        # to (n, a, k, b, l)
        return np.ascontiguousarray(np.transpose(inner, (2, 0, 4, 1, 3))).reshape(n, m * k, m * k)

    def unknowns(self, amplitudes: NDArray[np.complex128]) -> Array:
        """Return `z` with complex `amplitudes` (m, n) at the forcing frequency and nothing else."""
        c = np.zeros((*amplitudes.shape, self.coefficients))
        c[:, :, 1], c[:, :, 2] = amplitudes.real, -amplitudes.imag
        return self._as_columns(c / self.system.scale[:, :, None])

    def motions(self, z: Array, converged: NDArray[np.bool_]) -> PeriodicMotions:
        """Return the motions that `z` stands for."""
        return PeriodicMotions(
            coefficients=self._per_state(z) * self.system.scale[:, :, None],
            omega=np.asarray(self.system.omega, dtype=float),
            converged=converged,
            residual=np.max(np.abs(self.residual(z)), axis=0),
        )

    def _matrices(self) -> tuple[Array, Array, Array]:
        """Return series (K, t), its derivative by the phase (K, t), and the analysis (t, K)."""
        series = fourier_series(self.harmonics, self.phase)
        order = np.arange(1, self.harmonics + 1)[:, None]
        slope = np.zeros_like(series)
        slope[1::2], slope[2::2] = -order * series[2::2], order * series[1::2]
        analysis = 2.0 / len(self.phase) * series.T
        analysis[:, 0] /= 2.0
        return series, slope, analysis

    def _per_state(self, z: Array) -> Array:
        m, n = self.system.dimension, z.shape[1]
        return np.ascontiguousarray(np.moveaxis(z.reshape(m, self.coefficients, n), 2, 1))

    def _as_columns(self, c: Array) -> Array:
        m, n, k = c.shape
        return np.moveaxis(c, 1, 2).reshape(m * k, n)


@dataclass(frozen=True, kw_only=True)
class PeriodicMotions:
    """Periodic motions of n systems."""

    coefficients: Array  # (m, n, 2 H + 1), c_0, c_1, d_1, ... in the states' units
    omega: Array  # (n,) [rad/s]
    converged: NDArray[np.bool_]  # (n,)
    residual: Array  # (n,) largest Fourier coefficient of the defect over omega and scale

    @property
    def harmonics(self) -> int:
        """Highest harmonic."""
        return (self.coefficients.shape[2] - 1) // 2

    def states(self, phase: Array) -> Array:
        """Return the states at `phase` (k,) [rad], shape (m, n, k)."""
        return self.coefficients @ fourier_series(self.harmonics, phase)

    @property
    def peaks(self) -> Array:
        """Largest magnitude of each state over a period, (m, n): what a simulation shows."""
        return np.max(np.abs(self.states(2.0 * np.pi * np.arange(DENSE) / DENSE)), axis=2)

    def amplitude(self, harmonic: int = 1) -> NDArray[np.complex128]:
        """Return the complex amplitudes A of one harmonic, ``Re(A exp(i k omega t))``, (m, n).

        Raises
        ------
        ValueError
            If the motions have no such harmonic.
        """
        k = whole("harmonic", harmonic, most=self.harmonics)
        return self.coefficients[:, :, 2 * k - 1] - 1j * self.coefficients[:, :, 2 * k]


def balance(
    system: PeriodicSystem,
    *,
    harmonics: int = 7,
    start: NDArray[np.complex128] | None = None,
    samples: int | None = None,
) -> PeriodicMotions:
    """Solve for the periodic motions.

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    harmonics : int, optional
        Highest harmonic.
    start : ndarray (m, n), complex, optional
        Amplitudes at the forcing frequency to start from; rest by default.
    samples : int, optional
        See `HarmonicBalance`.

    Returns
    -------
    PeriodicMotions
        With `converged` false where Newton's method failed; the rest is valid.

    Raises
    ------
    ValueError
        If `start` has another shape, or a number is out of range.
    """
    equations = HarmonicBalance(system=system, harmonics=harmonics, samples=samples)
    if start is None:
        given = np.zeros((system.dimension, len(system.omega)), dtype=np.complex128)
    else:
        given = of_each_state("start", start, system, kinds="iufc").astype(np.complex128)
    found = newton(equations.residual, equations.jacobian, equations.unknowns(given))
    return equations.motions(found.z, found.converged)


def fourier_series(harmonics: int, phase: Array) -> Array:
    """Return ``1, cos(phase), sin(phase), cos(2 phase), ...`` at phases (k,), (2 H + 1, k)."""
    angle = np.arange(1, harmonics + 1)[:, None] * np.asarray(phase, dtype=float)
    series = np.empty((2 * harmonics + 1, angle.shape[1]))
    series[0], series[1::2], series[2::2] = 1.0, np.cos(angle), np.sin(angle)
    return series


def of_each_state(
    name: str, values: Any, system: PeriodicSystem, *, kinds: str = "iuf"
) -> NDArray[Any]:
    """Return `values` as an array (m, n), one number for each state of each system.

    Parameters
    ----------
    name : str
        What they are, for the message.
    values : array_like (m, n)
        The numbers; they may be NaN where a solver found none.
    system : PeriodicSystem
        n systems.
    kinds : str, optional
        Kinds of number allowed, as `numpy.dtype.kind` has them; real ones by default.

    Raises
    ------
    ValueError
        If they are no numbers, or have another shape.
    """
    shape = system.dimension, len(system.omega)
    try:
        found = np.asarray(values)
    except ValueError:  # rows of different lengths
        found = np.array(None)
    if found.shape != shape or found.dtype.kind not in kinds:
        raise ValueError(
            f"{name} must be numbers of shape {shape}, got {shown(values)}; "
            "give one for each state of each system"
        )
    return found


def rate_jacobian(system: PeriodicSystem, states: Array, phase: Array) -> Array:
    """Differentiate the rate by the states with central differences.

    Parameters
    ----------
    system : PeriodicSystem
        n systems.
    states : ndarray (m, n, k)
        Where.
    phase : ndarray (k,) or (n, k)
        When [rad].

    Returns
    -------
    ndarray (m, m, n, k)
        ``[a, b]`` is the derivative of rate a by state b.
    """
    m = system.dimension
    size = np.maximum(np.max(np.abs(states), axis=2), 1e-3 * system.scale)
    step = np.cbrt(np.finfo(float).eps) * size  # (m, n)
    slopes = np.empty((m, *states.shape))
    for b in range(m):
        shift = np.zeros_like(states)
        shift[b] = step[b][:, None]
        difference = system.rate(states + shift, phase) - system.rate(states - shift, phase)
        slopes[:, b] = difference / (2.0 * step[b][:, None])
    return slopes
