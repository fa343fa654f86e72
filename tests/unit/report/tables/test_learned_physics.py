"""Learned physics in tables: against the truth, by form of the mass, beside the paper's free rollouts."""

import pytest

from lagsplat.evaluate.truth import AT_REST, LINEARISED, ROLLOUT, ComparedQuantity
from lagsplat.report.common.printed_table import format_latex
from lagsplat.report.common.published_values import SYSTEMS
from lagsplat.report.common.table_rows import build_rows, build_simple_rows, build_table
from lagsplat.report.tables.learned_physics import (
    MASS_COLUMNS,
    PHYSICAL_COLUMNS,
    TRUTH_COLUMNS,
    build_mass_rows,
    build_mass_table,
    build_physical_table,
    build_recipes_table,
    build_truth_table,
    lay_out_mass,
    lay_out_physical,
    lay_out_recipes,
    lay_out_truth,
)
from tests.unit.report.tables.test_benchmark import names, run, scored


def measured(learned: float | None) -> dict:
    """Metrics as far as the table reads them."""
    error = None if learned is None else abs(learned / 2.0 - 1.0)
    frequency = ComparedQuantity("frequency", "Hz", ROLLOUT, mode=1)._asdict()
    frequency |= {"learned": learned, "truth": 2.0, "error": error}
    rest = ComparedQuantity("equilibrium", "rad", "law", AT_REST, coordinate="angle")._asdict()
    rest |= {"learned": 0.1, "truth": 0.0, "error": 0.02}
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
    assert tuple(table.columns[:8]) == TRUTH_COLUMNS[:8] == ("system", "method", *ComparedQuantity._fields)
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
    table = build_truth_table([names(0, system="pendulum", stage2="constant")], [measured(2.0)])
    assert set(table["method"]) == {"LaGSplat (constant)"}
    text = format_latex(lay_out_truth(table, titles={})[1])
    assert "frequency, free rollout [Hz] (constant) &" in text


def test_modes_are_numbered_where_there_are_several_and_the_law_at_rest_stands_first():
    rows = [
        ComparedQuantity("frequency", "Hz", ROLLOUT, mode=1),
        ComparedQuantity("frequency", "Hz", LINEARISED, AT_REST, mode=1),
        ComparedQuantity("decay rate", "1/s", LINEARISED, AT_REST, mode=2),
        ComparedQuantity("decay rate", "1/s", LINEARISED, "at mean pressure", mode=2),
        ComparedQuantity("equilibrium", None, "law", AT_REST, coordinate="strain 1"),
    ]
    measured = [{**of._asdict(), "learned": 1.0, "truth": 2.0, "error": 0.5} for of in rows]
    table = build_truth_table([names(0, system="krauss_1seg")], [{"truth": {"rows": measured}}])
    law, every = (
        [line[0].text for _, lines in part.blocks for line in lines]
        for part in lay_out_truth(table, titles={})
    )
    assert law == ["frequency 1 [Hz]", "decay rate 2 [1/s]"]
    assert every == [
        "frequency 1, free rollout [Hz]",
        "frequency 1, law at rest [Hz]",
        "decay rate 2, law at rest [1/s]",
        "decay rate 2, law at mean pressure [1/s]",
        "equilibrium, strain 1",
    ]


def test_print(table):
    main, rest = (format_latex(part) for part in lay_out_truth(table, titles={"pendulum": "Pendulum"}))
    assert main.count(r"\begin{table*}") == 1
    lines = [line for line in rest.splitlines() if line.startswith(("frequency", "equilibrium"))]
    assert r"\emph{Pendulum (simulated)}" in rest
    assert len(lines) == 4
    error = r"5.0\,{\scriptsize [5.0, 15.0]}"
    assert rf"2.10\,{{\scriptsize [1.90, 2.30]}} & 2.000 & {error} & 2.010 & --" in lines[0]
    assert "-- & 2.000 & -- & 2.010 & --" in lines[2]
    assert "brackets: their range" in rest


def test_intervals_are_marked_where_extrapolated_and_slanted_where_wide():
    metrics = measured(2.1)
    metrics["truth"]["rows"][0] |= {"low": 2.0, "high": 2.2, "extrapolated": True}
    metrics["truth"]["rows"][1] |= {"low": 0.1, "high": 3.0, "extrapolated": False}
    table = build_truth_table([names(0, system="pendulum")], [metrics])
    assert table["extrapolated"].tolist()[:2] == [True, False]
    text = format_latex(lay_out_truth(table, titles={})[1])
    assert r"2.00 to 2.20\textsuperscript{e} &" in text
    assert r"\emph{0.1 to 3.0} &" in text


def with_inertia(mse: float, seed: int, dependence: float) -> dict:
    inertia = {"state_dependence": dependence, "span": 1.6, "condition_median": 2.0, "condition_max": 3.0}
    return scored(mse, seed=seed) | {"inertia": inertia}


