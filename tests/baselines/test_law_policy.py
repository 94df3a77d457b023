"""A law as a policy: its filter between samples, its memory, its force, and SB3's evaluator."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from qcar_env import scenario
from qcar_env.baselines import catalogue
from qcar_env.baselines.law_policy import LawPolicy, filter_matrices, first_order_hold
from qcar_env.baselines.observation import scales_of
from qcar_env.control import CNVC, LAWS, LNVC, NDF, PD, PPF
from qcar_env.control.skyhook import Skyhook
from qcar_env.envs import episode as task
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.rollouts import rollout
from qcar_env.evaluation.tracks import stated
from qcar_env.parts.actuator import LaggedSemiActiveDamper, SemiActiveDamper
from qcar_env.physics.state import Filter, State

PAPER = scenario("paper")
HUMP = scenario("mathworks-hump")
UNIT, HUMP_UNIT = (1.0 / scales_of(each, "feedback") for each in (PAPER, HUMP))
WITH_FILTER = [NDF(), PPF(), NDF(omega_f1=20.0, zeta2=1.5), PPF(omega_f2=90.0, zeta1=0.7)]


def motion(seed: int, samples: int, cars: int) -> np.ndarray:
    """Return states (samples, cars, 4) of the size of the paper's controlled motion."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(samples, cars, 4)) * [0.2, 0.2, 10.0, 10.0]


def follow(policy, x, starts=None):
    """Return actions and memories of `policy` along states (samples, cars, 4)."""
    memory, seen = None, []
    for k, each in enumerate(x):
        start = np.zeros(x.shape[1], dtype=bool) if starts is None else starts[k]
        action, memory = policy.predict(each * UNIT, memory, start)
        seen.append((action, memory))
    return seen


# Filters ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", WITH_FILTER)
def test_the_filter_is_exact_for_an_input_that_runs_straight_between_samples(law):
    x = motion(1, samples=12, cars=3)
    dt = PAPER.dt
    eta = np.zeros((3, 4))
    for k, (action, (found, last)) in enumerate(follow(LawPolicy(law, PAPER), x)):
        if k > 0:

            def rate(t, flat, before=x[k - 1], now=x[k]):
                along = before + (now - before) * (t / dt)
                moved = law.filter_rate(State(*along.T), Filter(*flat.reshape(3, 4).T), law.numbers)
                return np.array(moved).T.ravel()

            solved = solve_ivp(rate, (0, dt), eta.ravel(), "DOP853", rtol=1e-12, atol=1e-13)
            eta = solved.y[:, -1].reshape(3, 4)
        # 1e-12 that DOP853 is asked for, of rates up to omega_f * 10 m/s, over a dozen samples
        assert found == pytest.approx(eta, abs=1e-9)
        assert last == pytest.approx(x[k], rel=1e-14)
        u = np.array(law.command(State(*x[k].T), Filter(*eta.T), law.numbers)).T
        expected = np.clip(u / PAPER.actuator.limit, -1.0, 1.0)
        assert action == pytest.approx(expected, abs=1e-6)  # float32


@given(dt=st.floats(1e-4, 0.1), law=st.sampled_from(WITH_FILTER), x=st.from_type(State))
def test_a_held_sample_leaves_the_filter_where_it_has_settled(dt, law, x):
    """For a constant input the hold has the filter's own rest point: no gain is lost."""
    F, G = filter_matrices(law)
    transition, from_last, from_now = first_order_hold(F, G, dt)
    settled = -np.linalg.solve(F, G @ np.array(x))
    found = transition @ settled + (from_last + from_now) @ np.array(x)
    assert found == pytest.approx(settled, rel=1e-9, abs=1e-9 * (1 + np.max(np.abs(settled))))


def test_the_matrices_are_the_filters():
    law, rng = NDF(zeta1=0.4), np.random.default_rng(2)
    x, eta = State(*rng.normal(size=4)), Filter(*rng.normal(size=4))
    F, G = filter_matrices(law)
    expected = np.array(law.filter_rate(x, eta, law.numbers))
    # a few products in another order, of terms up to omega_f^2 = 3025
    assert F @ np.array(eta) + G @ np.array(x) == pytest.approx(expected, abs=1e-11)


