"""The benchmark table: its columns, its caption, and that LaTeX can read it."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from lagsplat.report.common.formatting import format_digits
from lagsplat.report.common.table_rows import build_row, build_rows
from lagsplat.report.tables.benchmark import BENCHMARK_COLUMNS, build_benchmark_table, format_benchmark_latex

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


def test_unmeasured_is_empty_in_csv_and_a_dash_in_latex(rows):
    assert build_benchmark_table(rows)["frequency_error"].iloc[7] is None
    line = next(
        line
        for line in format_benchmark_latex(rows, titles={}).splitlines()
        if line.startswith("LaGSplat & non") and " 2 " in line
    )
    assert " -- " in line


def test_caption_says_recording_profile_and_spread(rows):
    caption = re.search(r"\\caption\{(.*)\}", format_benchmark_latex(rows, titles={})).group(1)
    for part in ("simulated recording", "profile quick", SPREAD, "95\\% interval".replace("\\%", " \\%")):
        assert part in caption


def test_latex_is_balanced_and_every_line_has_fourteen_cells(rows):
    text = format_benchmark_latex(rows, titles={"krauss_2seg": "Two segments & co_1"})
    assert r"\emph{Two segments \& co\_1}" in text
    assert text.count(r"\begin{") == text.count(r"\end{")
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}")
    lines = [line for line in text.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert all(len(re.findall(r"(?<!\\)&", line)) == 13 for line in lines)
    assert not re.search(r"(?<!\\)_(?![{\\])", re.sub(r"\$[^$]*\$|\\label\{.*\}", "", text))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex")
@pytest.mark.parametrize("preamble", ["", r"\usepackage{booktabs}"])
def test_latex_compiles_in_a_plain_article(rows, tmp_path, preamble):
    (tmp_path / "table.tex").write_text(format_benchmark_latex(rows, titles={}))
    document = rf"\documentclass{{article}}{preamble}\begin{{document}}\input{{table}}\end{{document}}"
    (tmp_path / "paper.tex").write_text(document)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)


def test_a_row_cannot_be_labelled_with_another_recording():
    with pytest.raises(ValueError, match="scores are of a filmed recording"):
        build_rows([names(0)], [run(0, origin="filmed")])
    with pytest.raises(ValueError, match="at least one row"):
        build_benchmark_table([])


def test_toy_rows_need_no_paper(rows):
    frame = build_benchmark_table(build_rows([names(0, system="toy")], [run(0)]))
    assert len(frame) == 1
    assert np.isclose(frame["mse_half_second_low"].iloc[0], 3.8e-4)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.44, "0.44"), (12.345, "12.3"), (1234.5, "1234"), (0.00001234, "0.000012"), (0.0, "0")],
)
def test_digits_are_plain(value, text):
    assert format_digits(value) == text


def test_table_row_carries_what_the_caption_needs(rows):
    assert {"rollouts", "spread"} <= set(rows[0])
    assert callable(build_row)
