"""The slow flow, proved symbolically from the equations of motion, and its errata."""

import numpy as np
import pytest
import sympy as sp

from qcar_env.analysis.paper.averaging import SlowFlow, slow_motion
from qcar_env.analysis.paper.describing_functions import average_force
from qcar_env.analysis.paper.fixed_points import fixed_points
from qcar_env.analysis.paper.forced_car import ForcedCar, ForcedCars, Gains, stack, sweep
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.analysis.paper.jacobian import JacobianEntries, jacobian_entries
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.physics.car import PaperCar
from qcar_env.physics.state import Filter

LAWS = [
    Passive(),
    CNVC(),
    LNVC(),
    PD(),
    PPF(),
    NDF(),
    Hardening(alpha1=500.0, alpha2=-90.0, G2=1.0),
]

a1, a2, w1, w2, w, h, f = sp.symbols("a1 a2 omega1 omega2 omega h f", positive=True)
b1, b2, E1, E2, E3, mu1, mu2, G1, G2 = sp.symbols("b1 b2 E1 E2 E3 mu1 mu2 G1 G2", positive=True)
s1, s2, th1, th2, tau = sp.symbols("sigma1 sigma2 theta1 theta2 tau", real=True)


def mean(expression):
    """Average over the fast phase tau: the coefficient of exp(i tau)^0."""
    z = sp.Symbol("z")
    powers = sp.expand(sp.expand(expression.rewrite(sp.exp)).subs(tau, -sp.I * sp.log(z)))
    return sp.simplify(sp.powsimp(powers).expand().coeff(z, 0).rewrite(sp.cos))


def derive(control1, control2):
    """Average (3)-(4) after (5)-(8): return ``a1', a1 theta1', a2', a2 theta2'``.

    With ``x = a cos(psi)``, ``v = -omega a sin(psi)`` and ``x'' + omega^2 x = g``, (9)-(14) give
    ``a' = -g sin(psi) / omega`` and ``a phi' = -g cos(psi) / omega``; ``theta' = sigma + phi'``.
    """
    psi1, psi2 = tau + th1, tau + th2  # omega = Omega, or there is no slow flow
    x1, v1 = a1 * sp.cos(psi1), -w1 * a1 * sp.sin(psi1)
    x2, v2 = a2 * sp.cos(psi2), -w2 * a2 * sp.sin(psi2)
    road = mu1 * h * sp.sin(tau) + mu2 * w * h * sp.cos(tau)
    g1 = -b1 * v1 + E2 * v2 + E1 * x2 + road + control1(x1, v1)  # (3)
    g2 = b2 * (v1 - v2) + E3 * x1 + f * sp.cos(tau) + control2(x2, v2)  # (4)
    return (
        mean(-g1 * sp.sin(psi1) / w1),
        s1 * a1 + mean(-g1 * sp.cos(psi1) / w1),
        mean(-g2 * sp.sin(psi2) / w2),
        s2 * a2 + mean(-g2 * sp.cos(psi2) / w2),
    )


def printed_equations(e3_factor):
    """Return (24)-(27) as the paper prints them, but for the factor of E3 in (26)."""
    c, s = sp.cos(th1 - th2), sp.sin(th1 - th2)
    return (
        -b1 * a1 / 2
        + E2 * w2 * a2 / (2 * w1) * c
        - E1 * a2 / (2 * w1) * s
        - mu1 * h / (2 * w1) * sp.cos(th1)
        - mu2 * w * h / (2 * w1) * sp.sin(th1)
        - sp.Rational(3, 8) * G1 * w1**2 * a1**3,
        s1 * a1
        - E2 * w2 * a2 / (2 * w1) * s
        - E1 * a2 / (2 * w1) * c
        + mu1 * h / (2 * w1) * sp.sin(th1)
        - mu2 * w * h / (2 * w1) * sp.cos(th1),
        w1 * a1 * b2 / (2 * w2) * c
        - b2 * a2 / 2
        + e3_factor * E3 * a1 / w2 * s
        - f / (2 * w2) * sp.sin(th2)
        - sp.Rational(3, 8) * G2 * w2**2 * a2**3,
        s2 * a2 + w1 * a1 * b2 / (2 * w2) * s - E3 * a1 / (2 * w2) * c - f / (2 * w2) * sp.cos(th2),
    )


