"""The summary says in words what the diagnosis says, for every verdict, and names effects and places."""

import re
from dataclasses import replace

import pytest

from lagsplat.diagnose.core.result import Candidate, Interval
from lagsplat.diagnose.effects.registry import catalogue, describe_effect, list_names
from lagsplat.report.common.formatting import format_percent
from lagsplat.report.diagnosis.summary import (
    format_estimates,
    name_candidate,
    select_chosen,
    write_headline,
    write_summary,
)
from tests.unit.report.diagnosis import made_diagnoses

KINDS = made_diagnoses.every_kind()
DESIGNED = """
none viscous_damping linear_stiffness mass_change constant_force input_gain cubic_stiffness coulomb_friction
stribeck_friction load_dependent_friction quadratic_drag input_lag input_delay input_dead_zone
input_saturation input_backlash hysteresis creep joint_backlash end_stop external_push
external_periodic_force parameter_drift
hidden_mode time_offset time_jitter frame_drops camera_change camera_drift exposure_blur unknown
payload armature controller_gain torque_speed_limit encoder_scale cogging position_dependent_damping
asymmetric_friction parametric_stiffness circulatory_force base_motion
"""


def test_every_name_has_words():
    assert set(list_names()) == set(DESIGNED.split())
    assert set(catalogue()) == set(list_names()) - {"none", "unknown"}
    with pytest.raises(ValueError, match="magnetism"):
        describe_effect("magnetism")


def test_kinds_follow_the_groups_of_the_catalogue():
    for name, effect in catalogue().items():
        assert (describe_effect(name).kind == "parameter") == (effect.group == "A"), name
        assert (describe_effect(name).kind == "observation") == (effect.group == "G"), name


@pytest.mark.parametrize("name", list_names())
def test_words_are_sentences(name):
    words = describe_effect(name)
    for sentence in (words.what, words.symptom, words.remedy):
        assert re.fullmatch(r"[A-Z][^.]+\.", sentence), sentence
    assert not words.title.endswith(".")


@pytest.mark.parametrize("kind", KINDS)
def test_every_paragraph_is_clean(kind):
    text = write_summary(KINDS[kind])
    assert text.endswith(".")
    assert not re.search(r"None|nan|inf\b|  |\.\.|_|\(\)|0\.99\d|1\.00", text), text
    assert len(text) < 1400
    assert write_headline(KINDS[kind])


def test_a_single_cause():
    text = write_summary(KINDS["single"])
    gap = KINDS["single"].gap
    for part in (
        "The cause is Coulomb friction at q1 (probability 0.99)",
        "0.801\u00a0q1/s²",
        "0.771 to 0.832",
        f"from {format_percent(gap.before)} to {format_percent(gap.after)} (95 % interval ",
        f"within their uncertainty leaves {format_percent(gap.refit)}",
        "mostly in q1 (96 %)",
        "a loss of energy (83 %)",
    ):
        assert part in text


def test_a_combination():
    text = write_summary(KINDS["combination"])
    assert "Two effects act together: Coulomb friction at q1 and input delay of u0" in text
    assert "delay 0.083\u00a0s" in text


def test_a_class_is_never_one_cause():
    text = write_summary(KINDS["class"])
    assert "cannot distinguish: Coulomb friction (0.50) or Stribeck friction (0.35)" in text
    assert "together they have probability 0.85" in text
    assert "The cause is Coulomb" not in text
    assert write_headline(KINDS["class"]) == "Coulomb friction or Stribeck friction"


def test_what_is_undecided_is_not_named():
    text = write_summary(KINDS["undecided"])
    assert "undecided" in text
    assert "cause is Coulomb" not in text


def test_likely_below_four_fifths():
    assert "The likely cause is time offset" in write_summary(KINDS["observation"])
    assert "sensor or its clock" in write_summary(KINDS["observation"])


def test_a_parameter_change():
    text = write_summary(KINDS["parameter"])
    assert "a refit suffices" in text
    assert "ratio (real to simulated) 1.123 (90 % interval 1.110 to 1.137)" in text
    assert "a refit suffices" not in write_summary(KINDS["single"])


def test_a_cause_within_the_tolerances_says_so():
    made = KINDS["parameter"]
    assert "tolerances" not in write_summary(made)
    text = write_summary(replace(made, checks={**made.checks, "within_tolerance": True}))
    assert "no larger than the tolerances of the simulation's own numbers" in text


def test_none_says_what_it_could_not_see():
    text = write_summary(KINDS["none"])
    assert text.startswith("The simulation agrees with the recording")
    assert "could not have shown input lag or input delay" in text


def test_unknown_names_no_cause():
    text = write_summary(KINDS["unknown"])
    assert "No effect of the catalogue explains it (probability 0.90)" in text
    assert "should not be taken for the cause" in text
    assert "cause is" not in text


