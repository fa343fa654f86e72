"""What a split holds, that the key alone gives it, and that nothing but the motion can be read off it."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.gapgen import laws
from benchmarks.gapgen.answers import equivalent, left_out
from benchmarks.gapgen.drawing import Stratum, draw
from benchmarks.gapgen.effect import CAMERA, FAMILIES, NEEDS_INPUT, OUTSIDE, Effect, Setting
from benchmarks.gapgen.effects import maker
from benchmarks.gapgen.make import STAMP, main
from benchmarks.gapgen.mechanisms import CART, Mechanism
from benchmarks.gapgen.motion import Plan, World, reseen, seen, unseen
from benchmarks.gapgen.strata import identities, seed_of, strata


def stratum(*label: str, forced: bool = True, bin: str = "middle") -> Stratum:
    return Stratum(label, "linear_cart", forced, 0.01, 18.0, bin)


def test_shares_are_kept_and_inputs_are_there_where_needed() -> None:
    split = strata(b"k" * 16, "dev", 200, "d1")
    labels = [s.label for s in split]
    assert labels.count(("none",)) == 30
    assert sum(label[0] in OUTSIDE for label in labels) == 24
    assert sum(len(label) == 2 for label in labels) == 20
    assert {label[0] for label in labels if len(label) == 1} >= {*FAMILIES, "time_offset", "none"}
    assert all(s.forced for s in split if set(s.label) & set(NEEDS_INPUT))
    with pytest.raises(ValueError, match="none such"):
        strata(b"k", "dev", 10, "d9")


def test_older_groups_keep_what_they_hold() -> None:
    """Later effects, and others outside the catalogue, are drawn in the wide groups alone."""
    known = {"d1": "664ad5fa", "multi": "c6d1677e", "d2": "c17475b6", "to2": "041a48c0", "all": "cc784a15"}
    for group, digest in known.items():
        held = repr(strata(b"public", "dev", 80, group))
        assert hashlib.sha256(held.encode()).hexdigest().startswith(digest), group


def test_the_key_decides_everything() -> None:
    one, same, other = (strata(key, "dev", 60, "d1") for key in (b"first", b"first", b"second"))
    assert one == same
    assert one != other
    names = identities(b"first", "dev", 60)
    assert len(set(names)) == 60
    assert seed_of(b"first", names[0]) != seed_of(b"second", names[0])
    # a longer split gives the names of a shorter one no other meaning by accident of order
    assert set(identities(b"first", "dev", 30)) < set(names)


def test_an_effect_has_the_gap_it_was_drawn_for() -> None:
    recording = draw(stratum("coulomb_friction"), np.random.default_rng(3))
    gap = recording.truth["gap"]
    assert 2.4 < gap["before"] / gap["floor"] < 12.0
    assert gap["after"] < 1.3 * gap["floor"]
    assert gap["after_sim_plus_effect"] < 0.5 * gap["before"]
    real = recording.files["real_0.csv"]
    assert set(real) == {"t", "q0", "u0"}
    assert len(real["t"]) == len(real["q0"])
    assert any(name.startswith("sim_") for name in recording.files)


def test_without_an_effect_there_is_no_gap_to_speak_of() -> None:
    recording = draw(stratum("none", forced=False), np.random.default_rng(4))
    gap = recording.truth["gap"]
    assert gap["before"] < 1.4 * gap["floor"]
    assert recording.truth["found"] == []
    assert "u0" not in recording.files["real_0.csv"]
    assert np.all(np.diff(recording.files["real_0.csv"]["t"]) > 0)


def test_what_is_outside_the_catalogue_can_be_made_alone(tmp_path: Path) -> None:
    words = ["--split", "t", "--key", "public", "--n", "16", "--out", str(tmp_path), "--systems", "d1"]
    main([*words, "--only-outside"])
    answers = [json.loads(line) for line in (tmp_path / "answers.jsonl").read_text().splitlines()]
    assert len(answers) == 2
    assert {a["id"] for a in answers} <= set(identities(b"public", "t", 16))
    assert all(a["effects"] == ["unknown"] for a in answers)


def test_files_give_nothing_away(tmp_path: Path) -> None:
    main(["--split", "t", "--key", "public", "--n", "3", "--out", str(tmp_path), "--systems", "d1"])
    answers = [json.loads(line) for line in (tmp_path / "answers.jsonl").read_text().splitlines()]
    assert [a["id"] for a in answers] == sorted(path.name for path in (tmp_path / "data").iterdir())
    for path in (tmp_path / "data").rglob("*.csv"):
        assert path.stat().st_mtime == STAMP
        head = path.read_text().splitlines()[0].split(",")
        assert all(name == "t" or name == "segment" or name[0] in "quv" for name in head)
        assert np.isfinite(np.loadtxt(path, delimiter=",", skiprows=1)).all()


@pytest.mark.parametrize("name", [*FAMILIES, *CAMERA, *OUTSIDE, "external_push"])
def test_effects_vanish_with_their_magnitude(name: str) -> None:
    one = np.ones(1)
    setting = Setting(
        one, 0.1 * one, 0.6 * one, 0.3 * one, 2.0 * one, one, 3 * one, 0.02 * one, 20.0, 0.02, True, "t"
    )
    make = maker(name, setting, 0, 0, np.random.default_rng(5))
    cart = Mechanism("t", CART, 1, np.array([1.0, 0.2, 39.0, 0.0]), one[None], 0.3 * one)
    u = 2.0 * np.sin(np.arange(500) * 0.09)[:, None]
    plan = Plan(0.02, [0.0], [np.array([0.1, 0.0])], [0], [u])
    still = World(cart).move(plan)[0].x[:, 0]

    def off(magnitude: float) -> float:
        effects = [make(magnitude)]
        ys = seen(World(cart, effects).move(plan), effects, 1, 0.02)
        return float(np.abs(ys[0][:, 0] - still).max() / np.abs(still).max())

    assert off(0.001) < 0.03
    assert off(0.5) > max(0.01, 2 * off(0.001))


def test_a_changed_camera_can_be_seen_through() -> None:
    numbers = {"zoom": 1.3, "shift": [0.1, -0.2], "bend": [0.2, -0.1]}
    effects = [
        Effect("camera_change", camera=("view", numbers)),
        Effect("d", camera=("drift", {"rate": [0.1, 0.0]})),
    ]
    q = np.random.default_rng(0).normal(size=(7, 2)) * 0.3
    t = np.arange(7.0)
    assert np.allclose(unseen(reseen(q, t, effects), t, effects), q)


def test_classes_hold_their_own_name_and_merge_only_what_physics_merges() -> None:
    truth = {"natural_hz": [1.0], "rms": [0.1], "span_s": 18.0}
    late = Effect("input_delay", parameters={"delay": 0.2})
    early = Effect("time_offset", parameters={"offset": 0.2})
    assert equivalent(late, stratum("input_delay"), truth) == ["input_delay", "time_offset"]
    assert equivalent(early, stratum("time_offset"), truth) == ["time_offset"]
    mass = Effect("mass_change", parameters={"ratio": 1.3})
    assert equivalent(mass, stratum("mass_change", forced=False), truth) == [
        "linear_stiffness",
        "mass_change",
    ]
    odd = Effect("cogging", [(laws.COGGING, 0, 0, [1.0])])
    assert equivalent(odd, stratum("cogging"), truth) == ["unknown"]
    gain = equivalent(Effect("input_gain"), stratum("input_gain"), truth)
    assert gain == ["camera_change", "input_gain", "mass_change"]


def test_what_holds_an_effect_as_a_limit_is_left_out_with_it() -> None:
    assert left_out(["coulomb_friction"]) == [
        "asymmetric_friction",
        "coulomb_friction",
        "hysteresis",
        "load_dependent_friction",
        "stribeck_friction",
    ]
    assert left_out(["linear_stiffness", "mass_change"]) == [
        "armature",
        "creep",
        "hidden_mode",
        "linear_stiffness",
        "mass_change",
        "payload",
    ]
    assert left_out(["input_gain"]) == ["camera_change", "encoder_scale", "input_gain"]
    assert left_out(["end_stop"]) == ["end_stop"]
