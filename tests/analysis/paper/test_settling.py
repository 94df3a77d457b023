"""When a motion is steady, against other solutions of the same equations."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import argrelmax

from qcar_env.analysis.paper.experiments import with_law
from qcar_env.analysis.paper.settling import settling
from qcar_env.control import CNVC, LNVC, Passive

PERIOD = 2.0 * math.pi / 55.0


def closed_loop(of, command):
    """Return the rate of (3)-(4) with forces ``command(v1), command(v2)``."""
    c, w = of.car, of.omega

    def rate(t, x):
        x1, x2, v1, v2 = x
        y, y_dot = of.h * math.sin(w * t), w * of.h * math.cos(w * t)
        dv1 = c.mu1 * y + c.mu2 * y_dot - c.omega1**2 * x1 - c.b1 * v1 + c.E2 * v2 + c.E1 * x2
        dv2 = of.f * math.cos(w * t) - c.omega2**2 * x2 + c.b2 * (v1 - v2) + c.E3 * x1
        return [v1, v2, dv1 + command(v1), dv2 + command(v2)]

    return rate


def steady_start(of):
    """Return a state of the steady motion without control, at phase 0: by DOP853, 100 s."""
    rate = closed_loop(of, lambda v: 0.0)
    end = 875 * PERIOD
    found = solve_ivp(rate, (0.0, end), np.zeros(4), "DOP853", rtol=1e-9, atol=1e-11)
    return found.y[:, -1]


def settled(t, x):
    """Return the time of the first maximum of |x| from which on all are within 5 %."""
    (at,) = argrelmax(np.abs(x))
    off = np.abs(np.abs(x[at]) / np.abs(x[at[-2:]]).max() - 1.0) > 0.05
    return t[at[np.flatnonzero(off)[-1] + 1]] if off.any() else 0.0


@pytest.mark.parametrize("from_rest", [True, False])
@pytest.mark.parametrize(
    ("law", "command"),
    [
        (CNVC(), lambda v: -1.2 * v**3),
        (LNVC(), lambda v: -1.2 * v),
        (LNVC(G1=40.0, G2=40.0), lambda v: -40.0 * v),
    ],
    ids=["CNVC", "LNVC", "LNVC 40"],
)
def test_times_are_those_of_lsoda(paper, law, command, from_rest):
    found = settling(with_law(paper, law), from_rest=from_rest, duration=20.0)
    start = np.zeros(4) if from_rest else steady_start(paper)
    end = 20.0 // PERIOD * PERIOD
    t = np.linspace(0.0, end, round(end / PERIOD * 500) + 1)
    rate = closed_loop(paper, command)
    x = solve_ivp(rate, (0.0, end), start, "LSODA", t, rtol=1e-8, atol=1e-10).y
    # an extreme that falls within 5e-4 of the band may count or not: half a period
    assert found.time == pytest.approx(max(settled(t, x[0]), settled(t, x[1])), abs=0.6 * PERIOD)
    last = np.abs(x[:2, -501:]).max(axis=1)
    assert found.amplitudes == pytest.approx(tuple(last), rel=2e-3)  # LNVC: exp(-0.8 * 20)


def test_cnvc_is_the_fastest_at_the_papers_gain_and_not_at_equal_force(paper):
    limit = (280.0, 33.0)
    cubic, linear = (with_law(paper, each) for each in (CNVC(), LNVC(G1=40.0, G2=40.0)))
    weak = settling(with_law(paper, LNVC()))
    found, other = settling(cubic), settling(linear)
    assert found.time < 0.1 * weak.time
    assert other.time < 1.5 * found.time
    assert max(other.peak_force) < 0.01 * max(found.peak_force)
    limited = [settling(each, force_limit=limit) for each in (cubic, linear)]
    assert limited[0].peak_force == limited[1].peak_force == limit
    assert limited[0].time == pytest.approx(limited[1].time, rel=0.05)
    assert limited[0].time > 10.0 * found.time


def test_the_steady_motion_without_control_is_steady_at_once(paper):
    found = settling(with_law(paper, Passive()), duration=5.0)
    assert found.time == 0.0
    assert found.amplitudes == pytest.approx((1.1163, 1.5892), rel=1e-3)
    assert found.peak_force == (0.0, 0.0)


def test_bad_input(paper):
    with pytest.raises(ValueError, match="band must be positive"):
        settling(paper, band=0.0)
    with pytest.raises(ValueError, match="duration must be positive"):
        settling(paper, duration=0.0)
