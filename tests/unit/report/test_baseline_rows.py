"""The baselines in the benchmark table: their rows, and what is said of them against ours."""

import numpy as np
import pytest

from lagsplat.report.tables.benchmark import (
    build_benchmark_rows,
    build_benchmark_table,
    format_benchmark_latex,
)
from tests.unit.report.test_tables import names, run


def scored(mse: float, *, seed: int = 0, starts: int = 50, **scores: object) -> dict:
    made = run(0)
    made["scores"] |= {"mse_half_second": mse} | scores
    per_window = mse * np.random.default_rng(seed).uniform(0.9, 1.1, size=starts)
    made["forecast"] = {"per_window": per_window.tolist(), "starts": list(range(starts)), "states": 30}
    made["training"] = {"steps": 1000, "frames_seen": 32000, "wall_s": 100.0 + 100.0 * seed}
    return made


def place(baseline: str, *, system: str = "krauss_2seg", seed: int = 0) -> dict:
    path = {"profile": "quick", "recording": "simulated", "system": system}
    return {**path, "baseline": baseline, "seed": seed}


def test_each_baseline_has_a_row_with_our_gain_on_the_same_starts():
    runs = [place("osc_abcd"), place("osc_abcd", seed=1), place("koopman_deconv")]
    theirs = [scored(3e-3, seed=1), scored(5e-3, seed=2), scored(2e-4, seed=3)]
    ours = [scored(1e-3), scored(4e-3, seed=5)]
    rows = build_benchmark_rows([names(0), names(0, stage2="constant")], ours, runs, theirs)
    assert [row["method"] for row in rows] == [
        "LaGSplat",
        "LaGSplat (constant)",
        "Osc. + ABCD",
        "Koopman + deconv",
    ]
    worse, better = rows[2:]
    assert worse["margin"] == pytest.approx(3e-3, rel=0.05)
    assert 0 < worse["margin_low"] < worse["margin"] < worse["margin_high"]
    assert better["margin_high"] < 0
    assert (worse["n_seeds"], worse["steps"], worse["wall_s"]) == (2, 1000, 250.0)
    frame = build_benchmark_table(rows)
    assert frame["margin"].notna().sum() == 2
    assert frame["method"].tolist()[4:] == [
        "LaGSplat (paper)",
        *(f"{law} + {decoder} (paper)" for law in ("Osc.", "Koopman") for decoder in ("deconv", "ABCD")),
    ]
    line = next(
        line
        for line in format_benchmark_latex(rows, titles={}).splitlines()
        if line.startswith("Osc. + ABCD &")
    )
    assert "& 1000 & simulated" in line
    assert r"\,{\scriptstyle[" in line


def test_without_ours_there_is_no_gain():
    rows = build_benchmark_rows(
        [names(0, stage2="constant")], [scored(1e-3)], [place("osc_abcd")], [scored(2e-3)]
    )
    assert rows[1]["margin"] is None


def test_other_starts_cannot_be_paired():
    with pytest.raises(ValueError, match="windows differ"):
        build_benchmark_rows([names(0)], [scored(1e-3)], [place("osc_abcd")], [scored(2e-3, starts=49)])
