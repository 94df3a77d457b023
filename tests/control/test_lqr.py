import numpy as np
import pytest

from qcar_env.control import lqr
from qcar_env.control.lqr import Weights
from qcar_env.physics import linear
from qcar_env.scenarios import scenario

PAPER = scenario("paper")
A = np.array(PAPER.reference_amplitudes)
SCALE = np.concatenate([A, 55.0 * A])
PUSH = np.diag(PAPER.actuator.limit)
PLANT = lqr.sampled_plant(PAPER.car, SCALE, PUSH, PAPER.dt)


def test_the_scaled_plant_is_the_plant():
    a, b = linear.held_transition(PAPER.car, PAPER.dt)
    x, u = np.array([0.1, -0.2, 3.0, 4.0]), np.array([100.0, -20.0])
    np.testing.assert_allclose(
        SCALE * (PLANT.A @ (x / SCALE) + PLANT.B @ (u / np.array([280.0, 33.0]))),
        a @ x + b @ u,
        rtol=1e-12,
    )


def test_the_cost_to_go_is_the_cost():
    weights = Weights(q1=2.0, q2=0.5, r1=0.1, r2=0.01)
    k = lqr.regulator(PLANT, weights)
    x = start = np.array([1.0, -0.5, 0.2, 0.7])
    q = np.diag([2.0, 0.5, 2.0, 0.5])
    total = 0.0
    for _ in range(4000):
        u = -k @ x
        total += x @ q @ x + u @ np.diag([0.1, 0.01]) @ u
        x = PLANT.A @ x + PLANT.B @ u
    assert total == pytest.approx(start @ lqr.cost_to_go(PLANT, weights) @ start, rel=1e-9)


def test_no_other_gain_is_cheaper():
    weights = Weights()
    best = lqr.regulator(PLANT, weights)
    value = lqr.cost_to_go(PLANT, weights)
    rng = np.random.default_rng(0)
    q, r = np.eye(4), 1e-3 * np.eye(2)
    for _ in range(20):
        k = best + 0.1 * rng.normal(size=best.shape)
        x = start = rng.normal(size=4)
        total = 0.0
        for _ in range(2000):
            u = -k @ x
            total += x @ q @ x + u @ r @ u
            x = PLANT.A @ x + PLANT.B @ u
        assert total >= start @ value @ start


def test_held_mean_is_the_mean_of_the_sinusoid():
    tau = (np.arange(2000) + 0.5) / 2000 * 0.005
    p = np.sin(1.1 + 55.0 * tau)
    a, b = lqr.held_mean(55.0, 0.005)
    assert a * np.sin(1.1) + b * np.cos(1.1) == pytest.approx(p.mean(), rel=1e-7)
    assert lqr.held_mean(0.0, 0.005) == (1.0, 0.0)


def test_feedforward_cancels_the_mean_disturbance_of_the_interval():
    k = lqr.feedforward(PAPER.car, PUSH, 55.0, 55.0, 0.005)
    t = 0.321
    tau = t + (np.arange(2000) + 0.5) / 2000 * 0.005
    y, rate = PAPER.excitation.height(tau), PAPER.excitation.rate(tau)
    wheel = np.mean(PAPER.car.mu1 * y + PAPER.car.mu2 * rate)
    body = np.mean(PAPER.force.value(tau))
    seen = [
        PAPER.excitation.height(t),
        PAPER.excitation.rate(t),
        PAPER.force.value(t),
        PAPER.force.rate(t),
    ]
    np.testing.assert_allclose(PUSH @ k @ seen, [-wheel, -body], rtol=1e-6)


def test_the_internal_model_finds_the_disturbance():
    model = lqr.internal_model(PLANT, 55.0)
    rng = np.random.default_rng(0)
    z = np.concatenate([rng.normal(size=4), rng.normal(size=4)])
    guess = np.zeros(8)
    for _ in range(300):
        guess = guess + model.correction @ (z[:4] - guess[:4])
        u = rng.uniform(-1.0, 1.0, 2)  # whatever the actuators do, the filter is told
        z = model.transition @ z + model.into @ u
        guess = model.transition @ guess + model.into @ u
    # The filter's poles: its error has died out in 300 samples.
    np.testing.assert_allclose(guess, z, atol=1e-6)


def test_the_oscillators_turn_at_the_forcing_frequency():
    model = lqr.internal_model(PLANT, 55.0)
    turned = model.transition[4:6, 4:6]
    angle = 55.0 * 0.005
    np.testing.assert_allclose(
        turned, [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]], atol=1e-12
    )


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="weight r1 must be positive"):
        Weights(r1=0.0)
    with pytest.raises(ValueError, match="drift must be positive"):
        lqr.internal_model(PLANT, 55.0, drift=0.0)
    with pytest.raises(ValueError, match="omega must be positive"):
        lqr.internal_model(PLANT, 0.0)


@pytest.mark.parametrize(
    ("name", "given"),
    [("omega", (-1.0, 55.0, 0.005)), ("Omega", (55.0, None, 0.005)), ("dt", (55.0, 55.0, 0.0))],
)
def test_a_feedforward_is_of_numbers_in_range(name, given):
    with pytest.raises(ValueError, match=f"^{name} must .*, got "):
        lqr.feedforward(PAPER.car, np.eye(2), *given)
