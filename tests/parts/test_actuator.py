"""Actuators keep their limits of force, rate and power, and the law of action and reaction."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from qcar_env.parts.actuator import (
    Actuator,
    IndependentActuators,
    LaggedSemiActiveDamper,
    LaggedSuspensionActuator,
    SemiActiveDamper,
    SuspensionActuator,
)
from qcar_env.parts.part import Nothing

ACTION = st.floats(-3.0, 3.0)
RATE = st.floats(-10.0, 10.0)
MEMORY = st.floats(-1e4, 1e4)
EM = LaggedSuspensionActuator(limit=2e3, lag=5e-3, rate_limit=4e4, power=2e3, dead_zone=50.0)


def remember(part, value):
    return part.State(*(value for _ in part.State._fields))


def forces(part, memory, action, travel_rate):
    p = part.numbers
    return part.force(remember(part, memory), part.command(action, p), travel_rate, p)


@given(part=..., memory=MEMORY, action=st.tuples(ACTION, ACTION), travel_rate=RATE)
def test_between_the_masses_forces_are_equal_and_opposite(
    part: Actuator, memory: float, action: tuple[float, float], travel_rate: float
):
    u1, u2 = forces(part, memory, action, travel_rate)
    assert part.unit == "m/s^2" or u1 == -u2


@given(part=..., a=ACTION, b=ACTION)
def test_ideal_actuators_give_their_limit_times_the_clipped_action(
    part: IndependentActuators, a: float, b: float
):
    expected = [limit * min(max(x, -1), 1) for limit, x in zip(part.limit, (a, b), strict=True)]
    assert [*forces(part, 0.0, (a, b), 0.0)] == expected
    one = SuspensionActuator(limit=part.limit[0])
    assert forces(one, 0.0, (a,), 0.0) == (-expected[0], expected[0])


@given(part=..., memory=MEMORY, action=ACTION, travel_rate=RATE)
def test_limits_of_force_rate_and_power_hold(
    part: LaggedSuspensionActuator, memory: float, action: float, travel_rate: float
):
    p = part.numbers
    (command,) = part.command((action,), p)
    assert abs(command) <= part.limit[0] - part.dead_zone * (1.0 - 1e-12)
    assert abs(part.rate(remember(part, memory), (command,), travel_rate, p).F) <= part.rate_limit
    _, F = forces(part, memory, (action,), travel_rate)
    assert abs(F * travel_rate) <= part.power * (1.0 + 1e-15)  # three roundings
    assert abs(F) <= abs(memory)
    assert F * memory >= 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_power_is_limited_in_and_out(sign: float):
    """2 kW at 4 m/s leave 500 N of 1500 N, whichever way it moves; at 1 m/s all of them."""
    assert forces(EM, 1500.0, (0.0,), 4.0 * sign) == (-500.0, 500.0)
    assert forces(EM, 1500.0, (0.0,), 1.0 * sign) == (-1500.0, 1500.0)
    assert forces(EM, 1500.0, (0.0,), 0.0 * sign) == (-1500.0, 1500.0)


@given(memory=MEMORY, action=ACTION, travel_rate=RATE)
def test_limits_that_are_not_given_change_nothing(memory: float, action: float, travel_rate: float):
    part = LaggedSuspensionActuator(limit=2e3, lag=0.01)
    assert part.linear
    assert forces(part, memory, (action,), travel_rate) == (-memory, memory)
    command = SuspensionActuator(limit=2e3).command((action,), part.numbers)
    assert part.command((action,), part.numbers) == command
    found = part.rate(part.State(memory), command, travel_rate, part.numbers)
    assert found.F == (command[0] - memory) * (1.0 / 0.01)


@pytest.mark.parametrize("limit", [{"rate_limit": 4e4}, {"power": 2e3}, {"dead_zone": 50.0}])
def test_each_limit_makes_a_lagged_actuator_nonlinear(limit):
    assert not LaggedSuspensionActuator(limit=2e3, lag=0.01, **limit).linear


def test_a_lag_reaches_its_command_exponentially():
    part, F, step = LaggedSuspensionActuator(limit=2e3, lag=0.01), 0.0, 1e-6
    for _ in range(10_000):  # one lag
        F += step * part.rate(part.State(F), (1e3,), 0.0, part.numbers).F
    # Euler's error of exp(-t / lag) after one lag: step / (2 lag), here 5e-5
    assert F == pytest.approx(1e3 * (1.0 - math.exp(-1.0)), rel=1e-4)


def test_a_dead_zone_takes_small_commands_away_and_diminishes_others():
    for action, expected in {0.02: 0.0, -0.025: 0.0, 0.5: 950.0, -2.0: -1950.0}.items():
        assert EM.command((action,), EM.numbers) == (pytest.approx(expected),)


SemiActive = SemiActiveDamper | LaggedSemiActiveDamper


@given(
    part=st.from_type(SemiActiveDamper) | st.from_type(LaggedSemiActiveDamper),
    memory=MEMORY,
    action=ACTION,
    v1=RATE,
    v2=RATE,
)
def test_semi_active_dampers_only_take_energy_out(
    part: SemiActive, memory: float, action: float, v1: float, v2: float
):
    """Whatever their memory: an integrator's overshoot feeds nothing in either."""
    _, F = forces(part, memory, (action,), v2 - v1)
    assert F * (v2 - v1) <= 0.0
    most, least = part.c_max * abs(v2 - v1), part.c_min * abs(v2 - v1)
    assert least - 1e-15 * most <= abs(F) <= most * (1.0 + 1e-15)


