"""The table of free rollouts: every system, the paper's numbers beside ours."""

import re
import shutil
import subprocess

import pytest

from lagsplat.report.common.published_values import SYSTEMS
from lagsplat.report.common.table_rows import build_rows
from lagsplat.report.tables.learned_physics import (
    PHYSICAL_COLUMNS,
    build_physical_table,
    format_physical_latex,
)
from tests.unit.report.test_tables import names, run


@pytest.fixture
def rows() -> list[dict]:
    runs = [names(0, system="pendulum"), names(0), names(1), names(0, system="toy")]
    return build_rows(runs, [run(0, d=1), run(0), run(1, frequency_error=0.04), run(0, d=2)])


def test_the_first_ten_columns_are_those_agreed(rows):
    assert PHYSICAL_COLUMNS == (
        "system", "d", "frequency_error", "latent_nrmse", "image_ratio", "ae_floor", "diverged", "recording",
        "profile", "n_seeds",
    )  # fmt: skip
    frame = build_physical_table(rows)
    assert tuple(frame.columns) == (*PHYSICAL_COLUMNS, "frequency_error_low", "frequency_error_high")


def test_every_system_stands_beside_its_row_of_the_paper(rows):
    frame = build_physical_table(rows)
    assert frame["system"].tolist() == ["pendulum", "pendulum", "krauss_2seg", "krauss_2seg", "toy"]
    assert frame["recording"].tolist()[:2] == ["simulated", "filmed, the paper's"]
    assert frame["frequency_error"].tolist() == pytest.approx([0.02, 0.034, 0.03, 0.057, 0.02])
    assert (frame["n_seeds"][2], frame["diverged"][2]) == (2, 2)


def test_another_dynamics_is_named_in_a_column_of_its_own(rows):
    runs = [names(0, system="pendulum"), names(0, system="pendulum", stage2="constant")]
    metrics = [run(0, d=1), run(0, d=1) | {"dynamics": "linear"}]
    frame = build_physical_table(build_rows(runs, metrics))
    assert frame.columns[len(PHYSICAL_COLUMNS)] == "dynamics"
    assert frame["dynamics"].tolist() == ["nonlinear", "linear (constant)", "nonlinear (paper)"]


def test_the_paper_has_seven_systems_ordered_by_dimension():
    assert len(SYSTEMS) == 7
    assert [values[0] for values in SYSTEMS.values()] == [1, 1, 1, 2, 2, 2, 4]


def test_latex_says_units_and_whose_numbers(rows):
    text = format_physical_latex(rows, titles={"pendulum": "Pendulum & co"})
    ours, papers = (
        line for line in text.splitlines() if re.match(r"Pendulum \\& co|\\quad nonl.*\$14\.5", line)
    )
    assert "$2$ & $0.19$ & $12.5$ & $0.41$ & 1/101 & simulated" in ours
    assert (
        r"\quad nonlinear (paper) & 1 & $3.4$ & $0.308$ & $14.5$ & $0.93$ & -- & filmed, the paper's"
        in papers
    )
    lines = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert all(len(re.findall(r"(?<!\\)&", line)) == 7 for line in lines)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex")
def test_latex_compiles(rows, tmp_path):
    (tmp_path / "table.tex").write_text(format_physical_latex(rows, titles={}))
    document = r"\documentclass{article}\begin{document}\input{table}\end{document}"
    (tmp_path / "paper.tex").write_text(document)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
