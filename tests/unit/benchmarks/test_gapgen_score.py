"""Scores of predictions whose worth is known beforehand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from benchmarks.gapgen.metrics import calibration, overlap, wilson
from benchmarks.gapgen.predictions import recomputed_gaps
from benchmarks.gapgen.score import main, read_answers, runs_to_make

GAP = {"before": 0.2, "after": 0.021, "floor": 0.02, "after_sim_plus_effect": 0.022}
NAMES = ("viscous_damping", "coulomb_friction", "input_delay", "creep", "none", "unknown")


def truth(k: int, names: list[str], **more: Any) -> dict[str, Any]:
    entries = [
        {
            "name": name,
            "kind": "cogging" if name == "unknown" else name,
            "parameters": {"rate": 0.5} if name == "viscous_damping" else {},
            "coordinate": "q1",
            "input": None,
            "class": ["input_delay", "time_offset"] if name == "input_delay" else [name],
            "component": "dissipative",
            "level": "dynamics",
            "time_s": [],
            "frequency_hz": [],
        }
        for name in names
        if name != "none"
    ]
    strata = {"noise": 0.01, "duration_s": 18.0, "bin": "high", "forced": True, "d": 2, "system": "bag"}
    whole = {
        "id": f"{k:03d}",
        "effects": names,
        "truth": entries,
        "identifiable": True,
        "gap": GAP,
        "rms": [1.0, 2.0],
    }
    return whole | strata | {"gap_ratio": 10.0} | more


def say(
    folder: Path, answer: dict[str, Any], first: str, *, verdict: str | None = None, p: float = 0.9
) -> None:
    place = folder / answer["id"]
    place.mkdir(parents=True)
    verdict = verdict or (first if first in ("none", "unknown") else "effect")
    others = [name for name in NAMES if name != first]
    rate = {"value": 0.55, "low": 0.4, "high": 0.6, "unit": "1/s"}
    effects = [
        {
            "name": name,
            "probability": q,
            "coordinate": "q1",
            "input": None,
            "parameters": {"rate": rate} if name == "viscous_damping" else {},
        }
        for name, q in [(first, p), *((name, (1 - p) / len(others)) for name in others)]
    ]
    where = {"level": "dynamics", "coordinates": {"q0": 0.1, "q1": 0.9}, "components": {"dissipative": 1.0}}
    combination = [first] if len(answer["truth"]) < 2 else answer["effects"]
    said = {"verdict": verdict, "effects": effects, "combination": combination, "where": where}
    (place / "diagnosis.json").write_text(json.dumps(said))
    rows = ["file,block,t,q0_real,q1_real,q0_sim,q1_sim,q0_augmented,q1_augmented"]
    for block in range(2):
        for k in range(30):
            off, left = (9.0, 9.0) if k < 10 else (0.2, 0.021)
            rows.append(f"real_0.csv,{block},{k / 60},0,0,{off},{2 * off},{left},{2 * left}")
    (place / "rollouts.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture
def answers(tmp_path: Path) -> list[dict[str, Any]]:
    labels = [*NAMES] * 5
    out = [truth(k, [name]) for k, name in enumerate(labels)]
    out += [truth(100 + k, ["creep", "coulomb_friction"]) for k in range(3)]
    (tmp_path / "answers.jsonl").write_text("".join(json.dumps(a) + "\n" for a in out))
    return out


def scored(tmp_path: Path, *more: str) -> dict[str, Any]:
    call = ["--predictions", str(tmp_path / "said"), "--answers", str(tmp_path / "answers.jsonl")]
    main([*call, "--out", str(tmp_path / "out"), *more])
    found: dict[str, Any] = json.loads((tmp_path / "out" / "scores.json").read_text())
    return found


def test_who_knows_everything_scores_everything(tmp_path: Path, answers: list[dict[str, Any]]) -> None:
    for a in answers:
        say(tmp_path / "said", a, a["effects"][0], p=1.0)
    s = scored(tmp_path, "--left-out", str(tmp_path / "nothing"))
    for name in ("top1_class", "top1_family", "top2_class", "abstention_outside", "top1_class_named"):
        assert s[name]["value"] == 1.0
    for name in ("false_alarms", "false_abstention", "missed", "wrong_names"):
        assert s[name]["value"] == 0.0
    assert s["top1_class_predicted"]["n"] == s["top1_class"]["n"]
    assert s["ece_class"] == pytest.approx(0.0, abs=1e-12)
    assert s["brier_class"] == pytest.approx(0.0, abs=1e-12)
    assert s["set_f1_class"]["mean"] == s["macro_f1"] == 1.0
    assert s["closure_over_oracle"]["median"] == pytest.approx(1.0)
    assert s["where"]["coordinate"]["value"] == s["where"]["component"]["value"] == 1.0
    assert s["parameters"]["relative_error"]["median"] == pytest.approx(0.1)
    assert s["parameters"]["coverage"]["value"] == 1.0
    assert s["permuted_top1_class"] < 0.5
    assert s["abstention_left_out"]["n"] == 0
    for name in (
        "confusion.pdf",
        "calibration.png",
        "risk_coverage.pdf",
        "table.csv",
        "per_item.jsonl",
    ):
        assert (tmp_path / "out" / name).stat().st_size > 0


def test_who_always_says_the_same_is_found_out(tmp_path: Path, answers: list[dict[str, Any]]) -> None:
    for a in answers:
        say(tmp_path / "said", a, "creep")
    s = scored(tmp_path)
    assert s["top1_class"]["value"] == pytest.approx(0.25)
    assert s["false_alarms"]["value"] == 1.0
    assert s["wrong_names"]["value"] == pytest.approx(1.0 - 8 / 33)  # five with creep, and three pairs
    assert s["abstention_outside"]["value"] == 0.0
    assert s["ece_class"] == pytest.approx(0.9 - 1 / 6, abs=1e-9)
    assert s["by_effect"]["creep"]["value"] == 1.0


def test_silence_is_counted(tmp_path: Path, answers: list[dict[str, Any]]) -> None:
    say(tmp_path / "said", answers[0], "viscous_damping", verdict="undetermined")
    s = scored(tmp_path)
    assert s["missing"] == len(answers) - 1
    assert s["false_abstention"]["value"] == 1.0
    assert s["top1_class_named"]["value"] == 0.0
    assert s["top1_class_predicted"]["n"] == 1
    assert s["closure"]["median"] == 0.0


def test_a_name_of_the_same_class_is_right_at_class_level_only(tmp_path: Path) -> None:
    a = truth(0, ["input_delay"])
    (tmp_path / "answers.jsonl").write_text(json.dumps(a) + "\n")
    say(tmp_path / "said", a, "time_offset")
    s = scored(tmp_path)
    assert s["top1_class"]["value"] == 1.0
    assert s["top1_family"]["value"] == 0.0


def test_probabilities_must_be_shares(tmp_path: Path, answers: list[dict[str, Any]]) -> None:
    say(tmp_path / "said", answers[0], "creep")
    path = tmp_path / "said" / answers[0]["id"] / "diagnosis.json"
    path.write_text(path.read_text().replace("0.9", "0.7", 1))
    with pytest.raises(ValueError, match="shares of one"):
        scored(tmp_path)


def test_the_runs_to_make_leave_out_the_class(tmp_path: Path, answers: list[dict[str, Any]]) -> None:
    runs = runs_to_make(read_answers(tmp_path / "answers.jsonl", None))
    assert len(runs) == 20
    assert {"id": "002", "without": ["input_delay", "time_offset"]} in runs


def test_gaps_are_recomputed_past_the_burn_in(tmp_path: Path) -> None:
    a = truth(0, ["creep"])
    say(tmp_path, a, "creep")
    assert recomputed_gaps(tmp_path / "000" / "rollouts.csv", [1.0, 2.0]) == pytest.approx((0.2, 0.021))
    assert recomputed_gaps(tmp_path / "missing.csv", [1.0]) is None


@pytest.mark.parametrize(("hits", "n"), [(0, 60), (2, 120), (17, 20), (5, 5)])
def test_wilson_agrees_with_scipy(hits: int, n: int) -> None:
    value, low, high = wilson(hits, n)
    other = binomtest(hits, n).proportion_ci(method="wilson")
    assert (value, low, high) == pytest.approx((hits / n, other.low, other.high), abs=1e-12)


def test_calibration_of_honest_and_of_boastful_words() -> None:
    rng = np.random.default_rng(0)
    confidence = rng.random(30_000)
    honest = (rng.random(30_000) < confidence).astype(float)
    assert calibration(confidence, honest)[0] < 0.02
    assert calibration(np.full(100, 0.9), np.r_[np.ones(50), np.zeros(50)])[0] == pytest.approx(0.4)


def test_overlap_of_intervals() -> None:
    assert overlap([["real_0.csv", 1.0, 3.0, 0.5]], [[2.0, 4.0]]) == pytest.approx(1 / 3)
    assert overlap([], [[2.0, 4.0]]) == 0.0
