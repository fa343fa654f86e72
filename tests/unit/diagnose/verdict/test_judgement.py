"""The most probable alternative is the verdict, and every name has a probability."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.verdict.choice_model import ChoiceModel, load_choice_model
from lagsplat.diagnose.verdict.features import NAMES
from lagsplat.diagnose.verdict.judgement import Judgement, judge_alternatives, name_main_causes
from tests.unit.diagnose.verdict.made_alternatives import NONE, Alternatives, Measures, alternatives, effect

CATALOGUE = tuple(catalogue())


def weigh(**weights: float) -> ChoiceModel:
    return ChoiceModel(NAMES, np.array([weights.get(name, 0.0) for name in NAMES]))


def judge(made: Alternatives, model: ChoiceModel | None = None) -> Judgement:
    return judge_alternatives(made, model or weigh(evidence=1.0, none=3.0, unknown=3.0), catalogue=CATALOGUE)


def test_the_likeliest_effect_is_the_verdict() -> None:
    made = alternatives(effect("creep"), effect("input_lag", log_evidence=10.0))
    said = judge(made)
    assert said.verdict == "effect"
    assert next(iter(said.probabilities)) == "creep"
    assert said.best is made.fits[1]


@pytest.mark.parametrize("verdict", ["none", "unknown"])
def test_none_and_unknown_are_verdicts_as_well(verdict: str) -> None:
    made = alternatives(effect("creep", log_evidence=1.0))
    said = judge(made, weigh(evidence=1.0, **{verdict: 4.0}))
    assert said.verdict == verdict
    assert next(iter(said.probabilities)) == verdict
    assert said.best is made.fits[1]  # what comes nearest is kept


def test_probabilities_are_a_distribution_over_the_catalogue_none_and_unknown() -> None:
    probabilities = judge(alternatives(effect("creep"), effect("input_lag"))).probabilities
    assert sum(probabilities.values()) == pytest.approx(1.0)
    assert set(probabilities) == {*CATALOGUE, "none", "unknown"}
    assert list(probabilities.values()) == sorted(probabilities.values(), reverse=True)


def test_a_set_counts_for_its_main_effect() -> None:
    pair = effect("creep", "input_lag", log_evidence=1e6)
    alone = effect("creep", log_evidence=5.0), effect("input_lag", log_evidence=9.0)
    said = judge(alternatives(*alone, pair))
    assert said.verdict == "effect"
    assert next(iter(said.probabilities.items())) == ("input_lag", pytest.approx(1.0, abs=1e-3))
    assert said.equivalent == ()


def test_what_the_recording_does_not_tell_apart_is_named_together() -> None:
    near = effect("input_lag", log_evidence=280.0)
    far = effect("end_stop", log_evidence=1.0)
    assert judge(alternatives(effect("creep"), near, far)).equivalent == (("creep", "input_lag"),)
    assert judge(alternatives(effect("creep", log_evidence=1e4), near)).equivalent == ()


def test_without_effects_there_is_no_best() -> None:
    said = judge(alternatives())
    assert (said.best, said.equivalent) == (None, ())


def test_a_rejected_effect_trades_places_with_the_new_verdict() -> None:
    said = judge(alternatives(effect("creep")))
    before, after = said.probabilities, said.reject("none").probabilities
    assert after["none"] == before["creep"]
    assert after["creep"] == before["none"]
    assert next(iter(after)) == "none"
    assert sum(after.values()) == pytest.approx(1.0)


def quiet(**measured: float) -> Measures:
    """A sim that agrees with the recording, but for what is said."""
    values = {"misfit": 1.0, "error": 0.02, "memory": 1.0}
    return Measures(**{**vars(NONE), **values, **measured})


def test_the_calibrated_model_says_what_no_one_doubts() -> None:
    model = load_choice_model()
    rival = effect("input_lag", misfit=8.0, log_evidence=20.0, error=0.11, gain_z=0.5)
    assert judge(alternatives(effect("creep"), rival), model).verdict == "effect"
    still = effect("creep", misfit=1.0, log_evidence=-4.0, error=0.0201, gain_z=-0.2, parameters=3)
    assert judge(alternatives(still, none=quiet()), model).verdict == "none"
    poor = effect("creep", misfit=60.0, log_evidence=90.0, error=0.9, gain_z=1.0, memory=25.0, surprise=9.0)
    lost = Measures(**{**vars(NONE), "misfit": 90.0, "error": 1.0})
    assert judge(alternatives(poor, none=lost), model).verdict == "unknown"


def test_sets_add_to_the_probability_of_their_main_effect_and_the_likeliest_explains() -> None:
    """With equal chances, two of the four alternatives stand for creep; of these the first is taken."""
    pair = effect("creep", "input_lag", log_evidence=300.0)
    made = alternatives(effect("creep"), pair)
    said = judge(made, weigh())
    assert said.probabilities["creep"] == pytest.approx(0.5)
    assert said.probabilities["none"] == said.probabilities["unknown"] == pytest.approx(0.25)
    assert said.probabilities["input_lag"] == 0.0
    likelier = judge(made, weigh(more_effects=2.0))
    assert likelier.best is made.fits[2]
    assert judge(made, weigh(more_effects=-2.0)).best is made.fits[1]


def test_an_effect_that_was_not_fitted_alone_is_no_main_cause_beside_one_that_was() -> None:
    pair = effect("creep", "input_lag")
    poor = effect("input_lag", log_evidence=-50.0)
    assert name_main_causes((NONE, pair, poor)) == ("none", "input_lag", "input_lag", "unknown")


def test_equivalent_effects_are_the_fewest_that_hold_the_credible_share() -> None:
    """Chances of 8, 2 and 1 of 11: the first two hold more than nine tenths."""
    singles = [effect(name, log_evidence=x) for name, x in (("creep", 8), ("input_lag", 2), ("end_stop", 1))]
    made = alternatives(*[replace(m, log_evidence=m.log_evidence - 1.0) for m in singles])
    assert VERDICT.credible == 0.9
    assert judge(made, weigh(evidence=1.0)).equivalent == (("creep", "input_lag"),)
    sure = alternatives(effect("creep", log_evidence=99.0), *singles[1:])
    assert judge(sure, weigh(evidence=1.0)).equivalent == ()


def test_a_rejection_changes_nothing_but_the_two_names() -> None:
    said = judge(alternatives(effect("creep"), effect("input_lag", log_evidence=290.0)))
    other = said.reject("unknown")
    assert (other.verdict, other.equivalent, other.best) == ("unknown", (), said.best)
    assert said.equivalent == (("creep", "input_lag"),)
    assert other.probabilities["unknown"] == said.probabilities["creep"]
    assert other.probabilities["input_lag"] == said.probabilities["input_lag"]
    values = list(other.probabilities.values())
    assert values == sorted(values, reverse=True)


def test_what_the_first_name_is_rejected_for_may_be_itself() -> None:
    said = judge(alternatives(effect("creep", log_evidence=1.0)), weigh(evidence=1.0, none=4.0))
    assert said.reject("none").probabilities == said.probabilities
