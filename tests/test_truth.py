"""The fleet's plant against equations written here, scipy's DOP853, and laws of physics.

What is run is `Driving.drive`, the function that the environments compile, as plain Python:
compiled code gives its bits (tests/parts/test_parts_numba.py, tests/envs/test_vector.py).
"""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp, trapezoid

from qcar_env.engine.driving import driving
from qcar_env.parts.actuator import (
    LaggedSemiActiveDamper,
    LaggedSuspensionActuator,
    SemiActiveDamper,
    SuspensionActuator,
)
from qcar_env.parts.damper import BilinearDamper, LinearDamper, TableDamper
from qcar_env.parts.spring import CubicSpring, LinearSpring, NoStops, Stops, TableSpring, TableStops
from qcar_env.parts.tyre import LiftOffTyre, LinearTyre
from qcar_env.physics.car import QuarterCar
from qcar_env.physics.external_force import ExternalForce
from qcar_env.physics.motion import Phasors, angle
from qcar_env.physics.plant import PlantState
from qcar_env.physics.state import State
from qcar_env.roads import shapes
from qcar_env.roads.flat_tops import FlatTop, SmoothFlatTop, cushion
from qcar_env.roads.functions import FunctionRoad
from qcar_env.roads.iso8608 import ISO8608
from qcar_env.roads.train import Train
from qcar_env.scenarios import Scenario
from qcar_env.scenarios.plan import UNSCALED, Plan

GRAVITY = 9.81  # [m/s^2] standard value, to three digits as in the library
DT = 0.005
M1, M2 = 45.0, 320.0


def scenario(road=None, actuator=None, speed=10.0, force=None, **parts):
    """Return a car of the linear parts of a compact car, with others in their place."""
    usual = {
        "spring": LinearSpring(k=18e3),
        "damper": LinearDamper(c=1500.0),
        "tyre": LinearTyre(k=190e3, c=80.0),
        "stops": NoStops(),
    }
    return Scenario(
        name="truth",
        car=QuarterCar(m1=M1, m2=M2, **{**usual, **parts}),
        road=road or shapes.Sine(h=0.01, wavenumber=4.8),
        speed=speed,
        force=force or ExternalForce(f=0.5, Omega=11.0),
        actuator=actuator or SuspensionActuator(limit=1500.0),
        duration=1.0,
    )


def drive(of: Scenario, actions, substeps, start=(0.0, 0.0, 0.0, 0.0), dt=DT):
    """Return the states after each action is held for `dt`, (k, 4), with the engine's function."""
    what = Plan(of, (), unscaled=UNSCALED).composition
    motion = driving(what.driven, False, False)
    driven, time = motion.start(of.numbers._replace(sensors=()), 0.0, 0.0, dt / substeps)
    table, kink = np.array(of.road.table).ravel(), 0
    while (next_kink := motion.road.next_kink(kink, driven.road, of.speed, table)) < time:
        kink += 1
    x = PlantState(State(*start), motion.state.memory)
    w = Phasors(motion.road.phasor(time, kink, driven.road), angle(0.0))
    delay = of.intervals("delay", of.actuator.delay)
    commands = [motion.command] * delay
    found = []
    for k, action in enumerate(actions):
        commands.append(type(of.actuator).command((action,), driven.actuator))
        x, w, kink, next_kink = motion.drive(
            *(x, w, commands[k], driven, kink, next_kink, time + k * dt, dt, substeps, table)
        )
        found.append(x.car)
    return np.array(found)


# Equations written here, from the parts' own numbers ---------------------------------------------


def spring(part, d):
    if isinstance(part, TableSpring):
        return line(part.travels, part.forces, d)
    return part.k * d + getattr(part, "k3", 0.0) * d**3


def damper(part, v):
    if isinstance(part, TableDamper):
        return line(part.rates, part.forces, v)
    if isinstance(part, BilinearDamper):
        size = min(abs(v), part.knee) + part.fast * max(abs(v) - part.knee, 0.0)
        return part.c_rebound * size if v > 0 else -part.c_compression * size
    return part.c * v


