"""Averaging and harmonic balance against long simulations; folds; stability labels."""

import dataclasses

import numpy as np
import pytest

from qcar_env.analysis import continuation
from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.fixed_points import balanced_start, fixed_points, solutions
from qcar_env.analysis.paper.forced_car import ForcedCar, stack, sweep
from qcar_env.analysis.paper.frequency_response import response
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.physics import linear
from qcar_env.physics.state import State

SIGMA = np.linspace(-20.0, 20.0, 61)  # [rad/s]


def with_law(paper: ForcedCar, law) -> ForcedCar:
    return dataclasses.replace(paper, law=law)


def cars_of(paper: ForcedCar, law, parameter: str) -> list[ForcedCar]:
    return list(sweep(with_law(paper, law), parameter, SIGMA))


@pytest.fixture(scope="module")
def simulated(paper):
    """Return simulated amplitudes (2, 61) for each law and detuning: 244 long simulations.

    80 s from rest: the slowest mode has decayed to exp(-0.2 * 80) = 1e-7.
    """
    found = {}
    for law in (Passive(), CNVC()):
        for parameter in ("sigma1", "sigma2"):
            cars = cars_of(paper, law, parameter)
            steady = steady_amplitudes(
                [c.car for c in cars], cars[0].road, cars[0].force, law, duration=80.0, step=5e-4
            )
            found[law.name, parameter] = np.array([steady.x1, steady.x2])
    return found


CASES = [(law, parameter) for law in (Passive(), CNVC()) for parameter in ("sigma1", "sigma2")]
IDS = [f"{law.name}-{parameter}" for law, parameter in CASES]


@pytest.mark.parametrize(("law", "parameter"), CASES, ids=IDS)
def test_first_order_averaging_is_within_5_percent_near_resonance(paper, simulated, law, parameter):
    points = fixed_points(stack(cars_of(paper, law, parameter)))
    assert points.converged.all()
    assert points.stable.all()
    error = np.abs(np.array([points.a1, points.a2]) / simulated[law.name, parameter] - 1.0)
    near = np.abs(SIGMA) <= 5.0
    assert np.sum(near) >= 15
    assert error[:, near].max() < 0.05
    assert error[:, np.abs(SIGMA) <= 1.0].max() < 0.025


@pytest.mark.parametrize(("law", "parameter"), CASES, ids=IDS)
def test_harmonic_balance_at_the_forcing_frequency_is_within_3_percent(
    paper, simulated, law, parameter
):
    cars = stack(cars_of(paper, law, parameter))
    motion = balance(cars, harmonics=1, start=balanced_start(cars))
    assert motion.converged.all()
    assert np.abs(motion.peaks[:2] / simulated[law.name, parameter] - 1.0).max() < 0.03


@pytest.mark.parametrize(("law", "parameter"), CASES, ids=IDS)
def test_harmonic_balance_with_nine_harmonics_is_within_a_thousandth(
    paper, simulated, law, parameter
):
    """The simulation itself reads peaks at its steps, low by at most 1e-4 at 0.5 ms."""
    cars = stack(cars_of(paper, law, parameter))
    motion = balance(cars, harmonics=9, start=balanced_start(cars))
    assert motion.converged.all()
    assert np.abs(motion.peaks[:2] / simulated[law.name, parameter] - 1.0).max() < 1e-3


def test_there_are_at_least_200_points():
    assert len(CASES) * SIGMA.size >= 200


@pytest.mark.parametrize("law", [Passive(), CNVC()], ids=lambda law: law.name)
def test_averaging_fails_far_from_resonance_and_the_rotating_form_does_not(paper, simulated, law):
    """The exact detuning is sigma + sigma^2/(2 omega): at 20 rad/s the first order is 18 % off."""
    cars = stack(cars_of(paper, law, "sigma1"))
    truth = simulated[law.name, "sigma1"]
    errors = {}
    for form in ("frozen", "natural", "rotating"):
        points = fixed_points(cars, form=form)
        errors[form] = np.abs(np.array([points.a1, points.a2]) / truth - 1.0).max()
    assert errors["rotating"] < 0.03 < errors["frozen"]
    assert errors["frozen"] < 0.25
    if law.name == "none":
        assert errors["natural"] > errors["frozen"]


@pytest.mark.parametrize("law", [Passive(), LNVC(), PD(), PPF(), NDF()], ids=lambda law: law.name)
def test_linear_laws_are_exact_with_one_harmonic(paper, law):
    """A linear loop answers at the forcing frequency alone; the simulation reads to 4e-4."""
    car = with_law(paper, law)
    cars = stack([car])
    points = fixed_points(cars, form="rotating")
    motion = balance(cars, harmonics=1)
    np.testing.assert_allclose(points.a1, np.abs(motion.amplitude()[0]), rtol=1e-9)
    np.testing.assert_allclose(points.a2, np.abs(motion.amplitude()[1]), rtol=1e-9)
    steady = steady_amplitudes(car.car, car.road, car.force, law, duration=80.0)
    np.testing.assert_allclose([points.a1[0], points.a2[0]], [steady.x1, steady.x2], rtol=5e-4)


