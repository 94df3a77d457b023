import numpy as np
import pytest
from scipy.integrate import solve_ivp

from qcar_env.control.suspension import OUTPUTS, STATES, suspension
from qcar_env.parts.spring import CubicSpring
from qcar_env.physics.car import QuarterCar
from qcar_env.scenarios import scenario

NUMBERS = {"m1": 40.0, "m2": 300.0, "k1": 190e3, "k2": 20e3, "c1": 50.0, "c2": 1500.0}
CAR = QuarterCar.from_physical(**NUMBERS)
DT = 0.005


def rates(xi, F, slope):
    """Return xi' by Newton's law."""
    travel, v2, tyre, v1 = xi
    p = NUMBERS
    strut = p["k2"] * travel + p["c2"] * (v2 - v1) - F  # pulls the masses together
    road = -p["k1"] * tyre + p["c1"] * (slope - v1)
    return np.array([v2 - v1, -strut / p["m2"], v1 - slope, (road + strut) / p["m1"]])


def test_it_is_newtons_law():
    plant = suspension(CAR, DT)
    for column in np.random.default_rng(0).normal(size=(20, 6)):
        xi, F, slope = column[:4], 1e3 * column[4], column[5]
        expected = rates(xi, F, slope)
        np.testing.assert_allclose(plant.A @ xi + plant.B * F + plant.G * slope, expected, 1e-9)
        c, d, e = plant.rows(OUTPUTS)
        values = c @ xi + d * F + e * slope
        np.testing.assert_allclose(values[:4], xi)
        np.testing.assert_allclose(values[4:], [xi[1] - xi[3], expected[1], expected[3]], 1e-9)
    assert STATES == OUTPUTS[:4]


def test_the_sampled_plant_is_exact_on_a_straight_road():
    plant = suspension(CAR, DT)
    xi, F, slope = np.array([0.02, -0.3, 0.01, 0.5]), 700.0, 0.8
    found = solve_ivp(lambda t, x: rates(x, F, slope), (0.0, DT), xi, rtol=1e-11, atol=1e-13)
    sampled = plant.Ad @ xi + plant.Bd * F + plant.Gd * slope
    np.testing.assert_allclose(sampled, found.y[:, -1], rtol=1e-8)


def test_a_nonlinear_car_is_taken_by_its_tangent_at_rest():
    stiff = QuarterCar(
        m1=40.0, m2=300.0, spring=CubicSpring(k=20e3, k3=1e6), damper=CAR.damper, tyre=CAR.tyre
    )
    np.testing.assert_allclose(suspension(stiff, DT).A, suspension(CAR, DT).A, rtol=1e-6, atol=1e-6)


def test_what_has_no_place_here_is_refused():
    with pytest.raises(ValueError, match="needs a car with masses, got a PaperCar"):
        suspension(scenario("paper").car, DT)
    with pytest.raises(ValueError, match="dt must be positive"):
        suspension(CAR, 0.0)
    with pytest.raises(ValueError, match="unknown signal of the suspension 'x2'"):
        suspension(CAR, DT).row("x2")