def stops(part, d):
    if isinstance(part, NoStops):
        return 0.0
    out, into = max(d - part.rebound, 0.0), max(-d - part.bump, 0.0)
    if isinstance(part, TableStops):
        return line(part.depths, part.forces, out) - line(part.depths, part.forces, into)
    return part.k * (out - into) + part.k3 * (out**3 - into**3)


def line(x, y, at):
    """Interpolate, the outer lines continued."""
    i = int(np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2))
    return y[i] + (at - x[i]) * (y[i + 1] - y[i]) / (x[i + 1] - x[i])


def tyre(part, z, z_dot):
    force = part.k * z + part.c * z_dot
    return max(force, -(M1 + M2) * GRAVITY) if isinstance(part, LiftOffTyre) else force


def exact(of: Scenario, actions, start=(0.0, 0.0, 0.0, 0.0), dt=DT):
    """Return the same by DOP853 between actions and kinks; kinks kick a damped wheel."""
    car, actuator, road = of.car, of.actuator, of.road
    kind = type(road)
    far = of.speed * dt * len(actions) + 1.0
    kinks, jumps = [each / of.speed for each in road.kinks(-1.0, far)], road.jumps(-1.0, far)
    lagged = isinstance(actuator, (LaggedSuspensionActuator, LaggedSemiActiveDamper))
    delay = of.intervals("delay", actuator.delay)

    def act(t, x, action, piece):
        x1, x2, v1, v2, memory = x
        s = of.speed * t
        y = kind.height(s, piece, road.numbers, road.table)
        y_dot = of.speed * kind.slope(s, piece, road.numbers, road.table)
        rate = 0.0
        if isinstance(actuator, (SemiActiveDamper, LaggedSemiActiveDamper)):
            low, high = actuator.c_min, actuator.c_max
            asked = low + (high - low) * (action + 1.0) / 2.0
            if lagged:
                rate, asked = (asked - (low + high) / 2.0 - memory) / actuator.lag, memory
                asked += (low + high) / 2.0
            F = -asked * (v2 - v1)
        else:
            asked = actuator.limit[0] * action
            F = asked
            if lagged:
                asked -= np.clip(asked, -actuator.dead_zone, actuator.dead_zone)
                rate = (asked - memory) / actuator.lag
                rate = float(np.clip(rate, -actuator.rate_limit, actuator.rate_limit))
                power = abs(memory * (v2 - v1))
                F = memory * min(1.0, actuator.power / power) if power > 0.0 else memory
        inner = spring(car.spring, x2 - x1) + damper(car.damper, v2 - v1)
        inner += stops(car.stops, x2 - x1)
        outer = tyre(car.tyre, y - x1, y_dot - v1)
        shaken = of.force.f * math.cos(of.force.Omega * t)
        return [v1, v2, (outer + inner - F) / M1, (F - inner) / M2 + shaken, rate]

    x, found, piece, t = np.array([*start, 0.0]), [], 0, 0.0
    given = [0.0] * delay + list(actions)
    for k in range(len(actions)):
        end = (k + 1) * dt
        while True:
            stop = min(kinks[piece] if piece < len(kinks) else math.inf, end)
            if stop > t:
                x = solve_ivp(
                    act, (t, stop), x, "DOP853", rtol=1e-12, atol=1e-14, args=(given[k], piece)
                ).y[:, -1]
                t = stop
            if piece < len(kinks) and kinks[piece] < end:
                jump = jumps[piece]
                kick = jump if isinstance(car.tyre, LinearTyre) else max(jump, 0.0)
                x[2] += car.tyre.c * kick / M1  # c1 h / m1
                piece += 1
            else:
                break
        found.append(x[:4].copy())
    return np.array(found)


def error(of, actions, substeps, expected, **given):
    scale = np.abs(expected).max(axis=0)
    return float(np.abs((drive(of, actions, substeps, **given) - expected) / scale).max())