@pytest.fixture
def mass_rows() -> list[dict]:
    runs = [
        names(seed, stage2=name) for name in ("default", "induced_mass", "constant_mass") for seed in (0, 1)
    ]
    errors = (1e-3, 1.1e-3, 2e-3, 2.1e-3, 5e-3, 5e-3)
    dependence = (0.2, 0.4, 0.1, 0.1, 0.0, 0.0)
    return build_mass_rows(
        runs, [with_inertia(*made) for made in zip(errors, range(6), dependence, strict=True)]
    )


def test_each_form_has_a_row_and_its_gain(mass_rows):
    frame = build_table(mass_rows, MASS_COLUMNS)
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


def test_scores_and_matrices_stand_apart(mass_rows):
    main, matrices = lay_out_mass(build_mass_table(mass_rows), titles={"krauss_2seg": "Two segments"})
    assert [len(rows) for _, rows in main.blocks] == [3, 3]
    assert [len(rows) for _, rows in matrices.blocks] == [3]
    assert "learned & 30.0 & 1.60 & 2.00 & 3.00" in format_latex(matrices)
    assert "Profile quick" in main.caption
    assert main.blocks[1][0] == "Two segments (filmed, the paper's)"


def test_other_arms_have_no_paper_rows():
    made = build_mass_rows([names(0, system="krauss_1seg")], [with_inertia(1e-3, 0, 0.1)])
    assert [row["mass"] for row in made] == ["learned"]


@pytest.fixture
def rows() -> list[dict]:
    runs = [names(0, system="pendulum"), names(0), names(1), names(0, system="toy")]
    return build_rows(runs, [run(0, d=1), run(0), run(1, frequency_error=0.04), run(0, d=2)])


def test_the_first_columns_are_those_agreed(rows):
    assert PHYSICAL_COLUMNS == (
        "system",
        "d",
        "frequency_error",
        "latent_nrmse",
        "image_ratio",
        "ae_floor",
        "diverged",
        "recording",
        "profile",
        "n_seeds",
        "rollouts",
        "method",
        "long_windows",
    )
    frame = build_physical_table(rows)
    assert tuple(frame.columns) == (*PHYSICAL_COLUMNS, "frequency_error_low", "frequency_error_high")


def test_every_system_stands_beside_its_row_of_the_paper(rows):
    frame = build_physical_table(rows)
    assert frame["system"].tolist() == ["pendulum", "pendulum", "krauss_2seg", "krauss_2seg", "toy"]
    assert frame["recording"].tolist()[:2] == ["simulated", "filmed, the paper's"]
    assert frame["frequency_error"].tolist() == pytest.approx([0.02, 0.034, 0.03, 0.057, 0.02])
    assert (frame["n_seeds"][2], frame["diverged"][2]) == (2, 2)


def test_other_dynamics_and_simple_predictors_are_methods_of_their_own(rows):
    runs = [names(0, system="pendulum"), names(0, system="pendulum", stage2="constant")]
    simple = build_simple_rows(runs[:1], [{"Hold": run(0, d=1)}])
    frame = build_physical_table([*build_rows(runs, [run(0, d=1)] * 2), *simple])
    assert frame["method"].tolist() == ["LaGSplat", "LaGSplat (constant)", "Hold", "LaGSplat (paper)"]


def test_the_paper_has_seven_systems_ordered_by_dimension():
    assert len(SYSTEMS) == 7
    assert [values[0] for values in SYSTEMS.values()] == [1, 1, 1, 2, 2, 2, 4]


def test_every_recording_has_its_block(rows):
    (table,) = lay_out_physical(build_physical_table(rows), titles={"pendulum": "Pendulum & co"})
    assert [(title, len(lines)) for title, lines in table.blocks] == [
        ("Pendulum & co (simulated)", 1),
        ("Pendulum & co (filmed, the paper's)", 1),
        ("Krauss_2seg (simulated)", 1),
        ("Krauss_2seg (filmed, the paper's)", 1),
        ("Toy (simulated)", 1),
    ]
    text = format_latex(table)
    assert r"\emph{Pendulum \& co (simulated)}" in text
    assert r"LaGSplat & 1 & 2.00 & 19.0 & 12.5 & 0.410 & 12 & 1/101" in text
    assert r"LaGSplat & 1 & 3.40 & 30.8 & 14.5 & 0.930 & --" in text


def test_recipes_stand_under_their_system_with_the_minutes_they_took():
    recipes = [("default", "default"), ("default", "networks"), ("paper", "paper")]
    runs = [{**names(0, system="pendulum", stage2=two), "stage1": one} for one, two in recipes]
    metrics = [{**run(0.1), "training": {"wall_s": 60.0 * k}} for k in (2, 3, 90)]
    (table,) = lay_out_recipes(
        build_recipes_table(build_rows(runs, metrics)), titles={"pendulum": "Pendulum"}
    )
    ((title, lines),) = table.blocks
    assert title == "Pendulum (simulated)"
    assert [line[0].text for line in lines] == ["default", "networks", "paper, paper"]
    time = [column.title for column in table.columns].index("Time")
    assert [line[time].text for line in lines] == ["2.0", "3.0", "90"]
