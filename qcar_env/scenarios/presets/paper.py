"""Scenarios by name, with the sources of their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from qcar_env.parts.actuator import IndependentActuators, SuspensionActuator
from qcar_env.physics.car import PaperCar, QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads.shapes import HalfSine, Sine, Step
from qcar_env.roads.train import Train
from qcar_env.scenarios.randomise import (
    Uniform,
    Vary,
    body_mass_of_paper_car,
    speed_and_force_frequency,
    wheel_mass_of_paper_car,
)
from qcar_env.scenarios.reference import Scales
from qcar_env.scenarios.scenario import Scenario

# The paper states no parameter values. This set was calibrated: least squares on Table 1's ratios
# and uncontrolled amplitudes, then on the signs of the trends of its section 5.2. Many sets fit.
PAPER_CAR = PaperCar(
    omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5, mu1=2510.0, mu2=16.0
)
PAPER_FORCE = ExternalForce(f=24.8, Omega=55.0)
PAPER_SOURCE = "calibrated on Table 1 of Alluhydan et al., Mathematics 2024, 12(19), 3046"
# CNVC's own peak forces in steady state with G = 1.2 are 277.5 and 32.3 m/s^2.
PAPER_ACTUATOR = IndependentActuators(limit=(280.0, 33.0))
# Chosen here, as the paper gives omega = 55 rad/s alone: 28.8 km/h, humps 0.457 m long. A power of
# two, so that speed times wavenumber is 55 rad/s to the last bit.
PAPER_SPEED = 8.0  # [m/s]
PAPER_WAVENUMBER = 55.0 / PAPER_SPEED  # [rad/m]
PAPER_ROAD = Sine(h=0.1, wavenumber=PAPER_WAVENUMBER)

_FORCING = {"y": 0.1, "y_dot": 0.1 * 55.0, "F": 24.8, "F_dot": 24.8 * 55.0}
# Amplitudes of the uncontrolled steady motion, as observations of version 0.1.0 had them.
PAPER_SCALES = Scales(
    A1=1.1163487155964877, A2=1.5892080534017654, omega1=55.0, omega2=55.0, others=_FORCING
)

# Sprung 300 kg, unsprung 60 kg, k 16 and 190 kN/m, damper 1 kN s/m; modes at 7.1 and 58 rad/s.
MATHWORKS_CAR = QuarterCar.from_physical(
    m1=60.0, m2=300.0, k1=190_000.0, k2=16_000.0, c1=0.0, c2=1_000.0
)
MATHWORKS_SOURCE = "MathWorks, Robust Control of Active Suspension (quarter-car example)"

_PRESETS = (
    Scenario(
        name="paper",
        title="The paper's worst case: omega1 = omega2 = omega = Omega, endless harmonic hump",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=PAPER_ROAD,
        speed=PAPER_SPEED,
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
        scales=PAPER_SCALES,
    ),
    Scenario(
        name="paper-hump",
        title="The paper's car over one half-sine hump, under the external force",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=HalfSine(h=0.1, wavenumber=PAPER_WAVENUMBER, start=4.0),
        speed=PAPER_SPEED,
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
        # As version 0.1.0 had them: of the answer to the external force alone.
        scales=Scales(
            A1=0.40738430948237647,
            A2=1.0424208303914153,
            omega1=55.0,
            omega2=55.0,
            others=_FORCING,
        ),
    ),
    Scenario(
        name="paper-step",
        title="The paper's car on a constant step (its Fig. 11), under the external force",
        source=PAPER_SOURCE,
        car=PAPER_CAR,
        road=Step(h=0.1),
        speed=PAPER_SPEED,
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
    ),
    Scenario(
        name="paper-randomised",
        title="The paper's worst case with height, force, speed and masses drawn per episode",
        source=PAPER_SOURCE + "; ranges chosen here: a hump half to one and a half times as "
        "high, speed and masses within 10 %",
        car=PAPER_CAR,
        road=PAPER_ROAD,
        speed=PAPER_SPEED,
        force=PAPER_FORCE,
        actuator=PAPER_ACTUATOR,
        randomisation=(
            Vary(by=Uniform(low=0.5, high=1.5), numbers={"road.h": 1.0}),
            Vary(by=Uniform(low=0.5, high=1.5), numbers={"force.f": 1.0}),
            speed_and_force_frequency(Uniform(low=0.9, high=1.1)),
            body_mass_of_paper_car(Uniform(low=0.9, high=1.1)),
            wheel_mass_of_paper_car(Uniform(low=0.9, high=1.1)),
        ),
        scales=PAPER_SCALES,
    ),
    Scenario(
        name="mathworks-hump",
        title="A passenger car over one hump, 3 m long and 0.1 m high, at 10 km/h",
        source=MATHWORKS_SOURCE + "; hump within the usual 3 to 9 m, 60 to 120 mm",
        car=MATHWORKS_CAR,
        road=HalfSine.of_length(h=0.1, L=3.0, start=1.5),
        speed=10.0 / 3.6,
        actuator=SuspensionActuator(limit=(1_500.0,)),
        duration=4.0,
    ),
    Scenario(
        name="mathworks-train",
        title="A passenger car over five humps, 3 m long and 3 m apart, at 20 km/h",
        source=MATHWORKS_SOURCE + "; humps as above",
        car=MATHWORKS_CAR,
        road=Train(shape=HalfSine.of_length(h=0.1, L=3.0, start=3.0), count=5, gap=3.0),
        speed=20.0 / 3.6,
        actuator=SuspensionActuator(limit=(1_500.0,)),
        duration=8.0,
    ),
)

SCENARIOS: Mapping[str, Scenario] = MappingProxyType({each.name: each for each in _PRESETS})
