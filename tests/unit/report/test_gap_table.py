"""The table of the gaps of every system."""

from lagsplat.report.gap_table import COLUMNS, gap_rows, gap_table, latex_gap

RUN = {"system": "toy", "profile": "toy", "recording": "simulated", "real": "held_out"}
FOUND = {
    "verdict": "none",
    "combination": [],
    "effects": [{"name": "none", "probability": 0.9}],
    "where": {"level": "dynamics"},
    "gap": {"before": 0.1, "refit": 0.1, "after": 0.1, "floor": 0.09, "horizon_s": 1.0,
            "closure": {"value": None, "low": None, "high": None}},
    "checks": {},
}  # fmt: skip


def test_one_row_a_diagnosis_with_its_place():
    rows = gap_rows([RUN], [FOUND])
    table = gap_table(rows)
    assert list(table.columns) == list(COLUMNS)
    assert table.loc[0, ["system", "verdict", "before"]].tolist() == ["toy", "none", 0.1]
    assert "Toy of a test" in latex_gap(rows, titles={"toy": "Toy of a test"})
