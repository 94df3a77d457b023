"""A tyre that can lift off never pulls; while it pushes it is the linear one."""

import pytest
from hypothesis import given, strategies as st

from qcar_env.parts.tyre import LiftOffTyre, LinearTyre

COMPRESSION, RATE, LOAD = st.floats(-1.0, 1.0), st.floats(-10.0, 10.0), st.floats(0.0, 1e5)


@given(part=..., compression=COMPRESSION, rate=RATE, load=LOAD)
def test_the_road_never_pulls(part: LiftOffTyre, compression: float, rate: float, load: float):
    found = part.force(compression, rate, load, part.numbers)
    linear = LinearTyre(k=part.k, c=part.c).force(compression, rate, load, part.numbers)
    assert load + found >= 0.0
    assert found == max(linear, -load)


@given(part=..., jump=st.floats(-1.0, 1.0))
def test_a_jump_of_the_road_is_the_limit_of_a_steep_ramp(part: LinearTyre, jump: float):
    tyres = part, LiftOffTyre(k=part.k, c=part.c)
    for tyre in tyres:
        # a ramp of 1e-9 s: its rate times its time is the jump, spring and load add 1e-9 of theirs
        found = tyre.force(jump, jump / 1e-9, 4e3, tyre.numbers) * 1e-9
        assert tyre.kick(jump, tyre.numbers) == pytest.approx(found, abs=1e-5 + 2e-9 * part.k)


def test_a_road_that_drops_away_pulls_at_no_tyre_that_can_lift_off():
    for tyre, expected in ((LinearTyre(k=2e5, c=100.0), -5.0), (LiftOffTyre(k=2e5, c=100.0), 0.0)):
        assert tyre.kick(-0.05, tyre.numbers) == expected
        assert tyre.kick(0.05, tyre.numbers) == 5.0


def test_a_tyre_without_stiffness_is_refused():
    with pytest.raises(ValueError, match="tyre stiffness k must be positive, got 0 N/m; give"):
        LinearTyre(k=0.0)
