"""Grids of simulations and families of response curves."""

import dataclasses

import numpy as np
import pytest

from qcar_env.analysis.harmonic_balance import balance
from qcar_env.analysis.paper.fixed_points import balanced_start
from qcar_env.analysis.paper.forced_car import from_scenario, stack, sweep
from qcar_env.analysis.paper.parameter_study import cases, response_curves, simulated_amplitudes
from qcar_env.control import CNVC, PPF
from qcar_env.physics.state import State
from qcar_env.scenarios import scenario


@pytest.fixture
def cnvc(paper):
    return dataclasses.replace(paper, law=CNVC())


def test_a_grid_is_laid_out_as_its_ranges(cnvc):
    grid = simulated_amplitudes(cnvc, {"h": [0.05, 0.1], "G": [0.5, 1.2, 2.0]}, duration=10.0)
    assert grid.parameters == ("h", "G")
    assert grid.a1.shape == grid.peak_u2.shape == grid.diverged.shape == (2, 3)
    cars = stack(cases(cnvc, {"h": [0.05, 0.1], "G": [0.5, 1.2, 2.0]}))
    peaks = balance(cars, harmonics=9, start=balanced_start(cars)).peaks
    # with CNVC 10 s are steady; peaks read at the steps of 1 ms are low by at most 4e-4
    np.testing.assert_allclose(grid.a1.ravel(), peaks[0], rtol=6e-4)
    np.testing.assert_allclose(grid.a2.ravel(), peaks[1], rtol=6e-4)
    assert np.all(np.diff(grid.a1, axis=1) < 0.0)


def test_cases_nest_in_the_order_of_the_ranges(cnvc):
    found = cases(cnvc, {"omega": [50.0, 60.0], "sigma1": [-1.0, 1.0]})
    assert [(c.omega, c.car.omega1) for c in found] == [
        (50.0, 49.0), (50.0, 51.0), (60.0, 59.0), (60.0, 61.0),
    ]  # fmt: skip


@pytest.mark.slow
def test_ten_thousand_cases_to_steady_state(cnvc):
    """100 x 100 cases, 20 s each: CNVC's slowest rate is above 2 1/s."""
    grid = simulated_amplitudes(
        cnvc,
        {"sigma1": np.linspace(-20.0, 20.0, 100), "G": np.linspace(0.2, 2.0, 100)},
        duration=20.0,
    )
    assert grid.a1.shape == (100, 100)
    assert not grid.diverged.any()
    cars = stack(list(sweep(cnvc.vary("G", 0.2), "sigma1", np.linspace(-20.0, 20.0, 100))))
    peaks = balance(cars, harmonics=7, start=balanced_start(cars)).peaks
    np.testing.assert_allclose(grid.a1[:, 0], peaks[0], rtol=1e-3)


def test_curves_for_every_setting(cnvc):
    curves = response_curves(
        cnvc, "sigma1", -5.0, 5.0, {"f": [10.0, 60.0], "G1": [0.5, 1.2]}, longest=0.2
    )
    assert [dict(c.setting) for c in curves] == [
        {"f": 10.0, "G1": 0.5}, {"f": 10.0, "G1": 1.2},
        {"f": 60.0, "G1": 0.5}, {"f": 60.0, "G1": 1.2},
    ]  # fmt: skip
    assert all(c.response.complete and c.response.stable.all() for c in curves)
    assert curves[0].response.a1.max() > curves[1].response.a1.max()
    one_by_one = response_curves(cnvc, "sigma1", -5.0, 5.0, [{"f": 10.0, "G1": 0.5}], longest=0.2)
    np.testing.assert_array_equal(one_by_one[0].response.a1, curves[0].response.a1)


def test_bad_input(cnvc, paper):
    with pytest.raises(ValueError, match="at least one parameter, got none"):
        simulated_amplitudes(cnvc, {})
    with pytest.raises(ValueError, match=r"unknown parameter 'gain'.*G1"):
        simulated_amplitudes(cnvc, {"gain": [1.0]})
    with pytest.raises(ValueError, match="values of h must not be empty"):
        simulated_amplitudes(cnvc, {"h": []})
    with pytest.raises(ValueError, match=r"omega must be positive, got 0 rad/s"):
        simulated_amplitudes(cnvc, {"omega": np.linspace(-10.0, 10.0, 3)[1:]})
    with pytest.raises(ValueError, match=r"frequencies must be positive, got -10"):
        simulated_amplitudes(cnvc, {"frequencies": [-10.0]})
    with pytest.raises(ValueError, match=r"gain G1 must be below omega1\^2 = 3025 1/s\^2"):
        simulated_amplitudes(dataclasses.replace(paper, law=PPF()), {"G": [30.0, 3100.0]})


def test_a_gain_that_makes_the_uncontrolled_start_diverge_is_refused(cnvc):
    """Switched on at 61 m/s the loop's slope 3 G v^2 is 13 000 1/s: too stiff for 1 ms."""
    fast = State(0.0, 0.0, 61.4, 87.4)
    with pytest.raises(ValueError, match=r"step must be below .* for CNVC at its start"):
        simulated_amplitudes(cnvc, {"G": [1.2]}, duration=1.0, start=fast)
    found = simulated_amplitudes(cnvc, {"G": [1.2]}, duration=5.0, start=fast, step=5e-5)
    assert found.a2[0] == pytest.approx(0.0547, rel=5e-3)


def test_a_case_that_diverges_is_marked(paper):
    grid = simulated_amplitudes(paper, {"E3": [0.5, 2000.0]}, duration=100.0)
    assert grid.diverged.tolist() == [False, True]
    assert np.isinf(grid.a1[1])


def test_scenarios_without_a_frequency_response_are_refused():
    with pytest.raises(ValueError, match=r"needs a harmonic road, got a Step"):
        from_scenario(scenario("paper-step"))
    preset = scenario("paper")
    other = dataclasses.replace(preset, force=dataclasses.replace(preset.force, Omega=50.0))
    with pytest.raises(ValueError, match=r"need omega = Omega, got omega = 55 and Omega = 50"):
        from_scenario(other)


@pytest.mark.parametrize("name", ["omega1", "b2", "h", "f", "G1", "G", "sigma2", "frequencies"])
def test_vary_and_value_are_inverse(cnvc, name):
    assert cnvc.vary(name, 0.7 * 55.0).value(name) == pytest.approx(0.7 * 55.0)


def test_moving_all_frequencies_keeps_the_detunings(cnvc):
    moved = cnvc.vary("sigma1", 3.0).vary("sigma2", -2.0).vary("frequencies", 40.0)
    assert (moved.sigma1, moved.sigma2, moved.omega) == (3.0, -2.0, 40.0)
    held = cnvc.vary("omega", 50.0)
    assert (held.sigma1, held.car.omega1) == (5.0, 55.0)
