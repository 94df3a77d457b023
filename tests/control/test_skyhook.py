import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.control.lnvc import LNVC
from qcar_env.control.skyhook import Groundhook, Hybrid, Skyhook
from qcar_env.parts.actuator import SuspensionActuator
from qcar_env.parts.part import Nothing
from qcar_env.physics import linear
from qcar_env.physics.closed_loop import ControlledState, LoopNumbers, loop_functions
from qcar_env.physics.state import State
from qcar_env.scenarios import scenario

GAIN = st.floats(0.0, 1e3)
CAR = scenario("mathworks-hump").car
READY = CAR.functions.prepare(CAR.numbers)


def forces(law, x):
    """Return the specific forces that a law asks for."""
    return law.command(x, Nothing(), law.numbers)


def between(law, x, limit=1e9):
    """Return the specific forces that one actuator between the masses gives."""
    actuator = SuspensionActuator(limit=limit)
    loop = loop_functions(CAR.functions, law.functions, actuator=SuspensionActuator)
    return loop.forces(
        ControlledState(x, Nothing()), LoopNumbers(READY, law.numbers, actuator.numbers)
    )


@given(x=..., G1=GAIN, G2=GAIN)
def test_against_the_ground_the_hybrid_is_linear_velocity_feedback(x: State, G1, G2):
    assert forces(Hybrid(G1=G1, G2=G2), x) == forces(LNVC(G1=G1, G2=G2), x)


@given(x=..., G1=GAIN, G2=GAIN)
def test_between_the_masses_the_two_forces_are_opposite_and_are_what_both_ask_for(x: State, G1, G2):
    u1, u2 = between(Hybrid(G1=G1, G2=G2), x)
    # half a dozen roundings, of the limit of 1e9 N too
    scale = 1e-14 * (CAR.m1 * G1 * abs(x.v1) + CAR.m2 * G2 * abs(x.v2))
    assert CAR.m1 * u1 == pytest.approx(-CAR.m2 * u2, abs=scale + 1e-280)
    asked = CAR.m1 * G1 * x.v1 - CAR.m2 * G2 * x.v2
    assert CAR.m2 * u2 == pytest.approx(asked, abs=scale + 1e-280)
    small = between(Hybrid(G1=G1, G2=G2), x, 100.0)
    assert abs(CAR.m2 * small[1]) <= 100.0 * (1.0 + 1e-15)


@given(x=..., G=GAIN)
def test_each_hook_holds_its_own_mass(x: State, G):
    assert forces(Skyhook(G=G), x) == (0.0, -G * x.v2)
    assert forces(Groundhook(G=G), x) == (-G * x.v1, 0.0)


def test_skyhook_calms_the_body_of_a_real_car_and_groundhook_the_wheel():
    # Closed loop at the two modes: damping of body mode grows with the skyhook.
    def damping(law):
        plant = linear.matrices(CAR)
        u = np.array(between(law, State(*np.eye(4))))
        values = np.linalg.eigvals(plant.A + plant.B @ u)
        order = np.argsort(np.abs(values))
        return -values.real[order[0]], -values.real[order[-1]]

    passive = damping(Hybrid(G1=0.0, G2=0.0))
    assert damping(Skyhook(G=5.0))[0] > 1.5 * passive[0]
    assert damping(Groundhook(G=5.0))[1] > 1.2 * passive[1]


@pytest.mark.parametrize("law", [Skyhook, Groundhook])
def test_bad_gains_are_refused(law):
    with pytest.raises(ValueError, match="gain G must not be negative"):
        law(G=-1.0)
    with pytest.raises(ValueError, match="gain G1 must not be negative"):
        Hybrid(G1=-1.0)