def test_without_control_the_answer_is_the_linear_plants(paper):
    exact = linear.steady_state(paper.car, paper.road, paper.force).amplitudes
    points = fixed_points(stack([paper]), form="rotating")
    np.testing.assert_allclose([points.a1[0], points.a2[0]], exact, rtol=1e-10)


@pytest.mark.parametrize(
    "parameter", ["h", "f", "G", "G2", "mu1", "b2", "E2", "omega", "frequencies"]
)
def test_any_parameter_can_be_followed(paper, parameter):
    """The curve passes through the fixed points that are found one by one."""
    car = with_law(paper, CNVC())
    value = car.value(parameter)
    curve = response(car, parameter, 0.8 * value, 1.2 * value)
    assert curve.complete
    assert curve.parameter == parameter
    assert curve.values[0] == pytest.approx(0.8 * value)
    assert curve.values[-1] == pytest.approx(1.2 * value)
    points = fixed_points(stack(list(sweep(car, parameter, curve.values))))
    np.testing.assert_allclose(curve.a1, points.a1, rtol=1e-7)
    np.testing.assert_allclose(curve.theta2, points.theta2, atol=1e-7)


def test_gains_and_couplings_can_be_followed_from_zero(paper):
    """A negative gain is refused, and so must not be tried."""
    car = with_law(paper, CNVC())
    for name, end in (("G", 1.2), ("E3", 1.0), ("mu2", 20.0), ("b1", 9.0)):
        curve = response(car, name, 0.0, end)
        assert curve.complete
        assert curve.values[0] == 0.0
        assert curve.values[-1] == end


def test_the_papers_response_has_one_stable_branch_and_no_fold(paper):
    """Against the paper's "stable in the right branch and unstable in the left" (Fig. 4)."""
    for law in (Passive(), CNVC(G1=0.5, G2=0.5), CNVC()):
        for parameter in ("sigma1", "sigma2"):
            curve = response(with_law(paper, law), parameter, -20.0, 20.0)
            assert curve.complete
            assert curve.bifurcations == ()
            assert curve.stable.all()
        found = solutions(with_law(paper, law), np.random.default_rng(0))
        assert found.a1.size == 1


HARD = Hardening(alpha2=800.0)


@pytest.mark.parametrize("parameter", ["sigma2", "omega"])
def test_a_hardening_spring_folds_the_response_of_this_plant(paper, parameter):
    """One harmonic and the rotating slow flow are the same equations: the same folds."""
    car = with_law(paper, HARD)
    low, high = (-20.0, 10.0) if parameter == "sigma2" else (50.0, 65.0)
    by_balance = {"method": "harmonic balance", "longest": 0.15}
    averaged = response(car, parameter, low, high, form="rotating")
    balanced = response(car, parameter, low, high, harmonics=1, **by_balance)
    assert averaged.complete
    assert balanced.complete
    assert len(averaged.folds) == len(balanced.folds) == 2
    np.testing.assert_allclose(
        [b.value for b in averaged.folds], [b.value for b in balanced.folds], rtol=1e-6
    )
    many = response(car, parameter, low, high, harmonics=3, **by_balance)
    np.testing.assert_allclose(
        [b.value for b in many.folds],
        [b.value for b in averaged.folds],
        atol=0.3,  # [rad/s] what the third harmonic moves them
    )
    # between the folds the branch that turns back is unstable, and all labels change at folds
    backward = np.gradient(averaged.values) * np.sign(high - low) < 0.0
    inside = np.abs(averaged.values - averaged.folds[0].value) > 0.3
    inside &= np.abs(averaged.values - averaged.folds[1].value) > 0.3
    np.testing.assert_array_equal(averaged.stable[inside], ~backward[inside])


def test_multi_start_finds_all_three_coexisting_motions(paper):
    car = with_law(paper, HARD).vary("sigma2", -8.0)
    found = solutions(car, np.random.default_rng(1), form="rotating")
    assert found.stable.tolist() == [True, False, True]
    curve = response(with_law(paper, HARD), "sigma2", -20.0, 10.0, form="rotating")
    crossings = np.flatnonzero(np.diff(np.sign(curve.values + 8.0)))
    assert crossings.size == 3
    near = [curve.a2[i] for i in crossings]
    np.testing.assert_allclose(sorted(near), found.a2, rtol=0.1)  # a step apart
    again = solutions(car, np.random.default_rng(1), form="rotating")
    np.testing.assert_array_equal(again.a2, found.a2)


