"""The paper's car as the analysis takes it."""

import pytest

from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.scenarios import scenario


@pytest.fixture(scope="session")
def paper() -> ForcedCar:
    """Return the calibrated worst case without control."""
    preset = scenario("paper")
    return ForcedCar(
        car=preset.car, h=preset.excitation.h, f=preset.force.f, omega=preset.excitation.omega
    )
