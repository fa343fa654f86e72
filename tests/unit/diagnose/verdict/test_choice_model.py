"""A conditional logit finds the weights that choices were drawn with, and says how sure it is."""

import json

import numpy as np
import pytest

from benchmarks.calibration.choices import Choice
from benchmarks.calibration.fit import fit_choice_model
from lagsplat.diagnose.verdict.choice_model import ChoiceModel, load_choice_model
from lagsplat.diagnose.verdict.features import NAMES

TRUE = np.array([1.5, -0.7, 0.4])
CALLED = ("a", "b", "c")


def draw_choices(n: int, seed: int) -> list[Choice]:
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(n):
        features = rng.normal(size=(int(rng.integers(3, 9)), 3))
        chance = np.exp(ChoiceModel(CALLED, TRUE).log_probabilities(features))
        right = np.zeros(len(features), dtype=bool)
        right[rng.choice(len(features), p=chance)] = True
        out.append(Choice(features, right))
    return out


def test_weights_are_recovered_within_their_spread() -> None:
    found = fit_choice_model(draw_choices(3000, 0), CALLED, ridge=1e-3)
    assert found.weights == pytest.approx(TRUE, abs=0.12)


def test_probabilities_are_those_of_the_choices() -> None:
    model = fit_choice_model(draw_choices(3000, 1), CALLED, ridge=1e-3)
    sure, hit = [], []
    for choice in draw_choices(3000, 2):
        chance = np.exp(model.log_probabilities(choice.features))
        assert chance.sum() == pytest.approx(1.0)
        sure.append(chance.max())
        hit.append(choice.right[chance.argmax()])
    high = np.array(sure) > np.median(sure)
    for part in (high, ~high):
        assert np.mean(np.array(hit)[part]) == pytest.approx(np.mean(np.array(sure)[part]), abs=0.03)


def test_either_of_two_right_alternatives_will_do() -> None:
    """Alternatives that look the same share what is right about them."""
    features = np.array([[1.0], [1.0], [0.0]])
    both = [Choice(features, np.array([True, True, False]))] * 50 + [
        Choice(features, np.array([False, False, True]))
    ] * 50
    model = fit_choice_model(both, ("a",), ridge=1e-6)
    assert np.exp(model.log_probabilities(features)) == pytest.approx([0.25, 0.25, 0.5], abs=1e-3)


def test_a_weight_counts_and_a_choice_without_a_right_alternative_does_not() -> None:
    one, other = (Choice(np.array([[1.0], [0.0]]), np.array(right)) for right in ([1, 0], [0, 1]))
    one, other = Choice(one.features, one.right > 0, 3.0), Choice(other.features, other.right > 0)
    lost = Choice(np.array([[5.0], [0.0]]), np.zeros(2, dtype=bool))
    model = fit_choice_model([one, other, lost], ("a",), ridge=1e-9)
    assert model.weights[0] == pytest.approx(np.log(3.0), abs=1e-4)


def test_a_wider_prior_bends_more() -> None:
    drawn = draw_choices(100, 3)
    sizes = [np.abs(fit_choice_model(drawn, CALLED, ridge=r).weights).sum() for r in (1e-3, 10.0, 1e4)]
    assert sizes == sorted(sizes, reverse=True)


def test_the_calibrated_model_weighs_the_features_that_are_computed(tmp_path) -> None:
    assert load_choice_model().names == NAMES
    known = dict.fromkeys(NAMES, 1.0)
    few, more = known | {}, known | {"zeal": 1.0}
    del few["effect"]
    for name, weights in (("effect", few), ("zeal", more)):
        other = tmp_path / f"{name}.json"
        other.write_text(json.dumps({"weights": weights}))
        with pytest.raises(ValueError, match=rf"{name}\.json: {name}: weights of other .*calibrate again"):
            load_choice_model(other)
