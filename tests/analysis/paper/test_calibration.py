"""The preset's fit to Table 1 can be repeated, and its flatness is measured."""

import dataclasses

import numpy as np
import pytest

from qcar_env.analysis.paper import calibration
from qcar_env.analysis.paper.table1 import table1
from qcar_env.control import NDF, PPF
from qcar_env.scenarios import scenario


@pytest.fixture(scope="module")
def preset(paper):
    return calibration.candidate_of(paper)


@pytest.fixture(scope="module")
def refit(preset):
    return calibration.fit(preset)


def test_predictions_are_those_of_simulation(preset):
    """Harmonic balance against 60 s of RK4, whose peaks are read at the steps (4e-4)."""
    cells = table1(scenario("paper"))
    simulated = [cell.uncontrolled / cell.controlled for cell in cells]
    simulated += [cells[0].uncontrolled, cells[1].uncontrolled]
    np.testing.assert_allclose(calibration.predictions(preset), simulated, rtol=1e-3)


def test_targets_are_table_1():
    found = calibration.targets()
    assert found.shape == (14,)
    np.testing.assert_allclose(found[:2], [2.57, 7.33])
    # the NDF, LNVC and CNVC rows agree on these, the PPF rows do not
    np.testing.assert_allclose(found[12:], [1.12, 1.57], atol=0.01)


def test_the_preset_is_a_fit(preset, refit):
    """Its residuals are near the least that a refit reaches; neither is exact."""
    residuals = calibration.residuals(preset)
    rms = np.sqrt(np.mean(residuals**2))
    assert refit.success
    assert refit.cost <= rms < 1.1 * refit.cost
    assert np.expm1(np.abs(residuals).max()) < 0.10
    assert refit.cost > 0.05  # the table's rows do not agree with each other


def test_a_fit_from_elsewhere_is_as_good(preset, refit):
    start = dataclasses.replace(preset, b1=6.0, b2=1.0, f=15.0, mu1=1500.0, zeta_ndf=0.5)
    assert calibration.fit(start).cost == pytest.approx(refit.cost, rel=0.02)


def test_the_fit_is_flat(refit):
    """The least visible direction moves the table a hundred times less than the most."""
    found = calibration.directions(refit)
    assert found[0].sensitivity < 0.02 * found[-1].sensitivity
    assert max(found[0].weights, key=lambda n: abs(found[0].weights[n])) == "mu2"
    assert sum(w * w for w in found[0].weights.values()) == pytest.approx(1.0)


@pytest.mark.slow
def test_other_frequencies_fit_as_well(preset):
    fits = calibration.profile(preset, (45.0, 66.0), fitted=tuple(calibration.BOUNDS))
    assert [each.candidate.omega for each in fits] == [45.0, 66.0]
    assert all(each.cost < 0.065 for each in fits)


def test_height_acts_only_through_the_tyre(preset):
    other = dataclasses.replace(preset, h=0.2, mu1=preset.mu1 / 2.0, mu2=preset.mu2 / 2.0)
    np.testing.assert_allclose(
        calibration.predictions(other), calibration.predictions(preset), rtol=1e-9
    )


def test_filters_are_tuned_to_the_candidate(preset):
    moved = dataclasses.replace(preset, omega=40.0, zeta_ndf=0.4, zeta_ppf2=1.5)
    ndf, ppf = moved.under(NDF(G1=2.0)).law, moved.under(PPF()).law
    assert (ndf.G1, ndf.omega_f1, ndf.zeta1, ndf.zeta2) == (2.0, 40.0, 0.4, 0.4)
    assert (ppf.omega_f2, ppf.zeta1, ppf.zeta2) == (40.0, preset.zeta_ppf1, 1.5)


def test_bad_input(preset):
    with pytest.raises(ValueError, match=r"cannot fit 'omega'; free parameters are b1"):
        calibration.fit(preset, fitted=("omega",))
    with pytest.raises(ValueError, match="omega must be positive, got -1"):
        calibration.profile(preset, (-1.0,))
