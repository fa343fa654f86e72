"""The table of gaps from made-up diagnoses."""

import math

import pandas as pd

from lagsplat.report.common.printed_table import format_latex
from lagsplat.report.diagnosis.serialization import build_diagnosis_content
from lagsplat.report.tables.gap import (
    GAP_COLUMNS,
    build_gap_rows,
    build_gap_table,
    lay_out_blind,
    lay_out_gap,
)
from tests.unit.report.diagnosis import made_diagnoses

RUN = {"recording": "simulated", "profile": "quick", "stage2": "default", "seed": 0}


def rows():
    made = made_diagnoses.every_kind()
    image = {"before": 0.02, "after": 0.012, "floor": 0.01, "closure": 0.8}
    own = made_diagnoses.base(
        "none", made["none"].candidates, gap=made["none"].gap, checks={"image": image, "windows": 4}
    )
    runs = [
        {**RUN, "system": "arm", "real": "held_out"},
        {**RUN, "system": "arm", "real": "coulomb_friction"},
        {**RUN, "system": "arm", "real": "none"},
        {**RUN, "system": "bag", "real": "held_out", "recording": "filmed"},
    ]
    found = [own, made["combination"], made["unknown"], made["undetermined"]]
    return build_gap_rows(runs, [build_diagnosis_content(one) for one in found])


def test_every_diagnosis_has_a_row_that_says_of_what_it_is():
    table = build_gap_table(rows())
    assert tuple(table.columns) == GAP_COLUMNS
    assert table["system"].tolist() == ["arm", "arm", "arm", "bag"]
    assert table["planted"].tolist()[1:3] == ["coulomb_friction", "none"]
    assert table["planted"].isna().tolist() == [True, False, False, True]
    assert table["found"].tolist() == ["", "coulomb_friction+input_delay", "", ""]
    assert table["verdict"].tolist() == ["none", "effect", "unknown", "undetermined"]
    assert table["recording"].tolist()[-1] == "filmed"


def test_numbers_are_those_of_the_diagnoses():
    first, second, _, last = rows()
    assert first["probability"] == 0.96
    assert (first["image_before"], first["image_floor"]) == (0.02, 0.01)
    assert second["probability"] == 0.9
    gap = made_diagnoses.gap()
    assert math.isclose(second["before"], gap.before)
    assert math.isclose(second["closure"], gap.closure.value)
    assert (second["blocks"], second["diverged_before"], second["diverged_after"]) == (8, 0, 0)
    assert last["before"] is None
    assert last["closure"] is None


def test_the_print_says_what_was_planted_and_what_was_found():
    (table,) = lay_out_gap(build_gap_table(rows()), titles={"arm": "An arm", "bag": "A bag"})
    text = format_latex(table)
    assert [title for title, _ in table.blocks] == ["An arm (simulated)", "A bag (filmed)"]
    lines = [line for line in text.splitlines() if "raggedright" in line and "&" in line]
    planted = next(line for line in lines if "with Coulomb friction" in line)
    assert "Coulomb friction; input delay" in planted
    assert "nothing planted" in text
    assert "undetermined" in lines[-1]
    assert "0, 0 of 8" in planted
    assert lines[-1].count("--") == 6  # chance, four sizes, and what diverged
    assert "a second recording" in text
    assert "a second recording" not in format_latex(lay_out_gap(build_gap_table(rows()[-1:]), titles={})[0])


def test_the_blind_check_has_a_row_for_each_method_that_was_tried():
    metrics = {"top-1, class": "0.96 [0.86, 0.99] n=49", "false alarms": "0.10 n=9", "Brier score": "0.162"}
    frame = pd.DataFrame({"tier": "T0", "recordings": "T0: 9 films", "metric": list(metrics)})
    frame["diagnosis"], frame["chance"], frame["other"] = metrics.values(), ["0.05", "0.00", None], None
    main, rest = lay_out_blind(frame)
    assert [title for title, _ in main.blocks] == ["T0: 9 films"]
    cells = [[cell.text for cell in row] for row in main.blocks[0][1]]
    assert cells == [["diagnosis", "0.96", "0.10"], ["chance", "0.05", "0.00"]]
    assert main.blocks[0][1][0][1].small == "[0.86, 0.99]"
    bold = [[cell.bold for cell in row] for row in main.blocks[0][1]]
    assert bold == [[False, True, False], [False, False, True]]
    assert [column.title for column in rest.columns] == ["Method", "Brier"]
