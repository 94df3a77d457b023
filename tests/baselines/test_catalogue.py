"""The baselines by name."""

import dataclasses

import pytest

from qcar_env import SCENARIOS
from qcar_env.baselines import catalogue
from qcar_env.control import LAWS


def test_every_law_has_a_name():
    assert set(catalogue.names()) >= set(LAWS)
    assert "none" in catalogue.names()


@pytest.mark.parametrize("name", list(LAWS))
def test_a_baseline_is_its_law_with_the_published_gains(name):
    assert catalogue.make(name).law == LAWS[name]()
    described = catalogue.describe(name)
    assert described["gains"] == dataclasses.asdict(LAWS[name]())
    assert described["reads"] == "feedback"
    assert described["name"] == LAWS[name]().name


@pytest.mark.parametrize("name", list(LAWS))
@pytest.mark.parametrize("scenario", list(SCENARIOS))
def test_every_baseline_fits_every_scenario(name, scenario):
    policy = catalogue.make(name, scenario)
    env_size = SCENARIOS[scenario].actuator.size
    assert policy.predict([[0.0] * 4])[0].shape == (1, env_size)


def test_gains_replace_the_published_ones():
    assert catalogue.make("cnvc", G1=0.5).law == LAWS["cnvc"](G1=0.5)
    assert catalogue.make("ndf", zeta1=0.5, G2=3.0).law == LAWS["ndf"](zeta1=0.5, G2=3.0)


def stored(name):
    return catalogue.stored(name, "paper", 1.0)


@pytest.mark.parametrize("call", [catalogue.make, catalogue.describe, catalogue.gain_names, stored])
def test_an_unknown_baseline_gets_the_nearest_name(call):
    with pytest.raises(ValueError, match=r"unknown baseline 'cnvcc'; did you mean 'cnvc'\? Known:"):
        call("cnvcc")


def test_an_unknown_gain_gets_the_laws_own():
    with pytest.raises(ValueError, match=r"unknown gain of cnvc 'G3'\. Known: G1, G2$"):
        catalogue.make("cnvc", G3=1.0)
    with pytest.raises(ValueError, match=r"unknown gain of none 'G1'\. Known: none$"):
        catalogue.make("none", G1=1.0)


def test_a_gain_out_of_range_is_refused():
    with pytest.raises(ValueError, match="gain G1 must not be negative, got -1"):
        catalogue.make("cnvc", G1=-1.0)


def test_an_unknown_scenario_is_refused():
    with pytest.raises(ValueError, match="unknown scenario 'papr'; did you mean 'paper'"):
        catalogue.make("cnvc", "papr")


@pytest.mark.parametrize("scale", [None, -0.5, float("nan"), "1"])
def test_tuned_gains_are_at_a_force_scale(scale):
    with pytest.raises(ValueError, match=rf"force_scale must be .*, got {scale!r}"):
        catalogue.stored("lnvc", "paper", scale)


def test_tuned_gains_are_of_a_track():
    with pytest.raises(ValueError, match="unknown track 'papr'; did you mean 'paper'"):
        catalogue.stored("lnvc", "papr", 1.0)
