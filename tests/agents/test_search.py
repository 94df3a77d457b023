import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("cma")

from qcar_env.agents.networks import LawNet, Schedule, space  # noqa: E402
from qcar_env.agents.recipes import FeatureMap  # noqa: E402
from qcar_env.agents.search import WINDOW, Runs  # noqa: E402
from qcar_env.engine.cars import SAME_STEP  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, episodes  # noqa: E402
from qcar_env.physics.peaks import largest_between  # noqa: E402

NODES = Schedule(roads=(0.6, 1.3), forces=(0.6, 0.9, 1.3))


def nodes_of(schedule):
    return schedule.roads, schedule.forces


def drive(law, runs, duration):
    """Let a law drive step by step, through the policy itself."""
    cars = runs.cars
    seen = cars.reset(np.ones(cars.n, bool), runs.start, runs._uniforms)
    steps = round(duration / cars.plan.dt)
    window = min(math.ceil(WINDOW / cars.plan.dt), steps // 2)
    peak = np.zeros((cars.n, 2))
    for step in range(steps):
        x = cars.states
        with torch.no_grad():
            seen = cars.step(law(torch.as_tensor(seen)).numpy(), SAME_STEP)[0]
        if step >= steps - window:
            y = cars.states
            ends = x[:, :2], x[:, 2:], y[:, :2], y[:, 2:]
            peak = np.maximum(peak, largest_between(*ends, cars.plan.dt))
    return peak


@pytest.mark.parametrize(
    ("name", "schedule"),
    [
        ("feedback", Schedule()),
        ("budget", Schedule()),
        ("randomised", Schedule()),
        ("randomised", NODES),
    ],
)
def test_compiled_episodes_are_those_of_the_policy(name, schedule):
    track = TRACKS[name]
    drawn = episodes(track, "training", force_scale=0.5, count=5)
    laws = []
    for seed in range(2):
        law = LawNet(space(track.observe, False), FeatureMap(), (), 2, schedule=schedule)
        generator = torch.Generator().manual_seed(seed)
        law.begin_at_velocity_feedback(2.0)
        with torch.no_grad():
            law.gains.add_(torch.randn(law.gains.shape, generator=generator))
        laws.append(law)
    gains = np.sinh([law.gains[0].detach().double().numpy() for law in laws])
    runs = Runs(drawn, len(laws), track.observe)
    peak = runs.drive(gains, 2.0, nodes_of(schedule))
    states = runs.cars.states.reshape(2, 5, 4)
    for k, law in enumerate(laws):
        by_hand = Runs(drawn, 1, track.observe)
        # The policy adds in another order: one unit of float32 in an action, and less as it damps.
        np.testing.assert_allclose(peak[k], drive(law, by_hand, 2.0), rtol=2e-4)
        end = by_hand.cars.states
        np.testing.assert_allclose(states[k], end, atol=2e-4 * np.abs(end).max())


def test_an_episode_in_two_parts_is_the_same():
    track = TRACKS["randomised"]
    drawn = episodes(track, "training", force_scale=1.0, count=3)
    gains = np.random.default_rng(0).normal(size=(1, NODES.nodes, 2, 8))
    runs = Runs(drawn, 1, track.observe)
    runs.drive(gains, 1.5, nodes_of(NODES))
    end = runs.cars.states
    runs.drive(gains, 0.6, nodes_of(NODES))
    runs.start = runs.now
    runs.drive(gains, 0.9, nodes_of(NODES))
    # The phase begins anew from the time on the road: its rounding, and no more
    np.testing.assert_allclose(runs.cars.states, end, rtol=0.0, atol=1e-6)


def test_each_law_drives_its_own_cars_and_one_that_breaks_scores_worst():
    track = TRACKS["feedback"]
    drawn = episodes(track, "training", force_scale=1.0, count=4)
    gains = np.random.default_rng(0).normal(size=(3, 1, 2, 4))
    together = Runs(drawn, 3, track.observe).drive(gains, 0.5, nodes_of(Schedule()))
    for k in range(3):
        alone = Runs(drawn, 1, track.observe).drive(gains[[k]], 0.5, nodes_of(Schedule()))
        np.testing.assert_array_equal(alone[0], together[k])
    gains[1, 0, 0, 0] = np.nan
    broken = Runs(drawn, 3, track.observe).drive(gains, 0.5, nodes_of(Schedule()))
    assert np.all(np.isinf(broken[1]))
    np.testing.assert_array_equal(broken[[0, 2]], together[[0, 2]])


def test_laws_that_cannot_share_the_cars_are_refused():
    drawn = episodes(TRACKS["feedback"], "training", force_scale=1.0, count=2)
    runs = Runs(drawn, 2, "feedback")
    seen = np.zeros((4, 4), np.float32)
    with pytest.raises(ValueError, match="laws must drive equally many of 4 cars, got 3 laws"):
        runs.cars.drive(None, np.zeros((3, 2, 4)), seen, intervals=1, window=1)


def test_a_law_cannot_be_scheduled_on_what_it_does_not_see():
    with pytest.raises(ValueError, match="must see them"):
        LawNet(
            space("feedback", False),
            FeatureMap(kind="feedback"),
            (),
            2,
            schedule=Schedule(roads=(0.5, 1.5)),
        )
    with pytest.raises(ValueError, match="limits must rise"):
        Schedule(limits=(1.0, 0.5))
