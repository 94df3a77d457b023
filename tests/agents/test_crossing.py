import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents import crossing, scoring  # noqa: E402
from agents.training_env import CrossingVecEnv, Reward, amplitudes  # noqa: E402
from qcar_env.control import CNVC  # noqa: E402
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, episodes  # noqa: E402
from qcar_env.physics import motion  # noqa: E402
from qcar_env.physics.forcing import World  # noqa: E402
from qcar_env.physics.roads import Phasor  # noqa: E402
from qcar_env.physics.state import State  # noqa: E402
from qcar_env.scenarios import SCENARIOS  # noqa: E402


@pytest.mark.parametrize("track", ["paper", "randomised", "feedback"])
def test_the_linear_map_and_the_environment_move_the_same_car(track):
    track = TRACKS[track]
    drawn = episodes(track, "training", force_scale=0.5, count=3)
    plants, z = crossing.of_track(drawn, track.nominal)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.2, 1.2, (500, 3, 2)).astype(np.float32)  # as the action space
    envs = [QuarterCarHumpEnv(each.scenario, observe=track.observe) for each in drawn]
    for env, each in zip(envs, drawn, strict=True):
        env.reset(options={"state": each.state, "phase": each.phase})
    for k, action in enumerate(actions):
        z = crossing.advance(z, action, plants)
        for i, env in enumerate(envs):
            _, _, terminated, _, _ = env.step(action[i])
            assert not terminated, f"left its travel limit at step {k}"
            # rounding of 500 steps, in metres and metres a second
            np.testing.assert_allclose(z[i, :4], np.array(env.state), rtol=0.0, atol=1e-9)


def test_the_linear_map_shows_what_the_environment_shows():
    scenario = SCENARIOS["paper"]
    env = QuarterCarHumpEnv(scenario, observe_limit=True, force_scale=0.5)
    seen, _ = env.reset(options={"state": (0.1, -0.2, 3.0, 4.0), "phase": 0.7})
    plants = crossing.plants(scenario, [scenario.with_force_scale(0.5)])
    z = crossing.start(np.array([[0.1, -0.2, 3.0, 4.0]]), np.array([0.7]))
    shown = crossing.observations(z, plants, "full", True)[0]
    np.testing.assert_allclose(shown, seen, rtol=0.0, atol=1e-6)


def test_the_map_is_the_torch_form_of_the_equations():
    """The analytic gradient differentiates the map; the equations on torch tensors agree."""
    scenario = SCENARIOS["paper"]
    plants = crossing.plants(scenario, [scenario])
    step = scenario.dt / scenario.substeps
    plant = motion.plant(scenario.car, scenario.road, scenario.force, step)
    values = torch.tensor([0.1, -0.2, 3.0, 4.0], dtype=torch.float64, requires_grad=True)
    x = State(*values)
    one = torch.ones((), dtype=torch.float64)
    world = World(Phasor(0.6 * one, 0.8 * one), Phasor(0.6 * one, 0.8 * one))
    for _ in range(scenario.substeps):
        x, world = motion.substep(
            x,
            world,
            plant.passage,
            plant.amplitudes,
            plant.step,
            100.0 * one,
            -20.0 * one,
            plant.car,
        )
    z = np.array([[0.1, -0.2, 3.0, 4.0, 0.6, 0.8, 0.6, 0.8]])
    action = np.array([[100.0, -20.0]]) / np.array(scenario.actuator.limit)
    after = crossing.advance(z, action, plants)[0]
    np.testing.assert_allclose([float(v.detach()) for v in x], after[:4], rtol=0.0, atol=1e-12)
    (slope,) = torch.autograd.grad(x.x1, values)
    np.testing.assert_allclose(slope.numpy(), plants.Z[0, :4, 0], rtol=0.0, atol=1e-12)


def test_roads_with_kinks_are_refused():
    hump = SCENARIOS["paper-hump"]
    with pytest.raises(ValueError, match="harmonic road"):
        crossing.plants(hump, [hump])


def make(**options):
    return CrossingVecEnv(TRACKS["paper"], (1.0,), n=4, seed=3, **options)


def test_the_reward_is_the_removed_amplitude_in_units_of_full_force():
    env = make()
    before = amplitudes(env.reset())
    seen, reward, _, _ = env.step(np.array([[0.3, -0.4]] * 4))
    scenario = SCENARIOS["paper"]
    per_step = (
        np.array(scenario.actuator.limit)
        * scenario.dt
        / (scenario.road.omega * np.array(scenario.reference_amplitudes))
    )
    expected = ((before - amplitudes(seen)) / per_step).sum(axis=1)
    np.testing.assert_allclose(reward, expected, rtol=0.0, atol=1e-4)  # float32 observations


def test_one_seed_one_history_and_another_seed_another():
    def history(seed):
        env = CrossingVecEnv(TRACKS["randomised"], (1.0, 0.5), n=5, seed=seed, steps=20)
        found = [env.reset()]
        for _ in range(50):
            found.append(env.step(np.full((5, 2), 0.1))[0])
        return np.array(found)

    np.testing.assert_array_equal(history(1), history(1))
    assert np.any(history(1) != history(2))


def test_episodes_end_at_their_length_and_tell_the_last_observation():
    env = make(steps=10)
    env.reset()
    ended = 0
    for _ in range(25):
        _, _, done, infos = env.step(np.zeros((4, 2)))
        for i in np.flatnonzero(done):
            ended += 1
            assert infos[i]["TimeLimit.truncated"]
            assert infos[i]["terminal_observation"].shape == (8,)
            assert infos[i]["episode"]["l"] == 10
    assert ended >= 8


def test_a_snapshot_brings_the_cars_back():
    env = CrossingVecEnv(TRACKS["randomised"], (1.0,), n=5, seed=0, steps=15)
    env.reset()
    for _ in range(20):
        env.step(np.full((5, 2), 0.2))
    kept = env.snapshot()
    first = [env.step(np.full((5, 2), 0.2))[0] for _ in range(30)]
    env.restore(kept)
    again = [env.step(np.full((5, 2), 0.2))[0] for _ in range(30)]
    np.testing.assert_array_equal(first, again)


def test_negative_weights_and_no_cars_are_refused():
    with pytest.raises(ValueError, match="reward weight must not be negative"):
        Reward(worst=-1.0)
    with pytest.raises(ValueError, match="number of cars"):
        CrossingVecEnv(TRACKS["paper"], (1.0,), n=0, seed=0)


def test_scores_agree_with_the_environment():
    track = TRACKS["paper"]
    found = scoring.reference("cnvc", track, 1.0)
    # CNVC sampled at 200 Hz; the continuous law leaves 0.1152 and 0.0547 m
    np.testing.assert_allclose(found.amplitudes[0], (0.1152, 0.0547), rtol=0.05)
    assert scoring.optimum(track.at(0.5)) == pytest.approx(0.167, rel=0.02)


@pytest.mark.parametrize(
    ("drawn", "duration", "message"),
    [
        ([], None, "episodes must not be empty; give at least one"),
        (None, 0.0, "duration must be positive, got 0 s; give a value above 0 s"),
        (None, 1e-3, "duration must hold a control interval, got 0.001 s with dt = 0.005 s; give"),
    ],
)
def test_a_score_of_nothing_is_refused(drawn, duration, message):
    track = TRACKS["paper"]
    if drawn is None:
        drawn = episodes(track, "validation", force_scale=1.0, count=1)
    policy = scoring.VelocityPolicy(law=CNVC(), scenario=track.nominal)
    with pytest.raises(ValueError, match=message):
        scoring.run(policy, track, drawn, duration=duration)
