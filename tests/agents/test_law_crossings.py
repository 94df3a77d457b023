import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from agents import crossing  # noqa: E402
from agents.law_crossings import cross  # noqa: E402
from agents.networks import FeatureMap, LawNet, Schedule  # noqa: E402
from agents.training_env import space  # noqa: E402
from qcar_env.evaluation.tracks import TRACKS, episodes  # noqa: E402


def drive(law, plants, z, observe, steps, window):
    """Let a law drive step by step, through the policy itself."""
    peak = np.zeros((len(plants), 2))
    for step in range(steps):
        seen = crossing.observations(z, plants, observe, False)
        with torch.no_grad():
            action = law(torch.as_tensor(seen)).numpy()
        z = crossing.advance(z, action.astype(np.float64), plants)
        if step >= steps - window:
            peak = np.maximum(peak, np.abs(z[:, :2]))
    return peak, z


@pytest.mark.parametrize(
    ("name", "schedule"),
    [
        ("feedback", Schedule()),
        ("budget", Schedule()),
        ("randomised", Schedule()),
        ("randomised", Schedule(roads=(0.6, 1.3), forces=(0.6, 0.9, 1.3))),
    ],
)
def test_compiled_crossings_are_those_of_the_policy(name, schedule):
    track = TRACKS[name]
    drawn = episodes(track, "training", force_scale=0.5, count=5)
    plants, z = crossing.of_track(drawn, track.nominal)
    laws = []
    for seed in range(2):
        law = LawNet(space(track.observe, False), FeatureMap(), (), 2, schedule=schedule)
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            law.gains.add_(torch.randn(law.gains.shape, generator=generator))
            law.gains[..., 0, 2] -= 2.0
            law.gains[..., 1, 3] -= 2.0
        laws.append(law)
    gains = np.sinh([law.gains[0].detach().double().numpy() for law in laws])
    peak, last = cross(
        gains,
        plants,
        z,
        steps=400,
        window=100,
        road_nodes=schedule.roads,
        force_nodes=schedule.forces,
    )
    for k, law in enumerate(laws):
        by_hand, end = drive(law, plants, z, track.observe, 400, 100)
        # The policy works in single precision: 400 intervals of 1e-7 each, and less as it damps.
        np.testing.assert_allclose(peak[k], by_hand, rtol=2e-4)
        np.testing.assert_allclose(last[k], end, atol=2e-4 * np.abs(end).max())


def test_a_crossing_in_two_parts_is_the_same():
    track = TRACKS["randomised"]
    plants, z = crossing.of_track(
        episodes(track, "training", force_scale=1.0, count=3), track.nominal
    )
    gains = np.random.default_rng(0).normal(size=(2, 4, 2, 8))
    nodes = {"road_nodes": (0.6, 1.3), "force_nodes": (0.6, 1.3)}
    peak, last = cross(gains, plants, z, steps=300, window=100, **nodes)
    for law in range(2):
        one = gains[law : law + 1]
        _, middle = cross(one, plants, z, steps=120, window=1, **nodes)
        again, end = cross(one, plants, middle[0], steps=180, window=100, **nodes)
        np.testing.assert_array_equal(again[0], peak[law])
        np.testing.assert_array_equal(end[0], last[law])


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
