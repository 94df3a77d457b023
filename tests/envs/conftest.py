"""A scenario unlike the presets: nonlinear parts, a road from a table, numbers that vary."""

import pytest

from qcar_env import SCENARIOS, Scenario, scenario
from qcar_env.parts.actuator import LaggedSuspensionActuator
from qcar_env.parts.damper import BilinearDamper
from qcar_env.parts.spring import CubicSpring, Stops
from qcar_env.parts.tyre import LiftOffTyre
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.scenarios import Choice, LogUniform, Normal, Uniform, Vary

ODD = "odd"
NAMES = [*SCENARIOS, ODD]


@pytest.fixture(scope="session")
def odd() -> Scenario:
    """A car of nonlinear parts on a rough road, with a lagged actuator and numbers that vary."""
    return Scenario(
        name=ODD,
        car=QuarterCar(
            m1=45.0,
            m2=320.0,
            spring=CubicSpring(k=18e3, k3=1e6),
            damper=BilinearDamper(c_compression=900.0, c_rebound=1600.0, knee=0.2, fast=0.5),
            tyre=LiftOffTyre(k=190e3, c=80.0),
            stops=Stops(bump=0.08, rebound=0.09, k=2e5, k3=1e8),
        ),
        road=ISO8608.of_class("D", L=200.0, seed=3, start=1.0),
        speed=15.0,
        force=ExternalForce(f=0.3, Omega=7.0),
        actuator=LaggedSuspensionActuator(limit=(2000.0,), lag=0.008, rate_limit=2e5, power=2e3),
        randomisation=(
            Vary(by=Uniform(low=0.9, high=1.2), numbers={"car.m2": 1.0}),
            Vary(by=LogUniform(low=0.5, high=2.0), numbers={"car.spring.k3": 1.0}),
            Vary(by=Normal(mean=0.008, sd=0.0005), numbers={"actuator.lag": 0.0}),
            Vary(by=Choice(values=(10.0, 15.0, 20.0)), numbers={"speed": 0.0}),
        ),
        duration=2.0,
    )


@pytest.fixture(scope="session")
def find(odd):
    """Return a preset by its name, or the scenario above."""
    return lambda name: odd if name == ODD else scenario(name)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run what asks for `every_name` on every preset and on the scenario above."""
    if "every_name" in metafunc.fixturenames:
        metafunc.parametrize("every_name", NAMES)