RNG = np.random.default_rng(7)
ACTIONS = RNG.uniform(-1.0, 1.0, 30)
SMOOTH = {
    "linear": {},
    "cubic spring": {"spring": CubicSpring(k=15e3, k3=2.5e6)},
    "lag": {"actuator": LaggedSuspensionActuator(limit=1200.0, lag=0.009)},
    "delay": {"actuator": SuspensionActuator(limit=1200.0, delay=0.015)},
    "semi-active": {"actuator": SemiActiveDamper(c_min=200.0, c_max=3000.0)},
    "lagged semi-active": {
        "actuator": LaggedSemiActiveDamper(c_min=200.0, c_max=3000.0, lag=0.008, delay=0.005)
    },
}
BENT = {
    "table spring": {
        "spring": TableSpring(
            travels=(-0.1, -0.02, 0.0, 0.03, 0.1), forces=(-3e3, -300, 0, 400, 4e3)
        )
    },
    "stops": {"stops": Stops(bump=0.004, rebound=0.003, k=6e4, k3=2e7)},
    "table stops": {
        "stops": TableStops(bump=0.004, rebound=0.003, depths=(0, 0.01, 0.02), forces=(0, 1e3, 4e3))
    },
    "bilinear damper": {
        "damper": BilinearDamper(c_compression=900.0, c_rebound=2200.0, knee=0.15, fast=0.3)
    },
    "table damper": {
        "damper": TableDamper(rates=(-1, -0.2, 0, 0.2, 1), forces=(-1200, -300, 0, 600, 1500))
    },
    "lift-off": {
        "tyre": LiftOffTyre(k=190e3, c=80.0),
        "road": shapes.Sine(h=0.05, wavenumber=4.8),
    },
    "rate, power and dead zone": {
        "actuator": LaggedSuspensionActuator(
            limit=1500.0, lag=0.008, rate_limit=4e4, power=150.0, dead_zone=60.0
        )
    },
}


@pytest.mark.parametrize("name", SMOOTH)
def test_the_error_of_smooth_parts_falls_with_the_fourth_power(name):
    of = scenario(**SMOOTH[name])
    expected = exact(of, ACTIONS)
    errors = [error(of, ACTIONS, n, expected) for n in (2, 4, 8)]
    assert errors[1] < 1e-4
    # from 2^4 by terms of the next order: the steps are not short beside the wheel's 10 ms
    assert errors[0] / errors[1] > 12.0
    assert errors[1] / errors[2] > 13.0


@pytest.mark.parametrize("name", BENT)
def test_parts_with_corners_agree_with_dop853(name):
    """A step over a corner of a force keeps second order: the error falls with its square."""
    of = scenario(**BENT[name])
    expected = exact(of, ACTIONS)
    assert not np.allclose(expected, exact(scenario(road=of.road), ACTIONS), rtol=1e-3)  # it is met
    errors = [error(of, ACTIONS, n, expected) for n in (4, 64)]
    assert errors[0] < 5e-3
    assert errors[1] < errors[0] / 16.0


def test_all_parts_together_agree_with_dop853_for_random_numbers():
    for _ in range(3):
        a = RNG.uniform(0.7, 1.4, 12)
        of = scenario(
            road=shapes.OneMinusCosine(h=0.06 * a[0], L=0.8 * a[1], start=0.211),
            spring=CubicSpring(k=18e3 * a[2], k3=1e6 * a[3]),
            damper=BilinearDamper(
                c_compression=900 * a[4], c_rebound=1900 * a[5], knee=0.2, fast=0.4
            ),
            tyre=LiftOffTyre(k=190e3 * a[6], c=90 * a[7]),
            stops=Stops(bump=0.03 * a[8], rebound=0.02 * a[9], k=1e5, k3=1e7),
            actuator=LaggedSuspensionActuator(
                limit=1500 * a[10], lag=0.008 * a[11], rate_limit=1e5, power=1e3, delay=0.005
            ),
        )
        start = tuple(RNG.normal(size=4) * (0.005, 0.01, 0.2, 0.2))
        expected = exact(of, ACTIONS, start)
        errors = [error(of, ACTIONS, n, expected, start=start) for n in (4, 64)]
        assert errors[0] < 2e-2
        assert errors[1] < min(1e-4, errors[0] / 16.0)


