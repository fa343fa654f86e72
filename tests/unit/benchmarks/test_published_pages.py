"""Tables of the pages that are made from several published files."""

import json
from pathlib import Path

import pandas as pd
import pytest

from benchmarks import published_aims, published_sealed, published_summary, published_tables
from lagsplat.evaluate.truth import AT_REST, LINEARISED, ROLLOUT, ComparedQuantity


def test_counts_of_sealed_splits_are_added() -> None:
    splits = [split for group in published_sealed.GROUPS.values() for split in group]
    scores = [published_sealed.read_scores(split) for split in splits]
    single = [published_sealed.add_counts([each], "top1_class") for each in scores]
    hits, trials = published_sealed.add_counts(scores, "top1_class")
    assert (hits, trials) == tuple(sum(part) for part in zip(*single, strict=True))
    *groups, every, _ = published_sealed.list_rows()
    assert int(every[1]) == sum(int(row[1]) for row in groups)
    assert every[2].endswith(f"of {trials}")
    assert every[2].startswith(f"{hits / trials:.2f} [")
    assert published_sealed.write_share(0, 0) == "–"


def test_the_worst_median_is_compared_with_its_aim(tmp_path: Path, monkeypatch, capsys) -> None:
    rows = [
        {"system": system, **of._asdict(), "error": float(error), "recording": "simulated"}
        for error, system in enumerate(published_aims.ONE + published_aims.TWO + published_aims.DRIVEN)
        for of in (
            ComparedQuantity("frequency", "Hz", LINEARISED, AT_REST, mode=1),
            ComparedQuantity("frequency", "Hz", LINEARISED, AT_REST, mode=2),
            ComparedQuantity("frequency", "Hz", LINEARISED, "at mean pressure", mode=1),
            ComparedQuantity("decay rate", "1/s", LINEARISED, AT_REST, mode=1),
            ComparedQuantity("frequency", "Hz", ROLLOUT, mode=1),
            ComparedQuantity("decay rate", "1/s", ROLLOUT, mode=1),
            ComparedQuantity("equilibrium", "rad", "law", AT_REST, coordinate="angle"),
        )
    ]
    table = pd.DataFrame(rows)
    table.loc[(table["mode"] == 2) | (table["state"] == "at mean pressure"), "error"] = 99.0
    table["error"] /= 1000.0
    table["error_high"] = 2.0 * table["error"]
    (tmp_path / "quick_simulated_seven").mkdir()
    table.to_csv(tmp_path / "quick_simulated_seven/truth.csv", index=False)
    monkeypatch.setattr(published_tables, "PUBLISHED", tmp_path)
    errors = published_aims.read_physics()
    worst = {aim: published_aims.find_worst(aim, errors) for aim in published_aims.list_physics_aims()}
    seeds = published_aims.find_worst(next(iter(worst)), errors, "worst_seed")
    assert seeds == (0.008, "double_pendulum")
    free, equilibria = next(iter(worst)), list(worst)[-1]
    assert worst[free] == (0.004, "double_pendulum")
    assert worst[equilibria] == (0.006, "krauss_2seg")
    published_aims.show_aims("physics")
    assert "| frequency, linearised law | free systems | 0.5 % | 0.4 % (" in capsys.readouterr().out


def test_answers_to_forces_have_aims_in_their_units(tmp_path: Path, monkeypatch, capsys) -> None:
    shared = {
        "recording": "simulated",
        "direction_deg": 6.0,
        "shape": 0.2,
        "amplitude": 0.1,
        "span": 3.0,
        "error": 9.0,
    }
    rows = [
        {"system": system, "what": what, **shared, "scale_low": 0.5, "scale_high": 1.2}
        for system in (*published_aims.PUSHED, *published_aims.ARM, *published_aims.SPACE)
        for what in ("visited", "first motion, learned mass", "span of energies, mass")
    ]
    (tmp_path / "quick_forces").mkdir()
    pd.DataFrame(rows).to_csv(tmp_path / "quick_forces/force_truth.csv", index=False)
    monkeypatch.setattr(published_tables, "PUBLISHED", tmp_path)
    published_aims.show_aims("forces")
    lines = capsys.readouterr().out.splitlines()[3:-1]
    assert lines[0].startswith("| direction of the pushed point | free systems | 5° | 6° (")
    met = ["**no**" not in line for line in lines]
    assert met == [False, False, True, True, True, True, True, False, True, False, True, True]
    assert "| 1.33 times | 2 times (" in lines[9]


def test_a_plain_table_leaves_what_is_missing_empty(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "some.csv").write_text("what,ms,mark\nstep,1.23456,\nother,,at most 4\n")
    monkeypatch.setattr(published_tables, "PUBLISHED", tmp_path)
    published_tables.show_plain("some")
    assert capsys.readouterr().out.splitlines()[3:5] == ["| step | 1.23 |  |", "| other |  | at most 4 |"]


def test_the_manifest_is_a_table_of_folders(tmp_path: Path, monkeypatch, capsys) -> None:
    made = {"commit": "abc", "minutes": 2.6, "machine": "2 cores", "seeds": {"runs": [0, 1]}}
    (tmp_path / "manifest.json").write_text(json.dumps({"speed": made}))
    monkeypatch.setattr(published_summary, "PUBLISHED", tmp_path)
    published_summary.show_manifest()
    row = capsys.readouterr().out.splitlines()[3]
    assert row.startswith("| `speed` | the parts of the pipeline")
    assert row.endswith("| 0, 1 | `abc` | 3 |")


@pytest.mark.parametrize("name", ["show", "show_plain"])
def test_a_table_that_is_not_there_is_an_error(name: str) -> None:
    with pytest.raises(FileNotFoundError):
        getattr(published_tables, name)("quick_moon/physical")
