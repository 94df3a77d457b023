"""Rollouts: the environment's own numbers, in order, for any policy, one episode or many."""

import dataclasses

import numpy as np
import pytest

from qcar_env import SCENARIOS, scenario
from qcar_env.analysis.optimum import period_optimum
from qcar_env.baselines import catalogue, classical
from qcar_env.envs import episode as task
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation.rollouts import rollout, rollouts
from qcar_env.evaluation.tracks import episodes, track
from qcar_env.parts.spring import CubicSpring
from qcar_env.physics import linear
from qcar_env.physics.signals import SIGNALS
from qcar_env.scenarios.presets import over_hump

PAPER = scenario("paper")
BUDGET = track("budget")


class Constant:
    """A policy that always does the same, and counts."""

    def __init__(self, *action):
        self.action = np.array(action, dtype=np.float32)
        self.seen = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append((observation.copy(), state, episode_start.copy(), deterministic))
        count = 0 if state is None else state[0]
        return np.tile(self.action, (len(observation), 1)), (count + 1,)


def test_a_rollout_is_what_the_environment_did():
    policy = Constant(0.3, -0.2)
    start = {"state": (0.1, -0.2, 3.0, 4.0), "phase": 1.0}
    found = rollout(policy, PAPER, duration=0.5, **start)
    env = QuarterCarHumpEnv("paper", duration=0.5)
    env.reset(seed=0, options=start)
    for k in range(100):
        _, reward, terminated, truncated, info = env.step(policy.action)
        assert found.reward[k] == reward
        assert np.array_equal(found.force[k], info["force"])
        state = (found.x1[k], found.x2[k], found.v1[k], found.v2[k])
        assert state == env.state
    assert truncated
    assert not terminated
    assert found.terminated is False
    assert found.scenario == env.episode


def test_the_shapes_and_times_are_those_of_the_intervals():
    found = rollout(Constant(0.0, 0.0), PAPER, duration=0.3)
    assert found.t == pytest.approx(0.005 * np.arange(1, 61), rel=1e-12)
    assert found.force.shape == (60, 2)
    for name in ("x1", "x2", "v1", "v2", "reward"):
        assert getattr(found, name).shape == (60,)


def test_the_policy_is_asked_as_sb3s_evaluator_asks():
    policy = Constant(0.0, 0.0)
    rollout(policy, PAPER, duration=0.05, observe="feedback")
    assert [seen[0].shape for seen in policy.seen] == [(1, task.FEEDBACK_SIZE)] * 10
    assert [seen[2].tolist() for seen in policy.seen] == [[True]] + [[False]] * 9
    assert policy.seen[0][1] is None
    assert [seen[1] for seen in policy.seen[1:]] == [(k,) for k in range(1, 10)]
    assert all(seen[3] for seen in policy.seen)


def test_a_rollout_that_leaves_its_limits_ends_there():
    limit = PAPER.travel_limit * PAPER.reference_amplitudes[0]
    found = rollout(Constant(0.0, 0.0), PAPER, state=(0.99 * limit, 0.0, 60.0, 0.0))
    assert found.terminated is True
    assert len(found.t) < PAPER.steps
    assert abs(found.x1[-1]) > limit
    assert np.all(np.abs(found.x1[:-1]) <= limit)


@pytest.mark.parametrize("name", list(SCENARIOS))
def test_every_scenario_can_be_driven_from_rest(name):
    found = rollout(Constant(*[0.0] * SCENARIOS[name].actuator.size), SCENARIOS[name])
    assert not found.terminated
    assert len(found.t) == SCENARIOS[name].steps
    assert np.max(np.abs(found.x2)) > 0.0


