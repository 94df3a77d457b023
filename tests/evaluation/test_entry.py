"""Entries: what may enter where, from whom, and that other processes can have them."""

import dataclasses
import pickle

import pytest

from qcar_env import agents, baselines
from qcar_env.baselines import catalogue
from qcar_env.evaluation.entry import Entry, entry_of, may_enter
from qcar_env.evaluation.policy import shown_to
from qcar_env.evaluation.tracks import TRACKS, track

BUDGET = track("budget")


def test_names_are_unique_and_say_their_kind():
    entries = (*baselines.entries(), *agents.entries())
    names = [each.name for each in entries]
    assert len(set(names)) == len(names)
    for each in baselines.entries():
        assert each.name.endswith(" (tuned)") == (each.kind == "tuned")
    assert {each.kind for each in agents.entries()} <= {"learned"}


def test_an_entry_survives_the_way_to_another_process():
    for each in (*baselines.entries(), *agents.entries(), entry_of("qcar_env.baselines:entries")):
        there = pickle.loads(pickle.dumps(each))
        assert dataclasses.replace(there, make=each.make) == each
        assert (there.make.func, there.make.args) == (each.make.func, each.make.args)


@pytest.mark.parametrize(
    "name",
    [
        "$x_{1$",
        "<!--<script>",
        "=cmd|' /C calc'!A0",
        "a|b",
        "a\nb",
        "a\\b",
        "`a`",
        "-1",
        "+1",
        "@a",
        "",
        "   ",
        "x" * 121,
        None,
        3,
    ],
)
def test_a_name_that_means_something_elsewhere_is_refused(name):
    with pytest.raises(ValueError, match="name of a policy must be 1 to 120 printable characters"):
        Entry(name=name, kind="yours", title="", make=str)


@pytest.mark.parametrize("name", ["mine:policy.best", "größer (2)", "a & b", "SAC, 3 layers", "_"])
def test_a_name_in_any_language_may_enter(name):
    assert Entry(name=name, kind="yours", title="", make=str).name == name


@pytest.mark.parametrize("entry", baselines.entries(), ids=lambda each: each.name)
def test_a_baseline_reads_what_its_entry_says(entry):
    policy = entry.make(BUDGET.at(0.5), BUDGET, 0.5)
    assert policy is None or shown_to(policy, "full") == (entry.reads, False)


@pytest.mark.parametrize("entry", agents.entries(), ids=lambda each: each.name)
def test_an_agent_enters_the_tracks_of_its_scenario_at_limits_that_it_was_trained_for(entry):
    for each in TRACKS.values():
        for scale in each.force_scales:
            policy = entry.make(each.at(scale), each, scale)
            if policy is not None:
                assert min(policy.force_scales) <= scale <= max(policy.force_scales)
                assert policy.reads == entry.reads
    outside = entry.make(BUDGET.at(0.9), None, 0.9)
    assert outside is not None  # a film may show what a benchmark would not score


def test_tuned_gains_are_those_of_the_scenario_and_limit():
    lnvc = next(each for each in baselines.entries(["lnvc"]) if each.kind == "tuned")
    feedback = track("feedback")
    made = lnvc.make(feedback.at(0.5), feedback, 0.5)
    expected = catalogue.make_tuned("lnvc", "budget", 0.5, feedback.at(0.5))
    assert made.law == expected.law
    assert lnvc.make(BUDGET.at(0.33), BUDGET, 0.33) is None
    with pytest.raises(ValueError, match="no tuned gains of 'lnvc' for track 'budget'"):
        lnvc.make(BUDGET.at(0.33), None, 0.33)


def test_a_plan_for_one_road_does_not_enter_where_the_road_is_drawn():
    drawn = track("randomised")
    assert catalogue.entry("mpc").make(drawn.at(1.0), drawn, 1.0) is None


def test_gains_can_be_given():
    entry = catalogue.entry("cnvc", G1=0.5)
    assert entry.make(BUDGET.at(1.0), None, 1.0).law.G1 == 0.5


def test_what_reads_no_more_than_is_shown_may_enter():
    blind = track("feedback")
    assert may_enter("feedback", blind)
    assert not may_enter("full", blind)
    assert may_enter("full", BUDGET)