@pytest.fixture(scope="module")
def cnvc_flow():
    """Return the derived slow flow under CNVC."""
    return derive(lambda x, v: -G1 * v**3, lambda x, v: -G2 * v**3)


@pytest.mark.parametrize("row", range(4))
def test_equations_24_to_27_follow_from_the_equations_of_motion(cnvc_flow, row):
    """Prove every coefficient, with E3/(2 omega2) in (26)."""
    corrected = printed_equations(sp.Rational(1, 2))
    assert sp.simplify((cnvc_flow[row] - corrected[row]).expand(trig=True)) == 0


def test_the_printed_e3_coefficient_of_equation_26_is_twice_the_derived_one(cnvc_flow):
    """Erratum of (17), (22), (26), (30)."""
    excess = printed_equations(1)[2] - cnvc_flow[2]
    expected = E3 * a1 * sp.sin(th1 - th2) / (2 * w2)
    assert sp.simplify((excess - expected).expand(trig=True)) == 0


def test_fixed_points_have_minus_sigma_a_on_the_left(cnvc_flow):
    """Erratum of (29), (31): a zero rate leaves ``-sigma a = ...``, not ``sigma a``."""
    for row, sigma, a in ((1, s1, a1), (3, s2, a2)):
        rest = cnvc_flow[row] - sigma * a
        assert sp.simplify(sp.diff(cnvc_flow[row], sigma) - a) == 0
        assert not rest.has(sigma)


def test_phases_that_rest_would_leave_no_detuning_in_the_fixed_points(cnvc_flow):
    """Erratum of section 4.3: it sets ``phi' = 0`` and yet has sigma in (29), (31)."""
    for row, sigma, a in ((1, s1, a1), (3, s2, a2)):
        phi_dot = sp.expand(cnvc_flow[row] / a - sigma)  # phi' = theta' - sigma
        assert not phi_dot.has(sigma)


@pytest.mark.parametrize("seed", range(3))
def test_printed_fixed_points_solve_the_equations_28_to_31_as_they_are_printed(seed):
    """E3/omega2 in (30), ``sigma a`` on the left of (29), (31)."""
    car = random_car(np.random.default_rng(seed), CNVC(G1=0.3, G2=0.6))
    points = fixed_points(stack([car]), form="natural", printed=True)
    found = (points.a1[0], points.theta1[0], points.a2[0], points.theta2[0])
    at = dict(zip((a1, th1, a2, th2), found, strict=True))
    da1, turn1, da2, turn2 = printed_equations(1)  # (25), (27) with theta' = sigma + phi'
    left = 0, s1 * a1, 0, s2 * a2
    right = da1, turn1 - s1 * a1, da2, turn2 - s2 * a2
    for one, other in zip(left, right, strict=True):
        # of terms of order 10 m/s
        assert float((one - other).subs(symbols_of(car)).subs(at)) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize(
    ("control", "damping", "detuning"),
    [
        (lambda x, v: -G1 * v**3, -sp.Rational(3, 8) * G1 * w1**2 * a1**3, 0),
        (lambda x, v: -G1 * v, -G1 * a1 / 2, 0),
        (lambda x, v: -(G2 * x + G1 * v), -G1 * a1 / 2, G2 * a1 / (2 * w1)),
        (lambda x, v: -G2 * x**3, 0, sp.Rational(3, 8) * G2 * a1**3 / w1),
    ],
    ids=["CNVC", "LNVC", "PD", "hardening"],
)
def test_describing_functions_of_memoryless_laws(control, damping, detuning):
    """A law's own terms of ``a'`` and ``a theta'``, derived by averaging."""
    psi = tau + th1
    force = control(a1 * sp.cos(psi), -w1 * a1 * sp.sin(psi))
    assert sp.simplify(mean(-force * sp.sin(psi) / w1) - damping) == 0
    assert sp.simplify(mean(-force * sp.cos(psi) / w1) - detuning) == 0