def test_a_seed_draws_one_episode_and_another_seed_another():
    nominal = dataclasses.replace(SCENARIOS["paper-randomised"], duration=0.1)
    a, b, c = (rollout(Constant(0.0, 0.0), nominal, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(a.x2, b.x2)
    assert a.scenario == b.scenario != c.scenario
    assert not np.array_equal(a.x2, c.x2)


@pytest.mark.parametrize("action", [(0.0,), (0.0, 0.0, 0.0)])
def test_a_policy_of_the_wrong_size_is_refused(action):
    got = rf"action must have shape \(1, 2\), got \(1, {len(action)}\)"
    message = f"{got}; return one number for each of 2 actuator"
    with pytest.raises(ValueError, match=message):
        rollout(Constant(*action), PAPER, duration=0.05)


def test_a_policy_that_gives_no_number_is_refused():
    with pytest.raises(ValueError, match=r"action must be finite, got .*nan"):
        rollout(Constant(0.0, float("nan")), PAPER, duration=0.05)


def test_an_observation_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="unknown observe 'ful'; did you mean 'full'"):
        rollout(Constant(0.0, 0.0), PAPER, observe="ful")


@pytest.mark.parametrize("name", ["none", "cnvc", "ndf", "lqr-feedforward"])
def test_many_episodes_are_each_of_them_alone(name):
    cases = episodes(BUDGET, force_scale=0.5, count=3)
    policy = catalogue.make(name, BUDGET.at(0.5))
    together = rollouts(policy, cases, duration=1.5, observe=policy.reads)
    assert len(together) == 3
    for j, case in enumerate(cases):
        alone = rollout(
            policy,
            BUDGET.at(0.5),
            duration=1.5,
            observe=policy.reads,
            state=case.state,
            phase=case.phase,
        )
        # A product of matrices may add in another order for another number of rows: 1e-7 of a
        # 32-bit action, which the mode of 4.8 s adds up. Everything else is the same to the bit.
        exact = {"rtol": 0.0, "atol": 1e-6 if name == "lqr-feedforward" else 0.0}
        for what in ("t", "x1", "x2", "v1", "v2", "force", "reward"):
            np.testing.assert_allclose(getattr(together[j], what), getattr(alone, what), **exact)


def test_the_motion_is_that_of_the_exact_map():
    push = Constant(0.3, -0.2)
    case = episodes(BUDGET, force_scale=1.0, count=2)[1]
    found = rollouts(push, [case], duration=1.5)[0]
    car, road, force = PAPER.car, PAPER.excitation, PAPER.force
    step = linear.exact_transition(car, road, force, PAPER.dt)
    x, u = np.array(case.state), np.float32([0.3, -0.2]) * np.array(PAPER.actuator.limit)
    start = case.phase / road.omega
    for k in range(len(found.t)):
        t = start + k * PAPER.dt
        on_road = np.array([np.sin(road.omega * t), np.cos(road.omega * t)])
        on_force = np.array([np.sin(force.Omega * t), np.cos(force.Omega * t)])
        x = step.A @ x + step.B @ u + step.road @ on_road + step.force @ on_force
        # RK4 with four substeps of 1.25 ms: 1e-8 a step, which 600 steps and the slow mode add up
        np.testing.assert_allclose((found.x1[k], found.x2[k]), x[:2], rtol=0.0, atol=2e-5)


def test_a_drawn_episode_is_the_environment_of_its_own_scenario():
    drawn = track("randomised")
    case = episodes(drawn, force_scale=1.0)[5]
    nothing = catalogue.make("none", drawn.at(1.0))
    together = rollouts(nothing, [case], duration=1.0)[0]
    own = dataclasses.replace(case.scenario, travel_limit=100.0)
    alone = rollout(nothing, own, duration=1.0, state=case.state, phase=case.phase)
    # a drawn number and the same one rounded on its way through a scenario: an ulp of each
    np.testing.assert_allclose(together.x1, alone.x1, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(together.x2, alone.x2, rtol=0.0, atol=1e-11)
    assert together.scenario == dataclasses.replace(case.scenario, duration=1.0)


def test_episodes_of_different_force_limits_run_together():
    pushed = [episodes(BUDGET, force_scale=scale, count=2)[1] for scale in (1.0, 0.5)]
    together = rollouts(Constant(1.0, 1.0), pushed, duration=0.1)
    np.testing.assert_array_equal(together.force[-1], [[280.0, 33.0], [140.0, 16.5]])
    for j, case in enumerate(pushed):
        alone = rollouts(Constant(1.0, 1.0), [case], duration=0.1)
        np.testing.assert_array_equal(together.x[:, j], alone.x[:, 0])


def test_a_policy_is_told_once_which_cars_begin_and_sees_what_was_asked_for():
    cases = episodes(BUDGET, force_scale=0.5, count=2)
    for observe, limit, size in (
        ("full", False, 8),
        ("feedback", False, 4),
        ("full", True, 9),
        ("feedback", True, 5),
    ):
        policy = Constant(0.0, 0.0)
        rollouts(policy, cases, duration=0.05, observe=observe, observe_limit=limit)
        begins = [seen[2] for seen in policy.seen]
        assert begins[0].all()
        assert not np.any(begins[1:])
        assert {seen[0].shape for seen in policy.seen} == {(2, size)}
        if limit:
            np.testing.assert_allclose([seen[0][:, -1] for seen in policy.seen], 0.5, rtol=1e-6)


def test_signals_are_kept_by_name_and_not_shown():
    policy = Constant(0.3)
    hump = scenario("mathworks-hump")
    names = ("travel", "tyre_load", "y", "u2", "body_acceleration")
    found = rollout(policy, hump, signals=names, duration=2.0)
    assert {seen[0].shape for seen in policy.seen} == {(1, 8)}
    assert set(found.signals) == set(names)
    # single precision: 2^-24 of the larger of the two
    close = {"rtol": 1e-6, "atol": 1e-7}
    np.testing.assert_allclose(found.signals["travel"], found.x2 - found.x1, **close)
    np.testing.assert_allclose(found.signals["u2"], found.force[:, 0], **close)
    np.testing.assert_allclose(found.signals["y"], hump.excitation.height(found.t), **close)
    pressed = 190_000.0 * (found.signals["y"] - found.x1)  # of the tyre alone, beyond its load
    still = (60.0 + 300.0) * 9.81
    np.testing.assert_allclose(found.signals["tyre_load"], still + pressed, rtol=1e-5, atol=0.1)
    wrong = "unknown signal 'travl'; did you mean 'travel'"
    with pytest.raises(ValueError, match=wrong):
        rollout(policy, hump, signals=("travl",))
    assert "travl" not in SIGNALS


def test_a_car_that_is_not_linear_is_driven_like_any_other():
    hump = scenario("mathworks-hump")
    spring = CubicSpring(k=16_000.0, k3=2e6)
    stiff = dataclasses.replace(hump, car=dataclasses.replace(hump.car, spring=spring))
    soft, hard = (rollout(Constant(0.0), each, duration=1.5) for each in (hump, stiff))
    assert np.abs(soft.x2 - hard.x2).max() > 1e-3
    assert np.abs(hard.x2 - hard.x1).max() < np.abs(soft.x2 - soft.x1).max()


def test_the_last_rows_alone_are_those_of_the_whole():
    cases = episodes(BUDGET, force_scale=0.5, count=2)
    policy = catalogue.make("cnvc", BUDGET.at(0.5))
    whole, last = (
        rollouts(policy, cases, duration=1.0, observe="feedback", last=k) for k in (None, 30)
    )
    np.testing.assert_array_equal(last.x, whole.x[-30:])
    np.testing.assert_array_equal(last.t, whole.t[-30:])
    np.testing.assert_array_equal(last.rho(1), whole.rho(1))


def test_actions_saturate():
    found = rollouts(Constant(7.0, -7.0), episodes(BUDGET, force_scale=1.0, count=1), duration=0.05)
    np.testing.assert_array_equal(found.force[:, 0], np.tile([280.0, -33.0], (10, 1)))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ((np.nan, 0.0), "action must be finite, got .* 0 s after the start"),
        ((0.0, np.inf), "action must be finite"),
    ],
)
def test_an_action_that_is_no_number_is_refused_among_many(action, message):
    with pytest.raises(ValueError, match=message):
        rollouts(Constant(*action), episodes(BUDGET, force_scale=1.0, count=2), duration=0.05)


