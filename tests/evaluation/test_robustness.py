"""Policies where car, road, sensors or timing are not those that they were made for."""

import dataclasses

import numpy as np
import pytest

from qcar_env.baselines import catalogue
from qcar_env.envs.quarter_car_hump import QuarterCarHumpEnv
from qcar_env.evaluation import robustness
from qcar_env.evaluation.benchmark import run
from qcar_env.evaluation.tracks import episodes, track
from qcar_env.scenarios import scenario

BUDGET = track("budget")
CASES = {each.name: each for each in robustness.tracks()}


def test_a_case_changes_one_thing_and_keeps_the_scales():
    nominal = BUDGET.lasting
    found = {name: each.lasting for name, each in CASES.items()}
    assert found["nominal"] == dataclasses.replace(nominal)
    assert found["speed +10 %"].speed == pytest.approx(1.1 * nominal.speed)
    assert found["speed +10 %"].force.Omega == pytest.approx(1.1 * nominal.force.Omega)
    assert found["height x 1.5"].road.h == pytest.approx(1.5 * nominal.road.h)
    heavy = found["body mass +20 %"]
    assert heavy.car.b2 == pytest.approx(nominal.car.b2 / 1.2)
    assert heavy.actuator.limit[1] == pytest.approx(nominal.actuator.limit[1] / 1.2)
    assert found["delay 2 intervals"].actuator.delay == 2.0 * nominal.dt
    assert found["interval x 2"].dt == 2.0 * nominal.dt
    assert found["interval x 2"].dt / found["interval x 2"].substeps == 0.00125
    kept = {name: scale for name, scale in nominal.reference.scales.items() if name != "limit"}
    for each in found.values():
        assert kept.items() <= each.reference.scales.items()


def test_masses_of_a_car_made_of_parts_are_masses():
    hump = scenario("mathworks-hump")
    found = robustness.masses(hump, body=1.2, wheel=0.8)
    assert found.car.m2 == pytest.approx(1.2 * hump.car.m2)
    assert found.car.m1 == pytest.approx(0.8 * hump.car.m1)


@pytest.mark.parametrize(
    ("home", "message"),
    [
        ("budge", "unknown track 'budge'; did you mean 'budget'"),
        ("randomised", "scenario 'paper-randomised' must not vary, as it is changed by a factor"),
    ],
)
def test_a_track_that_varies_or_is_none_is_refused(home, message):
    with pytest.raises(ValueError, match=message):
        robustness.tracks(home)


def test_noise_is_what_it_says_and_another_in_each_episode():
    noisy = CASES["noise 5 %"].lasting
    env = QuarterCarHumpEnv(noisy, duration=5.0)
    clean = QuarterCarHumpEnv(BUDGET.lasting, duration=5.0)
    seen, true = [], []
    for each, rows in ((env, seen), (clean, true)):
        each.reset(seed=3, options={"state": (0.0, 0.0, 0.0, 0.0), "phase": 0.0})
        for _ in range(900):
            rows.append(each.step(np.zeros(2, np.float32))[0])
    assert np.std(np.array(seen) - np.array(true), axis=0) == pytest.approx(0.05, rel=0.1)


def test_policies_enter_as_they_were_made():
    made = []

    def make(nominal, home, scale):
        made.append((nominal, home.name, scale))
        return catalogue.make("cnvc", nominal)

    entry = dataclasses.replace(catalogue.entry("cnvc"), make=make)
    few = [
        dataclasses.replace(CASES[name], duration=1.0, periods=3, episodes=2)
        for name in ("speed +10 %", "delay 1 interval", "noise 1 %")
    ]
    found = run(few, [entry])
    assert not found.failures
    assert {each[1:] for each in made} == {("budget", 1.0)}
    assert {each[0] for each in made} == {BUDGET.at(1.0)}
    assert len(found.rows) == 6
    assert {row.track for row in found.rows} == {each.name for each in few}


def test_episodes_beside_drive_slower_and_faster_by_turns():
    cases = episodes(BUDGET, "training", force_scale=0.5, count=4)
    found = robustness.beside(cases)
    factors = [each.scenario.speed / BUDGET.nominal.speed for each in found]
    assert factors == pytest.approx([0.97, 1.03, 0.97, 1.03])
    assert [each.state for each in found] == [each.state for each in cases]
    loss = robustness.loss_beside(np.array([[0.2, 0.9], [0.2, 1.5]]))
    assert loss.tolist() == [0.0, 1.0]
