"""Random roads: their spectrum is that of the class, and their seed is used."""

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import welch

from qcar_env.roads.iso8608 import CLASSES, HIGHEST, ISO8608, LOWEST, N0


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("interval", [0.05, 0.11])
def test_the_spectrum_is_that_of_the_class_whatever_the_sampling(name, interval):
    """Within 1 dB in each octave of the band, by Welch's method."""
    road = ISO8608.of_class(name, L=4000.0, seed=3)
    y = road.heights(np.arange(0.0, 4000.0, interval))
    n, found = welch(y, 1.0 / interval, nperseg=round(800.0 / interval), detrend="constant")
    for low in 0.02 * 2.0 ** np.arange(7):  # [1/m], 0.02 to 2.56
        inside = (n >= low) & (n < 2.0 * low)
        # a mean over the octave of the ratio to the standard's Gd
        ratio = (found[inside] / (CLASSES[name] * (n[inside] / N0) ** -2.0)).mean()
        assert abs(10.0 * math.log10(ratio)) < 1.0


@pytest.mark.parametrize("name", "ABCD")
def test_many_short_roads_have_the_spectrum_of_the_class(name):
    """Within 1 dB in each third of an octave, over twenty roads of 300 m."""
    s = np.arange(0.0, 300.0, 0.1)
    roads = [ISO8608.of_class(name, L=300.0, seed=seed).heights(s) for seed in range(20)]
    n, found = welch(np.array(roads), 10.0, nperseg=1500, detrend="linear")
    for low in 0.03 * 2.0 ** (np.arange(19) / 3.0):  # [1/m], 0.03 to 2.4
        inside = (n >= low) & (n < 2.0 ** (1.0 / 3.0) * low)
        ratio = (found[:, inside] / (CLASSES[name] * (n[inside] / N0) ** -2.0)).mean()
        assert abs(10.0 * math.log10(ratio)) < 1.0


def test_the_classes_are_the_standards_geometric_means():
    """ISO 8608: A 16, B 64, C 256, D 1024, E 4096 ... times 1e-6 m^3."""
    assert list(CLASSES) == list("ABCDEFGH")
    assert [CLASSES[each] * 1e6 for each in "ABCDE"] == pytest.approx([16, 64, 256, 1024, 4096])


def test_the_variance_is_the_integral_of_the_spectrum():
    road = ISO8608.of_class("B", L=2000.0, seed=1)
    y = road.heights(np.linspace(0.0, 2000.0, 40_001)[:-1])
    # int G n0^2 / n^2 dn over the band; the first of the waves stands for half a dn more
    exact = CLASSES["B"] * N0 * N0 * (1.0 / LOWEST - 1.0 / HIGHEST)
    assert y.var() == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize("spacing", [0.02, 0.05, 0.06])
def test_it_is_its_sum_of_waves_whatever_the_spacing(spacing):
    road = ISO8608(G=CLASSES["C"], L=120.0, seed=7, start=5.0, spacing=spacing)
    n, amplitudes, phases = road.waves
    s = np.linspace(0.0, 120.0, 999)
    angles = 2.0 * math.pi * n * s[:, None] + phases
    y = (amplitudes * np.cos(angles)).sum(axis=1)
    slope = -(amplitudes * 2.0 * math.pi * n * np.sin(angles)).sum(axis=1)[:-1]
    y0 = (amplitudes * np.cos(phases)).sum()
    error = np.abs(road.heights(5.0 + s) - (y - y0)).max()
    # the spline errs by (k d)^4 / 384 of each wave, most in the shortest; those of 340 waves, which
    # grow with the cube of the wavenumber, add up to sqrt(340 / 14) = 5 of it, peaks to 4 sigma
    assert error < (2.0 * math.pi * HIGHEST * spacing) ** 4 / 384.0 * 20.0 * amplitudes[-1]
    assert road.slopes(5.0 + s[:-1]) == pytest.approx(slope, abs=0.15 * np.std(slope))
    assert n[0] >= LOWEST
    assert n[-1] <= HIGHEST


def test_it_begins_and_ends_on_the_flat_at_height_zero():
    road = ISO8608.of_class("E", L=150.0, seed=2, start=10.0)
    assert road.heights([0.0, 10.0, 160.0, 200.0]).tolist() == [0.0, 0.0, 0.0, 0.0]
    assert road.kinks(0.0, 500.0) == [10.0, 160.0]


def test_a_seed_accepted_is_a_seed_used():
    make = "ISO8608.of_class('C', L=100.0, seed={}).table.tobytes()"
    one, same, other = (ISO8608.of_class("C", L=100.0, seed=i).table for i in (5, 5, 6))
    assert one.tobytes() == same.tobytes()
    assert not np.allclose(one[-400:], other[-400:])
    code = (
        "import hashlib; from qcar_env.roads.iso8608 import ISO8608; "
        f"print(hashlib.sha256({make.format(5)}).hexdigest())"
    )
    import hashlib

    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == hashlib.sha256(one.tobytes()).hexdigest()


def test_a_rougher_class_is_the_same_road_but_higher():
    a, b = (ISO8608.of_class(name, L=100.0, seed=5) for name in "AB")
    s = np.linspace(0.0, 100.0, 77)
    assert b.heights(s) == pytest.approx(2.0 * a.heights(s), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(seed=-1), "seed must be at least 0, got -1"),
        (dict(seed=1.5), "seed must be a whole number, got 1.5"),
        (dict(seed=None), "seed must be a whole number, got None"),
        (dict(L=50.0), "must hold the longest wave of 90.9091 m, got 50 m; give a longer road"),
        (dict(L=-1.0), "road length L must be positive, got -1 m"),
        (dict(G=0.0), "spectrum at 0.1 1/m G must be positive, got 0 m^3"),
        (dict(lowest=3.0), "must hold a whole number of waves in 100 m, got 3 to 2.83 1/m"),
        (dict(spacing=0.1), "a quarter of the shortest wave, 0.0883392 m, got 0.1 m; give"),
    ],
)
def test_bad_input_is_refused_with_name_value_and_remedy(changes, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        dataclasses.replace(ISO8608.of_class("C", L=100.0, seed=1), **changes)
    assert message in str(error.value)


def test_an_unknown_class_is_refused():
    with pytest.raises(ValueError, match="unknown road class 'Z'"):
        ISO8608.of_class("Z", L=100.0, seed=1)