class Excite:
    """Push the way that the car moves."""

    def __init__(self, whom):
        self.whom = whom
        self.begins = []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.begins.append(episode_start)
        action = np.sign(observation[:, 2:4])
        action[self.whom :] = 0.0
        return action, None


@pytest.mark.parametrize("last", [None, 500])
def test_a_car_that_leaves_its_limits_stays_there(last):
    cases = episodes(BUDGET, force_scale=10.0, count=2)
    policy = Excite(1)
    found = rollouts(policy, cases, duration=4.0, last=last)
    assert found.terminated.tolist() == [True, False]
    assert np.array_equal(found.x[-1, 0], found.x[-2, 0])
    assert found.rho(20)[0] > 3.0
    first, second = found[0], found[1]
    assert first.terminated
    assert len(second.t) == len(found.t) > len(first.t)
    assert (np.abs(first.x1[:-1]) <= 3.0 * PAPER.reference_amplitudes[0]).all()
    # the other one goes on as if it were alone
    alone = rollouts(Constant(0.0, 0.0), [cases[1]], duration=4.0, last=last)
    np.testing.assert_array_equal(found.x[:, 1], alone.x[:, 0])
    assert any(begins[0] for begins in policy.begins[1:])  # it has begun another, not kept


def test_episodes_that_do_not_fit_together_are_refused():
    with pytest.raises(ValueError, match="episodes must not be empty"):
        rollouts(Constant(0.0, 0.0), [])
    case = episodes(BUDGET, force_scale=1.0, count=1)[0]
    for change in ({"dt": 0.01}, {"substeps": 8}):
        other = dataclasses.replace(case, nominal=dataclasses.replace(case.nominal, **change))
        with pytest.raises(ValueError, match="must share parts, control interval"):
            rollouts(Constant(0.0, 0.0), [case, other], duration=0.1)


