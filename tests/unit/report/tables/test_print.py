"""Every printed table on a real page: two columns of 10 points, nothing too wide, too high or too wordy."""

import re
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.published_tables import LAYOUTS, ROOT, list_published, read_titles
from lagsplat.report.common.printed_table import (
    PrintedTable,
    format_html,
    format_latex,
    lay_out,
    make_text_column,
)
from lagsplat.report.common.table_rows import build_rows, build_table
from lagsplat.report.tables.extrapolation import (
    build_extrapolation_table,
    group_models,
    lay_out_extrapolation,
)
from lagsplat.report.tables.forces import ACCURACY_COLUMNS, build_force_rows, lay_out_forces
from lagsplat.report.tables.learned_physics import (
    build_mass_rows,
    build_mass_table,
    build_recipes_table,
    lay_out_mass,
    lay_out_recipes,
)
from tests.unit.report.tables.test_benchmark import names, run
from tests.unit.report.tables.test_extrapolation import RUN, found, other
from tests.unit.report.tables.test_forces import TRUTH
from tests.unit.report.tables.test_learned_physics import with_inertia

# The lines of a caption are 12 points apart, and the first is hardly 9 points high.
THREE_LINES_PT = 9 + 2 * 12
PREAMBLE = r"""\documentclass[10pt,twocolumn]{article}%s
\makeatletter
\long\def\@makecaption#1#2{%%
  \setbox0\vbox{\hsize\textwidth\noindent #1: #2\par}\typeout{caption \the\ht0}\box0}
\makeatother
\begin{document}
%s
\end{document}
"""


def make_others() -> list[PrintedTable]:
    """What no published table has: intervals of several seeds, variants of models, a refused answer."""
    titles = read_titles()
    runs = [
        names(seed, stage2=name) for name in ("default", "induced_mass", "constant_mass") for seed in (0, 1)
    ]
    metrics = [with_inertia(1e-3 * (1 + k), k, 0.1 * k) for k in range(6)]
    for k, one in enumerate(metrics):
        one["scores"] |= {"frequency_error": 0.013 + 0.02 * k, "latent_nrmse": 0.019 * (1 + k)}
    tables = lay_out_mass(build_mass_table(build_mass_rows(runs, metrics)), titles=titles)
    recipes = [{**one, "stage1": "upstream", "stage2": "upstream"} for one in runs[:3]]
    scores = [run(seed, frequency_error=0.01 * (1 + seed)) for seed in range(3)]
    for seed, one in enumerate(scores):
        one["scores"] |= {"image_ratio": 12.5 + seed, "latent_nrmse": 0.0719 + 0.01 * seed}
    tables += lay_out_recipes(build_recipes_table(build_rows(recipes, scores)), titles=titles)
    others = [
        other(kind, model, n)
        for kind, model in (("forecaster", "keypoints_noise"), ("ode", "default"), ("authors", "default"))
        for n in range(3)
    ]
    looks = [found(decay=0.01 * n + 0.001 * n * n, level=30.0 + n, diverged=n == 5) for n in range(10)]
    models = group_models([RUN], others, looks)
    tables += lay_out_extrapolation(build_extrapolation_table(models), titles=titles)
    refused = "no point of the object can be taken hold of: no matter was found there"
    rows = build_force_rows(
        [RUN, {**RUN, "system": "toy"}], [{"truth": TRUTH}, {"truth": {"refused": refused}}]
    )
    return tables + lay_out_forces(build_table(rows, ACCURACY_COLUMNS), titles=titles)


CASES = [(f"{path.parent.name}-{path.stem}", tables) for path, tables in list_published()]
CASES.append(("others", make_others()))
ON_PAPER = pytest.mark.skipif(
    shutil.which("pdflatex") is None,
    reason="pdflatex is missing: apt-get install texlive-latex-recommended",
)


def typeset(tables: list[PrintedTable], folder: Path, *, packages: str = r"\usepackage{booktabs}") -> str:
    """The log of pdflatex on a page for each table."""
    body = "\n\\clearpage\n".join(format_latex(table) for table in tables)
    (folder / "page.tex").write_text(PREAMBLE % (packages, body), encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
    log = (folder / "page.log").read_text("latin-1")
    assert done.returncode == 0, log[-2000:]
    return log


@ON_PAPER
@pytest.mark.parametrize("tables", [case[1] for case in CASES], ids=[case[0] for case in CASES])
def test_a_table_fits_on_the_page(tables: list[PrintedTable], tmp_path: Path) -> None:
    log = typeset(tables, tmp_path)
    assert not re.findall(r"^Overfull \\hbox.*", log, flags=re.MULTILINE)
    assert not re.findall(r"^LaTeX Warning: Float too large.*", log, flags=re.MULTILINE)
    heights = [float(height) for height in re.findall(r"^caption ([\d.]+)pt", log, flags=re.MULTILINE)]
    assert len(heights) >= len(tables)
    assert max(heights) < THREE_LINES_PT


@ON_PAPER
def test_what_is_too_wide_is_noticed(tmp_path: Path) -> None:
    table = CASES[0][1][0]
    blocks = [(title, [row * 3 for row in rows]) for title, rows in table.blocks]
    assert "Overfull" in typeset([table._replace(columns=table.columns * 3, blocks=blocks)], tmp_path)


@ON_PAPER
def test_booktabs_may_be_missing(tmp_path: Path) -> None:
    assert "Overfull" not in typeset(CASES[0][1], tmp_path, packages="")


def test_every_table_of_the_workflow_is_among_them() -> None:
    rules = "".join(path.read_text("utf-8") for path in (ROOT / "workflow/rules").glob("*.smk"))
    made = set(re.findall(r'tex="results/tables/(\w+)\.tex"', rules))
    assert made == set(LAYOUTS)
    assert made == {path.stem for path, _ in list_published()}


@pytest.mark.parametrize("tables", [case[1] for case in CASES], ids=[case[0] for case in CASES])
def test_a_page_has_the_same_content_and_needs_nothing_else(tables: list[PrintedTable]) -> None:
    page = format_html(tables)
    shown = [table for table in tables if table.blocks]
    assert page.count("<table>") == len(shown)
    rows = sum(len(lines) for table in shown for _, lines in table.blocks)
    assert page.count("<tr>\n<td") == rows
    assert not re.search(r"https?:|src=|<script|<link", page)


def test_the_type_is_smaller_where_cells_are_wide_not_where_they_are_many() -> None:
    def write(text: str, count: int) -> str:
        columns = [make_text_column("n", lambda _: text)] * count
        frame = pd.DataFrame({"system": ["pendulum"], "recording": ["simulated"]})
        return format_latex(lay_out(frame, columns, label="a", lead="A.", caption="", block=lambda _: ""))

    assert r"\footnotesize" in write("0.5", 12)
    assert r"\scriptsize" in write("0.75 [0.25, 1.25] of all of the frames", 4)
