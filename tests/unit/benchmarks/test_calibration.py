"""The calibration of the verdict: what is right in a measured recording, and fits that leave things out."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.calibration.choices import (
    EARLIER_WEIGHT,
    label_rows,
    pack_alternatives,
    read_rows,
    unpack_alternatives,
    write_rows,
)
from benchmarks.calibration.fit import GROUPS, fit_weights, predict_left_out, summarize
from benchmarks.calibration.fit import main as fit
from benchmarks.calibration.measure import measure_split
from benchmarks.gapgen.make import main as make
from benchmarks.gapgen.strata import OUTSIDE_SHARE
from lagsplat.config.compose import compose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.verdict.choice_model import ChoiceModel, load_choice_model
from lagsplat.diagnose.verdict.features import NAMES, compute_features
from tests.unit.diagnose.verdict.made_alternatives import NONE, alternatives, effect

PUBLISHED = Path(__file__).parents[3] / "benchmarks" / "calibration" / "measures.jsonl.xz"


def truth(name: str, *others: str) -> dict[str, Any]:
    return {"name": name, "kind": name, "class": [name, *others]}


def row(made: Any, *true: dict[str, Any], **more: Any) -> dict[str, Any]:
    answer = {"truth": list(true), "identifiable": True, "source": "own", "gap_ratio": 3.0}
    one = {"id": f"{len(made.measures):06x}", "undetermined": more.pop("undetermined", False)}
    return one | {"answer": {**answer, **more}, "full": pack_alternatives(made)}


def right_names(one: dict[str, Any]) -> list[tuple[str, ...]]:
    (labelled,) = label_rows([one])
    return [n for n, right in zip(labelled.names, labelled.choice.right, strict=True) if right]


MADE = alternatives(effect("creep"), effect("input_lag"), effect("creep", "input_lag"), effect("end_stop"))


def test_alternatives_are_the_same_after_packing() -> None:
    there = unpack_alternatives(json.loads(json.dumps(pack_alternatives(MADE))))
    assert there.measures == MADE.measures
    assert np.array_equal(compute_features(there), compute_features(MADE))


def test_what_is_right_depends_on_the_truth() -> None:
    assert right_names(row(MADE)) == [("none",)]
    assert right_names(row(MADE, truth("input_lag"))) == [("input_lag",)]
    assert right_names(row(MADE, truth("input_lag", "end_stop"))) == [("input_lag",), ("end_stop",)]
    assert right_names(row(MADE, truth("creep"), truth("input_lag"))) == [("creep", "input_lag")]
    assert right_names(row(MADE, truth("unknown"))) == [("unknown",)]
    # of a pair that was not found whole, either half is as right as can be
    halves = alternatives(effect("creep"), effect("input_lag"), effect("end_stop"))
    assert right_names(row(halves, truth("creep"), truth("end_stop"))) == [("creep",), ("end_stop",)]
    assert right_names(row(MADE, truth("hysteresis"))) == []


def test_a_recording_without_its_true_effect_is_a_choice_of_its_own() -> None:
    poor = alternatives(effect("end_stop", log_evidence=40.0))
    one = row(MADE, truth("creep")) | {"left_out": pack_alternatives(poor)}
    whole, removed = label_rows([one])
    assert (whole.kind, removed.kind) == ("single", "left_out")
    assert removed.names[int(removed.choice.right.argmax())] == ("unknown",)
    assert removed.choice.weight < whole.choice.weight
    imitated = {"left_out": pack_alternatives(alternatives(effect("end_stop")))}
    assert [each.kind for each in label_rows([one | imitated])] == ["single"]
    assert label_rows([row(MADE, truth("creep"), identifiable=False)]) == []
    assert label_rows([row(MADE, truth("creep"), undetermined=True)]) == []
    assert label_rows([row(MADE, truth("creep"), gap_ratio=1.1)]) == []


def test_what_earlier_code_measured_weighs_less_and_is_not_checked(tmp_path: Path) -> None:
    rows = draw_rows(24)
    later, before = label_rows([rows[1], rows[3] | {"earlier": True}])[::2]
    assert before.choice.weight == pytest.approx(EARLIER_WEIGHT * later.choice.weight)
    files = [tmp_path / "later.jsonl", tmp_path / "before.jsonl"]
    for file, part in zip(files, (rows[:40], rows[30:]), strict=True):
        file.write_text("".join(json.dumps(one) + "\n" for one in part))
    fit([str(files[0]), "--earlier", str(files[1]), "--out", str(tmp_path)])
    stored = read_rows([tmp_path / "measures.jsonl.xz"])
    assert sum(bool(one.get("earlier")) for one in stored) == 8
    told = (tmp_path / "validation.csv").read_text().splitlines()
    assert next(line for line in told if "none: not named" in line).endswith(",20")


def test_stored_rows_are_those_measured_and_always_the_same_bytes(tmp_path: Path) -> None:
    rows, files = [row(MADE, truth("creep"), noise=1.23456789e-3)], [tmp_path / f"{i}.xz" for i in range(2)]
    for file in files:
        write_rows(file, rows)
    (kept,) = read_rows(files[:1])
    assert kept["answer"]["noise"] == 1.2346e-3
    assert unpack_alternatives(kept["full"]).measures == MADE.measures
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_model_in_use_is_the_fit_to_the_published_measures() -> None:
    fitted = fit_weights(label_rows(read_rows([PUBLISHED])))
    np.testing.assert_allclose(load_choice_model().weights, fitted.weights, rtol=1e-3, atol=1e-4)


def draw_poor(rng: np.random.Generator) -> dict[str, float]:
    """An effect that leaves most of the gap."""
    return {"misfit": rng.uniform(3.0, 8.0), "error": rng.uniform(0.05, 0.12), "log_evidence": 40.0}


def draw_rows(n: int) -> list[dict[str, Any]]:
    """Recordings in which the right effect explains all, and what is there else explains little."""
    rng, rows = np.random.default_rng(0), []
    names = ("creep", "input_lag", "end_stop", "hysteresis")
    for i in range(n):
        true = names[i % 4]
        others = [effect(name, **draw_poor(rng)) for name in names if name != true]
        quiet = effect(true, misfit=1.0, error=0.0201, log_evidence=-2.0)
        still = alternatives(quiet, none=effect("none", misfit=1.0, error=0.02, log_evidence=0.0))
        there, source = alternatives(effect(true), *others), ("own", "mujoco", "textbook")[i % 3]
        kinds = [
            row(still, source=source),
            row(there, truth(true), source=source) | {"left_out": pack_alternatives(alternatives(*others))},
        ]
        rows += [{**one, "id": f"{17 * i + k:06x}"} for k, one in enumerate(kinds)]
    return rows


def test_what_was_left_out_is_predicted_by_the_rest() -> None:
    labelled = label_rows(draw_rows(40))
    for group in GROUPS.values():
        found = {name: value for name, value, *_ in summarize(labelled, predict_left_out(labelled, group))}
        assert found["single: right first"] > 0.9
        assert found["none: not named"] > 0.9
        assert found["left_out: not named"] > 0.9
        assert found["calibration error"] < 0.15


def test_a_model_is_written_with_a_weight_for_every_feature(tmp_path: Path) -> None:
    files = []
    for part in range(2):
        files.append(tmp_path / f"{part}.jsonl")
        files[-1].write_text("".join(json.dumps(one) + "\n" for one in draw_rows(24)[part::2]))
    fit([*map(str, files), "--out", str(tmp_path / "out")])
    weights = json.loads((tmp_path / "out" / "model.json").read_text())["weights"]
    assert set(weights) == set(NAMES)
    model = ChoiceModel(NAMES, np.array([weights[name] for name in NAMES]))
    chances = np.exp(model.log_probabilities(compute_features(alternatives(effect("creep"), none=NONE))))
    assert chances.argmax() == 1
    told = (tmp_path / "out" / "validation.csv").read_text()
    assert told.count("left_out: not named") == 3


def test_a_gap_within_tolerances_is_judged_beside_an_exact_sim() -> None:
    still = alternatives(effect("creep", log_evidence=-2.0), none=effect("none", misfit=1.0, error=0.02))
    one = row(still, truth("creep")) | {"exact": pack_alternatives(MADE)}
    whole, exact = label_rows([one])
    assert [n for n, right in zip(whole.names, whole.choice.right, strict=True) if right] == [
        ("none",),
        ("creep",),
    ]
    assert not exact.choice.right[0]
    told = {name: value for name, value, *_ in summarize([whole, exact], [np.eye(3)[0], np.eye(6)[1]])}
    assert told["single: right first"] == 1.0
    told = {name: value for name, value, *_ in summarize([whole, exact], [np.eye(3)[0], np.eye(6)[5]])}
    assert (told["single: right first"], told["single: left unnamed"]) == (0.0, 1.0)


def test_effects_outside_the_catalogue_weigh_alike() -> None:
    def outside(kind: str) -> dict[str, Any]:
        return {"name": "unknown", "kind": kind, "class": ["unknown"]}

    rows = [row(MADE, outside("bump")), *[row(MADE, outside("belt"))] * 3, *[row(MADE)] * 22]
    weights = {each.families: each.choice.weight for each in label_rows(rows) if each.kind == "outside"}
    assert weights[frozenset({"bump"})] == pytest.approx(3 * weights[frozenset({"belt"})])
    assert 2 * weights[frozenset({"bump"})] == pytest.approx(OUTSIDE_SHARE / (1 - OUTSIDE_SHARE) * 22)


@pytest.mark.slow
def test_recordings_are_measured_once_and_a_file_is_continued(tmp_path: Path) -> None:
    split, out = tmp_path / "split", tmp_path / "measures.jsonl"
    make(["--split", "t", "--key", "c", "--n", "1", "--out", str(split), "--systems", "d1", "--jobs", "1"])
    kept = ("cubic_stiffness", "coulomb_friction", "viscous_damping")
    without = [name for name in catalogue() if name not in kept]
    quick = replace(compose("profile=toy").diagnose, without=without, always_fitted=[], families=1)
    quick = replace(quick, iterations=3, identify_iterations=4)
    measure_split(split, out, quick)
    (one,) = read_rows([out])
    assert one["full"]["measures"][0]["names"] == []
    assert one["answer"]["effects"] == ["cubic_stiffness"]
    assert not {"cubic_stiffness", "none"} & {
        name for each in one["left_out"]["measures"] for name in each["names"]
    }
    before = out.read_text()
    measure_split(split, out, quick)
    assert out.read_text() == before
