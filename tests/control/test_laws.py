"""The laws: their formulas, what they do to energy and stability, and their one source."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from qcar_env.control import CNVC, LAWS, LNVC, NDF, PD, PPF, Passive
from qcar_env.control.law import Law
from qcar_env.control.lqr import Weights
from qcar_env.control.skyhook import Groundhook, Hybrid, Skyhook
from qcar_env.parts.part import UNLIMITED, Nothing, clamp
from qcar_env.parts.spring import CubicSpring
from qcar_env.physics import linear, tree
from qcar_env.physics.car import PAPER_FUNCTIONS, REST, PaperCar, QuarterCar, RoadForce
from qcar_env.physics.closed_loop import ControlledState, Limits, LoopNumbers, loop_functions
from qcar_env.physics.motion import Input
from qcar_env.physics.state import Filter, State

PAPER = PaperCar(
    omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5, mu1=2510.0, mu2=16.0
)
NONE = Nothing()
gain = st.floats(0.0, 200.0, allow_subnormal=False)
frequency = st.floats(1.0, 200.0)
ratio = st.floats(0.01, 3.0)
ndf = st.builds(
    NDF, G1=gain, G2=gain, omega_f1=frequency, omega_f2=frequency, zeta1=ratio, zeta2=ratio
)
ppf = st.builds(
    PPF, G1=gain, G2=gain, omega_f1=frequency, omega_f2=frequency, zeta1=ratio, zeta2=ratio
)


def rate(law, car, x, limits=None, input=None):
    """Return the rate of car and filter at a state, on a road at rest if `input` is left out."""
    functions = car.functions
    ready = functions.prepare(car.numbers)
    loop = loop_functions(functions, law.functions, limited=limits is not None)
    still = Input(functions.road_input(0.0, 0.0, ready), 0.0)
    p = LoopNumbers(ready, law.numbers, limits if limits else NONE)
    return loop.rate(x, input or still, None, p)


def closed_loop_matrix(law, car) -> np.ndarray:
    """Return the matrix of plant and filter under a linear law, column by column."""
    like = ControlledState(REST, law.at_rest)
    units = np.eye(len(tree.flat(like)))
    columns = [tree.flat(rate(law, car, tree.unflat(like, unit))) for unit in units]
    return np.array(columns, dtype=float).T


def transfer(law: Law, omega: float) -> np.ndarray:
    """Return from velocity to force of each mass at `omega`, with positions v / (i omega)."""
    unit, none = np.eye(4), np.zeros((4, 4))
    F = np.array(law.filter_rate(State(*none), Filter(*unit), law.numbers))
    G = np.array(law.filter_rate(State(*unit), Filter(*none), law.numbers))
    into = np.array([[1 / (1j * omega), 0], [0, 1 / (1j * omega)], [1, 0], [0, 1]])
    eta = np.linalg.solve(1j * omega * np.eye(4) - F, G @ into)
    return np.diag(np.array(law.command(State(*(0j,) * 4), Filter(*eta), law.numbers)))


# Formulas ---------------------------------------------------------------------------------------


def test_the_registry_holds_every_law_by_its_name():
    assert set(LAWS) == {"none", "cnvc", "lnvc", "ppf", "ndf", "pd"}
    for key, law in LAWS.items():
        assert law().name.lower() == key
        assert dataclasses.is_dataclass(law)


@given(G1=gain, G2=gain, x=st.from_type(State))
def test_velocity_laws_are_the_papers_formulas(G1, G2, x):
    cubic, straight = CNVC(G1=G1, G2=G2), LNVC(G1=G1, G2=G2)
    # three products in another order
    expected = (-G1 * x.v1**3, -G2 * x.v2**3)
    assert cubic.command(x, NONE, cubic.numbers) == pytest.approx(expected, rel=1e-15)
    assert straight.command(x, NONE, straight.numbers) == (-G1 * x.v1, -G2 * x.v2)


@given(p1=gain, p2=gain, d1=gain, d2=gain, x=st.from_type(State))
def test_pd_is_a_spring_and_a_damper(p1, p2, d1, d2, x):
    law = PD(p1=p1, p2=p2, d1=d1, d2=d2)
    expected = (-(p1 * x.x1 + d1 * x.v1), -(p2 * x.x2 + d2 * x.v2))
    assert law.command(x, NONE, law.numbers) == expected


@given(...)
def test_no_control_is_no_force(x: State):
    law = Passive()
    assert law.command(x, NONE, law.numbers) == (0.0, 0.0)


@given(law=ppf, x=st.from_type(State), eta=st.from_type(Filter))
def test_ppf_is_fanson_and_caugheys_filter(law, x, eta):
    rate = law.filter_rate(x, eta, law.numbers)
    assert (rate.eta1, rate.eta2) == (eta.eta1_dot, eta.eta2_dot)
    for w, zeta, position, e, de, dde in (
        (law.omega_f1, law.zeta1, x.x1, eta.eta1, eta.eta1_dot, rate.eta1_dot),
        (law.omega_f2, law.zeta2, x.x2, eta.eta2, eta.eta2_dot, rate.eta2_dot),
    ):
        terms = [dde, 2 * zeta * w * de, w**2 * e, -(w**2) * position]
        assert sum(terms) == pytest.approx(
            0.0, abs=4e-15 * sum(map(abs, terms)) + 1e-300
        )  # roundings
    assert law.command(x, eta, law.numbers) == (law.G1 * eta.eta1, law.G2 * eta.eta2)


@given(law=ndf, x=st.from_type(State), eta=st.from_type(Filter))
def test_ndf_is_a_band_passed_velocity(law, x, eta):
    rate = law.filter_rate(x, eta, law.numbers)
    assert (rate.eta1, rate.eta2) == (eta.eta1_dot, eta.eta2_dot)
    for w, zeta, velocity, e, de, dde in (
        (law.omega_f1, law.zeta1, x.v1, eta.eta1, eta.eta1_dot, rate.eta1_dot),
        (law.omega_f2, law.zeta2, x.v2, eta.eta2, eta.eta2_dot, rate.eta2_dot),
    ):
        terms = [dde, 2 * zeta * w * de, w**2 * e, -w * velocity]
        assert sum(terms) == pytest.approx(
            0.0, abs=4e-15 * sum(map(abs, terms)) + 1e-300
        )  # roundings
    assert law.command(x, eta, law.numbers) == (-law.G1 * eta.eta1_dot, -law.G2 * eta.eta2_dot)


# Energy -----------------------------------------------------------------------------------------


@given(G1=gain, G2=gain, x=st.from_type(State), law=st.sampled_from([CNVC, LNVC]))
def test_velocity_laws_take_energy_out_of_each_mass(law, G1, G2, x):
    law = law(G1=G1, G2=G2)
    u1, u2 = law.command(x, NONE, law.numbers)
    assert u1 * x.v1 <= 0.0
    assert u2 * x.v2 <= 0.0


@given(law=ndf, x=st.from_type(State), eta=st.from_type(Filter))
def test_ndf_takes_out_what_its_filter_does_not_store(law, x, eta):
    """u v + dS/dt = -2 zeta G eta'^2 with the store S = G (eta'^2 + omega_f^2 eta^2) / (2 omega_f).

    So over any motion from rest to rest the law has done negative work.
    """
    u = law.command(x, eta, law.numbers)
    rate = law.filter_rate(x, eta, law.numbers)
    for G, w, zeta, force, v, e, de, dde in (
        (law.G1, law.omega_f1, law.zeta1, u[0], x.v1, eta.eta1, eta.eta1_dot, rate.eta1_dot),
        (law.G2, law.omega_f2, law.zeta2, u[1], x.v2, eta.eta2, eta.eta2_dot, rate.eta2_dot),
    ):
        stored = G / w * de * dde + G * w * e * de
        terms = [force * v, stored, 2.0 * zeta * G * de**2]
        scale = sum(map(abs, terms)) + G * w * abs(e * de) + G * abs(de * v)
        assert sum(terms) == pytest.approx(0.0, abs=1e-14 * scale + 1e-300)  # a dozen roundings


@given(law=ndf, omega=frequency)
def test_ndf_is_positive_real(law, omega):
    for response, G in zip(transfer(law, omega), (law.G1, law.G2), strict=True):
        assert response.real <= 1e-12 * G  # rounding of the solve


@given(G=gain, omega_f=frequency, zeta=ratio)
def test_ndf_at_its_frequency_is_velocity_feedback(G, omega_f, zeta):
    law = NDF(G1=G, G2=G, omega_f1=omega_f, omega_f2=omega_f, zeta1=zeta, zeta2=zeta)
    expected = -G / (2.0 * zeta)
    # the solve's condition grows as 1 / zeta, to 100
    assert transfer(law, omega_f) == pytest.approx(np.full(2, expected), rel=1e-11, abs=1e-12)


@given(G=st.floats(0.1, 200.0), omega_f=frequency, zeta=ratio)
def test_ppf_at_its_frequency_is_velocity_feedback_too(G, omega_f, zeta):
    """There eta lags x by a quarter turn: u = G eta = -G v / (2 zeta omega_f)."""
    law = PPF(G1=G, G2=G, omega_f1=omega_f, omega_f2=omega_f, zeta1=zeta, zeta2=zeta)
    expected = -G / (2.0 * zeta * omega_f)
    assert transfer(law, omega_f) == pytest.approx(np.full(2, expected), rel=1e-9)


# Stability --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law", [LNVC(G1=40.0, G2=40.0), NDF(), NDF(G1=50.0, G2=50.0), PD(), PPF(), PPF(G1=70, G2=70)]
)
def test_the_papers_gains_leave_the_papers_car_stable(law):
    law.check(PAPER)
    poles = np.linalg.eigvals(closed_loop_matrix(law, PAPER))
    assert np.max(poles.real) < 0.0


@given(
    car=st.from_type(PaperCar),
    share1=st.floats(0.0, 0.95),
    zeta=st.floats(0.1, 3.0),
    omega_f=st.floats(10.0, 100.0),
)
def test_ppf_is_refused_from_the_gain_at_which_a_pole_reaches_zero(car, share1, zeta, omega_f):
    stiffness1, stiffness2 = car.omega1**2, car.omega2**2
    assume(car.E1 * car.E3 < 0.9 * (1.0 - share1) * stiffness1 * stiffness2)
    G1 = share1 * stiffness1
    limit = stiffness2 - car.E1 * car.E3 / (stiffness1 - G1)

    def law(G2):
        return PPF(G1=G1, G2=G2, omega_f1=omega_f, omega_f2=omega_f, zeta1=zeta, zeta2=zeta)

    poles = [
        np.linalg.eigvals(closed_loop_matrix(law(share * limit), car)) for share in (0.0, 1.0, 1.1)
    ]
    # the product of the poles is positive, then a pole goes through zero and makes it negative
    assert np.prod(poles[0]).real > 0.0
    assert np.min(np.abs(poles[1])) < 1e-6 * np.max(np.abs(poles[1]))  # the solver's rounding
    assert np.prod(poles[2]).real < 0.0
    law(0.999 * limit).check(car)
    with pytest.raises(ValueError, match=re.escape(f"G2 must be below {limit:g} 1/s^2 (static")):
        law(1.001 * limit).check(car)


def test_ppf_below_the_limit_is_stable_and_above_it_is_not():
    limit = 55.0**2 - 0.25 / (55.0**2 - 30.0)
    for share, stable in ((0.99, True), (1.01, False)):
        law = PPF(G1=30.0, G2=share * limit, zeta1=0.5, zeta2=0.5)
        poles = np.linalg.eigvals(closed_loop_matrix(law, PAPER))
        assert (np.max(poles.real) < 0.0) == stable


def test_without_coupling_the_limit_is_the_literatures():
    """Fanson and Caughey: G_i < omega_i^2."""
    alone = dataclasses.replace(PAPER, E1=0.0, E3=0.0)
    PPF(G1=3024.9, G2=3024.9).check(alone)
    for name in ("G1", "G2"):
        with pytest.raises(
            ValueError, match=rf"gain {name} must be below .*3025 .*got 3025 1/s\^2"
        ):
            PPF(**{name: 3025.0}).check(alone)


@given(car=st.from_type(PaperCar), over=st.floats(1.001, 10.0))
def test_a_negative_proportional_gain_has_the_same_limit(car, over):
    assume(car.E1 * car.E3 < 0.9 * car.omega1**2 * car.omega2**2)
    limit = car.omega2**2 - car.E1 * car.E3 / car.omega1**2
    PD(p1=0.0, p2=-0.999 * limit).check(car)
    with pytest.raises(ValueError, match=r"gain -p2 must be below .* give a smaller gain"):
        PD(p1=0.0, p2=-over * limit).check(car)


def test_a_car_that_is_not_linear_has_the_limit_of_its_stiffness_at_rest():
    linear_car = QuarterCar.from_physical(60.0, 300.0, 190e3, 16e3, 100.0, 1e3)
    hardening = dataclasses.replace(linear_car, spring=CubicSpring(k=16e3, k3=1e7))
    for law in (PPF(G1=1.0, G2=50.0), PD(p1=0.0, p2=-50.0), PPF(G1=3500.0, G2=1.0)):
        messages = []
        for car in (linear_car, hardening):
            with pytest.raises(
                ValueError, match=r"must be below .* 1/s\^2 .*static stability"
            ) as e:
                law.check(car)
            messages.append(str(e.value))
        assert messages[0] == messages[1]
    PPF(G1=1.0, G2=45.0).check(hardening)  # k1 k2 / ((k1 + k2) m2) = 49.2


@given(law=st.one_of(ndf, st.builds(LNVC, G1=gain, G2=gain)))
def test_laws_that_take_energy_out_leave_a_real_car_stable(law):
    car = QuarterCar.from_physical(60.0, 300.0, 190e3, 16e3, 100.0, 1e3)
    law.check(car)
    poles = np.linalg.eigvals(closed_loop_matrix(law, car))
    # a filter without gain keeps its own poles, down to zeta omega_f = 0.01
    assert np.max(poles.real) <= 1e-9


@given(G1=gain, G2=gain)
def test_linear_velocity_feedback_adds_to_the_damping(G1, G2):
    """On (3)-(4) the gains stand beside b1 and, on v2 alone, beside b2."""
    found = closed_loop_matrix(LNVC(G1=G1, G2=G2), PAPER)[:4, :4]
    expected = linear.matrices(PAPER).A - np.diag([0.0, 0.0, G1, G2])
    assert found == pytest.approx(expected, rel=1e-15)


@given(a=st.floats(0.01, 2.0), omega=st.floats(1.0, 100.0), G=st.floats(0.01, 2.0))
def test_the_averaged_damping_of_cnvc(a, omega, G):
    """Work over a period of x = a cos(omega t), over that of a unit damper: (3/4) G omega^2 a^2."""
    law = CNVC(G1=G, G2=G)
    psi = 2.0 * math.pi * np.arange(64) / 64  # a trapezoid is exact for harmonics below 64
    v = -omega * a * np.sin(psi)
    u, _ = law.command(State(0.0 * v, 0.0 * v, v, v), NONE, law.numbers)
    assert np.mean(-u * v) / np.mean(v * v) == pytest.approx(0.75 * G * (omega * a) ** 2, rel=1e-12)


# Saturation -------------------------------------------------------------------------------------


@given(u=st.floats(-1e6, 1e6), limit=st.floats(1e-3, 1e5))
def test_an_actuator_holds_the_force_within_its_limit(u, limit):
    assert clamp(u, -limit, limit) == max(-limit, min(limit, u))


@given(u=st.floats(-1e6, 1e6))
def test_an_unlimited_actuator_changes_nothing(u):
    assert clamp(u, -UNLIMITED, UNLIMITED) == u
    assert np.isnan(clamp(math.nan, -1.0, 1.0))


@given(x=st.from_type(State), eta=st.from_type(Filter), law=st.one_of(ppf, ndf))
def test_without_reaching_the_limit_saturation_changes_nothing(x, eta, law):
    state = ControlledState(x, eta)
    free = rate(law, PAPER, state)
    assert rate(law, PAPER, state, Limits(1e9, 1e9)) == free
    tight = rate(law, PAPER, state, Limits(1.0, 1.0))
    assert tight.filter == free.filter  # the filter does not see the actuator
    bare = rate(Passive(), PAPER, ControlledState(x, NONE)).plant
    assert abs(tight.plant.v1 - bare.v1) <= 1.0 + 1e-9
    assert abs(tight.plant.v2 - bare.v2) <= 1.0 + 1e-9


# One source -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(LAWS))
def test_floats_arrays_and_tensors_give_the_same_bits(same_bits, name):
    law = LAWS[name]()
    rng = np.random.default_rng(1)
    n = 67
    x = State(*rng.normal(size=(4, n)))
    eta = law.State(*rng.normal(size=(len(law.State._fields), n)))
    gains = type(law.numbers)(*(np.full(n, each) for each in law.numbers))
    same_bits(law.command, x, eta, gains)
    if law.filter_rate is not None:
        same_bits(law.filter_rate, x, eta, gains)
    car = type(PAPER.numbers)(*(np.full(n, each) for each in PAPER.numbers))
    input = Input(RoadForce(rng.normal(size=n)), rng.normal(size=n))
    limits = Limits(*rng.random((2, n)))
    for held in (False, True):
        loop = loop_functions(PAPER_FUNCTIONS, law.functions, limited=True, held=held)
        p = LoopNumbers(car, gains, limits)
        same_bits(loop.rate, ControlledState(x, eta), input, tuple(rng.normal(size=(2, n))), p)


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "name"),
    [(CNVC, "G1"), (LNVC, "G2"), (PPF, "G1"), (NDF, "G2"), (PD, "d1"), (PD, "d2")],
)
def test_a_gain_must_not_be_negative(law, name):
    with pytest.raises(
        ValueError, match=rf"gain {name} must not be negative, got -1 .*s.*; give 0"
    ):
        law(**{name: -1.0})


@pytest.mark.parametrize("law", [PPF, NDF])
@pytest.mark.parametrize("name", ["omega_f1", "omega_f2", "zeta1", "zeta2"])
def test_a_filter_must_have_a_frequency_and_damping(law, name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        law(**{name: 0.0})


@pytest.mark.parametrize(
    ("law", "name"),
    [(law, field.name) for law in LAWS.values() for field in dataclasses.fields(law)],
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_gain_must_be_finite(law, name, value):
    with pytest.raises(ValueError, match=f"{name} must be finite, got {value}"):
        law(**{name: value})


@pytest.mark.parametrize("law", [CNVC, LNVC, NDF, PD, PPF, Hybrid, Skyhook, Groundhook, Weights])
@pytest.mark.parametrize("kind", [np.array, np.float32, int])
def test_gains_are_kept_as_plain_floats(law, kind):
    names = [each.name for each in dataclasses.fields(law)]
    plain, given_ = (law(**dict.fromkeys(names, each)) for each in (2.0, kind(2)))
    assert (given_, hash(given_), repr(given_)) == (plain, hash(plain), repr(plain))
    for value in (10**400, np.ones(2), "2"):
        with pytest.raises(ValueError, match=rf"{names[-1]} must be .*, got .*; give a finite"):
            law(**{names[-1]: value})
