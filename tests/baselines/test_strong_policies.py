"""LQR, internal model and MPC in the fleet, and what they read."""

import dataclasses
import time

import numpy as np
import pytest

from qcar_env import scenario
from qcar_env.analysis.optimum import period_optimum
from qcar_env.baselines import catalogue, mpc_policy
from qcar_env.baselines.linear_policy import LinearPolicy
from qcar_env.evaluation.rollouts import rollouts
from qcar_env.evaluation.tracks import episodes, stated, track
from qcar_env.parts.actuator import SemiActiveDamper
from qcar_env.parts.spring import CubicSpring

BUDGET = track("budget")


def left(policy, scale, *, duration=60.0, count=1):
    cases = episodes(BUDGET, "validation", force_scale=scale, count=count)
    rolled = rollouts(policy, cases, duration=duration, observe=policy.reads)
    return rolled.rho(20).max()


@pytest.mark.parametrize("name", ["lqr-model", "lqr-feedforward"])
def test_a_regulator_with_a_disturbance_model_leaves_less_than_a_hundredth(name):
    assert left(catalogue.make(name, BUDGET.at(1.0)), 1.0) < 0.01
    assert left(catalogue.make("lqr", BUDGET.at(1.0)), 1.0) > 0.01  # the model does it


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_mpc_comes_within_five_percent_of_the_optimum(scale):
    optimum = period_optimum(BUDGET.at(scale)).bound
    assert left(catalogue.make("mpc", BUDGET.at(scale)), scale) < max(1.05 * optimum, 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.75, 0.25, 0.1])
def test_mpc_comes_within_five_percent_of_the_optimum_at_the_other_limits(scale):
    optimum = period_optimum(BUDGET.at(scale)).bound
    assert left(catalogue.make("mpc", BUDGET.at(scale)), scale, count=3) < max(1.05 * optimum, 0.01)


def test_mpc_is_faster_than_real_time():
    policy = catalogue.make("mpc", BUDGET.at(0.5))
    cases = episodes(BUDGET, force_scale=0.5, count=1)
    rollouts(policy, cases, duration=0.1)
    begin = time.process_time()
    rollouts(policy, cases, duration=2.0)
    assert time.process_time() - begin < 2.0  # 200 Hz: 2 s of driving


@pytest.mark.parametrize(
    "name", [name for name in catalogue.everything() if name not in catalogue.WITHOUT_PUBLISHED]
)
@pytest.mark.parametrize("scale", [0.75, 0.25])
def test_no_baseline_is_below_the_bound(name, scale):
    # Sampled at 200 Hz over 20 periods the peaks are read to (pi / 457)^2 / 2 of their height;
    # the start is the uncontrolled motion, so what is left of it only adds.
    policy = catalogue.make(name, BUDGET.at(scale))
    bound = period_optimum(BUDGET.at(scale)).bound
    assert left(policy, scale, duration=40.0) >= bound * (1.0 - 1e-3)


@pytest.mark.parametrize(
    ("name", "home", "scale"), [each for each in catalogue.tuned() if each[1] == "budget"]
)
def test_tuned_gains_are_not_below_the_bound_and_what_was_stored(name, home, scale):
    policy = catalogue.make_tuned(name, home, scale, BUDGET.at(scale))
    found = left(policy, scale, duration=25.0)
    bound = period_optimum(BUDGET.at(scale)).bound
    stored = catalogue.stored(name, home, scale)["validation_rho"]
    assert stored >= bound * (1.0 - 1e-3)
    # 25 s leave a transient of 1 %; the stored value is from 60 s.
    assert found == pytest.approx(stored, rel=0.1, abs=0.01)


def test_a_batch_is_its_cars_one_by_one():
    cases = episodes(BUDGET, force_scale=0.5, count=3)
    for name in ("lqr-model", "mpc"):
        policy = catalogue.make(name, BUDGET.at(0.5))
        together = rollouts(policy, cases, duration=0.5)
        alone = [rollouts(policy, [each], duration=0.5).x[:, 0] for each in cases]
        # OSQP stops all programs of a batch together: they agree to its tolerance, 1e-4 of a limit.
        atol = 1e-6 if name != "mpc" else 5e-3
        np.testing.assert_allclose(together.x[:, :, :2], np.stack(alone, 1)[:, :, :2], atol=atol)


@pytest.mark.parametrize("name", ["lqr-model", "mpc"])
def test_an_episode_that_begins_forgets_the_one_before(name):
    policy = catalogue.make(name, BUDGET.at(0.5))
    size = 4 if policy.reads == "feedback" else 8
    seen = np.random.default_rng(0).normal(size=(2, size)).astype(np.float32)
    _, memory = policy.predict(seen)
    fresh, _ = policy.predict(seen)
    again, _ = policy.predict(seen, memory, np.array([True, True]))
    kept, _ = policy.predict(seen, memory, np.array([False, False]))
    np.testing.assert_allclose(again, fresh, atol=1e-6)
    if name == "lqr-model":
        assert not np.allclose(kept, fresh)


