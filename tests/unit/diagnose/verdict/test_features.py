"""Features of alternatives: each kind has its own columns, on scales that do not depend on units."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.verdict.features import NAMES, OF_EFFECTS, OF_NONE, compute_features
from tests.unit.diagnose.verdict.made_alternatives import NONE, alternatives, effect


def named(row: np.ndarray) -> dict[str, float]:
    return dict(zip(NAMES, row.tolist(), strict=True))


def test_none_comes_first_and_unknown_last_and_each_has_columns_of_its_own() -> None:
    table = compute_features(alternatives(effect("creep"), effect("coulomb_friction")))
    assert table.shape == (4, len(NAMES))
    assert len(set(NAMES)) == len(NAMES)
    ends = len(OF_EFFECTS), len(OF_EFFECTS) + len(OF_NONE)
    columns = [np.flatnonzero(np.abs(table[rows]).max(0)) for rows in ([1, 2], [0], [3])]
    assert columns[0].max() < ends[0] <= columns[1].min() <= columns[1].max() < ends[1] <= columns[2].min()


def test_what_explains_all_leaves_nothing_and_gains_all() -> None:
    rival = effect("input_lag", misfit=4.0, error=0.1)
    row = named(compute_features(alternatives(effect("creep"), rival))[1])
    assert row["misfit"] == row["rival_misfit"] == row["rival_error"] == 0.0
    assert row["error"] == pytest.approx(np.log(0.021 / 0.02))
    assert row["gain"] == pytest.approx(np.log(0.12 / 0.021))
    assert row["behind"] == 0.0
    assert (row["more_effects"], row["unrepeated"]) == (0.0, 0.0)


def test_rivals_are_measured_against_the_best() -> None:
    rival = effect("input_lag", misfit=4.0, error=0.1, log_evidence=250.0)
    row = named(compute_features(alternatives(effect("creep"), rival))[2])
    assert row["rival_misfit"] == pytest.approx(np.log(4.0))
    assert row["rival_error"] == pytest.approx(np.log(0.1 / 0.021))
    assert row["behind"] == pytest.approx(np.log(51.0))


def test_what_the_best_leaves_speaks_for_unknown() -> None:
    good, poor = (named(compute_features(alternatives(effect("creep", misfit=m)))[-1]) for m in (1.0, 5.0))
    assert poor["unknown: misfit"] == pytest.approx(np.log(5.0))
    assert good["unknown: misfit"] == 0.0
    assert poor["unknown: left"] == pytest.approx(np.log(0.5))
    assert good["unknown: left"] < -8.0
    assert good["unknown: gap"] == poor["unknown: gap"] == pytest.approx(np.log(6.0))


def test_without_a_fitted_effect_none_and_unknown_are_left() -> None:
    table = compute_features(alternatives(none=replace(NONE, misfit=1.0, error=0.02)))
    assert table.shape[0] == 2
    assert np.isfinite(table).all()
    assert named(table[1])["unknown: left"] == 0.0


def test_every_feature_of_an_effect_is_a_worked_number() -> None:
    e = np.e
    one = effect(
        "creep", misfit=2 * e, error=0.04 * e, floor=0.04, gain_z=np.sinh(2.0), log_evidence=e**2 - 1,
        parameters=3, surprise=e**3 - 1, memory=e**4, refit_penalty=e**5 - 1, flexible=2, recurrence=0.25,
    )  # fmt: skip
    best = effect("input_lag", misfit=2.0, error=0.01, log_evidence=e**2 - 1 + e**6 - 1)
    made = replace(alternatives(one, best), nominal=2.0, chance=0.5)
    made = replace(made, measures=(replace(NONE, error=0.04 * e**8), *made.measures[1:]))
    row = named(compute_features(made)[1])
    assert row["excess"] == pytest.approx(np.arcsinh(e - 1))  # half of it, over a chance of a half
    expected = {
        "effect": 1, "misfit": 1, "rival_misfit": 1, "error": 1, "rival_error": 1 + np.log(4), "gain": 7,
        "gain_z": 2, "evidence": 2, "behind": 6, "leads": 0, "parameters": 3, "surprise": 3, "memory": 4,
        "refit": 5, "more_effects": 0, "added": 0, "added_error": 0, "single_samples": 0,
        "sample_evidence": 0, "flexible": 2, "unrepeated": 0.75,
    }  # fmt: skip
    assert {name: row[name] for name in expected} == pytest.approx(expected)
    assert named(compute_features(made)[2])["leads"] == 1.0


def test_evidence_of_single_samples_counts_once_more() -> None:
    row = named(
        compute_features(alternatives(effect("time_jitter", log_evidence=np.e - 1, single_samples=True)))[1]
    )
    assert (row["single_samples"], row["evidence"], row["sample_evidence"]) == pytest.approx((1, 1, 1))


def test_evidence_against_an_effect_is_none_for_it() -> None:
    row = named(compute_features(alternatives(effect("creep", log_evidence=-4.0)))[1])
    assert row["evidence"] == 0.0
    assert row["behind"] == pytest.approx(np.log(5.0))  # `none`, at zero, is the best


def test_a_set_is_compared_with_the_best_of_its_parts() -> None:
    e = np.e
    worse = effect("creep", misfit=7.0, error=0.5, log_evidence=10.0)
    better = effect("input_lag", misfit=2 * e**2, error=0.3 * e, log_evidence=20.0)
    other = effect("end_stop", misfit=0.1, error=0.001, log_evidence=1e3)
    pair = effect("creep", "input_lag", misfit=1.0, error=0.3, log_evidence=30.0)
    made = replace(alternatives(worse, better, other, pair), nominal=2.0)
    row = named(compute_features(made)[4])
    assert row["added"] == pytest.approx(2.0)  # the misfit of the pair is below the nominal one, which counts
    assert row["added_error"] == pytest.approx(1.0)
    assert row["more_effects"] == 1.0
    assert named(compute_features(made)[2])["added"] == 0.0


def test_a_triple_is_compared_with_pairs_too() -> None:
    pair = effect("creep", "input_lag", misfit=np.e, log_evidence=30.0)
    single = effect("creep", misfit=50.0, log_evidence=10.0)
    triple = effect("creep", "input_lag", "end_stop", misfit=1.0)
    row = named(compute_features(alternatives(single, pair, triple))[3])
    assert row["added"] == pytest.approx(1.0)
    assert row["more_effects"] == 2.0


def test_every_feature_of_none_and_of_unknown_is_a_worked_number() -> None:
    e = np.e
    none = replace(NONE, misfit=2 + 6 * e, error=0.02 * e**3, refit_penalty=e**2 - 1, gain_z=0.0)
    best = effect(
        "creep", misfit=2 + 6, error=0.02 * e**2, gain_z=-1.0, log_evidence=e**4 - 1, memory=e**5,
        refit_penalty=e**6 - 1, flexible=3,
    )  # fmt: skip
    rival = effect("input_lag", misfit=9.0, error=0.02 * e, gain_z=np.sinh(0.5), log_evidence=1.0)
    made = replace(alternatives(best, rival, none=none), nominal=2.0, chance=0.5, motionless=1e9)
    made = replace(made, relaxed_log_evidence=best.log_evidence + np.sinh(3.0))
    table = compute_features(made)
    found, left = named(table[0]), named(table[-1])
    expected = {
        "none": 1, "none: misfit": np.log(1 + 3 * e), "none: excess": np.arcsinh(3 * e), "none: error": 3,
        "none: rival_error": 2, "none: gain_z": 0.5, "none: evidence": 4, "none: refit": 2,
    }  # fmt: skip
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    expected = {
        "unknown": 1, "unknown: misfit": np.log(4), "unknown: excess": np.arcsinh(3.0), "unknown: error": 2,
        "unknown: memory": 5, "unknown: left": -1, "unknown: gap": 3, "unknown: refit": 6,
        "unknown: relaxed": 3, "unknown: flexible": 3,
    }  # fmt: skip
    assert {name: left[name] for name in expected} == pytest.approx(expected)