def test_steady_amplitudes_take_whole_periods():
    case = episodes(BUDGET, force_scale=1.0, count=1)
    found = rollouts(Constant(0.0, 0.0), case, duration=4.0)[0]
    assert len(found.t[found.window(20)]) == np.ceil(20 * 2 * np.pi / 55.0 / 0.005)
    assert found.window(None) == slice(None)
    brief = rollouts(Constant(0.0, 0.0), case, duration=1.0)
    with pytest.raises(ValueError, match=r"record must hold 20 periods .* got 0.995 s"):
        brief.rho(20)


def test_a_steady_motion_is_refused_by_name_where_there_is_none():
    found = rollout(Constant(0.0), scenario("mathworks-hump"))
    with pytest.raises(ValueError, match="last 5 periods need a steady motion, and scenario 'math"):
        found.rho(5)
    # Of what divides it: the largest of the same episode, to the single precision of its search.
    assert found.rho(None) == pytest.approx(1.0, rel=1e-6)


def test_the_uncontrolled_car_keeps_all_of_its_vibration():
    cases = episodes(BUDGET, force_scale=1.0, count=2)
    found = rollouts(catalogue.make("none", BUDGET.at(1.0)), cases).rho(20)
    # 60 s from rest: exp(-0.209 * 60) = 4e-6 is missing; 457 phases miss a peak by 2e-5.
    np.testing.assert_allclose(found, 1.0, atol=1e-4)


def test_episodes_shorter_than_a_control_interval_are_refused():
    crossing = episodes(BUDGET, force_scale=1.0, count=1)
    message = r"duration must hold a control interval, got 0.001 s with dt = 0.005 s; give 0.005 s"
    with pytest.raises(ValueError, match=message):
        rollouts(Constant(0.0, 0.0), crossing, duration=1e-3)
    shortest = rollouts(Constant(0.0, 0.0), crossing, duration=5e-3)
    with pytest.raises(ValueError, match=r"record must hold 1 periods .* got 0 s"):
        shortest.rho(1)


class Planned:
    """Forces held one after another, over and over."""

    reads = "full"

    def __init__(self, actions):
        self.actions = actions

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        k = 0 if state is None else state
        return np.tile(self.actions[k % len(self.actions)], (len(observation), 1)), k + 1


@pytest.mark.parametrize("scale", [0.75, 0.5])
def test_no_force_that_is_calm_at_the_samples_alone_passes_the_bound(scale):
    """At its 200 Hz samples this force leaves less than the bound, which is for every instant."""
    found = BUDGET.at(scale)
    plan = period_optimum(found, dt=found.dt, inside=1)
    policy = Planned(plan.u / np.array(found.actuator.limit))
    ran = rollout(policy, found, state=plan.x[0], duration=len(plan.u) * found.dt)
    at_samples = max(np.abs(ran.x1).max(), 0.0) / found.reference_amplitudes[0]
    assert at_samples < ran.rho(None)
    assert ran.rho(None) >= period_optimum(found).bound
    fine = dataclasses.replace(found, dt=found.dt / 20, substeps=1)
    slow = Planned(np.repeat(policy.actions, 20, axis=0))
    dense = rollout(slow, fine, state=plan.x[0], duration=len(plan.u) * found.dt)
    assert ran.rho(None) == pytest.approx(dense.rho(None), rel=5e-5)


def test_the_first_interval_that_is_measured_begins_before_the_first_row():
    cases = episodes(BUDGET, force_scale=0.5, count=4)
    policy = catalogue.make("lqr", BUDGET.at(0.5))
    whole = rollouts(policy, cases, duration=1.5, observe=policy.reads)
    end = rollouts(policy, cases, duration=1.5, observe=policy.reads, last=100)
    assert np.array_equal(whole.before, [case.state for case in cases])
    assert np.array_equal(end.before, whole.x[-101])
    assert np.array_equal(end.rho(3), whole.rho(3))


def test_a_policy_is_shown_what_it_reads():
    # the full observation was the default, whose first entries controllers took for their own
    scenario = over_hump("escort", "belgium", actuator="cdc")
    for name in ("add", "skyhook-on-off"):
        policy = classical.make(name, scenario)
        given = rollout(policy, scenario, duration=1.0, observe=policy.reads)
        left_out = rollout(policy, scenario, duration=1.0)
        assert np.array_equal(given.x2, left_out.x2)
        full = rollout(policy, scenario, duration=1.0, observe="full")
        assert not np.array_equal(given.x2, full.x2)