ROADS = {
    "sine": shapes.Sine(h=0.02, wavenumber=5.7, start=0.1),
    "half sine": shapes.HalfSine(h=0.06, wavenumber=6.0, start=0.123),
    "one minus cosine": shapes.OneMinusCosine(h=0.06, L=0.5, start=0.123),
    "arc": shapes.CircularArc(h=0.05, L=0.6, start=0.123),
    "parabola": shapes.Parabola(h=0.05, L=0.6, start=0.123),
    "quartic": shapes.Quartic(h=0.05, L=0.6, start=0.123),
    "sextic": shapes.Sextic(h=0.05, L=0.6, start=0.123),
    "square bar": shapes.SquareBar(h=0.02, L=0.4, start=0.123),
    "pothole": shapes.pothole(depth=0.05, L=0.4, start=0.123),
    "flat top": FlatTop(h=0.05, ramp=0.3, top=0.4, start=0.123),
    "smooth flat top": SmoothFlatTop(h=0.05, ramp=0.3, top=0.4, start=0.123),
    "cushion": cushion(h=0.05, L=1.0, gradient=0.2, start=0.123),
    "step": shapes.Step(h=0.03, start=0.123),
    "train": Train(shape=shapes.HalfSine(h=0.03, wavenumber=15.0, start=0.05), gap=0.17, count=3),
    "function": FunctionRoad(profile=lambda s: 0.01 * math.sin(9.0 * s), kinks_at=()),
}


@pytest.mark.parametrize("name", ROADS)
def test_the_error_on_every_road_falls_with_the_fourth_power_between_kinks(name):
    of = scenario(road=ROADS[name])
    expected = exact(of, ACTIONS)
    errors = [error(of, ACTIONS, n, expected) for n in (4, 8)]
    assert errors[0] < 2e-4
    assert errors[0] / errors[1] > 11.0


def test_a_rough_road_agrees_with_dop853():
    """Splines join three times differentiable pieces, more of them than steps: second order."""
    of = scenario(road=ISO8608.of_class("C", L=100.0, seed=2, start=0.2))
    expected = exact(of, ACTIONS)
    assert error(of, ACTIONS, 4, expected) < 2e-3
    assert error(of, ACTIONS, 32, expected) < 1e-4


# Laws that no controller can break: real_cars 5.2, for any force between the masses -------------


def saturated(x, of):
    """Return an action of a cubic law that saturates, of the state."""
    return float(np.clip(-400.0 * x[3] ** 3 + 3.0 * (x[1] - x[0]) + 0.5 * x[2], -1.0, 1.0))


