"""Frequency weightings: the standard's tables, and that a record is weighted exactly."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal
from scipy.linalg import expm

from qcar_env.evaluation import comfort
from qcar_env.evaluation.weighting import WEIGHTINGS, Weighting, find_weighting, recursion, weighted

# ISO 8041-1:2017, annex B: Wk at 10^(n/10) Hz, n = -10..26
TABLE = np.array(
    """.03121 .04931 .07756 .1207 .1832 .2644 .3504 .4188 .4588 .4767 .4825 .4846 .4935 .5308 .6335
    .8071 .9648 1.039 1.054 1.037 .9884 .8989 .7743 .6373 .5103 .4031 .316 .2451 .1857 .1339 .08873
    .05311 .02922 .01528 .007795 .003935 .001978""".split(),
    dtype=float,
)
FREQUENCY = 10.0 ** (np.arange(-10, 27) / 10.0)

# The same, table 8: cycles of a saw-tooth of 100 rad/s and 1 m/s^2, from 1 s on in every 10 s, for
# 60 s; root mean square, VDV, MTVV linear and exponential of Wk
BURSTS = {
    1: (0.0299, 0.323, 0.0944, 0.0922),
    2: (0.0411, 0.380, 0.130, 0.125),
    4: (0.0577, 0.455, 0.182, 0.171),
    8: (0.0814, 0.543, 0.257, 0.228),
    16: (0.115, 0.648, 0.363, 0.289),
}
WB_BURST = (0.0314, 0.342, 0.0991, 0.0968)  # of one cycle


def bursts(cycles, dt):
    """Return the saw-tooth, which begins at a zero crossing upward."""
    t = np.arange(0.0, 60.0, dt)
    turned = 100.0 * np.mod(t - 1.0, 10.0) / (2.0 * np.pi)
    return (2.0 * np.mod(turned + 0.5, 1.0) - 1.0) * ((t >= 1.0) & (turned < cycles))


def judged(a, dt, name):
    aw = weighted(a, dt, name)
    return (
        comfort.weighted_rms(aw),
        comfort.vdv(aw, dt),
        comfort.mtvv(aw, dt),
        comfort.mtvv(aw, dt, "exponential"),
    )


def test_wk_is_that_of_the_table():
    """To a tenth of a per cent, what four printed digits allow; the standard's own is 26 %."""
    found = np.abs(WEIGHTINGS["Wk"].response(FREQUENCY))
    assert found == pytest.approx(TABLE, rel=1e-3)


@pytest.mark.parametrize("cycles", list(BURSTS))
def test_bursts_are_those_of_the_standard(cycles):
    """To a digit of the three that are printed; the standard's tolerance is 10 and 12 %."""
    found = judged(bursts(cycles, 1.0 / 4_000.0), 1.0 / 4_000.0, "Wk")
    assert found == pytest.approx(BURSTS[cycles], rel=0.005)


def test_a_burst_of_wb_is_that_of_the_standard():
    assert judged(bursts(1, 2.5e-4), 2.5e-4, "Wb") == pytest.approx(WB_BURST, rel=0.005)


@pytest.mark.parametrize("name", list(WEIGHTINGS))
def test_scipy_and_the_optimum_take_a_weighting_as_it_is(name):
    one = WEIGHTINGS[name]
    _, found = signal.freqresp(signal.lti(*one), 2.0 * np.pi * FREQUENCY)
    assert one.response(FREQUENCY) == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("frequency", [0.5, 4.0, 20.0, 40.0, 63.0, 80.0])
def test_a_sine_in_a_record_of_200_hz_has_the_analogue_gain(frequency):
    """Once the start has faded. The bilinear transform is 15 % low at 40 Hz, and half at 63."""
    dt = 0.005
    t = dt * np.arange(4_000)
    fades_in = np.minimum(1.0, t / 5.0) * np.minimum(1.0, (t[-1] - t) / 5.0)
    aw = weighted(fades_in * np.sin(2.0 * np.pi * frequency * t), dt)
    middle = slice(1_600, 2_400)  # 4 s, whole cycles
    amplitude = np.sqrt(2.0) * comfort.weighted_rms(aw[middle])
    assert amplitude == pytest.approx(abs(WEIGHTINGS["Wk"].response(frequency)), rel=1e-3)