def test_describing_functions_of_filters_solve_their_equations():
    """Put ``eta = Re(B exp(i omega t))`` into PPF's and NDF's filters."""
    wf, zeta, G, A = sp.symbols("omega_f zeta G A", positive=True)
    i = sp.I
    turning = -(w**2) + 2 * i * zeta * wf * w + wf**2
    ppf = G * wf**2 * A / turning  # u = +G eta, driven by omega_f^2 x
    ndf = -G * i * w * (wf * i * w * A) / turning  # u = -G eta', driven by omega_f v
    assert sp.simplify(ppf - G * wf**2 * A / (wf**2 - w**2 + 2 * i * zeta * wf * w)) == 0
    assert sp.simplify(ndf - G * wf * w**2 * A / (wf**2 - w**2 + 2 * i * zeta * wf * w)) == 0
    # at omega = omega_f: NDF is velocity feedback with gain G / (2 zeta)
    assert sp.simplify(ndf.subs(wf, w) + i * w * G / (2 * zeta) * A) == 0


def random_car(rng: np.random.Generator, law) -> ForcedCar:
    """Return a car whose coefficients are all different and matter."""
    car = PaperCar(
        omega1=50.0 + 10.0 * rng.random(),
        omega2=50.0 + 10.0 * rng.random(),
        b1=10.0 * rng.random(),
        b2=10.0 * rng.random(),
        E1=300.0 * rng.random(),
        E2=10.0 * rng.random(),
        E3=300.0 * rng.random(),
        mu1=2500.0 * rng.random(),
        mu2=50.0 * rng.random(),
    )
    return ForcedCar(car=car, h=0.1 * rng.random(), f=50.0 * rng.random(), omega=55.0, law=law)


