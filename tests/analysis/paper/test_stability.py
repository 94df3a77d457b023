"""Jacobian, Routh-Hurwitz, maps, Floquet: the averaged statement and what it is worth."""

import dataclasses

import numpy as np
import pytest
import sympy as sp
from hypothesis import example, given, strategies as st

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.averaging import SlowFlow
from qcar_env.analysis.paper.fixed_points import balanced_start, eigenvalues, fixed_points
from qcar_env.analysis.paper.forced_car import ForcedCar, stack, sweep
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.analysis.paper.jacobian import jacobian_entries
from qcar_env.analysis.paper.routh_hurwitz import (
    CONDITIONS,
    characteristic_polynomial,
    routh_hurwitz,
)
from qcar_env.analysis.paper.stability import (
    compare_with_floquet,
    contraction_margin,
    first_loss,
    stability_map,
)
from qcar_env.analysis.periodic_orbit import periodic_orbits
from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.physics import linear
from qcar_env.physics.car import PaperCar

SIGMA = np.linspace(-20.0, 20.0, 41)
matrices = st.lists(st.floats(-3.0, 3.0), min_size=16, max_size=16).map(
    lambda values: np.array(values).reshape(1, 4, 4)
)


def with_law(car: ForcedCar, law) -> ForcedCar:
    return dataclasses.replace(car, law=law)


def test_the_characteristic_polynomial_is_that_of_sympy():
    matrix = np.random.default_rng(0).integers(-5, 6, (4, 4))
    exact = sp.Matrix(matrix.tolist()).charpoly().all_coeffs()[1:]
    got = characteristic_polynomial(matrix[None].astype(float))[:, 0]
    np.testing.assert_allclose(got, [float(c) for c in exact], rtol=1e-12, atol=1e-9)


@given(matrix=matrices, shift=st.floats(-4.0, 1.0))
@example(matrix=np.diag([8.6e-13, 0.0, 0.0, 1.0])[None], shift=0.0)  # Gamma2 loses its digits
def test_routh_hurwitz_says_what_the_eigenvalues_say(matrix, shift):
    """For any matrix whose eigenvalues are not within rounding of the imaginary axis."""
    shifted = matrix + shift * np.eye(4)
    largest = np.linalg.eigvals(shifted).real.max()
    if abs(largest) < 1e-3:
        return
    conditions = routh_hurwitz(shifted)
    assert conditions.stable[0] == (largest < 0.0)
    assert (conditions.failing() == ()) == (largest < 0.0)
    assert np.all(np.abs(conditions.margins) <= 1.0 + 1e-9)


@given(matrix=matrices, power=st.integers(-1000, 1000))
def test_the_verdict_of_routh_and_hurwitz_does_not_hang_on_the_unit_of_time(matrix, power):
    """A power of two changes no digit, so that every margin is the same to the last bit."""
    matrix[np.abs(matrix) < 1e-3] = 0.0  # what falls below float64 does lose digits
    found, scaled = routh_hurwitz(matrix), routh_hurwitz(matrix * 2.0**power)
    np.testing.assert_array_equal(scaled.margins, found.margins)
    np.testing.assert_array_equal(scaled.holds, found.holds)
    with np.errstate(over="ignore", under="ignore"):
        expected = np.ldexp(found.values, np.array([1, 3, 6, 4])[:, None] * power)
    np.testing.assert_array_equal(scaled.values, expected)


@pytest.mark.parametrize("size", [1e-310, 1e-160, 1e-80, 1e80, 1e160, 1e300])
def test_a_quartic_near_zero_or_infinity_has_margins_and_a_verdict(size):
    """Roots -1 + 2i, -1 - 2i, -3 + i, -3 - i, times `size`: all conditions hold."""
    blocks = [[-1, 2, 0, 0], [-2, -1, 0, 0], [0, 0, -3, 1], [0, 0, -1, -3]]
    found = routh_hurwitz(np.array([blocks]) * size)
    assert found.stable.all()
    assert np.all((found.margins > 0.0) & (found.margins <= 1.0))


def test_a_matrix_of_zeros_has_no_margin_and_one_that_is_not_finite_is_refused():
    assert routh_hurwitz(np.zeros((1, 4, 4))).margins.tolist() == [[0.0]] * 4
    with pytest.raises(ValueError, match=r"matrices must be finite \[1/s\]"):
        routh_hurwitz(np.full((1, 4, 4), np.nan))


