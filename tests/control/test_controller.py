import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.signal import lfilter

from qcar_env.control.controller import Controller, feedback, times
from qcar_env.control.pid import FILTER, pid


@given(n=st.integers(1, 9), m=st.integers(0, 5), k=st.integers(0, 6), seed=st.integers(0, 99))
def test_a_row_does_not_know_of_the_others(n, m, k, seed):
    rng = np.random.default_rng(seed)
    matrix, rows = rng.normal(size=(m, k)), rng.normal(size=(n, k))
    together = times(matrix, rows)
    np.testing.assert_allclose(together, rows @ matrix.T, atol=1e-12)
    alone = [times(matrix, each[np.newaxis])[0] for each in rows]
    np.testing.assert_array_equal(together, np.array(alone).reshape(n, m))


def test_matrices_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"matrix D of P must have shape \(2,\), got \(1,\)"):
        Controller(name="P", signals=("v2", "v1"), D=[1.0])
    with pytest.raises(ValueError, match="matrix D of P must be finite"):
        feedback("P", {"v2": np.nan})
    with pytest.raises(ValueError, match="unknown signal 'v3'"):
        feedback("P", {"v3": 1.0})


def run(controller, readings, limit=np.inf):
    """Return the forces over a series of readings (k,)."""
    z, out = np.zeros((1, controller.memory)), []
    for value in readings:
        r = np.array([[value]])
        F = controller.asked(z, r)
        given = np.clip(F, -limit, limit)
        z = controller.following(z, r, given)
        out.append(F[0])
    return np.array(out)


def test_pid_is_its_transfer_function():
    dt, Kp, Ki, Kd = 0.005, 2000.0, 9000.0, 60.0
    r = np.random.default_rng(0).normal(size=400)
    Tf = Kd / Kp / FILTER
    derivative = lfilter([Kd / (Tf + dt), -Kd / (Tf + dt)], [1.0, -Tf / (Tf + dt)], r)
    integral = lfilter([0.0, Ki * dt], [1.0, -1.0], r)  # of what has been read before
    found = run(pid(dt, Kp=Kp, Ki=Ki, Kd=Kd), r)
    np.testing.assert_allclose(found, -(Kp * r + integral + derivative), rtol=1e-9, atol=1e-6)


def test_a_saturated_pid_lets_go_within_its_tracking_time():
    error = np.concatenate([np.ones(400), -0.1 * np.ones(100)])
    free = run(pid(0.005, Kp=1000.0, Ki=9000.0, Kd=0.0, Tt=1e9), error, 1500.0)
    held = run(pid(0.005, Kp=1000.0, Ki=9000.0, Kd=0.0, Tt=0.05), error, 1500.0)
    assert free[-1] < -10_000.0  # wound up over two seconds, and still there
    assert abs(held[-1]) < 1500.0


def test_pid_without_integral_and_derivative_is_a_damper_to_the_sky():
    r = np.random.default_rng(1).normal(size=50)
    np.testing.assert_allclose(run(pid(0.005, Kp=2000.0, Ki=0.0, Kd=0.0), r), -2000.0 * r)


def test_bad_gains_are_refused():
    with pytest.raises(ValueError, match="gain Ki must not be negative, got -1 N/s"):
        pid(0.005, Kp=1.0, Ki=-1.0, Kd=0.0)
    with pytest.raises(ValueError, match="Tt must be positive"):
        pid(0.005, Kp=1.0, Ki=1.0, Kd=0.0, Tt=0.0)