def symbols_of(car: ForcedCar) -> dict:
    """Return the values of the symbols, natural frequencies as printed."""
    c = car.car
    return {
        w1: c.omega1, w2: c.omega2, w: car.omega, h: car.h, f: car.f, b1: c.b1, b2: c.b2,
        E1: c.E1, E2: c.E2, E3: c.E3, mu1: c.mu1, mu2: c.mu2,
        s1: car.sigma1, s2: car.sigma2, G1: car.value("G1"), G2: car.value("G2"),
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_the_code_is_the_derived_flow(cnvc_flow, seed):
    """At random points and cars, to rounding (values of order 10, 1e-12 is 100 ulp)."""
    rng = np.random.default_rng(seed)
    car = random_car(rng, CNVC(G1=rng.random(), G2=rng.random()))
    at = {a1: 0.3, th1: 5.0 * rng.random(), a2: 0.2, th2: 5.0 * rng.random()}
    expected = [float(row.subs(symbols_of(car)).subs(at)) for row in cnvc_flow]
    point = [np.array([float(at[s])]) for s in (a1, th1, a2, th2)]
    got = SlowFlow(cars=stack([car]), form="natural").rates(*point)
    np.testing.assert_allclose(np.concatenate(got), expected, rtol=1e-12, atol=1e-12)
    printed = SlowFlow(cars=stack([car]), form="natural", printed=True).rates(*point)
    row = float(printed_equations(1)[2].subs(symbols_of(car)).subs(at))
    np.testing.assert_allclose(printed[2][0], row, rtol=1e-12)


N = sp.symbols("N1:17")


def appendix(printed):
    """Return N1 ... N16 of Appendix A; `printed` puts the misprints back."""
    c, s = sp.cos(th1 - th2), sp.sin(th1 - th2)
    sign, e3 = (-1, 2) if printed else (1, 1)
    return (
        -b1 / 2 - 9 * G1 * w1**2 * a1**2 / 8,
        (-E2 * w2 * a2 * s - E1 * a2 * c + mu1 * h * sp.sin(th1) - mu2 * w * h * sp.cos(th1))
        / (2 * w1),
        (E2 * w2 * c - sign * E1 * s) / (2 * w1),
        (E2 * w2 * a2 * s + E1 * a2 * c) / (2 * w1),
        s1 / a1,
        (-E2 * w2 * a2 * c + E1 * a2 * s + mu1 * h * sp.cos(th1) + mu2 * w * h * sp.sin(th1))
        / (2 * w1 * a1),
        (-E2 * w2 * s - E1 * c) / (2 * w1 * a1),
        (E2 * w2 * a2 * c - sign * E1 * a2 * s) / (2 * w1 * a1),
        (w1 * b2 * c + e3 * E3 * s) / (2 * w2),
        (-w1 * b2 * a1 * s + e3 * E3 * a1 * c) / (2 * w2),
        -b2 / 2 - 9 * G2 * w2**2 * a2**2 / 8,
        (-f * sp.cos(th2) + w1 * b2 * a1 * s - e3 * E3 * a1 * c) / (2 * w2),
        (w1 * b2 * s - E3 * c) / (2 * w2 * a2),
        (w1 * b2 * a1 * c + sign * E3 * a1 * s) / (2 * w2 * a2),
        s2 / a2,
        (f * sp.sin(th2) - w1 * b2 * a1 * c - sign * E3 * a1 * s) / (2 * w2 * a2),
    )


def exact_jacobian(flow):
    """Differentiate ``(a1', theta1', a2', theta2')`` and use that the rates vanish."""
    rates = (flow[0], flow[1] / a1, flow[2], flow[3] / a2)
    entries = [sp.diff(rate, by) for rate in rates for by in (a1, th1, a2, th2)]
    # d(T/a)/da = (dT/da)/a - T/a^2 with T = 0: the last term is left out
    entries[4] += flow[1] / a1**2
    entries[14] += flow[3] / a2**2
    return entries


MISPRINTED = {
    3: "E sign",
    8: "E sign",
    14: "E sign",
    16: "E sign",
    9: "E3/2",
    10: "E3/2",
    12: "E3/2",
}


@pytest.mark.parametrize("number", range(1, 17))
def test_appendix_a(cnvc_flow, number):
    """N1 ... N16 are the derivatives of (24)-(27); seven of them are misprinted."""
    exact = exact_jacobian(cnvc_flow)[number - 1]
    corrected, printed = appendix(False)[number - 1], appendix(True)[number - 1]
    assert sp.simplify((exact - corrected).expand(trig=True)) == 0
    right_as_printed = sp.simplify((exact - printed).expand(trig=True)) == 0
    assert right_as_printed == (number not in MISPRINTED)


@pytest.mark.parametrize("printed", [False, True])
def test_the_code_has_appendix_a(printed):
    """Every entry of the code against the typed appendix, at a random car's fixed point."""
    car = random_car(np.random.default_rng(3), CNVC(G1=0.3, G2=0.6))
    cars = stack([car])
    points = fixed_points(cars, form="natural")
    at = dict(
        zip(
            (a1, th1, a2, th2),
            (points.a1[0], points.theta1[0], points.a2[0], points.theta2[0]),
            strict=True,
        )
    )
    entries = jacobian_entries(cars, points, form="natural", printed=printed)
    expected = [float(e.subs(symbols_of(car)).subs(at)) for e in appendix(printed)]
    np.testing.assert_allclose(np.concatenate(entries), expected, rtol=1e-11)
    assert JacobianEntries(*entries).matrix.shape == (1, 4, 4)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("form", ["frozen", "natural", "rotating"])
def test_numerical_averaging_agrees_with_the_describing_functions(law, form):
    """For polynomial laws and linear filters the Fourier sum is exact: rounding only."""
    car = ForcedCar(
        car=random_car(np.random.default_rng(1), Passive()).car, h=0.1, f=9.0, omega=52.0, law=law
    )
    cars = stack(list(sweep(car, "h", np.linspace(0.05, 0.2, 7))))
    z = np.random.default_rng(2).standard_normal((4, 7))
    known = SlowFlow(cars=cars, form=form).flow(z)
    numerical = SlowFlow(cars=cars, form=form, numerical=True).flow(z)
    np.testing.assert_allclose(numerical, known, rtol=1e-10, atol=1e-10 * np.abs(known).max())


def test_numerical_averaging_of_a_law_given_as_a_function():
    """A bang-bang law's fundamental is 4/pi of its force (F. series of a square wave)."""

    def command(x, eta, gains):
        return -gains[0] * np.sign(x.v1), 0.0 * x.v2

    functions = CNVC().functions._replace(command=command)
    gains = Gains(functions, type(CNVC().numbers)(np.array([3.0]), np.array([0.0])))
    A = np.array([0.2 * np.exp(0.7j)])
    one = np.array([50.0])
    U1, U2 = average_force(gains, A, A, omega1=one, omega2=one, samples=4096)
    # u = -3 sign(v) is in phase with -v = -i omega A; the kink leaves an error of 1/samples
    np.testing.assert_allclose(U1, -1j * 3.0 * 4.0 / np.pi * A / np.abs(A), rtol=2e-3)
    np.testing.assert_allclose(U2, 0.0, atol=1e-12)


def test_a_filter_that_is_not_linear_has_no_describing_function():
    """The message says what to use instead."""

    def filter_rate(x, eta, gains):
        return Filter(eta.eta1_dot, eta.eta2_dot, -eta.eta1 * eta.eta1, -eta.eta2 + 0.0 * x.x1)

    functions = NDF().functions._replace(filter_rate=filter_rate)
    gains = Gains(functions, NDF().numbers._make(np.ones((6, 1))))
    one = np.ones(1)
    with pytest.raises(ValueError, match=r"not linear.*use harmonic balance"):
        average_force(gains, one * 1j, one * 1j, omega1=one, omega2=one)


@pytest.mark.parametrize("law", [Passive(), CNVC()], ids=lambda law: law.name)
def test_the_slow_motion_settles_on_the_fixed_point(paper, law):
    """From rest, after 40 s: the slow mode has decayed to exp(-0.2 * 40) = 3e-4."""
    car = ForcedCar(car=paper.car, h=paper.h, f=paper.f, omega=paper.omega, law=law)
    motion = slow_motion(car, np.linspace(0.0, 40.0, 401))
    point = fixed_points(stack([car]))
    np.testing.assert_allclose(motion.a1[-1], point.a1[0], rtol=1e-3)
    np.testing.assert_allclose(motion.a2[-1], point.a2[0], rtol=1e-3)
    assert motion.x1[0] == motion.x2[0] == 0.0
    last = slice(-1, None)
    np.testing.assert_allclose(
        motion.x1[last], motion.a1[last] * np.cos(car.omega * 40.0 + motion.theta1[last])
    )


def test_stacked_cars_keep_their_parameters(paper):
    """`stack` and `select` lose nothing."""
    cars: ForcedCars = stack(list(sweep(paper, "h", [0.1, 0.2, 0.3]))).select([2, 0])
    assert len(cars) == 2
    np.testing.assert_array_equal(cars.h, [0.3, 0.1])
    with pytest.raises(ValueError, match="one kind of law, got CNVC, Passive"):
        stack([paper, ForcedCar(car=paper.car, h=0.1, f=1.0, omega=55.0, law=CNVC())])
    with pytest.raises(ValueError, match="no car to stack"):
        stack([])
    with pytest.raises(ValueError, match=r"unknown form of averaging 'exact'.*frozen"):
        SlowFlow(cars=cars, form="exact")
