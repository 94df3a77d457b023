"""Pseudo-arclength continuation on curves that are known."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq

from qcar_env.analysis.continuation import Equations, follow
from qcar_env.analysis.harmonic_balance import HarmonicBalance
from qcar_env.analysis.newton import numerical_jacobian

DELTA, ALPHA, F = 0.1, 1.0, 0.3  # x'' + DELTA x' + x + ALPHA x^3 = F cos(w t)


def equations(residual) -> Equations:
    return Equations(
        residual=residual,
        jacobian=lambda z, p: numerical_jacobian(lambda c: residual(c, p), z),
    )


def duffing_balance(z, w):
    """One-harmonic balance of the Duffing oscillator, for A = z0 + i z1."""
    A = z[0] + 1j * z[1]
    rest = (1.0 - w * w + 1j * DELTA * w + 0.75 * ALPHA * np.abs(A) ** 2) * A - F
    return np.array([rest.real, rest.imag])


def duffing_folds() -> list[tuple[float, float]]:
    """Return (w, a) where the response has a vertical tangent, upper fold first.

    With Y = a^2: Y [(1 - w^2 + 3/4 alpha Y)^2 + (delta w)^2] = F^2; at a fold its derivative by Y
    vanishes too. A. H. Nayfeh, D. T. Mook, Nonlinear Oscillations, Wiley 1979, section 4.1.
    """

    def candidate(w: float, side: float) -> float:
        s = 1.0 - w * w  # (s + 3/4 Y)(s + 9/4 Y) + (delta w)^2 = 0, alpha = 1
        return (-3.0 * s + side * np.sqrt(9 * s**2 - 6.75 * (s**2 + (DELTA * w) ** 2))) / 3.375

    def defect(w: float, side: float) -> float:
        Y = candidate(w, side)
        return Y * ((1.0 - w * w + 0.75 * Y) ** 2 + (DELTA * w) ** 2) - F**2

    upper = brentq(defect, 1.2, 2.5, args=(1.0,), xtol=1e-14)
    lower = brentq(defect, 1.2, 2.5, args=(-1.0,), xtol=1e-14)
    return [(w, float(np.sqrt(candidate(w, side)))) for w, side in ((upper, 1.0), (lower, -1.0))]


@dataclass(frozen=True)
class Duffing:
    """The oscillator in the time domain, n times at frequency w."""

    omega: np.ndarray

    dimension = 2

    @property
    def scale(self):
        return np.array([np.ones_like(self.omega), self.omega])

    def rate(self, state, phase):
        x, v = state
        return np.array([v, F * np.cos(phase) - DELTA * v - x - ALPHA * x * x * x])


def in_time(harmonics: int) -> Equations:
    def at(z, w):
        return HarmonicBalance(system=Duffing(np.full(z.shape[1], w)), harmonics=harmonics)

    return Equations(
        residual=lambda z, w: at(z, w).residual(z), jacobian=lambda z, w: at(z, w).jacobian(z)
    )


def test_passes_both_folds_of_the_duffing_oscillator():
    """The folds of the one-harmonic response are known in closed form."""
    branch = follow(equations(duffing_balance), np.array([0.3, 0.0]), 0.2, 3.0, z_scale=1.0)
    assert branch.complete
    assert branch.message.startswith("reached p = 3")
    found = [(fold.p, np.hypot(*fold.z)) for fold in branch.folds]
    # the fold's parameter is stationary, its amplitude is not: root of the tolerance
    np.testing.assert_allclose([p for p, _ in found], [w for w, _ in duffing_folds()], rtol=1e-9)
    np.testing.assert_allclose([a for _, a in found], [a for _, a in duffing_folds()], rtol=1e-5)
    between = (branch.p > duffing_folds()[1][0] + 0.01) & (branch.p < duffing_folds()[0][0] - 0.01)
    assert np.sum(np.diff(branch.p) < 0.0) > 5  # it did turn back
    assert np.sum(between) > 30
    residual = [
        np.abs(duffing_balance(z, p)).max() for z, p in zip(branch.z.T, branch.p, strict=True)
    ]
    assert max(residual) < 1e-9


def test_the_same_folds_with_harmonic_balance_in_time():
    """With one harmonic the time-domain equations are the closed form's."""
    start = np.zeros((2, 3))
    branch = follow(in_time(1), start.ravel(), 0.9, 3.0, z_scale=1.0)
    assert branch.complete
    np.testing.assert_allclose(
        [fold.p for fold in branch.folds], [w for w, _ in duffing_folds()], rtol=1e-8
    )


