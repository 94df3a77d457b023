"""The paper's statements on parameters and figures, as numbers."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from qcar_env.analysis.paper import experiments, fidelity
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.control import CNVC, Passive
from qcar_env.scenarios import scenario


@pytest.fixture
def cnvc(paper):
    return experiments.with_law(paper, CNVC())


def test_no_statement_of_section_5_2_is_contradicted(cnvc):
    """35 statements: 23 hold, 12 concern a change under 1 %."""
    found = experiments.trends(cnvc)
    assert len(found) == 35
    assert Counter(each.verdict for each in found) == {"holds": 23, "negligible": 12}


def test_a_statement_can_be_contradicted(cnvc, monkeypatch):
    flipped = dataclasses.replace(experiments.EFFECTS[0], claims={"h": "-", "f": "+"})
    monkeypatch.setattr(experiments, "EFFECTS", (flipped,))
    assert [t.verdict for t in experiments.trends(cnvc)] == ["contradicts", "negligible"]


def test_every_panel_has_its_curves(cnvc):
    effects = experiments.EFFECTS[1]
    curves = experiments.parameter_effect(cnvc, effects, "omega")
    assert [dict(c.setting) for c in curves] == [
        {"frequencies": pytest.approx(each)} for each in (38.5, 55.0, 71.5)
    ]
    force = experiments.parameter_effect(cnvc, effects, "f")
    assert [c.setting["f"] for c in force] == [24.8, 60.0, 100.0]
    peaks = [c.response.a2.max() for c in force]
    # no inverse effect above 60: the cube root of f
    assert np.log(peaks[2] / peaks[1]) / np.log(100 / 60) == pytest.approx(1 / 3, abs=0.02)


def test_slow_flow_and_full_equations_from_rest(paper):
    """The averaged envelope follows the transient, not only the end."""
    both = experiments.transient(paper, duration=10.0)
    t = both.numerical.t
    late = t > 1.0
    envelope = np.hypot(both.numerical.x2, both.numerical.v2 / paper.omega)
    error = np.abs(both.averaged.a2 - envelope)[late] / envelope[-1]
    assert error.max() < 0.02  # first order: terms of the size of damping over frequency


def test_sweeps_jump_where_the_branch_folds(paper):
    car = experiments.with_law(paper, Hardening(alpha2=800.0))
    found = experiments.folded_response(car, "sigma2", -6.0, 2.0, points=9)
    fold = found.balanced.folds[0].value
    below = found.upward.values < fold
    # rising from below it stays on the lower branch to the fold, then meets the other sweep
    assert found.upward.a2[below].max() < 0.25
    down = dict(zip(found.downward.values, found.downward.a2, strict=True))
    up = dict(zip(found.upward.values, found.upward.a2, strict=True))
    assert down[-4.0] > 5.0 * up[-4.0]
    assert down[1.0] == pytest.approx(up[1.0], rel=2e-3)


def test_approximation_errors_are_what_the_docs_say(paper):
    found = experiments.approximation_errors(paper, "sigma1", [-5.0, 0.0, 5.0, 20.0])
    assert set(found.errors) == {
        "averaging, natural",
        "averaging, frozen",
        "harmonic balance, 1 harmonic",
        "harmonic balance, 9 harmonics",
    }
    assert found.errors["averaging, frozen"][:3].max() < 0.05
    assert 0.15 < found.errors["averaging, frozen"][3] < 0.2
    assert found.errors["harmonic balance, 1 harmonic"].max() < 1e-3


def test_claims_are_judged():
    found = fidelity.claims(scenario("paper"))
    assert len(found) == 14
    by_place = {each.where: each for each in found}
    assert by_place["Section 6.1, Fig. 12, Table 1"].agreement == "yes"
    assert by_place["Section 6.1"].agreement == "no"
    assert by_place["Fig. 4, section 7(3)"].agreement == "no"
    assert by_place["Section 5"].agreement == "no"
    assert all(each.ours and each.paper for each in found)


def test_the_step_hump_settles_on_the_static_deflection(paper):
    """mu1 h / omega1^2, E1 and E3 being small: 0.083 m."""
    motion = experiments.step_hump(paper, {"none": Passive()}, duration=40.0, with_force=False)
    car = paper.car
    static = car.mu1 * paper.h / car.omega1**2
    assert float(motion["none"].x1[-1]) == pytest.approx(static, rel=1e-2)


def test_effects_are_the_papers():
    """Two statements of "no effect", both on f; one panel (b2 in Fig. 7) is not in the text."""
    claims = [
        (effects.figure, name, claim)
        for effects in experiments.EFFECTS
        for name, claim in effects.claims.items()
    ]
    assert [c[:2] for c in claims if c[2] == "0"] == [(5, "f"), (7, "f")]
    assert [c[:2] for c in claims if not c[2]] == [(7, "b2")]
