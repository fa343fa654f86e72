"""The benchmark: columns, caption, printed rows, baselines, and margins over constant dynamics."""

import numpy as np
import pytest

from lagsplat.report.common.printed_table import format_latex
from lagsplat.report.common.table_rows import build_rows
from lagsplat.report.tables.benchmark import (
    BENCHMARK_COLUMNS,
    MARGIN_COLUMNS,
    build_benchmark_rows,
    build_benchmark_table,
    build_margin_table,
    lay_out_benchmark,
)

SPREAD = "median and range over seeds"
PAPERS = [f"{law} + {decoder} (paper)" for law in ("Osc.", "Koopman") for decoder in ("deconv", "ABCD")]


def run(seed: int, *, origin: str = "simulated", d: int = 4, frequency_error: float | None = 0.02) -> dict:
    """Metrics as `evaluate` writes them, as far as rows are made of them."""
    return {
        "schema": 1,
        "recording": {"origin": origin, "source": "arm_2", "sha256": None},
        "d": d,
        "dynamics": "nonlinear",
        "scores": {
            "ae_floor": 4.1e-5,
            "mse_half_second": 4e-4 + 1e-5 * seed,
            "mse_ahead": 5e-4,
            "frequency_error": frequency_error,
            "latent_nrmse": 0.19,
            "image_ratio": 12.5,
            "external_force": "anywhere",
            "diverged": 1,
            "rollouts": 101,
        },
        "intervals": {"mse_half_second": [3.8e-4, 4.4e-4], "frequency_error": [None, None]},
        "frequency": {"n_windows": 1, "estimator": "spectral peak"},
        "forecast": {"distinct": 50},
        "latent": {"distinct": 12},
    }


def names(seed: int, *, system: str = "krauss_2seg", recording: str = "simulated", stage2: str = "default"):
    return {
        "profile": "quick",
        "recording": recording,
        "system": system,
        "stage1": "default",
        "ae": 0,
        "stage2": stage2,
        "seed": seed,
    }


@pytest.fixture
def rows() -> list[dict]:
    runs = [names(seed) for seed in range(3)] + [
        names(0, stage2="constant_mass"),
        names(0, system="krauss_1seg"),
    ]
    return build_rows(runs, [run(0), run(1), run(2), run(0), run(0, d=2, frequency_error=None)])


def test_columns_are_those_agreed_then_the_spreads(rows):
    frame = build_benchmark_table(rows)
    assert tuple(frame.columns[: len(BENCHMARK_COLUMNS)]) == BENCHMARK_COLUMNS
    assert set(frame.columns[len(BENCHMARK_COLUMNS) :]) == {"mse_half_second_low", "mse_half_second_high"}


def test_rows_group_seeds_and_stand_beside_the_paper(rows):
    frame = build_benchmark_table(rows)
    assert frame["robot"].tolist() == ["krauss_2seg"] * 7 + ["krauss_1seg"] * 6
    assert frame["method"].tolist() == [
        "LaGSplat",
        "LaGSplat (constant_mass)",
        "LaGSplat (paper)",
        *PAPERS,
        "LaGSplat",
        "LaGSplat (paper)",
        *PAPERS,
    ]
    ours, papers = frame.iloc[0], frame.iloc[2]
    assert (
        ours["mse_half_second"],
        ours["mse_half_second_low"],
        ours["mse_half_second_high"],
    ) == pytest.approx((4.1e-4, 4e-4, 4.2e-4))
    assert (ours["n_seeds"], ours["diverged"], ours["recording"]) == (3, 3, "simulated")
    assert (papers["mse_half_second"], papers["recording"]) == (0.769e-3, "filmed, the paper's")
    assert frame["recording"].iloc[[1, 7]].tolist() == ["simulated", "simulated"]


def printed(rows: list[dict], *, part: int = 0, **titles: str) -> str:
    return format_latex(lay_out_benchmark(build_benchmark_table(rows), titles=titles)[part])


