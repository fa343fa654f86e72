"""The comparison of every dynamics with the constant-coefficient one."""

import numpy as np

from lagsplat.report.tables.benchmark import MARGIN_COLUMNS, build_margin_table


def scores(level: float, *, period: bool = True) -> dict:
    windows = level * np.linspace(0.9, 1.1, 50)
    latent = {"starts": list(range(40)), "states": 70, "per_window_image": list(windows[:40])}
    return {
        "recording": {"origin": "simulated"},
        "forecast": {"starts": list(range(50)), "states": 30, "per_window": list(windows)},
        "latent": latent if period else {"reason": "no free window"},
    }


def names(stage2: str, seed: int = 0, system: str = "krauss_2seg") -> dict:
    place = {"profile": "quick", "recording": "simulated", "system": system, "stage1": "default", "ae": 0}
    return place | {"stage2": stage2, "seed": seed}


def test_every_variant_stands_against_the_constant_one():
    runs = [names("default", 0), names("default", 1), names("constant"), names("induced_mass")]
    table = build_margin_table(runs, [scores(0.8), scores(0.9), scores(1.0), scores(1.1)])
    assert list(table.columns) == list(MARGIN_COLUMNS)
    assert list(table.dynamics) == ["default", "default", "induced_mass", "induced_mass"]
    better, worse = table.iloc[0], table.iloc[2]
    assert better.n_seeds == 2
    assert better.decided
    assert abs(better.value - 0.15) < 1e-9
    assert worse.high < 0


def test_systems_are_not_mixed_and_a_missing_baseline_leaves_no_row():
    runs = [names("default"), names("constant", system="krauss_1seg")]
    assert build_margin_table(runs, [scores(0.8), scores(1.0)]).empty


def test_a_score_that_was_not_measured_has_no_row():
    table = build_margin_table(
        [names("default"), names("constant")], [scores(0.8, period=False), scores(1.0)]
    )
    assert list(table.score) == ["mse_half_second"]
