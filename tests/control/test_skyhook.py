import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.control.lnvc import LNVC
from qcar_env.control.skyhook import Groundhook, Hybrid, Skyhook
from qcar_env.physics import linear
from qcar_env.physics.closed_loop import REST
from qcar_env.physics.state import State
from qcar_env.scenarios import MATHWORKS_CAR

GAIN = st.floats(0.0, 1e3)


def forces(law, x):
    return law.command(x, REST, law.gains)


@given(x=..., G1=GAIN, G2=GAIN)
def test_against_the_ground_the_hybrid_is_linear_velocity_feedback(x: State, G1, G2):
    assert forces(Hybrid(G1=G1, G2=G2), x) == forces(LNVC(G1=G1, G2=G2), x)


@given(x=..., G1=GAIN, G2=GAIN, ratio=st.floats(0.5, 20.0))
def test_between_the_masses_the_two_forces_are_opposite(x: State, G1, G2, ratio):
    u1, u2 = forces(Hybrid(G1=G1, G2=G2, mass_ratio=ratio), x)
    # m1 u1 + m2 u2 = 0; rounding of four products.
    scale = (G1 * abs(x.v1) + ratio * G2 * abs(x.v2)) * 1e-14
    assert u1 + ratio * u2 == pytest.approx(0.0, abs=scale + 1e-300)


@given(x=..., G=GAIN)
def test_each_hook_holds_its_own_mass(x: State, G):
    assert forces(Skyhook(G=G), x) == (0.0 * x.v2 - 0.0 * x.v1, 0.0 * x.v1 - G * x.v2)
    assert forces(Groundhook(G=G), x)[0] == -G * x.v1
    assert forces(Groundhook(G=G), x)[1] == 0.0


def test_skyhook_calms_the_body_of_a_real_car_and_groundhook_the_wheel():
    # Closed loop at the two modes: damping of body mode grows with the skyhook.
    car = MATHWORKS_CAR
    ratio = car.m2 / car.m1

    def damping(law):
        plant = linear.matrices(car)
        unit = np.eye(4)
        u = np.array(forces(law, State(*unit)))
        values = np.linalg.eigvals(plant.A + plant.B @ u)
        order = np.argsort(np.abs(values))
        return -values.real[order[0]], -values.real[order[-1]]

    passive = damping(Hybrid(G1=0.0, G2=0.0))
    assert damping(Skyhook(G=5.0, mass_ratio=ratio))[0] > 1.5 * passive[0]
    assert damping(Groundhook(G=5.0, mass_ratio=ratio))[1] > 1.2 * passive[1]


@pytest.mark.parametrize("law", [Skyhook, Groundhook])
def test_bad_gains_are_refused(law):
    with pytest.raises(ValueError, match="gain G must not be negative"):
        law(G=-1.0)
    with pytest.raises(ValueError, match="mass_ratio must be positive"):
        law(mass_ratio=0.0)
    with pytest.raises(ValueError, match="gain G1 must not be negative"):
        Hybrid(G1=-1.0)