def test_a_short_event_that_holds_most_of_the_residual_is_told_with_its_time():
    made = KINDS["unknown"]
    event = ("swing.csv", 16.01, 16.17, 0.91)
    checks = {**made.checks, "natural_period_s": 1.4}

    def told(*, share: float, stop_s: float) -> str:
        at = (*event[:2], stop_s, share)
        return write_summary(replace(made, checks=checks, where={**made.where, "time_s": [at]}))

    assert "91 % of what is missing acts between 16.01 and 16.17 s of swing.csv" in told(
        share=0.91, stop_s=16.17
    )
    assert "swing.csv" not in told(share=0.3, stop_s=16.17)
    assert "swing.csv" not in told(share=0.91, stop_s=18.0)


def test_an_effect_that_does_not_help_forecasts_is_not_said_to():
    made = KINDS["single"]
    assert made.gap is not None
    text = write_summary(replace(made, gap=replace(made.gap, after=1.1 * made.gap.before)))
    assert "does not shrink the miss of held-out forecasts" in text
    assert "shrinks the miss" not in text


def test_unknown_tells_of_several_effects_that_leave_far_less_together():
    made = KINDS["unknown"]
    chain = [{"effects": ["creep"], "misfit": 21.0}, {"effects": ["creep", "external_push"], "misfit": 3.0}]
    text = write_summary(replace(made, checks={**made.checks, "sim_misfit": 1.0, "chain": chain}))
    assert "creep and external push together, which leave 10 % as much" in text
    assert "together" not in write_summary(replace(made, checks={**made.checks, "chain": chain[:1]}))


@pytest.mark.parametrize("verdict", ["none", "unknown"])
def test_an_effect_that_hardly_matters_is_said_with_its_share(verdict):
    made = KINDS[verdict]
    small = {"effects": ["time_offset"], "share": {"value": 0.02, "low": 0.01, "high": 0.03}}
    text = write_summary(replace(made, checks={**made.checks, "immaterial": small}))
    assert "Time offset can be seen but hardly matters: 2.0 % of the gap beyond a refit." in text
    assert "hardly matters" not in write_summary(made)


def test_undetermined_gives_its_reason():
    made = KINDS["undetermined"]
    assert "the recording lasts only 1.4 periods" in write_summary(made)
    found = [{"level": "undetermined", "source": "a.csv", "what": "it is at rest", "why": "nothing moves"}]
    assert "it is at rest; nothing moves" in write_summary(replace(made, checks={"findings": found}))
    assert "about equally well" in write_summary(replace(made, checks={}, warnings=()))


def test_what_remains_is_said():
    made = KINDS["single"]
    worse = replace(made, gap=replace(made.gap, after=2.0 * made.gap.floor))
    assert "2.0 times what noise leaves" in write_summary(worse)
    assert "something else is missing" not in write_summary(made)


def test_a_closure_that_is_not_defined():
    made = KINDS["single"]
    vague = replace(made, gap=replace(made.gap, closure=Interval(None, None, None)))
    assert "is unknown" in write_summary(vague)


def test_forecasts_that_diverged_are_told():
    made = KINDS["single"]
    lost = replace(made, gap=replace(made.gap, blocks=8, diverged={"before": 2, "refit": 1, "after": 0}))
    assert "Of 8 forecasts 2 of the simulation diverged; all count." in write_summary(lost)
    assert "left the motion" not in write_summary(made)


def test_a_refit_has_no_share_of_a_gap_that_is_none():
    made = KINDS["single"]
    assert "would remove" not in write_summary(replace(made, gap=replace(made.gap, before=made.gap.floor)))


def test_several_pushes_and_bare_bounds():
    push = select_chosen(KINDS["push"])[0]
    assert format_estimates(push)[0] == "times 3.21, 7.40\u00a0s"
    assert name_candidate(push) == "external push at q1"
    bare = Candidate(
        "creep",
        1.0,
        parameters={"time_constant": replace(push.parameters["times"], value=2.0, low=None, high=None)},
    )
    assert format_estimates(bare) == ["time constant 2.00\u00a0s"]


@pytest.mark.parametrize(
    ("candidate", "name"),
    [
        (Candidate("coulomb_friction", 0.9, coordinate="q1"), "Coulomb friction at q1"),
        (Candidate("coulomb_friction", 0.9, places=("q0", "q1")), "Coulomb friction at q0 and q1"),
        (Candidate("input_lag", 0.9, input="u0"), "input lag of u0"),
        (Candidate("input_lag", 0.9, places=("u0", "u1", "u2")), "input lag of u0, u1 and u2"),
    ],
)
def test_an_effect_is_named_with_all_its_places(candidate: Candidate, name: str) -> None:
    assert name_candidate(candidate) == name


def test_a_planned_experiment_takes_the_place_of_general_advice():
    planned = made_diagnoses.planned()
    made = replace(KINDS["single"], next_experiments=planned)
    assert write_summary(made).endswith("for 12 s; its inputs are in next_experiment_1.csv.")
    nothing = replace(planned, suggestions=(), reason="No experiment tells them apart")
    assert write_summary(replace(made, next_experiments=nothing)).endswith("No experiment tells them apart.")