# Memory -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(LAWS))
def test_many_cars_are_predicted_as_one_by_one(name):
    policy = LawPolicy(LAWS[name](), PAPER)
    x = motion(3, samples=6, cars=5)
    together = follow(policy, x)
    for car in range(5):
        alone = follow(policy, x[:, car : car + 1])
        for (many, memory), (one, its) in zip(together, alone, strict=True):
            assert many[car : car + 1] == pytest.approx(one, abs=1e-6)  # one bit of float32
            if memory is not None:
                # matrix products of other shapes may sum in another order
                assert memory[0][car : car + 1] == pytest.approx(its[0], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("name", list(LAWS))
def test_one_observation_gives_one_action(name):
    policy = LawPolicy(LAWS[name](), PAPER)
    memory = batch_memory = None
    for x in motion(4, samples=4, cars=1):
        action, memory = policy.predict(x[0] * UNIT, memory)
        batch, batch_memory = policy.predict(x * UNIT, batch_memory)
        assert action.shape == (2,)
        assert action.dtype == np.float32
        assert np.array_equal(action, batch[0])


@pytest.mark.parametrize("law", WITH_FILTER)
def test_an_episode_begins_with_the_filter_at_rest(law):
    policy = LawPolicy(law, PAPER)
    x = motion(5, samples=8, cars=3)
    starts = np.zeros((8, 3), dtype=bool)
    starts[0], starts[4, 1] = True, True  # the second car begins anew at the fifth sample
    seen = follow(policy, x, starts)
    assert not np.any(seen[0][1][0])
    assert not np.any(seen[4][1][0][1])
    assert np.all(np.any(seen[4][1][0][[0, 2]], axis=1))
    fresh = follow(policy, x[4:, 1:2])
    for (_, memory), (_, its) in zip(seen[4:], fresh, strict=True):
        assert memory[0][1:2] == pytest.approx(its[0], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("law", [CNVC(), LNVC(), PD()])
def test_a_law_without_memory_carries_none(law):
    policy = LawPolicy(law, PAPER)
    x = motion(6, samples=3, cars=2)
    assert [memory for _, memory in follow(policy, x)] == [None] * 3
    once, _ = policy.predict(x[2] * UNIT)
    assert np.array_equal(once, follow(policy, x)[2][0])


def test_predicting_changes_no_memory_that_it_was_given():
    policy = LawPolicy(NDF(), PAPER)
    x = motion(7, samples=3, cars=2)
    _, memory = policy.predict(x[0] * UNIT)
    kept = [each.copy() for each in memory]
    first = policy.predict(x[1] * UNIT, memory)
    again = policy.predict(x[1] * UNIT, memory)
    assert all(np.array_equal(a, b) for a, b in zip(memory, kept, strict=True))
    assert np.array_equal(first[0], again[0])


# Force ------------------------------------------------------------------------------------------


@given(x=st.from_type(State))
def test_the_force_is_the_laws_over_the_limit(x):
    law = LNVC(G1=5.0, G2=1.0)
    action, _ = LawPolicy(law, PAPER).predict(np.array(x) * UNIT)
    u = np.array(law.command(x, law.at_rest, law.numbers)) / PAPER.actuator.limit
    assert action == pytest.approx(np.clip(u, -1.0, 1.0), abs=1e-6)  # float32


@given(x=st.from_type(State))
def test_a_suspension_actuator_realises_what_both_masses_ask_for(x):
    action, _ = LawPolicy(LNVC(G1=5.0, G2=1.0), HUMP).predict(np.array(x) * HUMP_UNIT)
    F = -1.0 * x.v2 * HUMP.car.m2 + 5.0 * x.v1 * HUMP.car.m1  # m2 u2 - m1 u1
    assert action.shape == (1,)
    assert action[0] == pytest.approx(np.clip(F / HUMP.actuator.limit[0], -1.0, 1.0), abs=1e-6)


DAMPERS = (
    SemiActiveDamper(c_min=200.0, c_max=3_000.0),
    LaggedSemiActiveDamper(c_min=200.0, c_max=3_000.0, lag=0.01),
)


@pytest.mark.parametrize("damper", DAMPERS)
@given(x=st.from_type(State))
def test_a_semi_active_damper_gives_what_it_can_of_the_force(damper, x):
    damped = dataclasses.replace(HUMP, actuator=damper, scales=stated(HUMP))
    action, _ = LawPolicy(Skyhook(G=5.0), damped).predict(np.array(x) * HUMP_UNIT)
    seen = State(*(np.array(x) * HUMP_UNIT / HUMP_UNIT))
    travel_rate = seen.v2 - seen.v1
    c = 1_600.0 + 1_400.0 * float(action[0])
    F = -c * travel_rate
    asked = -5.0 * seen.v2 * HUMP.car.m2
    # The nearest to what is asked for of all that a damping in the range can give.
    low, high = sorted((-200.0 * travel_rate, -3_000.0 * travel_rate))
    nearest = np.clip(asked, low, high)
    rounding = 4e-16 * max(abs(seen.v1), abs(seen.v2))  # where the velocities are equal but for it
    close = 3_000.0 * (1e-4 * abs(travel_rate) + rounding)
    assert pytest.approx(nearest, rel=1e-4, abs=close) == F
    assert F * travel_rate <= 0.0  # takes energy out


def test_a_skyhook_through_a_damper_calms_the_body():
    """Karnopp's switched damper: better than the same damper held at its middle."""
    damped = dataclasses.replace(HUMP, actuator=DAMPERS[0])
    held, switched = (
        rollout(LawPolicy(law, damped), damped, signals=["body_acceleration"])
        for law in (Skyhook(G=0.0), Skyhook(G=20.0))
    )
    assert np.abs(switched.x2).max() < np.abs(held.x2).max()


def test_laws_side_by_side_are_each_of_them_alone():
    laws = [PPF(G1=gain, G2=2.0 * gain) for gain in (1.0, 10.0, 30.0)]
    numbers = type(laws[0].numbers)(*np.array([law.numbers for law in laws]).T)
    x = motion(9, samples=4, cars=3)
    many = follow(LawPolicy(laws[0], PAPER, numbers=numbers), x)
    for car, law in enumerate(laws):
        one = follow(LawPolicy(law, PAPER), x[:, car : car + 1])
        for (action, _), (alone, _) in zip(many, one, strict=True):
            assert action[car : car + 1] == pytest.approx(alone, abs=1e-6)  # float32


@pytest.mark.parametrize("name", list(LAWS))
def test_only_the_state_is_read(name):
    policy = catalogue.make(name)
    rng = np.random.default_rng(8)
    full = rng.normal(size=(4, task.FULL_SIZE))
    feedback = full[:, : task.FEEDBACK_SIZE]
    assert policy.reads == "feedback"
    assert np.array_equal(policy.predict(full)[0], policy.predict(feedback)[0])


# Sampled at 200 Hz ------------------------------------------------------------------------------


@pytest.mark.parametrize(("gain", "amplitudes"), [(1.2, (0.1152, 0.0547)), (0.5, (0.1497, 0.0732))])
def test_sampled_cnvc_comes_within_a_tenth_of_the_continuous_one(gain, amplitudes):
    """The continuous amplitudes are those of equations.md; ours move by the hold's delay."""
    policy = catalogue.make("cnvc", PAPER, G1=gain, G2=gain)
    # CNVC's averaged damping, (3/4) G omega^2 a^2 / 2 > 2.2 1/s, leaves e^-10 of the start in 5 s
    found = rollout(policy, PAPER, duration=5.0, observe="feedback")
    assert found.amplitudes(periods=5) == pytest.approx(amplitudes, rel=0.1)


@pytest.fixture(scope="module")
def uncontrolled():
    return steady_amplitudes("none")


def steady_amplitudes(name):
    policy = catalogue.make(name, PAPER)
    found = rollout(policy, PAPER, duration=15.0, observe="feedback")
    return found.amplitudes(periods=5)


@pytest.mark.parametrize("name", ["cnvc", "lnvc", "ppf", "ndf", "pd"])
def test_every_law_of_the_paper_reduces_both_masses(name, uncontrolled):
    for controlled, without in zip(steady_amplitudes(name), uncontrolled, strict=True):
        assert controlled < 0.9 * without


# SB3's evaluator --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(LAWS))
def test_sb3_evaluates_a_baseline_like_a_model(name):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    def make():
        return Monitor(QuarterCarHumpEnv("paper", duration=0.1))

    env = DummyVecEnv([make] * 2)
    env.seed(0)
    returns, lengths = evaluate_policy(
        catalogue.make(name), env, n_eval_episodes=4, return_episode_rewards=True
    )
    assert lengths == [20] * 4
    assert all(-1e3 < each <= 0.0 for each in returns)


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0, 1, 3])
def test_an_observation_that_is_too_short_is_refused(size):
    message = rf"at least 4 entries, got {size}; make the environment with observe='feedback'"
    with pytest.raises(ValueError, match=message):
        catalogue.make("cnvc").predict(np.zeros((1, size)))


@pytest.mark.parametrize("law", [None, "cnvc", LNVC])
def test_what_is_no_law_is_refused(law):
    with pytest.raises(ValueError, match=r"law must be a control law, got .*; give one of"):
        LawPolicy(law, PAPER)


def test_a_policy_takes_the_name_of_its_scenario():
    assert LawPolicy(LNVC(), "paper").predict(np.zeros(4))[0].shape == (2,)
    with pytest.raises(ValueError, match="unknown scenario 'papr'; did you mean 'paper'"):
        LawPolicy(LNVC(), "papr")


@settings(max_examples=10)
@given(over=st.floats(1.01, 10.0))
def test_a_law_that_destabilises_the_car_is_refused(over):
    with pytest.raises(ValueError, match=r"gain G1 must be below .* give a smaller gain"):
        LawPolicy(PPF(G1=over * PAPER.car.omega1**2), PAPER)