@pytest.mark.parametrize("controlled", [False, True])
def test_moments_of_the_motion_over_a_hump_are_the_roads(controlled):
    """Wheel hop and travel at their frequencies, momentum, from rest to rest, tyre undamped."""
    k1, speed, L, H, dt = 190e3, 10.0, 0.8, 0.03, 0.0005
    of = scenario(
        road=shapes.HalfSine(h=H, wavenumber=math.pi / L),
        tyre=LinearTyre(k=k1, c=0.0),
        damper=LinearDamper(c=2500.0),
        force=ExternalForce(f=0.0, Omega=1.0),
        speed=speed,
    )
    motion = driving(Plan(of, (), unscaled=UNSCALED).composition.driven, False, False)
    driven, _ = motion.start(of.numbers._replace(sensors=()), 0.0, 0.0, dt)
    x, w = PlantState(State(0.0, 0.0, 0.0, 0.0), motion.state.memory), Phasors(*[angle(0.0)] * 2)
    w = Phasors(motion.road.phasor(0.0, 0, driven.road), w.force)
    kink, next_kink, table = 0, 0.0, np.zeros(0)
    steps = round(3.0 / dt)
    states, forces = np.zeros((steps + 1, 4)), np.zeros(steps)
    for k in range(steps):
        action = saturated(x.car, of) if controlled else 0.0
        forces[k] = 1500.0 * action
        x, w, kink, next_kink = motion.drive(
            *(x, w, (forces[k],), driven, kink, next_kink, k * dt, dt, 1, table)
        )
        states[k + 1] = x.car
    if controlled:
        assert np.abs(forces).max() == 1500.0  # it saturates
    t = np.arange(steps + 1) * dt
    y = np.where(speed * t < L, H * np.sin(np.pi * speed * t / L), 0.0)

    def moment(values, omega):
        return trapezoid(values * np.exp(-1j * omega * t), t)

    hop, both = math.sqrt(k1 / M1), math.sqrt(k1 / (M1 + M2))
    x1, x2 = states[:, 0], states[:, 1]
    # the trapezoids of a smooth motion, of a road with two corners, and what is left at the end
    tolerance = 2e-4 * abs(moment(y, both))
    assert abs(moment(x2, hop) + M1 / M2 * moment(y, hop)) < tolerance
    assert abs(moment(x2 - x1, both) + (1.0 + M1 / M2) * moment(y, both)) < tolerance
    assert abs(trapezoid(k1 * (y - x1), t)) < 1e-3 * trapezoid(np.abs(k1 * (y - x1)), t)


def test_energy_that_goes_in_is_stored_or_lost():
    of = scenario(spring=CubicSpring(k=15e3, k3=2.5e6), road=shapes.Sine(h=0.02, wavenumber=4.8))
    n, dt = 4000, 0.0002
    states = np.vstack([np.zeros(4), drive(of, np.full(n, 0.3), 1, dt=dt)])
    t, (x1, x2, v1, v2) = np.arange(n + 1) * dt, states.T
    s = of.speed * t
    y, y_dot = of.road.heights(s), of.road.slopes(s) * of.speed
    d, F = x2 - x1, 0.3 * 1500.0
    tyre_force = 190e3 * (y - x1) + 80.0 * (y_dot - v1)
    into = tyre_force * y_dot + F * (v2 - v1) + M2 * 0.5 * np.cos(11.0 * t) * v2
    lost = 1500.0 * (v2 - v1) ** 2 + 80.0 * (y_dot - v1) ** 2
    stored = 0.5 * (M1 * v1**2 + M2 * v2**2) + 0.5 * 15e3 * d**2 + 0.25 * 2.5e6 * d**4
    stored += 0.5 * 190e3 * (y - x1) ** 2
    gone = trapezoid(into - lost, t)
    assert stored[-1] - stored[0] == pytest.approx(gone, abs=1e-5 * trapezoid(np.abs(into), t))


def test_a_held_force_ends_in_its_static_deflection():
    of = scenario(
        spring=CubicSpring(k=15e3, k3=2.5e6),
        damper=LinearDamper(c=3000.0),
        road=shapes.Step(h=0.02, start=0.1),
        force=ExternalForce(f=0.0, Omega=1.0),
    )
    x1, x2, v1, v2 = drive(of, np.full(1600, 0.4), 4)[-1]
    d = x2 - x1
    assert 15e3 * d + 2.5e6 * d**3 == pytest.approx(0.4 * 1500.0, rel=1e-9)
    assert x1 == pytest.approx(0.02, rel=1e-9)  # forces between the masses do not load the tyre
    assert max(abs(v1), abs(v2)) < 1e-9


def test_a_step_under_the_bus_gives_its_published_travel():
    """The bus of the Control Tutorials for MATLAB and Simulink; 0.1 m, its tyre damped."""
    bus = QuarterCar.from_physical(320.0, 2500.0, 500e3, 80e3, 15020.0, 350.0)
    of = dataclasses.replace(
        scenario(road=shapes.Step(h=0.1), force=ExternalForce(f=0.0, Omega=1.0)), car=bus
    )
    states = drive(of, np.zeros(4000), 4, dt=0.001)
    assert np.abs(states[:, 1] - states[:, 0]).max() == pytest.approx(0.1103, abs=5e-5)