@pytest.mark.parametrize(
    ("roots", "failing"),
    [
        ((-1.0, -2.0, -3.0, -4.0), ()),
        ((1.0, -2.0, -3.0, -4.0), ("Gamma4 > 0",)),
        ((0.1 + 5j, 0.1 - 5j, -3.0, -4.0), (CONDITIONS[2],)),
        ((1.0, 2.0, 3.0, 4.0), (CONDITIONS[0], CONDITIONS[1])),
    ],
)
def test_conditions_fail_one_by_one(roots, failing):
    """A real eigenvalue that crosses breaks the fourth condition, a pair the third."""
    matrix = np.real(np.diag(roots)) if np.isrealobj(np.array(roots)) else np.zeros((4, 4))
    if not np.isrealobj(np.array(roots)):
        matrix[:2, :2] = [[0.1, 5.0], [-5.0, 0.1]]
        matrix[2, 2], matrix[3, 3] = -3.0, -4.0
    found = routh_hurwitz(np.asarray(matrix, dtype=float)[None])
    assert set(failing) <= set(found.failing())
    assert (failing == ()) == (found.failing() == ())


@pytest.mark.parametrize("law", [Passive(), CNVC()], ids=lambda law: law.name)
@pytest.mark.parametrize("form", ["frozen", "natural", "rotating"])
def test_appendix_a_has_the_eigenvalues_of_the_flow(paper, law, form):
    """Polar and Cartesian coordinates are similar at a fixed point (differences: 1e-8)."""
    cars = stack(list(sweep(with_law(paper, law), "sigma1", SIGMA)))
    points = fixed_points(cars, form=form)
    matrix = jacobian_entries(cars, points, form=form).matrix
    np.testing.assert_allclose(
        np.sort_complex(eigenvalues(matrix)), np.sort_complex(points.eigenvalues), atol=1e-6
    )


def test_no_sign_of_n5_and_n15_makes_the_left_branch_alone_unstable(paper):
    """Fig. 4's 'unstable in the left branch': flipped signs lose both outer branches alike."""
    cars = stack(list(sweep(paper, "sigma1", SIGMA)))
    points = fixed_points(cars)
    entries = jacobian_entries(cars, points)
    flipped = entries._replace(N5=-entries.N5, N15=-entries.N15).matrix
    growth = eigenvalues(flipped)[:, 0].real
    correct = eigenvalues(entries.matrix)[:, 0].real
    assert np.all(correct < 0.0)
    assert np.all(growth[SIGMA <= -3.0] > 0.0)
    np.testing.assert_array_equal(growth > 0.0, growth[::-1] > 0.0)
    assert np.all(growth[np.abs(SIGMA) <= 2.0] < 0.0)


def test_the_jacobian_of_the_paper_is_for_its_law(paper):
    car = with_law(paper, LNVC())
    cars = stack([car])
    with pytest.raises(ValueError, match=r"for CNVC or no control, got LNVC"):
        jacobian_entries(cars, fixed_points(cars))


@pytest.mark.parametrize(
    "law", [Passive(), LNVC(), PD(), CNVC(), PPF(), NDF()], ids=lambda law: law.name
)
def test_floquet_exponents_of_linear_loops_are_their_poles(paper, law):
    """Without control the poles are known; every law's orbit is stable."""
    cars = stack([with_law(paper, law)])
    guess = balance(cars, harmonics=9, start=balanced_start(cars))
    orbit = periodic_orbits(cars, guess.states(np.zeros(1))[:, :, 0])
    assert orbit.converged.all()
    assert orbit.stable.all()
    np.testing.assert_allclose(orbit.peaks[:2, 0], guess.peaks[:2, 0], rtol=1e-4)
    if law.name == "none":
        poles = np.sort(linear.poles(paper.car).real)
        # multipliers are 1e-8 exact; the fast mode's is exp(-0.5)
        np.testing.assert_allclose(np.sort(orbit.exponents[0].real), poles, rtol=1e-5)


def test_averaged_and_floquet_stability_agree(paper):
    """122 motions, stable and unstable, with growth rates of the same size."""
    cars = [with_law(paper, law) for law in (Passive(), CNVC())]
    for car in cars:
        for parameter, values in (("sigma1", SIGMA), ("E3", np.linspace(0.5, 600.0, 20))):
            found = compare_with_floquet(stack(list(sweep(car, parameter, values))))
            decided = np.abs(found.exact) > 0.02
            assert found.agree[decided].all()
            assert np.abs(found.averaged - found.exact).max() < 0.5
            assert np.all((found.multiplier < 1.0) == (found.exact < 0.0))


def test_the_averaged_loss_of_stability_is_the_plants(paper):
    """The uncontrolled plant's own poles say at which E3 it is lost: within 3 %."""
    loss = first_loss(paper, "E3", 0.5, 1000.0)
    assert loss is not None
    assert loss.kind == "Hopf"
    assert loss.condition == CONDITIONS[2]

    def growth(E3: float) -> float:
        return float(linear.poles(dataclasses.replace(paper.car, E3=E3)).real.max())

    assert growth(0.97 * loss.value) < 0.0 < growth(1.03 * loss.value)
    points = fixed_points(stack([paper.vary("E3", loss.value)]))
    assert abs(points.eigenvalues[0, 0].real) < 1e-6


