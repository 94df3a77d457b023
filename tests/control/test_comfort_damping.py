import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import solve_continuous_lyapunov

from qcar_env.control.comfort_damping import comfort_damping, mean_square_acceleration
from qcar_env.control.suspension import suspension
from qcar_env.physics.car import QuarterCar
from qcar_env.scenarios import scenario

SET = {
    "m1": st.floats(20.0, 80.0),
    "m2": st.floats(150.0, 600.0),
    "k1": st.floats(1e5, 3e5),
    "k2": st.floats(1e4, 5e4),
    "c2": st.floats(300.0, 5e3),
}


@given(**SET)
def test_it_is_the_lyapunov_equation(m1, m2, k1, k2, c2):
    car = QuarterCar.from_physical(m1=m1, m2=m2, k1=k1, k2=k2, c1=0.0, c2=c2)
    plant = suspension(car, 0.005)
    P = solve_continuous_lyapunov(plant.A, -0.02 * np.outer(plant.G, plant.G))
    found = plant.A[1] @ P @ plant.A[1]
    assert mean_square_acceleration(m1, m2, k1, k2, c2, 0.02) == pytest.approx(found, rel=1e-6)


@given(**SET)
def test_no_other_damper_is_calmer(m1, m2, k1, k2, c2):
    car = QuarterCar.from_physical(m1=m1, m2=m2, k1=k1, k2=k2, c1=0.0, c2=c2)
    best, own = comfort_damping(car)
    assert own == pytest.approx(c2)
    left = mean_square_acceleration(m1, m2, k1, k2, best, 1.0)
    for factor in (0.9, 0.99, 1.01, 1.1):
        assert left <= mean_square_acceleration(m1, m2, k1, k2, factor * best, 1.0)


def test_a_car_without_masses_is_refused():
    with pytest.raises(ValueError, match="needs a car with masses"):
        comfort_damping(scenario("paper").car)
