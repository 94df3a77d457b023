"""Every number that enters the analysis is refused by name, with what was got, where it is none."""

import dataclasses
import math

import numpy as np
import pytest

from qcar_env.analysis import continuation
from qcar_env.analysis.chaos import largest_lyapunov_exponent, poincare_section
from qcar_env.analysis.harmonic_balance import HarmonicBalance, balance
from qcar_env.analysis.paper import calibration
from qcar_env.analysis.paper.averaging import slow_motion
from qcar_env.analysis.paper.describing_functions import average_force
from qcar_env.analysis.paper.experiments import (
    EFFECTS,
    folded_response,
    parameter_effect,
    trends,
)
from qcar_env.analysis.paper.fixed_points import solutions
from qcar_env.analysis.paper.forced_car import stack, sweep
from qcar_env.analysis.paper.frequency_response import response
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.analysis.paper.parameter_study import cases, response_curves
from qcar_env.analysis.paper.routh_hurwitz import routh_hurwitz
from qcar_env.analysis.paper.stability import first_loss, stability_map
from qcar_env.analysis.periodic_orbit import flow_map, orbit_states, periodic_orbits
from qcar_env.control import CNVC

NO_NUMBER = [None, "1", math.nan, math.inf, 10**400, np.ones(2)]
NO_POSITIVE = [*NO_NUMBER, 0.0, -1.0]
NO_COUNT = [*NO_NUMBER, -1, 1.5, 10**9]
NO_NUMBERS = [None, "ab", [0.1, math.nan], [0.1, "1"], [0.1, [0.2]], [0.1, 1j]]
NO_STATES = [None, "abcd", np.zeros(4), np.zeros((3, 1)), np.zeros((4, 2)), [[0.0], [1.0, 2.0]]]
RNG = np.random.default_rng(0)
LINE = continuation.Equations(
    residual=lambda z, p: z - p, jacobian=lambda z, p: np.ones((z.shape[1], 1, 1))
)
AT_REST = np.zeros((4, 1))


def follow(**given):
    return continuation.follow(LINE, **{"z": [0.0], "p_start": 0.0, "p_end": 1.0, **given})


def motions(car):
    return balance(stack([car]), harmonics=3)


