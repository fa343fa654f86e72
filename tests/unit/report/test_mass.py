"""The table of mass ablations: forms by name, gains over the constant one, the paper's numbers beside."""

import pytest

from lagsplat.report.tables.learned_physics import (
    MASS_COLUMNS,
    build_mass_rows,
    build_mass_table,
    format_mass_latex,
)
from tests.unit.report.test_baseline_rows import scored
from tests.unit.report.test_tables import names


def with_inertia(mse: float, seed: int, dependence: float) -> dict:
    inertia = {"state_dependence": dependence, "span": 1.6, "condition_median": 2.0, "condition_max": 3.0}
    return scored(mse, seed=seed) | {"inertia": inertia}


@pytest.fixture
def rows() -> list[dict]:
    runs = [
        names(seed, stage2=name) for name in ("default", "induced_mass", "constant_mass") for seed in (0, 1)
    ]
    errors = (1e-3, 1.1e-3, 2e-3, 2.1e-3, 5e-3, 5e-3)
    dependence = (0.2, 0.4, 0.1, 0.1, 0.0, 0.0)
    return build_mass_rows(
        runs, [with_inertia(*made) for made in zip(errors, range(6), dependence, strict=True)]
    )


def test_each_form_has_a_row_and_its_gain(rows):
    frame = build_mass_table(rows)
    assert tuple(frame.columns) == MASS_COLUMNS
    forms = ["learned", "induced by the decoder", "constant"]
    assert frame["mass"].tolist() == [
        *forms,
        "learned (paper)",
        "induced by the decoder (paper)",
        "constant (paper)",
    ]
    assert frame["margin"].iloc[0] == pytest.approx(4e-3, rel=0.05)
    assert frame["margin_low"].iloc[1] > 0
    assert frame["margin"].iloc[2:].isna().all()
    assert frame["state_dependence"].iloc[0] == pytest.approx(0.3)
    assert frame["mse_half_second"].iloc[3:].tolist() == [0.769e-3, 1.33e-3, 4.8e-3]


def test_latex_has_nine_cells_a_line_and_says_whose_numbers(rows):
    text = format_mass_latex(rows, titles={"krauss_2seg": "Two segments"})
    lines = [line for line in text.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert all(line.replace(r"\&", "").count("&") == 8 for line in lines)
    assert "$2$ ($3$)" in text
    assert "profile quick" in text
    assert "filmed, the paper's" in text


def test_other_arms_have_no_paper_rows():
    made = build_mass_rows([names(0, system="krauss_1seg")], [with_inertia(1e-3, 0, 0.1)])
    assert [row["mass"] for row in made] == ["learned"]