def test_stability_labels_agree_with_simulation(paper):
    """Start 1 % beside each motion of the folded response and see whether the car comes back.

    Points whose growth rate is below 0.15 1/s are left out: at a fold nothing decides in 100 s;
    and those within 1.5 rad/s of the second fold, where another motion lies 1 % beside.
    """
    car = with_law(paper, HARD)
    curve = response(car, "sigma2", -18.0, 2.0, method="harmonic balance", harmonics=3, longest=0.1)
    growth = curve.eigenvalues[:, 0].real
    chosen = np.flatnonzero((np.abs(growth) > 0.15) & (curve.values > curve.folds[1].value + 1.5))
    assert chosen.size >= 60
    assert np.sum(growth[chosen] > 0.0) >= 30
    cars = [car.vary("sigma2", float(v)) for v in curve.values[chosen]]
    A1 = curve.a1 * np.exp(1j * curve.theta1)
    A2 = curve.a2 * np.exp(1j * curve.theta2)
    start = np.array([A1, A2, 55j * A1, 55j * A2])[:, chosen]
    motion = balance(stack(cars), harmonics=7, start=start)
    assert motion.converged.all()
    beside = 1.01 * motion.states(np.zeros(1))[:, :, 0]
    steady = steady_amplitudes(
        [c.car for c in cars],
        cars[0].road,
        cars[0].force,
        HARD,
        duration=100.0,
        step=5e-4,
        start=[State(*column) for column in beside.T],
    )
    away = np.abs(steady.x2 / motion.peaks[1] - 1.0)
    stayed = away < 1e-3  # exp(-0.15 * 100) * 1 %, and the reading of peaks at the steps
    np.testing.assert_array_equal(stayed, curve.stable[chosen])
    assert away[~stayed].min() > 5e-3


@pytest.mark.parametrize("law", [Passive(), CNVC()], ids=lambda law: law.name)
def test_perturbed_motions_of_the_paper_return_as_labelled(paper, law):
    """41 detunings, started 50 % beside the steady motion."""
    cars = [with_law(paper, law).vary("sigma1", float(s)) for s in np.linspace(-20, 20, 41)]
    motion = balance(stack(cars), harmonics=9, start=balanced_start(stack(cars)))
    assert fixed_points(stack(cars)).stable.all()
    beside = 1.5 * motion.states(np.zeros(1))[:, :, 0]
    steady = steady_amplitudes(
        [c.car for c in cars],
        cars[0].road,
        cars[0].force,
        law,
        duration=60.0,
        step=5e-4,
        start=[State(*column) for column in beside.T],
    )
    np.testing.assert_allclose([steady.x1, steady.x2], motion.peaks[:2], rtol=1e-3)


def test_a_hopf_point_is_found_where_a_pair_crosses(paper):
    """Without control and with a one-sided coupling E3 the plant itself becomes unstable."""
    curve = response(paper, "E3", 0.5, 600.0)
    assert curve.complete
    (hopf,) = curve.bifurcations
    assert hopf.kind == "Hopf"
    # the averaged plant is linear: the crossing is that of its 2 x 2 complex matrix
    point = fixed_points(stack([paper.vary("E3", hopf.value)]))
    pair = point.eigenvalues[0, :2]
    assert np.abs(pair.real).max() < 1e-7
    assert abs(pair[0].imag) > 0.5
    np.testing.assert_array_equal(curve.stable, curve.values < hopf.value)


def test_bad_input(paper):
    with pytest.raises(ValueError, match=r"unknown parameter 'sigma_1'; did you mean 'sigma1'"):
        response(paper, "sigma_1", -1.0, 1.0)
    with pytest.raises(ValueError, match=r"sigma1 must be above -omega = -55 rad/s, got -60"):
        response(paper, "sigma1", -60.0, 10.0)
    with pytest.raises(ValueError, match=r"omega must be positive, got -5"):
        response(paper, "omega", -5.0, 10.0)
    with pytest.raises(ValueError, match=r"unknown parameter 'G1'"):
        response(paper, "G1", 0.0, 1.0)  # no control has no gain
    with pytest.raises(ValueError, match=r"unknown method 'averages'"):
        response(paper, "h", 0.1, 0.2, method="averages")
    with pytest.raises(ValueError, match=r"gain G1 must be below omega1\^2"):
        response(with_law(paper, PPF()), "G", 30.0, 4000.0)
    with pytest.raises(ValueError, match=r"gain G1 must not be negative"):
        response(with_law(paper, CNVC()), "G1", -1.0, 1.0)


def test_a_solver_that_stops_says_where_and_keeps_what_it_has(paper):
    curve = response(with_law(paper, HARD), "sigma2", -20.0, 10.0, max_points=20)
    assert not curve.complete
    assert "sigma2: points ran out at p = " in curve.message
    assert curve.values.size == 20
    assert curve.eigenvalues.shape == (20, 4)


@pytest.mark.parametrize("method", ["averaging", "harmonic balance"])
def test_a_branch_without_a_start_is_empty_and_says_so(paper, monkeypatch, method):
    nothing = continuation.Branch(
        p=np.empty(0), z=np.empty((4, 0)), points=(), complete=False, message="no solution found"
    )
    monkeypatch.setattr(continuation, "follow", lambda *args, **options: nothing)
    curve = response(paper, "sigma1", -1.0, 1.0, method=method)
    assert (curve.values.size, curve.stable.size, curve.complete) == (0, 0, False)
    assert curve.message == "sigma1: no solution found"
