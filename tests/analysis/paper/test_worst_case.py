"""Is resonance of everything the worst case of the uncontrolled car."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.analysis.paper.worst_case import largest, uncontrolled_amplitudes, worst_phases
from qcar_env.analysis.simulate import steady_amplitudes
from qcar_env.control import Passive
from qcar_env.physics.car import PaperCar


def simulated(of: ForcedCar, phase: float) -> tuple[float, float]:
    """Return the amplitudes of (3)-(4) with the road ahead by a phase, by DOP853 from rest."""
    c, w = of.car, of.omega

    def rate(t, x):
        x1, x2, v1, v2 = x
        y, y_dot = of.h * math.sin(w * t + phase), w * of.h * math.cos(w * t + phase)
        dv1 = c.mu1 * y + c.mu2 * y_dot - c.omega1**2 * x1 - c.b1 * v1 + c.E2 * v2 + c.E1 * x2
        dv2 = of.f * math.cos(w * t) - c.omega2**2 * x2 + c.b2 * (v1 - v2) + c.E3 * x1
        return [v1, v2, dv1, dv2]

    end = 4.0
    t = np.linspace(end - 2.0 * math.pi / w, end, 2001)
    x = solve_ivp(rate, (0.0, end), np.zeros(4), "DOP853", t, rtol=1e-10, atol=1e-12).y
    return np.abs(x[0]).max(), np.abs(x[1]).max()


@pytest.mark.parametrize("seed", range(3))
def test_amplitudes_at_any_phase_are_those_of_a_simulation(seed):
    """Of a damped car, which is steady after 4 s."""
    rng = np.random.default_rng(seed)
    car = PaperCar(
        omega1=55.0 + rng.normal(), omega2=55.0 + rng.normal(), b1=20.0, b2=12.0, E1=90.0, E2=3.0,
        E3=70.0, mu1=2000.0, mu2=20.0,
    )  # fmt: skip
    of = ForcedCar(car=car, h=0.1, f=25.0, omega=55.0)
    for phase in rng.uniform(-math.pi, math.pi, 2):
        found = uncontrolled_amplitudes(of, phase=phase)
        assert found == pytest.approx(simulated(of, phase), rel=1e-5)


def test_no_phase_is_worse_than_the_worst(paper):
    most, at = uncontrolled_amplitudes(paper, phase=None), worst_phases(paper)
    assert math.degrees(at[1]) == pytest.approx(71.4, abs=0.05)
    tried = np.linspace(-math.pi, math.pi, 361)
    found = np.array([uncontrolled_amplitudes(paper, phase=each) for each in tried])
    for mass in (0, 1):
        assert uncontrolled_amplitudes(paper, phase=at[mass])[mass] == pytest.approx(most[mass])
        assert 0.9999 * most[mass] < found[:, mass].max() <= most[mass] * (1.0 + 1e-12)


def test_a_detuned_wheel_is_worse_for_the_body_than_resonance(paper):
    """At the phase of (3)-(4): simulated, 80 s from rest, peaks read to 1e-4."""
    found = largest(paper, 2, "sigma1", -20.0, 20.0)
    cars = paper, paper.vary("sigma1", found.value)
    steady = steady_amplitudes(
        [each.car for each in cars], paper.road, paper.force, Passive(), duration=80.0, step=5e-4
    )
    assert steady.x2[1] == pytest.approx(found.amplitude, rel=2e-4)
    assert steady.x2[1] > 1.02 * steady.x2[0]
    for value in np.linspace(-20.0, 20.0, 100):
        assert uncontrolled_amplitudes(paper.vary("sigma1", value))[1] <= found.amplitude


def test_at_the_worst_phase_resonance_is_the_worst_case(paper):
    """To within the width of the modes: b2 / 2 = 0.4 rad/s."""
    for mass in (1, 2):
        for parameter in ("sigma1", "sigma2"):
            found = largest(paper, mass, parameter, -20.0, 20.0, phase=None)
            assert abs(found.value) < 0.1
            at_resonance = uncontrolled_amplitudes(paper, phase=None)[mass - 1]
            assert found.amplitude == pytest.approx(at_resonance, rel=1e-3)


def test_bad_input(paper):
    with pytest.raises(ValueError, match=r"mass must be .* got 3"):
        largest(paper, 3, "sigma1", -1.0, 1.0)
    with pytest.raises(ValueError, match="unknown parameter 'sigma3'"):
        largest(paper, 1, "sigma3", -1.0, 1.0)
    with pytest.raises(ValueError, match="phase must be finite"):
        uncontrolled_amplitudes(paper, phase=math.nan)
