"""The plant in torch: the engine's own functions, differentiated."""

import dataclasses
import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from qcar_env.agents.gradient import GradientTrainer, Motion  # noqa: E402
from qcar_env.agents.recipes import RECIPES  # noqa: E402
from qcar_env.engine.cars import SAME_STEP  # noqa: E402
from qcar_env.envs.episode import Settings  # noqa: E402
from qcar_env.parts.actuator import SuspensionActuator  # noqa: E402
from qcar_env.parts.damper import LinearDamper  # noqa: E402
from qcar_env.parts.spring import CubicSpring  # noqa: E402
from qcar_env.parts.tyre import LinearTyre  # noqa: E402
from qcar_env.physics.car import QuarterCar  # noqa: E402
from qcar_env.physics.signals import Signal  # noqa: E402
from qcar_env.roads.shapes import Sine  # noqa: E402
from qcar_env.scenarios import SCENARIOS, Scenario  # noqa: E402

HARDENING = Scenario(
    name="hardening",
    car=QuarterCar(
        m1=60.0,
        m2=300.0,
        spring=CubicSpring(k=16_000.0, k3=1e6),
        damper=LinearDamper(c=1_000.0),
        tyre=LinearTyre(k=190_000.0, c=100.0),
    ),
    road=Sine(h=0.02, wavenumber=1.0),
    speed=10.0,
    actuator=SuspensionActuator(limit=(1_500.0,)),
    substeps=8,
)


def moving(scenario, n=3, observe="full"):
    plan = Settings(observe, False, "amplitudes", None, None).plan(scenario, 1.0)
    return Motion(scenario, plan, n, 5)


@pytest.mark.parametrize(
    "scenario", [SCENARIOS["paper"], SCENARIOS["paper-randomised"], HARDENING], ids=lambda s: s.name
)
def test_torch_and_the_engine_move_the_same_car(scenario):
    motion = moving(scenario)
    cars, z = motion.cars, motion.z
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = rng.uniform(-1.0, 1.0, (3, cars.actions)).astype(np.float32)
        z = motion.advance(z, torch.tensor(action))
        seen = motion.seen(z, torch.tensor(action))
        expected = cars.step(action, SAME_STEP)[0]
        # torch works in single precision: sixty intervals of 1e-7 and its growth
        np.testing.assert_allclose(seen.numpy(), expected, rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("scenario", [SCENARIOS["paper"], HARDENING], ids=lambda s: s.name)
def test_the_gradient_is_the_slope_of_the_engines_motion(scenario):
    motion = moving(scenario, n=2)
    m = motion.cars.actions
    action = torch.full((2, m), 0.3, requires_grad=True)
    z = motion.z
    for _ in range(10):
        z = motion.advance(z, action)
    x2 = motion.seen(z, action)[0, 1]
    (slope,) = torch.autograd.grad(x2, action)
    kept, found = motion.cars.snapshot(), []
    for push in (0.35, 0.25):
        motion.cars.restore(kept)
        held = np.full((2, m), 0.3, np.float32)
        held[0, -1] = push
        for _ in range(10):
            seen = motion.cars.step(held, SAME_STEP)[0]
        found.append(float(seen[0, 1]))
    # a central difference over 0.1, in float32
    assert float(slope[0, -1]) == pytest.approx((found[0] - found[1]) / 0.1, rel=1e-2)
    assert float(slope[1].abs().max()) == 0.0


def test_what_torch_cannot_run_is_refused_by_name():
    with pytest.raises(ValueError, match="needs an endless sine as its road, got HalfSine"):
        moving(SCENARIOS["paper-hump"])

    class Clicking(CubicSpring):
        @staticmethod
        def force(travel, p):
            return p.k * np.sin(travel)

    car = dataclasses.replace(HARDENING.car, spring=Clicking(k=16_000.0))
    with pytest.raises(ValueError, match="cannot differentiate car QuarterCar"):
        moving(dataclasses.replace(HARDENING, car=car, scales=None))
    odd = Signal("odd", "m", "odd", lambda m, p: math.floor(m.x.x1), scale=1.0)
    with pytest.raises(ValueError, match="cannot differentiate signal 'odd'"):
        moving(SCENARIOS["paper"], observe=("x1", odd))


def test_a_training_that_diverges_ends():
    """It went on with a network, and cars, that were no numbers."""
    recipe = next(each for each in RECIPES.values() if each.algorithm == "gradient")
    trainer = GradientTrainer(dataclasses.replace(recipe, cars=4), 0)
    with torch.no_grad():
        next(trainer.actor().parameters()).fill_(math.nan)
    with pytest.raises(ValueError, match="the gradient must be finite, got nan after 0 steps"):
        trainer.learn(lambda: True)
