"""Tables of forces: invariants beside the paper's, and errors against the truth."""

import math

import numpy as np

from lagsplat.report.common.printed_table import format_latex
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.figures.forces import draw_force_map
from lagsplat.report.tables.forces import (
    ACCURACY_COLUMNS,
    INVARIANT_COLUMNS,
    build_force_rows,
    build_invariant_rows,
    lay_out_forces,
    lay_out_invariants,
)

RUN = {
    "profile": "quick",
    "recording": "simulated",
    "system": "rainbow_rocker",
    "stage1": "default",
    "ae": 0,
    "stage2": "default",
    "seed": 0,
}
INVARIANTS = {
    "lever": {"rank": 0.99, "sign": 1.0, "left": -0.6, "right": 0.7},
    "background": {"largest": 0.001, "typical": 0.5, "ratio": 500.0},
    "superposition": {"force": 1e-16, "answer": 0.02, "small_answer": 3e-7},
    "chart": {"state": 1e-9, "picture": 2e-8},
    "across": 0.0,
}
ERRORS = {
    "direction_deg": 2.0,
    "shape": 0.1,
    "amplitude": 0.05,
    "pictured_direction_deg": 1.0,
    "pictured_shape": 0.02,
    "pictured_amplitude": 0.06,
}
BLOCK = {"n": 12, **ERRORS, **{f"{name}_p90": 2 * value for name, value in ERRORS.items()}}
TRUTH = {
    **{"scale": 3.0, "scale_of_others": [0.9, 1.0, 1.2], "inside": BLOCK},
    "levels": [{**BLOCK, "level": 0.3, "distance": 0.31}, {**BLOCK, "n": 0, "level": 2.0, "distance": None}],
    "map": [{"place": [1.0, 2.0], **ERRORS}, {"place": [3.0, 2.0], **ERRORS, "shape": None}],
    "in_time": {"n": 4, "length_s": 0.5, "error": 0.3, "shape": 0.2, "shape_p90": 0.25},
    "at_once": {"learned": 0.9},
    "energy_spans": {"mass": 30.0},
}


def printed_invariants(rows: list[dict], **titles: str) -> str:
    return format_latex(lay_out_invariants(build_table(rows, INVARIANT_COLUMNS), titles=titles)[0])


def test_the_paper_s_values_stand_beside_ours_and_say_so() -> None:
    rows = build_invariant_rows([RUN], [{"invariants": INVARIANTS}])
    assert [row["method"] for row in rows] == ["ours", "paper"]
    frame = build_table(rows, INVARIANT_COLUMNS)
    assert frame["ratio"].tolist() == [500.0, 70.0]
    assert frame["n_seeds"].tolist()[0] == 1
    tex = printed_invariants(rows, rainbow_rocker="rocker")
    assert r"\emph{Filmed, the paper's}" in tex
    assert r"\emph{Simulated}" in tex
    other = build_invariant_rows([{**RUN, "system": "toy"}], [{"invariants": {**INVARIANTS, "lever": None}}])
    assert [row["method"] for row in other] == ["ours"]
    assert math.isnan(build_table(other, INVARIANT_COLUMNS).astype({"left": float})["left"][0])


def test_a_run_in_space_has_a_row_of_what_is_felt_across() -> None:
    solid = [({**RUN, "system": "rocker_3d"}, {"felt_across": 7e-19})]
    rows = build_invariant_rows([RUN], [{"invariants": INVARIANTS}], solid=solid)
    assert [row["method"] for row in rows] == ["ours", "paper", "ours, in space"]
    assert rows[-1]["across"] == 7e-19
    assert r"7$\cdot$10$^{-19}$" in printed_invariants(rows, rocker_3d="rocker in space")


def test_a_background_that_never_answers_is_told_as_such() -> None:
    still = {**INVARIANTS, "background": {"largest": 0.0, "typical": 0.5, "ratio": None}}
    rows = build_invariant_rows([{**RUN, "system": "toy"}], [{"invariants": still}])
    assert r"$\infty$ & " in printed_invariants(rows, toy="toy")


def test_seeds_are_brought_together_by_their_median() -> None:
    other = {**INVARIANTS, "background": {"largest": 0.003, "typical": 0.5, "ratio": 100.0}}
    rows = build_invariant_rows(
        [RUN, {**RUN, "seed": 1}], [{"invariants": INVARIANTS}, {"invariants": other}]
    )
    assert rows[0]["ratio"] == 300.0
    assert rows[0]["n_seeds"] == 2


def test_every_kind_of_answer_has_a_row() -> None:
    rows = build_force_rows([RUN], [{"truth": TRUTH}])
    assert [row["what"] for row in rows] == [
        "visited",
        "level 0.3",
        "in time, 0.5 s",
        "span of energies, mass",
        "first motion, learned mass",
    ]
    frame = build_table(rows, ACCURACY_COLUMNS)
    assert frame["scale_high"][0] == 1.2
    assert frame["error"][2] == 0.3
    assert frame["span"][3] == 30.0
    main, levels, masses = (format_latex(part) for part in lay_out_forces(frame, titles={}))
    assert r"2.0\,{\scriptsize (4.0)}" in main
    assert "0.90 to 1.20" in main
    assert "level" not in main
    assert "level 0.3 & 12" in levels
    assert "span of energies, mass & -- & 30.0" in masses


def test_several_seeds_have_their_range() -> None:
    other = {**TRUTH, "energy_spans": {"mass": 50.0}}
    rows = build_force_rows([RUN, {**RUN, "seed": 1}], [{"truth": TRUTH}, {"truth": other}])
    spans = next(row for row in rows if row["what"] == "span of energies, mass")
    assert (spans["span"], spans["span_low"], spans["span_high"]) == (40.0, 30.0, 50.0)
    single = build_force_rows([RUN], [{"truth": TRUTH}])
    assert not any("span_low" in row for row in single)


def test_a_law_that_answers_the_wrong_way_says_why() -> None:
    rows = build_force_rows([RUN], [{"truth": {"refused": "against the measured way"}}])
    assert [row["what"] for row in rows] == ["nothing measured"]
    (main, *_) = lay_out_forces(build_table(rows, ACCURACY_COLUMNS), titles={})
    assert "against the measured way" in format_latex(main)


def test_the_map_shows_three_errors_or_the_reason() -> None:
    ground = np.zeros((8, 12, 3))
    figure = draw_force_map(ground, TRUTH, title="t")
    assert len(figure.axes) == 6
    figure = draw_force_map(ground, {"refused": "why"}, title="t")
    assert "why" in figure.texts[-1].get_text()