def test_which_condition_fails_at_what_gain():
    """LNVC holds a car together that is unstable by itself; less gain than found loses it."""
    car = ForcedCar(
        car=PaperCar(
            omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=600.0, mu1=2510.0,
            mu2=16.0,
        ),
        h=0.1, f=24.8, omega=55.0, law=LNVC(),
    )  # fmt: skip
    loss = first_loss(car, "G", 5.0, 0.0)
    assert loss is not None
    assert loss.condition == CONDITIONS[2]
    # averaging is first order in E3 / omega^2 = 0.2: its critical gain is good to a tenth
    for gain, stable in ((1.1 * loss.value, True), (0.9 * loss.value, False)):
        cars = stack([car.vary("G", gain)])
        conditions = routh_hurwitz(_jacobian(cars))
        assert conditions.stable[0] == stable
        exact = compare_with_floquet(cars).exact[0]
        assert (exact < 0.0) == stable
    assert first_loss(car, "G", 5.0, 4.0) is None


def test_cubic_damping_holds_what_it_cannot_stabilise_at_rest(paper):
    """Past the loss CNVC limits the amplitude: simulation stays, and without control diverges."""
    unstable = paper.vary("E3", 600.0)
    with pytest.raises(FloatingPointError, match="diverged"):
        steady_amplitudes(unstable.car, unstable.road, unstable.force, Passive(), duration=100.0)
    held = steady_amplitudes(unstable.car, unstable.road, unstable.force, CNVC(), duration=60.0)
    assert float(held.x2) < 1.0


def test_stability_map(paper):
    found = stability_map(paper, "E3", np.linspace(0.5, 600.0, 13), "E2", np.linspace(0.0, 8.0, 9))
    assert found.growth.shape == (9, 13)
    assert found.a1.shape == found.failing.shape == (9, 13)
    assert 0 < np.sum(found.stable) < found.stable.size
    assert np.all((found.failing == -1) == found.stable)
    for i, j in ((0, 0), (4, 6), (8, 12), (8, 0)):
        car = dataclasses.replace(
            paper.car, E3=float(found.x_values[j]), E2=float(found.y_values[i])
        )
        # the plant's own poles: the averaged ones are first order in coupling over frequency
        assert found.growth[i, j] == pytest.approx(linear.poles(car).real.max(), abs=0.05)
    with pytest.raises(ValueError, match="two different parameters"):
        stability_map(paper, "E3", [1.0], "E3", [1.0])
    with pytest.raises(ValueError, match="unknown parameter"):
        stability_map(paper, "E4", [1.0], "E3", [1.0])


@pytest.mark.parametrize("seed", range(20))
def test_the_contraction_condition_is_sufficient(seed):
    """Random coupled cars: where the margin is positive, all motions found are stable and one."""
    rng = np.random.default_rng(seed)
    car = ForcedCar(
        car=PaperCar(
            omega1=55.0, omega2=55.0, b1=5.0 + 20.0 * rng.random(), b2=1.0 + 20.0 * rng.random(),
            E1=300.0 * rng.random(), E2=10.0 * rng.random(), E3=600.0 * rng.random(), mu1=1000.0,
            mu2=1.0,
        ),
        h=0.1, f=20.0, omega=55.0, law=CNVC(G1=rng.random(), G2=rng.random()),
    )  # fmt: skip
    if contraction_margin(car) <= 0.0:
        return
    cars = stack(list(sweep(car, "sigma1", SIGMA)))
    points = fixed_points(cars)
    assert points.stable.all()
    far = fixed_points(cars, start=np.full((4, SIGMA.size), 2.0))
    np.testing.assert_allclose(far.a2[far.converged], points.a2[far.converged], rtol=1e-8)


def test_the_paper_satisfies_the_contraction_condition(paper):
    assert contraction_margin(paper) > 1.0
    assert contraction_margin(paper.vary("E3", 600.0)) < 0.0


def test_folds_make_real_eigenvalues_vanish(paper):
    """Just before and after a fold of the hardening car one real eigenvalue has changed sign."""
    car = with_law(paper, Hardening(alpha2=800.0))
    from qcar_env.analysis.paper.frequency_response import response

    curve = response(car, "sigma2", -20.0, 0.0, form="rotating")
    fold = curve.folds[0].value
    index = int(np.argmin(np.abs(curve.values - fold)))
    nearest = curve.eigenvalues[index]
    smallest = nearest[np.argmin(np.abs(nearest))]
    assert abs(smallest.imag) < 1e-6
    assert abs(smallest) < 0.5


def _jacobian(cars):
    return SlowFlow(cars=cars).jacobian(fixed_points(cars).z)
