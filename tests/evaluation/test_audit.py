"""The audit: honest drives pass, whatever pushes; forged ones do not."""

import dataclasses

import numpy as np
import pytest

from qcar_env.evaluation.audit import AUDIT_SIGNALS, audit
from qcar_env.evaluation.rollouts import rollout
from qcar_env.physics.external_force import ExternalForce
from qcar_env.scenarios import presets, scenario

STATES = ("x1", "x2", "v1", "v2")


class Pushes:
    """A policy that draws each action."""

    def __init__(self, seed=0, scale=1.0, size=1):
        self.seed, self.scale, self.size = seed, scale, size

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        k = 0 if state is None else state[0]
        drawn = np.random.default_rng([self.seed, k]).uniform(-self.scale, self.scale)
        return np.full((len(observation), self.size), drawn), (k + 1,)


def drive(
    car="escort", hump="watts", km_h=20.0, actuator="ideal", scale=1.0, c1=0.0, seed=0, **given
):
    over = presets.over_hump(car, hump, speed=km_h / 3.6, actuator=actuator, **given)
    tyre = dataclasses.replace(over.car.tyre, c=c1)
    over = dataclasses.replace(over, car=dataclasses.replace(over.car, tyre=tyre))
    return rollout(Pushes(seed, scale), over, signals=AUDIT_SIGNALS)


def forged(honest, acceleration=1.0, load=1.0, force=1.0, **states):
    kept = honest.signals
    return dataclasses.replace(
        honest,
        **{name: factor * getattr(honest, name) for name, factor in states.items()},
        force=force * honest.force,
        signals={
            "body_acceleration": acceleration * kept["body_acceleration"],
            "tyre_load": load * kept["tyre_load"],
        },
    )


def failed(drive):
    return {name for name, each in audit(drive).checks.items() if not each.ok}


@pytest.mark.parametrize("car", ["escort", "heavy-axle"])
@pytest.mark.parametrize(("hump", "km_h"), [("watts", 30.0), ("italy-40", 15.0), ("bar", 40.0)])
@pytest.mark.parametrize("actuator", ["ideal", "em", "mr"])
@pytest.mark.parametrize(("c1", "lift_off"), [(0.0, True), (300.0, False)])
def test_every_honest_drive_passes(car, hump, km_h, actuator, c1, lift_off):
    """Random forces, with stops, with and without damping of the tyre."""
    found = drive(car, hump, km_h, actuator, c1=c1, lift_off=lift_off)
    assert failed(found) == set()


class Slow:
    """A policy of one frequency [Hz]: its force bends alike in all intervals of a window."""

    def __init__(self, frequency):
        self.frequency = frequency

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        k = 0 if state is None else state[0]
        turned = 2.0 * np.pi * self.frequency * 0.005 * k
        return np.full((len(observation), 1), np.sin(turned)), (k + 1,)


@pytest.mark.parametrize("actuator", ["ideal", "em", "abc", "mr"])
@pytest.mark.parametrize("frequency", [0.7, 3.0, 13.0])
@pytest.mark.parametrize(
    ("car", "hump"), [("escort", "italy-40"), ("ctms-bus", "bar"), ("golden-car", "mexico")]
)
def test_steps_of_a_slow_force_that_the_samples_hide_are_no_forgery(actuator, frequency, car, hump):
    """Fewer samples show the same: halving them is no measure of it."""
    over = presets.over_hump(car, hump, actuator=actuator)
    assert failed(rollout(Slow(frequency), over, signals=AUDIT_SIGNALS)) == set()


@pytest.mark.parametrize("seed", range(3))
def test_an_external_force_is_counted(seed):
    over = presets.over_hump("escort", "watts", actuator="ideal", lift_off=False)
    pushed = dataclasses.replace(over, force=ExternalForce(f=1.0, Omega=7.0))
    found = rollout(Pushes(seed), pushed, signals=AUDIT_SIGNALS)
    assert failed(found) == set()
    calm = dataclasses.replace(found, scenario=over)
    assert {"wheel_hop", "travel", "momentum", "body_force"} <= failed(calm)


def test_a_drive_without_motion_passes():
    over = presets.over_hump("escort", "watts", actuator="ideal")
    found = rollout(Pushes(scale=0.0), over, duration=0.3, signals=AUDIT_SIGNALS)
    assert not np.any(found.x2)
    assert audit(found).ok


@pytest.mark.parametrize("actuator", ["ideal", "em", "mr"])
@pytest.mark.parametrize("c1", [0.0, 300.0])
def test_forged_logs_are_found(actuator, c1):
    """Each forger keeps what he can consistent; the road is the auditor's own."""
    honest = drive(actuator=actuator, c1=c1, lift_off=False)
    assert failed(honest) == set()
    # nine tenths of the acceleration alone
    assert "body_force" in failed(forged(honest, acceleration=0.9))
    # of all that the body does, so that its numbers fit each other
    body = failed(forged(honest, acceleration=0.9, x2=0.9, v2=0.9))
    assert {"wheel_hop", "travel", "momentum"} <= body
    # of everything, loads but for the static one: no force between the masses makes that
    everything = forged(honest, acceleration=0.9, **dict.fromkeys(STATES, 0.9))
    assert {"wheel_hop", "travel"} <= failed(everything)
    assert "tyre_load" in failed(forged(honest, load=1.01))
    assert "wheel_hop" in failed(forged(honest, v1=0.9))
    assert "travel" in failed(forged(honest, x2=0.9))


def test_a_calm_forgers_acceleration_is_found_by_its_velocity():
    """Also by who does not know the suspension: without a force that jumps, to a twentieth."""
    honest = drive(scale=0.0)
    assert failed(honest) == set()
    assert "body_acceleration" in failed(forged(honest, acceleration=0.95))
    assert "body_velocity" in failed(forged(honest, x2=0.95))
    assert "wheel_velocity" in failed(forged(honest, x1=0.95))


def test_a_force_beyond_the_limit_and_energy_from_a_damper_are_found():
    assert failed(forged(drive(), force=1.1)) >= {"force"}
    assert failed(forged(drive(actuator="mr"), force=-1.0)) >= {"energy"}


def test_a_tyre_that_lifts_off_has_no_such_law_but_momentum():
    found = audit(drive(km_h=50.0, hump="mexico"))
    assert found.ok
    assert found.left_out == dict.fromkeys(("wheel_hop", "travel"), "the tyre lifts off")
    assert "momentum" in found.checks


def test_numbers_that_are_none_do_not_pass():
    honest = drive()
    spoilt = dataclasses.replace(honest, v2=np.where(honest.t > 1.0, np.nan, honest.v2))
    assert {"body_acceleration", "body_velocity", "travel", "momentum"} <= failed(spoilt)


def test_what_cannot_be_audited_is_refused():
    over = presets.over_hump("escort", "watts")
    with pytest.raises(ValueError, match="must keep body_acceleration, tyre_load"):
        audit(rollout(Pushes(), over, duration=0.5))
    with pytest.raises(ValueError, match="must last four control intervals"):
        audit(rollout(Pushes(), over, duration=0.01, signals=AUDIT_SIGNALS))
    with pytest.raises(ValueError, match="car must have masses"):
        audit(rollout(Pushes(size=2), scenario("paper"), duration=0.5))