@pytest.mark.parametrize("name", ["lqr", "lqr-feedforward", "lqr-model", "mpc"])
def test_a_short_observation_is_refused(name):
    policy = catalogue.make(name)
    with pytest.raises(ValueError, match="observation must have at least"):
        policy.predict(np.zeros(3, dtype=np.float32))


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (None, r"observation must have shape \(n, k\) or \(k,\), got \(\); give what the env"),
        (np.zeros((1, 2, 8)), r"observation must have shape .* got \(1, 2, 8\); give what"),
        ("none", r"observation must be numbers .* got str .*; give what the environment returns"),
        ([[0.0] * 8, [0.0]], r"observation must be numbers .* got list .*; give what the env"),
    ],
    ids=["nothing", "rank 3", "a word", "ragged"],
)
@pytest.mark.parametrize("name", ["cnvc", "ndf", "lqr", "lqr-feedforward", "lqr-model", "mpc"])
def test_what_is_no_observation_is_refused(name, observation, message):
    with pytest.raises(ValueError, match=message):
        catalogue.make(name).predict(observation)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_mpc_refuses_an_observation_that_is_not_finite(wrong):
    seen = np.zeros((3, 8))
    seen[1, 4] = wrong
    with pytest.raises(
        ValueError, match=rf"observation must be finite, got \[.*{wrong}.*; give what"
    ):
        catalogue.make("mpc").predict(seen)


@pytest.mark.parametrize(
    ("status", "error", "message"),
    [
        ("OSQP_SIGINT", KeyboardInterrupt, "^$"),
        ("OSQP_MAX_ITER_REACHED", RuntimeError, r"OSQP did not solve .* \(its words\); give"),
        ("OSQP_SOLVED_INACCURATE", RuntimeError, r"OSQP did not solve .* \(its words\); give"),
    ],
)
def test_a_program_that_mpc_has_not_solved_moves_no_car(status, error, message):
    """Ctrl-C ended the program, and what it had come to was taken for its solution."""
    policy, seen = catalogue.make("mpc"), np.zeros((1, 8))
    solver = policy._solver(1)
    solve = solver.solve

    def ended(**kwargs):
        result = solve(**kwargs)
        result.info.status_val, result.info.status = policy._osqp.SolverStatus[status], "its words"
        return result

    solver.solve = ended
    with pytest.raises(error, match=message):
        policy.predict(seen)
    solver.solve = solve
    expected = catalogue.make("mpc").predict(seen)[0]
    assert policy.predict(seen)[0] == pytest.approx(expected, abs=1e-3)  # OSQP's tolerance


@pytest.mark.parametrize("name", ["cnvc", "ndf", "lqr", "lqr-feedforward", "lqr-model", "mpc"])
def test_no_cars_get_no_actions(name):
    policy = catalogue.make(name)
    nobody = np.zeros((0, 8), dtype=np.float32)
    actions, memory = policy.predict(nobody, episode_start=np.ones(0, dtype=bool))
    assert actions.shape == (0, 2)
    assert policy.predict(nobody, memory, np.zeros(0, dtype=bool))[0].dtype == np.float32


@pytest.mark.parametrize("name", ["lqr", "lqr-feedforward", "lqr-model", "mpc"])
@pytest.mark.parametrize("part", ["car", "actuator"])
def test_a_plant_that_is_not_linear_is_refused_by_name(name, part, monkeypatch):
    monkeypatch.setattr(mpc_policy, "period_optimum", None)  # before any work
    hump = scenario("mathworks-hump")
    spring = CubicSpring(k=16_000.0, k3=2e6)
    damper = SemiActiveDamper(c_min=200.0, c_max=3_000.0)
    change = {"car": dataclasses.replace(hump.car, spring=spring), "actuator": damper}[part]
    other = dataclasses.replace(hump, scales=stated(hump), **{part: change})
    two = "an actuator on each mass, got" if name in ("lqr-feedforward", "lqr-model") else part
    with pytest.raises(ValueError, match=f"{part} must be linear|{two}"):
        catalogue.make(name, other)


@pytest.mark.parametrize("name", ["lqr-feedforward", "lqr-model"])
def test_one_actuator_cannot_cancel_two_disturbances(name):
    with pytest.raises(ValueError, match="an actuator on each mass"):
        catalogue.make(name, "mathworks-hump")
    assert isinstance(catalogue.make("lqr", scenario("mathworks-hump")), LinearPolicy)


def test_gains_that_are_missing_or_unknown_are_named():
    with pytest.raises(ValueError, match="missing k12"):
        catalogue.make("state", k11=1.0)
    with pytest.raises(ValueError, match="unknown gain of lqr"):
        catalogue.make("lqr", r3=1.0)
    with pytest.raises(ValueError, match="no tuned gains of 'cnvc' for track 'budget'"):
        catalogue.make_tuned("cnvc", "budget", 0.33, scenario("paper"))


def test_what_each_reads():
    reads = {name: catalogue.describe(name)["reads"] for name in catalogue.everything()}
    full = {name for name, what in reads.items() if what == "full"}
    assert full == {"lqr-feedforward", "mpc", "linear"}
    for name in catalogue.everything():
        if name not in catalogue.WITHOUT_PUBLISHED:
            assert catalogue.make(name).reads == reads[name]
