"""Keys, gathered predictions and the table of all tiers."""

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.gapgen import gather, keys, runs, tiers


def test_a_key_is_drawn_once_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    place, other = tmp_path / "a" / "one.key", tmp_path / "two.key"
    assert keys.draw_key(place)
    drawn = keys.read_key(f"@{place}")
    assert not keys.draw_key(place)
    assert keys.read_key(f"@{place}") == drawn
    assert place.stat().st_mode & 0o077 == 0
    keys.draw_key(other)
    assert keys.read_key(f"@{other}") != drawn
    assert len(drawn) >= 32


def batch(place: Path, seal: Path, names: list[str], *, dirty: bool = False) -> Path:
    for name in names:
        (place / name).mkdir(parents=True)
        (place / name / "diagnosis.json").write_text(name)
    made = {"seal": hashlib.sha256(seal.read_bytes()).hexdigest(), "tree": "abc", "dirty": dirty}
    (place / "made_by.json").write_text(json.dumps(made))
    return place


@pytest.fixture
def seal(tmp_path: Path) -> Path:
    path = tmp_path / "SEAL.json"
    path.write_text('{"split": "blind"}')
    return path


def test_batches_are_laid_side_by_side(tmp_path: Path, seal: Path) -> None:
    parts = [batch(tmp_path / str(k), seal, [f"r{k}", f"s{k}"], dirty=k > 0) for k in range(2)]
    out = tmp_path / "all"
    assert gather.gather(seal, out, parts) == ["abc", "abc-dirty"]
    assert sorted(path.name for path in out.iterdir()) == ["r0", "r1", "s0", "s1"]
    assert (out / "s1" / "diagnosis.json").read_text() == "s1"
    gather.gather(seal, out, parts[:1])
    assert sorted(path.name for path in out.iterdir()) == ["r0", "s0"]


def test_predictions_of_another_seal_are_refused(tmp_path: Path, seal: Path) -> None:
    part = batch(tmp_path / "0", seal, ["r"])
    seal.write_text('{"split": "blind", "answers_sha256": "other"}')
    with pytest.raises(ValueError, match="another seal"):
        gather.gather(seal, tmp_path / "all", [part])


def test_a_recording_is_predicted_once(tmp_path: Path, seal: Path) -> None:
    parts = [batch(tmp_path / str(k), seal, ["r"]) for k in range(2)]
    with pytest.raises(ValueError, match="r is in another batch"):
        gather.gather(seal, tmp_path / "all", parts)


def share(value: float) -> dict[str, Any]:
    return {"value": value, "low": value - 0.1, "high": value + 0.1, "n": 9}


def scores(top1: float, **more: Any) -> dict[str, Any]:
    middle = {"median": 0.5, "p10": 0.1, "n": 4}
    where = dict.fromkeys(("level", "component", "coordinate"), share(0.5))
    return {
        "recordings": 9,
        "top1_class": share(top1),
        "closure_over_oracle": middle,
        "set_f1_class": {"mean": 0.5, "n": 2},
        "wrong_names": share(0.5 - 0.4 * top1),
        "ece_class": 0.05,
        "calibrated": 8,
        "where": where,
        "parameters": {"relative_error": middle, "coverage": share(0.9)},
    } | more


def test_all_tiers_stand_in_one_table(tmp_path: Path) -> None:
    for tier, others in (("T0", {"chance": scores(0.25)}), ("T1", {})):
        (tmp_path / tier).mkdir()
        whole = scores(0.875, others=others, submissions=2, split="blind", tree="abc")
        (tmp_path / tier / "scores.json").write_text(json.dumps(whole))
    tiers.main(["--out", str(tmp_path / "table.csv"), f"T0={tmp_path / 'T0'}", f"T1={tmp_path / 'T1'}"])
    with (tmp_path / "table.csv").open() as stream:
        rows = {(row["tier"], row["metric"]): row for row in csv.DictReader(stream)}
    assert rows["T0", "top-1, class"]["chance"].startswith("0.25 [0.15")
    assert rows["T1", "top-1, class"]["chance"] == ""
    assert rows["T1", "top-1, class"]["diagnosis"].startswith("0.88")
    relative = rows["T0", "wrong names over those of the best baseline"]
    assert float(relative["diagnosis"]) == pytest.approx(0.15 / 0.4, abs=0.01)
    assert float(relative["chance"]) == 1.0
    assert rows["T1", "wrong names over those of the best baseline"]["diagnosis"] == ""
    assert rows["T0", "calibration error"]["chance"] == "0.050 n=8"
    told = {tier: row["recordings"] for (tier, _), row in rows.items()}
    assert told["T1"] == "T1, films: 9 simulated recordings, split blind, opened 2 times"


def test_no_more_runs_are_made_than_asked_for(tmp_path: Path) -> None:
    answers = [
        {"id": f"{k}", "truth": [{"class": ["creep"]}], "identifiable": True, "effects": ["creep"]}
        for k in (3, 1, 2)
    ]
    (tmp_path / "answers.jsonl").write_text("".join(json.dumps(a) + "\n" for a in answers))
    call = ["--answers", str(tmp_path / "answers.jsonl"), "--out", str(tmp_path / "runs.jsonl")]
    runs.main([*call, "--most", "2"])
    lines = [json.loads(line) for line in (tmp_path / "runs.jsonl").read_text().splitlines()]
    assert lines == [{"id": "1", "without": ["creep"]}, {"id": "2", "without": ["creep"]}]
