"""The table of learned physics against the truth."""

import re

import pytest

from lagsplat.report.tables.learned_physics import TRUTH_COLUMNS, build_truth_table, format_truth_latex
from tests.unit.report.test_tables import names


def measured(learned: float | None) -> dict:
    """Metrics as far as the table reads them."""
    error = None if learned is None else abs(learned / 2.0 - 1.0)
    frequency = {"quantity": "frequency, free rollout [Hz]", "learned": learned, "truth": 2.0, "error": error}
    rest = {"quantity": "equilibrium, angle [rad]", "learned": 0.1, "truth": 0.0, "error": 0.02}
    rows = [{**frequency, "encoded": 2.01, "residual": None}, {**rest, "encoded": None, "residual": 0.01}]
    return {"truth": {"rows": rows}}


@pytest.fixture
def table():
    runs = [names(seed, system="pendulum") for seed in range(3)] + [
        names(0, system="rocking_chair"),
        names(0, system="pendulum_pair", recording="filmed"),
    ]
    return build_truth_table(runs, [measured(1.9), measured(2.3), measured(2.1), measured(None), {}])


def test_a_row_for_each_system_and_quantity_and_none_without_truth(table):
    assert tuple(table.columns[:5]) == TRUTH_COLUMNS == ("system", "quantity", "learned", "truth", "error")
    assert table["system"].tolist() == ["pendulum"] * 2 + ["rocking_chair"] * 2
    with pytest.raises(ValueError, match="no run has a truth"):
        build_truth_table([names(0, recording="filmed")], [{}])


def test_seeds_give_a_median_and_a_range(table):
    first = table.iloc[0]
    assert (first["learned"], first["learned_low"], first["learned_high"]) == (2.1, 1.9, 2.3)
    assert first["error"] == pytest.approx(0.05)
    assert first["n_seeds"] == 3
    assert table.iloc[2]["learned"] is None


def test_other_dynamics_are_named():
    runs = [names(0, system="pendulum", stage2="constant")]
    assert (
        build_truth_table(runs, [measured(2.0)])["quantity"][0] == "frequency, free rollout [Hz] (constant)"
    )


def test_latex(table):
    text = format_truth_latex(table, titles={"pendulum": "Pendulum"})
    assert r"\emph{Pendulum}" in text
    lines = [line for line in text.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert len(lines) == 5
    assert all(len(re.findall(r"(?<!\\)&", line)) == 5 for line in lines)
    assert r"$2.1\,{\scriptstyle[1.9,\,2.3]}$ & $2$ & $2.01$ & $5$ & --" in lines[1]
    assert "-- & $2$ & $2.01$ & -- & --" in lines[3]
    assert "Brackets: range over seeds" in text