def test_more_harmonics_move_the_folds_a_little():
    """The third harmonic of a hardening spring at this amplitude is a few per cent."""
    branch = follow(in_time(7), np.zeros(30), 0.9, 3.0, z_scale=1.0)
    assert branch.complete
    main = [fold.p for fold in branch.folds]
    np.testing.assert_allclose(main, [w for w, _ in duffing_folds()], rtol=0.02)
    assert abs(main[0] / duffing_folds()[0][0] - 1.0) > 1e-5


def test_a_test_function_is_located():
    """On the line z = p the zero of cos(z) is at pi/2."""
    line = equations(lambda z, p: z - p)
    branch = follow(line, np.zeros(1), 0.0, 3.0, tests={"cosine": lambda z, p: np.cos(z[0])})
    assert [point.kind for point in branch.points] == ["cosine"]
    assert branch.points[0].p == pytest.approx(np.pi / 2, abs=1e-10)
    assert branch.p[0] == 0.0
    assert branch.p[-1] == pytest.approx(3.0, abs=1e-12)


def test_a_branch_that_turns_round_ends_where_it_began():
    """z^2 + p = 1: from (0.99, -1) up to the fold at p = 1 and back."""
    parabola = equations(lambda z, p: z * z + p - 1.0)
    branch = follow(parabola, np.array([1.4]), -1.0, 2.0, z_scale=1.0)
    assert branch.complete
    assert branch.folds[0].p == pytest.approx(1.0, abs=1e-9)
    assert branch.p[-1] == pytest.approx(-1.0)
    assert branch.z[0, -1] == pytest.approx(-np.sqrt(2.0))


def test_a_lost_branch_says_where_and_returns_what_it_has():
    """There is no solution of z = sqrt(1 - p) beyond p = 1: a wall, not a fold."""
    wall = equations(lambda z, p: z - np.sqrt(np.maximum(1.0 - p, np.nan if p > 1.0 else 0.0)))
    branch = follow(wall, np.array([1.0]), 0.0, 2.0)
    assert not branch.complete
    assert "p = " in branch.message
    assert len(branch.p) > 3
    assert branch.p[-1] <= 1.0
    np.testing.assert_allclose(branch.z[0], np.sqrt(1.0 - branch.p), atol=1e-7)


def test_no_solution_at_the_start_is_reported():
    """z^2 + 1 = 0 has none."""
    branch = follow(equations(lambda z, p: z * z + 1.0 + 0 * p), np.array([0.7]), 0.0, 1.0)
    assert not branch.complete
    assert branch.p.size == 0
    assert "no solution found at the start, p = 0" in branch.message


def test_nothing_is_evaluated_outside_the_range():
    """Beyond the range there may be no system: a gain below zero, a frequency at zero."""
    seen = []

    def residual(z, p):
        seen.append(p)
        return z * z - 1.0 - p

    branch = follow(equations(residual), np.array([1.0]), 0.0, 3.0, longest=0.5)
    assert branch.complete
    assert branch.p[-1] == 3.0
    assert branch.z[0, -1] == pytest.approx(2.0)
    assert min(seen) == 0.0
    assert max(seen) == 3.0


def test_running_out_of_points_is_reported():
    branch = follow(equations(lambda z, p: z - p), np.zeros(1), 0.0, 1.0, max_points=5)
    assert not branch.complete
    assert "points ran out at p = " in branch.message


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"p_end": 0.0}, "range must not be empty, got 0 at both ends"),
        ({"step": -1.0}, "step must be positive"),
        ({"p_end": np.inf}, "p_end must be finite"),
        ({"z_scale": 0.0}, "z_scale must be positive"),
    ],
)
def test_bad_input(arguments, message):
    given = {"p_start": 0.0, "p_end": 1.0, **arguments}
    with pytest.raises(ValueError, match=message):
        follow(equations(lambda z, p: z - p), np.zeros(1), **given)