@given(part=...)
def test_actions_span_the_damping_from_least_to_largest(part: SemiActiveDamper):
    found = [forces(part, 0.0, (action,), 1.0)[0] for action in (-1.0, 0.0, 1.0)]
    middle = (part.c_min + part.c_max) / 2
    assert found == pytest.approx([part.c_min, middle, part.c_max], abs=1e-15 * part.c_max)
    lagged = LaggedSemiActiveDamper(c_min=part.c_min, c_max=part.c_max, lag=0.01)
    assert forces(lagged, lagged.at_rest.c, (1.0,), 1.0)[0] == found[1]


@given(part=...)
def test_the_protocol_is_complete(part: Actuator):
    assert len(part.limit) == part.size == len(part.command((0.0, 0.0), part.numbers))
    assert part.delay >= 0.0
    assert (part.at_rest == Nothing()) == (not hasattr(part, "rate"))


def test_a_limit_of_one_is_a_number_or_a_tuple_and_can_be_replaced():
    assert SuspensionActuator(limit=2e3) == SuspensionActuator(limit=[2000])
    assert replace(SuspensionActuator(limit=2e3), limit=1e3).limit == (1e3,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: IndependentActuators(limit=3.0),
            r"force limit must be a tuple of 2, got 3.0; give 2",
        ),
        (
            lambda: SuspensionActuator(limit=(1.0, 2.0)),
            r"force limit must be a tuple of 1, got \(1.0, 2.0\); give 1",
        ),
        (
            lambda: SuspensionActuator(limit=0.0),
            r"force limit must be positive, got 0 N; give a value above 0 N",
        ),
        (lambda: replace(EM, lag=0.0), "time constant lag must be positive, got 0 s; give a value"),
        (lambda: replace(EM, power=-1.0), "largest power must be positive, got -1 W; give a value"),
        (
            lambda: replace(EM, rate_limit=math.inf),
            "rate_limit must be finite, got inf N/s; give a finite number",
        ),
        (
            lambda: replace(EM, delay=-1.0),
            "delay of the command delay must not be negative, got -1",
        ),
        (
            lambda: replace(EM, dead_zone=2e3),
            "dead_zone must be below the limit of 2000 N, got 2000 N; give a smaller one",
        ),
        (
            lambda: SemiActiveDamper(c_min=2.0, c_max=1.0),
            "c_max must be at least c_min of 2 N s/m, got 1 N s/m; exchange them",
        ),
    ],
)
def test_what_is_refused_is_named_with_value_and_remedy(make, message: str):
    with pytest.raises(ValueError, match=message):
        make()