def test_unmeasured_is_empty_in_csv_and_a_dash_in_print(rows):
    assert build_benchmark_table(rows)["frequency_error"].iloc[7] is None
    line = next(line for line in printed(rows).splitlines() if line.startswith("LaGSplat & 2 "))
    assert " -- " in line
    assert printed(rows).count("A dash: not measured") == 1


def test_caption_says_profile_and_spread_and_blocks_the_recording(rows):
    text = printed(rows, krauss_2seg="two segments & co_1")
    caption = next(line for line in text.splitlines() if line.startswith(r"\caption"))
    for part in (r"\textbf{Forecasts", "Profile quick", "ranges over 3 seeds", r"95 \% intervals"):
        assert part in caption
    assert r"\emph{Two segments \& co\_1 (simulated), 50 distinct windows}" in text
    assert r"\emph{Two segments \& co\_1 (filmed, the paper's)}" in text


def test_a_file_that_a_user_gave_is_named_with_its_block():
    filmed = build_rows([names(0, recording="filmed")], [run(0, origin="filmed")])
    assert r"(filmed arm\_2), 50 distinct windows" in printed(filmed)


def test_the_best_is_bold_among_rows_of_one_recording_only(rows):
    lines = [line for line in printed(rows).splitlines() if r"\textbf{" in line and "&" in line]
    assert [line.split(" &")[0] for line in lines] == [
        r"LaGSplat (constant\_mass)",
        *("LaGSplat", "Osc. + deconv", "Koopman + ABCD"),  # of the paper: the first arm, then the other
    ]


def test_a_row_cannot_be_labelled_with_another_recording():
    with pytest.raises(ValueError, match="scores are of a filmed recording"):
        build_rows([names(0)], [run(0, origin="filmed")])
    with pytest.raises(ValueError, match="at least one row"):
        build_benchmark_table([])


def test_toy_rows_need_no_paper(rows):
    frame = build_benchmark_table(build_rows([names(0, system="toy")], [run(0)]))
    assert len(frame) == 1
    assert np.isclose(frame["mse_half_second_low"].iloc[0], 3.8e-4)


def scored(mse: float, *, seed: int = 0, starts: int = 50, **scores: object) -> dict:
    made = run(0)
    made["scores"] |= {"mse_half_second": mse} | scores
    per_window = mse * np.random.default_rng(seed).uniform(0.9, 1.1, size=starts)
    made["forecast"] = {
        "per_window": per_window.tolist(),
        "starts": list(range(0, 30 * starts, 30)),
        "states": 30,
        "distinct": 50,
    }
    made["training"] = {"steps": 1000, "frames_seen": 32000, "wall_s": 100.0 + 100.0 * seed}
    return made


def place(baseline: str, *, system: str = "krauss_2seg", seed: int = 0) -> dict:
    path = {"profile": "quick", "recording": "simulated", "system": system}
    return {**path, "baseline": baseline, "seed": seed}


def test_each_baseline_has_a_row_with_our_gain_on_the_same_starts():
    runs = [place("osc_abcd"), place("osc_abcd", seed=1), place("koopman_deconv")]
    theirs = [scored(3e-3, seed=1), scored(5e-3, seed=2), scored(2e-4, seed=3)]
    ours = [scored(1e-3), scored(4e-3, seed=5)]
    rows = build_benchmark_rows([names(0), names(0, stage2="constant")], ours, [], [], runs, theirs)
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
    line, rest = (
        next(line for line in printed(rows, part=part).splitlines() if line.startswith("Osc. + ABCD &"))
        for part in (0, 1)
    )
    assert r"\,{\scriptsize [" in line
    assert rest.endswith(r"& 32.0 & 4.2 \\")


