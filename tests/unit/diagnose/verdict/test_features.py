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
