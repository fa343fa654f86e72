"""What effects gain on a sim's own recording they must gain more elsewhere."""

import pytest

from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.recalibration import calibrate_null_evidence
from tests.unit.diagnose.toys import HARD, film, oscillator, settings, wave


@pytest.fixture(scope="module")
def motion():
    return film(u=wave(3), noise=0.01, seed=3)


def test_an_exact_sim_passes_for_nothing_and_a_wrong_one_for_much(motion) -> None:
    exact = calibrate_null_evidence(EstimatedSimulator.exact(oscillator()), motion, [motion], settings())
    wrong = calibrate_null_evidence(
        EstimatedSimulator.exact(oscillator(hard=3.0 * HARD)), motion, [motion], settings()
    )
    assert exact < 4.0
    assert wrong > 50.0


def test_longer_real_motions_let_the_errors_pass_for_more(motion) -> None:
    sim = EstimatedSimulator.exact(oscillator(hard=3.0 * HARD))
    once = calibrate_null_evidence(sim, motion, [motion], settings())
    twice = calibrate_null_evidence(sim, motion, [motion, motion], settings())
    assert twice == pytest.approx(2.0 * once)


def test_what_the_errors_pass_for_counts_for_nothing(motion) -> None:
    sim = EstimatedSimulator.exact(oscillator(hard=1.5 * HARD))
    plain = diagnose(sim, [motion], settings())
    less = diagnose(sim, [motion], settings(), log_evidence_offset=25.0)
    first, same = plain.ranking.found[0], less.ranking.found[0]
    assert first.effects[0].effect.name == same.effects[0].effect.name
    assert same.log_evidence == pytest.approx(first.log_evidence - 25.0)
    beyond = diagnose(sim, [motion], settings(), log_evidence_offset=2.0 * first.log_evidence)
    assert plain.diagnosis.verdict == "effect"
    assert beyond.diagnosis.verdict != "effect"
