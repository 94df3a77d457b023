import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from qcar_env.control.semi_active import (
    ADD,
    SEMI_ACTIVE_LAWS,
    SHADD,
    LinearHybrid,
    Mix1,
    Motion,
    OnOffGroundhook,
    OnOffSkyhook,
)

NUMBER = st.floats(-1e3, 1e3)
MOTION = st.builds(lambda v1, v2, a2: Motion(v1, v2, v2 - v1, a2), NUMBER, NUMBER, NUMBER)
SOFT, HARD = 200.0, 4000.0


def damping(law, m, low=SOFT, high=HARD):
    return law.damping(m, low, high, law.numbers)


@pytest.mark.parametrize("kind", SEMI_ACTIVE_LAWS.values())
@given(m=MOTION)
def test_every_law_stays_within_the_damper(kind, m):
    assert SOFT <= damping(kind(), m) <= HARD
    assert damping(kind(), m, 700.0, 700.0) == 700.0  # a damper with no range is a passive one


@given(m=MOTION)
def test_skyhook_is_hard_exactly_where_it_takes_energy_from_the_body(m):
    # The force on the body is -c w; its power on the body's own motion is -c w v2.
    assert (damping(OnOffSkyhook(), m) == HARD) == (-m.travel_rate * m.v2 <= 0.0)


@given(m=MOTION)
def test_groundhook_is_hard_exactly_where_it_takes_energy_from_the_wheel(m):
    assert (damping(OnOffGroundhook(), m) == HARD) == (m.travel_rate * m.v1 <= 0.0)


@given(m=MOTION)
def test_add_is_hard_exactly_where_the_damper_pushes_against_the_acceleration(m):
    assert (damping(ADD(), m) == HARD) == (-m.travel_rate * m.body_acceleration <= 0.0)


@given(m=MOTION.filter(lambda m: abs(m.body_acceleration) > 1e-6 and abs(m.v2) > 1e-6))
def test_sh_add_is_add_at_a_low_crossover_and_skyhook_at_a_high_one(m):
    assert damping(SHADD(crossover=0.0), m) == damping(ADD(), m)
    assert damping(SHADD(crossover=1e12), m) == damping(OnOffSkyhook(), m)
    assert damping(Mix1(crossover=0.0), m) == SOFT
    assert damping(Mix1(crossover=1e12), m) == HARD


@pytest.mark.parametrize("frequency", [0.5, 1.8, 2.0, 8.0])
def test_a_body_that_swings_is_slow_below_the_crossover(frequency):
    # Of a sine the amplitude of a2 is omega times that of v2, so that a2^2 - alpha^2 v2^2 has the
    # mean (omega^2 - alpha^2) V^2 / 2.
    omega, t = 2.0 * math.pi * frequency, np.linspace(0.0, 1.0 / frequency, 1000, endpoint=False)
    m = Motion(v2=np.cos(omega * t), body_acceleration=-omega * np.sin(omega * t))
    hard = (damping(Mix1(crossover=1.9), m) == HARD).mean()
    # Slow where |tan(omega t)| <= alpha / omega: 2 / pi arctan of it of the time.
    assert hard == pytest.approx(2.0 / math.pi * math.atan(1.9 / frequency), abs=0.01)
    assert (hard > 0.5) == (frequency < 1.9)


@given(m=MOTION.filter(lambda m: abs(m.travel_rate) > 1e-3), share=st.floats(0.0, 1.0))
def test_the_hybrid_gives_both_hooks_where_a_damper_can(m, share):
    law = LinearHybrid(c_hook=1500.0, share=share)
    w = m.travel_rate
    sky = -1500.0 * m.v2 if m.v2 * w > 0.0 else 0.0  # force on the body
    ground = 1500.0 * m.v1 if -m.v1 * w > 0.0 else 0.0  # reaction of that on the wheel
    asked = share * sky + (1.0 - share) * ground
    c = min(max(-asked / w, SOFT), HARD)
    assert damping(law, m) == pytest.approx(c, rel=1e-9)


@given(m=MOTION.filter(lambda m: abs(m.travel_rate) > 1e-3))
def test_one_law_holds_both_linear_hooks(m):
    sky, ground = LinearHybrid(c_hook=1500.0, share=1.0), LinearHybrid(c_hook=1500.0, share=0.0)
    force = -damping(sky, m, 0.0, 1e12) * m.travel_rate
    assert force == pytest.approx(-1500.0 * m.v2 if m.v2 * m.travel_rate > 0.0 else 0.0, abs=1e-6)
    on_wheel = damping(ground, m, 0.0, 1e12) * m.travel_rate
    braked = -m.v1 * m.travel_rate > 0.0
    assert on_wheel == pytest.approx(-1500.0 * m.v1 if braked else 0.0, abs=1e-6)


@pytest.mark.parametrize("kind", SEMI_ACTIVE_LAWS.values())
def test_a_batch_is_its_cars_one_by_one_bit_for_bit(kind):
    rng = np.random.default_rng(0)
    v1, v2, a2 = rng.normal(size=(3, 101))
    law = kind()
    together = damping(law, Motion(v1, v2, v2 - v1, a2))
    alone = [
        damping(law, Motion(*m))
        for m in zip(v1.tolist(), v2.tolist(), (v2 - v1).tolist(), a2.tolist(), strict=True)
    ]
    assert together.tolist() == alone


def test_bad_numbers_are_refused():
    with pytest.raises(ValueError, match="crossover of skyhook and ADD must not be negative"):
        SHADD(crossover=-1.0)
    with pytest.raises(ValueError, match="damping c_hook must be positive, got 0 N s/m"):
        LinearHybrid(c_hook=0.0)
    with pytest.raises(ValueError, match=r"of the skyhook share must be from 0 to 1, got 1\.5"):
        LinearHybrid(share=1.5)
