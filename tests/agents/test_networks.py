import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from qcar_env.agents import export  # noqa: E402
from qcar_env.agents.export import TOLERANCE, export_checked, largest_difference  # noqa: E402
from qcar_env.agents.networks import (  # noqa: E402
    Deterministic,
    Features,
    LawNet,
    Schedule,
    space,
)
from qcar_env.agents.recipes import RECIPES, FeatureMap, recipe  # noqa: E402
from qcar_env.agents.sb3 import SB3Trainer  # noqa: E402

LIMITS = (0.1, 0.25, 0.5, 0.75, 1.0)


def jumbled(module, scale=0.3):
    """Return the module with weights as large as training makes them."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for each in module.parameters():
            each.add_(scale * torch.randn(each.shape, generator=generator))
    return module


def trainer(name):
    return SB3Trainer(dataclasses.replace(RECIPES[name], cars=8), seed=0)


@pytest.mark.parametrize("name", ["ppo-budget", "sac-paper", "td3-paper"])
def test_what_is_exported_is_what_sb3_predicts(name, tmp_path):
    model = trainer(name).model
    actor = Deterministic(model.policy)
    if name != "td3-paper":
        jumbled(actor, 0.1)
    size = model.observation_space.shape[0]
    seen = np.random.default_rng(0).uniform(-2.0, 2.0, (10_000, size)).astype(np.float32)
    if size == 9:
        seen[:, -1] = np.random.default_rng(1).uniform(0.1, 1.0, 10_000)
    theirs, _ = model.predict(seen, deterministic=True)
    with torch.no_grad():
        ours = actor(torch.as_tensor(seen)).numpy()
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=TOLERANCE)
    if name != "td3-paper":
        export_checked(actor, size, tmp_path / "policy.onnx")  # compares on 10^4 observations


@pytest.mark.parametrize("limits", [(1.0,), LIMITS])
def test_a_law_of_high_gain_is_exported_to_the_tolerance(limits, tmp_path):
    scheduled = len(limits) > 1
    law = LawNet(space("full", scheduled), FeatureMap(), (), 2, schedule=Schedule(limits=limits))
    jumbled(law, 3.0)
    export_checked(law, 8 + scheduled, tmp_path / "policy.onnx")


def test_an_export_that_differs_is_found_and_refused(tmp_path, monkeypatch):
    path = tmp_path / "policy.onnx"
    law = jumbled(LawNet(space("feedback", False), FeatureMap(kind="feedback"), (), 2), 1.0)
    export_checked(law, 4, path)
    with torch.no_grad():
        law.gains[0, 0, 0, 0] += 0.1
    assert largest_difference(law, path, 4) > 1e-3
    monkeypatch.setattr(export, "export", lambda *_: None)  # leave the older file
    with pytest.raises(RuntimeError, match="differs"):
        export_checked(law, 4, path)
    assert not path.exists()


def test_gains_between_two_limits_lie_between_theirs():
    schedule = Schedule(limits=(0.5, 1.0))
    law = LawNet(space("feedback", True), FeatureMap(kind="feedback"), (), 2, schedule=schedule)
    with torch.no_grad():
        law.gains[0, 0, 0, 2], law.gains[1, 0, 0, 2] = -0.1, -0.3  # at limits 0.5 and 1
    for limit, parameter in ((0.5, -0.1), (0.75, -0.2), (1.0, -0.3), (0.2, -0.1), (2.0, -0.3)):
        seen = torch.tensor([[0.0, 0.0, 1.0, 0.0, limit]])
        assert float(law(seen)[0, 0].detach()) == pytest.approx(np.sinh(parameter), rel=1e-6)


def test_the_envelope_stands_still_while_the_car_swings_with_the_road():
    features = Features(space("full", False), FeatureMap())
    angle = torch.linspace(0.0, 6.0, 50)
    a, phi = 0.3, 0.9
    x, v = a * torch.cos(angle + phi), -a * torch.sin(angle + phi)
    seen = torch.stack(
        [x, x, v, v, torch.sin(angle), torch.cos(angle), torch.cos(angle), -torch.sin(angle)], 1
    )
    z = features(seen)[:, 14:18]  # twice (Re z1, Re z2, Im z1, Im z2)
    assert float((z.max(dim=0).values - z.min(dim=0).values).max()) < 1e-5
    envelope = features(seen)[:, 8:10]
    assert torch.allclose(envelope, torch.full((50, 2), a), atol=1e-6)


def test_unknown_names_list_what_there_is():
    with pytest.raises(ValueError, match=r"unknown algorithm 'ppoo'; did you mean 'ppo'"):
        recipe("ppoo", "paper")
    with pytest.raises(ValueError, match="unknown track 'papr'"):
        recipe("ppo", "papr")
    with pytest.raises(ValueError, match="unknown recipe 'td3-budget'"):
        recipe("td3", "budget")
    with pytest.raises(ValueError, match="unknown feature map"):
        FeatureMap(kind="more")


def test_ppo_and_sac_have_a_recipe_for_every_task():
    from qcar_env.agents.recipes import TASKS

    for task in TASKS:
        for algorithm in ("ppo", "sac", "cma", "gradient"):
            assert recipe(algorithm, task).name == f"{algorithm}-{task}"