def test_no_gain_is_given_over_a_baseline_that_is_no_better_than_the_mean_image():
    image_models = [names(0), {**names(0), "ae": 1}]
    simple = [
        {"Mean image": scored(mse), "Linear least squares": scored(0.1 * mse, seed=4)} for mse in (2e-3, 4e-3)
    ]
    runs = [place(name) for name in ("osc_abcd", "osc_deconv", "koopman_abcd", "koopman_deconv")]
    theirs = [scored(3.1e-3, seed=1), scored(3e-3, seed=2), scored(2e-3, seed=3), scored(2e-4, seed=5)]
    rows = build_benchmark_rows([names(0)], [scored(1e-4, seed=6)], image_models, simple, runs, theirs)
    assert [(row["method"], row["n_seeds"]) for row in rows] == [
        ("LaGSplat", 1),
        ("Mean image", 2),
        ("Linear least squares", 2),
        *((f"{law} + {decoder}", 1) for law in ("Osc.", "Koopman") for decoder in ("ABCD", "deconv")),
    ]
    assert rows[2]["margin"] == pytest.approx(2e-4, rel=0.1)
    assert rows[2]["margin_low"] < rows[2]["margin"] < rows[2]["margin_high"]
    assert [(row["converged"], row["margin"] is None) for row in rows[3:]] == [
        (False, True),
        (False, True),
        (True, False),
        (True, False),
    ]
    assert [row["over_mean"] > 0.5 for row in rows[3:]] == [False, False, False, True]
    text = printed(rows)
    for name in ("Osc. + ABCD †", "Osc. + deconv †", "Koopman + ABCD ‡", "Koopman + deconv &"):
        assert name in text
    assert "†: not better than the mean image" in text
    assert "‡: less than twice as good" in text


def test_without_ours_there_is_no_gain():
    rows = build_benchmark_rows(
        [names(0, stage2="constant")], [scored(1e-3)], [], [], [place("osc_abcd")], [scored(2e-3)]
    )
    assert rows[1]["margin"] is None


def test_other_starts_cannot_be_paired():
    with pytest.raises(ValueError, match="windows differ"):
        build_benchmark_rows(
            [names(0)], [scored(1e-3)], [], [], [place("osc_abcd")], [scored(2e-3, starts=49)]
        )


def scores(level: float, *, period: bool = True) -> dict:
    windows = level * np.linspace(0.9, 1.1, 50)
    latent = {"starts": list(range(0, 2800, 70)), "states": 70, "per_window_image": list(windows[:40])}
    return {
        "recording": {"origin": "simulated"},
        "forecast": {"starts": list(range(0, 1500, 30)), "states": 30, "per_window": list(windows)},
        "latent": latent if period else {"reason": "no free window"},
    }


def margin_names(stage2: str, seed: int = 0, system: str = "krauss_2seg") -> dict:
    place = {"profile": "quick", "recording": "simulated", "system": system, "stage1": "default", "ae": 0}
    return place | {"stage2": stage2, "seed": seed}


def test_every_variant_stands_against_the_constant_one():
    runs = [
        margin_names("default", 0),
        margin_names("default", 1),
        margin_names("constant"),
        margin_names("induced_mass"),
    ]
    table = build_margin_table(runs, [scores(0.8), scores(0.9), scores(1.0), scores(1.1)])
    assert list(table.columns) == list(MARGIN_COLUMNS)
    assert list(table.dynamics) == ["default", "default", "induced_mass", "induced_mass"]
    better, worse = table.iloc[0], table.iloc[2]
    assert better.n_seeds == 2
    assert better.decided
    assert abs(better.value - 0.15) < 1e-9
    assert worse.high < 0


def test_systems_are_not_mixed_and_a_missing_baseline_leaves_no_row():
    runs = [margin_names("default"), margin_names("constant", system="krauss_1seg")]
    assert build_margin_table(runs, [scores(0.8), scores(1.0)]).empty


def test_a_score_that_was_not_measured_has_no_row():
    table = build_margin_table(
        [margin_names("default"), margin_names("constant")], [scores(0.8, period=False), scores(1.0)]
    )
    assert list(table.score) == ["mse_half_second"]