CALLS = [
    ("t", lambda car, v: slow_motion(car, v), [*NO_NUMBERS, 1.0, [], [1.0], [1.0, 0.5], np.eye(2)]),
    ("start", lambda car, v: slow_motion(car, [0, 1], start=v), [*NO_NUMBERS[:-1], 1j, (1, 2, 3)]),
    ("samples", lambda car, v: average(car, v), [*NO_COUNT, 3]),
    ("h", lambda car, v: dataclasses.replace(car, h=v), NO_NUMBER),
    ("car", lambda car, v: dataclasses.replace(car, car=v), [None, 5]),
    ("law", lambda car, v: dataclasses.replace(car, law=v), [None, "cnvc", CNVC]),
    ("factor", lambda car, v: trends(car, factor=v), NO_POSITIVE),
    ("threshold", lambda car, v: trends(car, threshold=v), [*NO_NUMBER, -1.0]),
    ("factor", lambda car, v: parameter_effect(car, EFFECTS[0], "h", factors=[v]), NO_NUMBER),
    ("points", lambda car, v: folded_response(car, "h", 0.1, 0.2, points=v), [*NO_COUNT, 0, 1]),
    ("omega", lambda car, v: car.vary("omega", v), NO_POSITIVE),
    ("sigma1", lambda car, v: car.vary("sigma1", v), NO_NUMBER),
    ("values of h", lambda car, v: list(sweep(car, "h", v)), NO_NUMBERS),
    ("alpha2", lambda car, v: Hardening(alpha2=v), NO_NUMBER),
    ("start", lambda car, v: response(car, "h", v, 0.2), NO_NUMBER),
    ("end", lambda car, v: response(car, "h", 0.1, v), NO_NUMBER),
    ("harmonics", lambda car, v: response(car, "h", 0.1, 0.2, harmonics=v), [*NO_COUNT, 0]),
    ("guess", lambda car, v: response(car, "h", 0.1, 0.2, guess=v), [1j, "ab", (1, math.nan)]),
    ("max_points", lambda car, v: response(car, "h", 0.1, 0.2, max_points=v), NO_COUNT),
    ("starts", lambda car, v: solutions(car, RNG, starts=v), [*NO_COUNT, 0]),
    ("largest", lambda car, v: solutions(car, RNG, largest=v), NO_POSITIVE[1:]),
    ("z", lambda car, v: follow(z=v), [None, "1", 1.0, [], [[0.0]], [1j]]),
    ("p_start", lambda car, v: follow(p_start=v), NO_NUMBER),
    ("p_scale", lambda car, v: follow(p_scale=v), NO_POSITIVE[1:]),
    ("longest", lambda car, v: follow(longest=v), NO_POSITIVE),
    ("harmonics", lambda car, v: HarmonicBalance(system=stack([car]), harmonics=v), [*NO_COUNT, 0]),
    ("samples", lambda car, v: balance(stack([car]), harmonics=3, samples=v), NO_COUNT[1:]),
    ("start", lambda car, v: balance(stack([car]), start=v), NO_STATES[1:]),
    ("harmonic", lambda car, v: motions(car).amplitude(v), [*NO_COUNT, 0, 4]),
    ("start", lambda car, v: periodic_orbits(stack([car]), v), [*NO_STATES, 1j * AT_REST]),
    ("steps", lambda car, v: next(orbit_states(stack([car]), AT_REST, steps=v)), [*NO_COUNT, 0]),
    ("periods", lambda car, v: flow_map(stack([car]), AT_REST, periods=v), NO_COUNT),
    ("start", lambda car, v: poincare_section(stack([car]), v), NO_STATES),
    ("settle", lambda car, v: poincare_section(stack([car]), AT_REST, settle=v), NO_COUNT),
    ("periods", lambda car, v: poincare_section(stack([car]), AT_REST, periods=v), [*NO_COUNT, 0]),
    ("start", lambda car, v: largest_lyapunov_exponent(stack([car]), v, RNG), NO_STATES),
    ("settle", lambda car, v: lyapunov(car, settle=v), NO_COUNT),
    ("periods", lambda car, v: lyapunov(car, periods=v), [*NO_COUNT, 0]),
    ("start", lambda car, v: first_loss(car, "h", v, 0.2), NO_NUMBER),
    ("samples", lambda car, v: first_loss(car, "h", 0.1, 0.2, samples=v), [*NO_COUNT, 0, 1]),
    ("values of h", lambda car, v: stability_map(car, "h", v, "f", [1.0]), NO_NUMBERS),
    ("values of f", lambda car, v: stability_map(car, "h", [0.1], "f", v), NO_NUMBERS),
    ("matrices", lambda car, v: routh_hurwitz(v), [np.eye(4), np.zeros((2, 3, 3)), None]),
    ("values of h", lambda car, v: cases(car, {"h": v}), NO_NUMBERS),
    ("parameter", lambda car, v: cases(car, v), [None, 5, "h", ["h"]]),
    ("start", lambda car, v: response_curves(car, "h", v, 0.2, [{}]), NO_NUMBER),
    ("omegas?", lambda car, v: calibration.profile(candidate(car), v), [None, 5.0, [], [None]]),
    ("fit", lambda car, v: calibration.fit(candidate(car), fitted=v), [None, "b1", []]),
    ("b1", lambda car, v: dataclasses.replace(candidate(car), b1=v), [*NO_NUMBER, -1.0]),
    ("zeta_ndf", lambda car, v: dataclasses.replace(candidate(car), zeta_ndf=v), NO_POSITIVE),
]  # fmt: skip


def average(car, samples):
    one = np.ones(1, dtype=complex)
    gains, omega = stack([car]).gains, np.array([car.omega])
    return average_force(gains, one, one, omega1=omega, omega2=omega, samples=samples)


def lyapunov(car, **given):
    return largest_lyapunov_exponent(stack([car]), AT_REST, RNG, **given)


def candidate(car):
    return calibration.candidate_of(car)


@pytest.mark.parametrize(
    ("name", "call", "value"),
    [
        pytest.param(name, call, value, id=f"{number} {name}")
        for number, (name, call, values) in enumerate(CALLS)
        for value in values
    ],
)
def test_a_number_that_is_none_is_refused_by_name(paper, name, call, value):
    with pytest.raises(ValueError, match=rf"\b{name}\b.*got ") as caught:
        call(paper, value)
    assert len(str(caught.value)) < 500


def test_counts_may_be_floats_that_are_whole(paper):
    system = stack([paper])
    assert poincare_section(system, AT_REST, periods=2.0, settle=1.0, steps=16.0).shape == (4, 1, 2)
    assert lyapunov(paper, periods=2.0, settle=1.0, steps=16.0).history.shape == (2, 1)
    assert balance(system, harmonics=3.0, samples=16.0).amplitude(3.0).shape == (4, 1)
    np.testing.assert_array_equal(average(paper, 16.0), average(paper, 16))


def test_numbers_are_kept_as_plain_ones(paper):
    given = dataclasses.replace(paper, h=np.array(2), f=np.float32(3.0), omega=np.int64(55))
    plain = dataclasses.replace(paper, h=2.0, f=3.0, omega=55.0)
    assert (given, hash(given), repr(given)) == (plain, hash(plain), repr(plain))
    assert repr(Hardening(alpha1=np.float64(1.0))) == repr(Hardening(alpha1=1))
    assert repr(dataclasses.replace(candidate(paper), h=np.array(1))) == repr(
        dataclasses.replace(candidate(paper), h=1.0)
    )