def test_a_smooth_pulse_is_weighted_as_by_the_exact_state_space():
    """Its spectrum ends far below 100 Hz: one record of 200 Hz, one stepped by expm at 20 kHz."""
    dt, fine = 0.005, 100
    t = (dt / fine) * np.arange(400 * fine)
    pulse = np.exp(-0.5 * ((t - 0.5) / 0.02) ** 2)  # 3e-6 of its spectrum is above 40 Hz
    lti = signal.lti(*WEIGHTINGS["Wk"]).to_ss()
    size = len(lti.A)
    exact = expm((dt / fine) * np.block([[lti.A, lti.B], [np.zeros((1, size + 1))]]))
    z, out = np.zeros(size), np.empty(len(t))
    middle = np.exp(-0.5 * ((t + 0.5 * dt / fine - 0.5) / 0.02) ** 2)  # held: second order
    for k, (now, held) in enumerate(zip(pulse, middle, strict=True)):
        out[k] = lti.C[0] @ z + lti.D[0, 0] * now
        z = exact[:size, :size] @ z + exact[:size, size] * held
    found = weighted(pulse[::fine], dt)
    assert found == pytest.approx(out[::fine], abs=2e-6)


@given(
    seed=st.integers(0, 1_000),
    shift=st.integers(0, 300),
    scale=st.floats(-1e3, 1e3),
    name=st.sampled_from(list(WEIGHTINGS)),
)
@settings(max_examples=25, deadline=None)
def test_weighting_is_linear_and_knows_no_time_and_starts_from_rest(seed, shift, scale, name):
    dt = 0.005
    a = np.random.default_rng(seed).normal(size=(400, 2))
    aw = weighted(a, dt, name)
    late = weighted(np.concatenate([np.zeros((shift, 2)), a]), dt, name)
    # what samples cannot hold rings through the record, some 1e-3 of its size
    assert late[shift:] == pytest.approx(aw, abs=5e-3)
    both = weighted(a[:, 0] + scale * a[:, 1], dt, name)
    assert both == pytest.approx(aw[:, 0] + scale * aw[:, 1], abs=1e-9 * (1.0 + abs(scale)))
    assert weighted(a[:, 0], dt, name) == pytest.approx(aw[:, 0], abs=1e-12)


def test_the_end_of_a_record_does_not_reach_its_beginning():
    """Circular weighting would answer at the beginning to the step at the end."""
    a = np.zeros(2_000)
    a[1_900:] = 1.0
    aw = weighted(a, 0.005)
    assert np.abs(aw[:1_700]).max() < 1e-3
    assert np.abs(aw[1_900:]).max() > 0.3


def test_a_weighting_of_ones_own_is_taken():
    lag = Weighting((), (-10.0 + 0.0j,), 10.0)
    t = 0.005 * np.arange(400)
    smooth = np.sin(np.pi * t) ** 2  # of 1 Hz
    steady = abs(lag.response(1.0)) * 0.5
    aw = weighted(smooth, 0.005, lag)
    assert aw[200:].max() - aw[200:].min() == pytest.approx(2.0 * steady, rel=0.01)
    assert find_weighting(lag) is lag


@pytest.mark.parametrize("name", list(WEIGHTINGS))
@pytest.mark.parametrize("frequency", [1.0, 8.0, 20.0, 50.0])
def test_sample_by_sample_a_sine_loses_what_lines_between_samples_take(name, frequency):
    """The spectrum of a line between samples is sinc^2."""
    dt = 0.005
    a = np.sin(2.0 * np.pi * frequency * dt * np.arange(4_000))
    filter = recursion(dt, name)
    z, found = filter.start(2), np.zeros((4_000, 2))
    for k in range(1, 4_000):
        z, found[k] = filter.step(z, [a[k - 1], 0.0], [a[k], 0.0])
    gain = abs(WEIGHTINGS[name].response(frequency)) * np.sinc(frequency * dt) ** 2
    amplitude = np.sqrt(2.0) * comfort.weighted_rms(found[3_000:, 0])
    assert amplitude == pytest.approx(gain, rel=0.01 if frequency < 30.0 else 0.07)
    assert not np.any(found[:, 1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: weighted([1.0], 0.005, "Wz"), "unknown weighting 'Wz'"),
        (lambda: weighted([], 0.005), r"must have shape \(k,\) or \(k, n\)"),
        (lambda: weighted(np.zeros((2, 2, 2)), 0.005), r"got \(2, 2, 2\)"),
        (lambda: weighted([np.nan], 0.005), "acceleration must be finite"),
        (lambda: weighted([1.0], 0.0), "dt must be positive, got 0 s"),
        (lambda: find_weighting(Weighting((), (1.0 + 0.0j,), 1.0)), "must be a stable filter"),
        (lambda: find_weighting(Weighting((0j, 0j), (-1.0 + 0j,), 1.0)), "must be a stable filter"),
    ],
)
def test_what_is_no_record_or_filter_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
