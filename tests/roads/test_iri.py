"""The International Roughness Index: printed numbers, and laws that it obeys."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import trapezoid

from qcar_env.roads.iri import (
    A,
    B,
    golden_car,
    international_roughness_index,
    suspension_slopes,
)
from qcar_env.roads.iso8608 import CLASSES, HIGHEST, ISO8608, LOWEST, spectrum

PROFILE = Path(__file__).parents[1] / "data" / "roads" / "profile_1.txt"

# As printed for 0.25 m at 80 km/h in older programs and since (michalsorel/iri, python/iri.py)
S = """
.9966071 .01091514 -.002083274 .0003190145
-.5563044 .9438768 -.8324718 .05064701
.02153176 .002126763 .7508714 .008221888
3.335013 .3376467 -39.12762 .4347564
"""
P = ".005476107 1.388776 .2275968 35.79262"


@pytest.mark.parametrize(("name", "printed"), [("S", S), ("P", P)])
def test_the_golden_car_has_the_printed_digits_up_to_their_single_precision(name, printed):
    """Four roundings of it; .005476107 is a difference from 1 and lost its last four digits."""
    found = getattr(golden_car(0.25), name).ravel()
    for value, digits in zip(found, map(float, printed.split()), strict=True):
        assert abs(value - digits) <= 4.0 * 2.0**-23 * max(1.0, abs(digits))


@given(spacing=st.floats(1e-3, 0.9))
def test_a_gradient_without_end_moves_no_suspension(spacing):
    """Z = (1, 0, 1, 0) stays under u = 1, which fixes P from S: P[0] = 1 - S[0, 0] - S[0, 2]."""
    car = golden_car(spacing)
    steady = np.array([1.0, 0.0, 1.0, 0.0])
    assert car.S @ steady + car.P == pytest.approx(steady, abs=1e-11)


@given(spacing=st.floats(1e-3, 0.5), parts=st.integers(2, 9))
def test_steps_that_are_small_add_up_to_a_large_one(spacing, parts):
    small, large = golden_car(spacing / parts), golden_car(spacing)
    z = np.zeros(4)
    for _ in range(parts):
        z = small.S @ z + small.P
    # rounding of entries of up to 650
    assert np.linalg.matrix_power(small.S, parts) == pytest.approx(large.S, abs=1e-10)
    assert z == pytest.approx(large.P, abs=1e-10)


def test_a_measured_profile():
    """michalsorel/iri, profile_1.txt: 3.335 m/km, computed by another program of the same steps."""
    s, y = np.loadtxt(PROFILE).T
    assert np.diff(s) == pytest.approx(0.25, abs=1e-9)
    assert international_roughness_index(y, spacing=0.25) == pytest.approx(3.3354, abs=1e-4)


def test_a_triangle_gives_the_series_of_its_table():
    """2 mm high, from 1 m over 3 m to 5 m, as in World Bank Technical Paper 46: IRI so far."""
    s = np.arange(0.0, 30.25, 0.25)
    y = np.interp(s, [1.0, 3.0, 5.0], [0.0, 0.002, 0.0])
    moved = 1000.0 * np.abs(suspension_slopes(y, spacing=0.25))
    table = {
        2: 0.37738, 3: 0.47518, 4: 0.665619, 5: 0.78293, 6: 0.701181, 8: 0.576496, 10: 0.50867,
        15: 0.371304, 20: 0.295143, 25: 0.241392, 30: 0.204955,
    }  # fmt: skip
    for end, expected in table.items():
        assert moved[: 4 * end].mean() == pytest.approx(expected, abs=1e-5)


profiles = st.lists(st.floats(-0.1, 0.1), min_size=60, max_size=90).map(np.array)


@given(y=profiles, factor=st.floats(-3.0, 3.0), rise=st.floats(-0.1, 0.1), up=st.floats(-9.0, 9.0))
def test_it_scales_with_the_heights_and_knows_neither_level_nor_gradient(y, factor, rise, up):
    one = international_roughness_index(y, spacing=0.2)
    scaled = international_roughness_index(factor * y, spacing=0.2)
    assert scaled == pytest.approx(abs(factor) * one, rel=1e-9, abs=1e-9)
    tilted = y + up + rise * 0.2 * np.arange(y.size)
    assert international_roughness_index(tilted, spacing=0.2) == pytest.approx(one, abs=1e-7)


def exact(G):
    """The IRI of an endless road of a class: the mean of |Gaussian| is sqrt(2 / pi) sigma.

    The variance of z2' - z1' is the integral of the slope's spectrum (2 pi n)^2 Gd times |H|^2
    times that of the average over 0.25 m.
    """
    n = np.geomspace(LOWEST, HIGHEST, 4000)
    jw = 2j * math.pi * n * 80.0 / 3.6
    z = np.linalg.solve(jw[:, None, None] * np.eye(4) - A, np.tile(B[:, None], (n.size, 1, 1)))
    gain = np.abs(z[:, 0, 0] - z[:, 2, 0]) * np.sinc(0.25 * n)
    sigma = math.sqrt(trapezoid((gain * 2.0 * math.pi * n) ** 2 * spectrum(n, G), n))
    return 1000.0 * math.sqrt(2.0 / math.pi) * sigma


@pytest.mark.parametrize("name", "ABCD")
def test_a_road_of_iso_8608_has_the_index_of_its_spectrum(name):
    roads = [ISO8608.of_class(name, L=1000.0, seed=seed) for seed in range(4)]
    s = np.arange(0.0, 1000.0, 0.05)
    found = [international_roughness_index(road.heights(s), spacing=0.05) for road in roads]
    # the car remembers 10 m or so: 4 km are 400 draws, whose mean of |x| scatters by 4 %
    assert np.mean(found) == pytest.approx(exact(CLASSES[name]), rel=0.06)


def test_the_classes_a_to_d_have_plausible_indices():
    """Twice as much per class, and on the scale of the index.

    World Bank Technical Paper 46 (recalled): airport runways and motorways 0.3 to 2 m/km, new
    pavements 1.5 to 3.5, older 2.5 to 6, unpaved and damaged 4 to 11, rough unpaved 8 to 20.
    """
    found = [exact(CLASSES[name]) for name in "ABCD"]
    assert found[1:] == pytest.approx([2.0 * each for each in found[:-1]])
    for each, (low, high) in zip(found, [(1, 3), (2.5, 6), (4, 11), (8, 20)], strict=True):
        assert low < each < high


@pytest.mark.parametrize(
    ("heights", "spacing", "message"),
    [
        (np.zeros(99), 1.0, "spacing must be below 1 m, got 1 m; the index is not defined"),
        (np.zeros(99), 0.0, "spacing must be positive, got 0 m"),
        (np.zeros(40), 0.25, "must be the samples of at least 11 m, got shape (40,) at 0.25 m;"),
        (np.zeros((99, 2)), 0.25, "must be the samples of at least 11 m, got shape (99, 2)"),
        ([0.0] * 98 + [math.nan], 0.25, "heights must be finite [m], got"),
        (["a"] * 99, 0.25, "heights must be finite [m], got"),
    ],
)
def test_bad_profiles_are_refused_with_name_value_and_remedy(heights, spacing, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        international_roughness_index(heights, spacing=spacing)
    assert message in str(error.value)
