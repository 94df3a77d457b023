"""Two hundred random crossings, solved by scipy's DOP853 from equations written here."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from qcar_env.physics import linear
from qcar_env.physics.car import PaperCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.roads import excitation as roads
from qcar_env.roads.excitation import Excitation

END = 0.3  # [s] length of a crossing: two periods of a body at 7 Hz and three of a wheel
PAPER_LIKE = dict(omega1=55.0, omega2=55.0, b1=8.7, b2=0.71, E1=0.5, E2=3.4, E3=0.5)


@dataclass(frozen=True)
class Crossing:
    """A car on a road under an external and two held actuator forces, and where it gets."""

    car: PaperCar
    road: Excitation
    profile: str
    force: ExternalForce
    x0: tuple[float, float, float, float]
    u: tuple[float, float]
    edges: tuple[float, ...]  # times at which the road changes, with 0 and END [s]
    truth: NDArray[np.float64]  # (4,) state at END

    @property
    def fastest(self) -> float:
        """Fastest rate in the problem [rad/s]."""
        modes = np.max(np.abs(linear.poles(self.car)))
        return max(float(modes), self.road.omega, self.force.Omega)

    @property
    def scale(self) -> NDArray[np.float64]:
        """Size of the motion, for relative errors: metres, and metres times the fastest rate."""
        size = float(np.max(np.abs([*self.x0[:2], self.road.h])))
        return size * np.array([1.0, 1.0, self.fastest, self.fastest])


@pytest.fixture(scope="session")
def crossings() -> list[Crossing]:
    rng = np.random.default_rng(20240930)
    drawn = [draw(rng, ("harmonic", "hump", "train", "step")[i % 4]) for i in range(200)]
    return [Crossing(*each, x) for each, x in zip(drawn, solve(drawn), strict=True)]


def draw(rng, profile):
    """Draw car, road, force, start, actuator forces and the road's edges."""
    if rng.random() < 0.7:
        low, high = [20, 150, 5e4, 5e3, 0, 0], [500, 3000, 6e5, 1e5, 2e3, 1e4]
        car = PaperCar.from_physical(*rng.uniform(low, high), reciprocal=rng.random() < 0.5)
    else:
        scaled = {name: value * rng.uniform(0.5, 1.5) for name, value in PAPER_LIKE.items()}
        car = PaperCar(**scaled, mu1=rng.uniform(0, 5e3), mu2=rng.uniform(0, 50))
    h, omega, start = rng.uniform(0.02, 0.2), rng.uniform(2.0, 60.0), rng.uniform(0.0, 0.2)
    length = math.pi / omega
    if profile == "harmonic":
        road, edges = roads.harmonic(h=h, omega=omega), []
    elif profile == "hump":
        road, edges = roads.hump(h=h, omega=omega, start=start), [start, start + length]
    elif profile == "train":
        road = roads.train(h=h, omega=omega, start=start, count=3, gap=0.5)
        edges = [start + (1.5 * i + j) * length for i in range(3) for j in range(2)]
    else:
        road, edges = roads.step(h=h, start=start), [start]
    edges = (0.0, *(edge for edge in edges if edge < END), END)
    force = ExternalForce(f=rng.uniform(-30.0, 30.0), Omega=rng.uniform(0.0, 60.0))
    x0 = rng.normal(size=4) * [0.1, 0.1, 3.0, 3.0]
    return car, road, profile, force, tuple(x0), tuple(rng.uniform(-50.0, 50.0, 2)), edges


def solve(drawn):
    """Integrate all crossings together, one piece of their roads after the other.

    Time runs from 0 to 1 on each piece, so that every crossing is at its own edge at 0 and at 1;
    a crossing without a further piece stands still.
    """
    cars, road_of, profiles, forces, x0, u, edges = zip(*drawn, strict=True)
    column = {
        name: np.array([getattr(car, name) for car in cars])
        for name in ("omega1", "omega2", "b1", "b2", "E1", "E2", "E3", "mu1", "mu2")
    }
    h, omega = np.array([(road.h, road.omega) for road in road_of]).T
    f, Omega = np.array([(force.f, force.Omega) for force in forces]).T
    u1, u2 = np.array(u).T
    state = np.array(x0).T
    for piece in range(max(map(len, edges)) - 1):
        begin = np.array([each[min(piece, len(each) - 1)] for each in edges])
        end = np.array([each[min(piece + 1, len(each) - 1)] for each in edges])
        # on a hump's pieces: flat, hump, flat, hump, ...; a step's: flat, raised
        moving = np.array([each == "harmonic" or piece % 2 == 1 for each in profiles])
        raised = np.array([each == "step" and piece == 1 for each in profiles])
        if piece == 1:  # the jump of a step throws the wheel: an infinite rate for no time
            state[2] += column["mu2"] * h * raised * (end > begin)

        def rate(s, flat, begin=begin, end=end, moving=moving, raised=raised):
            x1, x2, v1, v2 = flat.reshape(4, -1)
            t = begin + s * (end - begin)
            y = h * np.where(raised, 1.0, np.sin(omega * (t - begin)) * moving)
            y_dot = h * omega * np.cos(omega * (t - begin)) * moving
            c = column
            a1 = c["mu1"] * y + c["mu2"] * y_dot + u1  # (3)
            a1 -= c["omega1"] ** 2 * x1 + c["b1"] * v1 - c["E2"] * v2 - c["E1"] * x2
            a2 = f * np.cos(Omega * t) + u2  # (4)
            a2 -= c["omega2"] ** 2 * x2 - c["b2"] * (v1 - v2) - c["E3"] * x1
            return (np.array([v1, v2, a1, a2]) * (end - begin)).ravel()

        # 1e-12 for each of 200 crossings, of which the method controls the mean square: 1e-13
        found = solve_ivp(rate, (0.0, 1.0), state.ravel(), "DOP853", rtol=1e-13, atol=1e-14)
        state = found.y[:, -1].reshape(4, -1)
    return state.T
