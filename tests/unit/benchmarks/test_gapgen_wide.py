"""Widely drawn conditions: shares, sensors, missing rows, and what the answers tell of them."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.gapgen.controllers import under_control
from benchmarks.gapgen.drawing import draw
from benchmarks.gapgen.effect import DISCREPANCIES, MACHINE, NEEDS_INPUT, OUTSIDE, OUTSIDE_WIDE, Setting
from benchmarks.gapgen.effects import maker
from benchmarks.gapgen.files import MOST_SAMPLES, Stratum
from benchmarks.gapgen.make import main
from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.motion import Plan, seen
from benchmarks.gapgen.sensors import (
    COLOURED,
    QUANTISED,
    Conditions,
    Sensor,
    kept_rows,
    measured,
    quantisation_step,
)
from benchmarks.gapgen.sources import HELD_BACK, base_reach, draw_any, payload_kg, source_of, world_of
from benchmarks.gapgen.strata import fits, strata


def wide(sensor: Sensor, *label: str, rate: float = 90.0, sine: bool = False) -> Stratum:
    ratios = () if label == ("none",) else (6.0,)
    conditions = Conditions(rate, sensor, ratios, 1.2, sine)
    return Stratum(label, "linear_cart", True, 0.01, 6.0, "middle", conditions)


def test_small_splits_together_hold_every_effect_outside_the_catalogue() -> None:
    splits = [strata(b"k" * 16, f"batch {i}", 10, "calibration") for i in range(120)]
    found = Counter(label for split in splits for s in split for label in s.label if label in OUTSIDE_WIDE)
    assert found.keys() == set(OUTSIDE_WIDE)
    assert max(found.values()) < 4 * min(found.values())


def test_shares_and_bounds_are_kept() -> None:
    split = strata(b"k" * 16, "cal", 300, "calibration")
    assert split == strata(b"k" * 16, "cal", 300, "calibration")
    assert split != strata(b"other", "cal", 300, "calibration")
    assert Counter(source_of(s.system) for s in split) == {"own": 100, "mujoco": 100, "textbook": 100}
    labels = [s.label for s in split]
    assert labels.count(("none",)) == 60
    assert sum(label[0] in OUTSIDE_WIDE for label in labels) == 36
    assert {label[0] for label in labels} >= {*MACHINE, *OUTSIDE_WIDE}
    assert len(set(OUTSIDE_WIDE)) >= 8
    assert all(fits(s.system, s.label) for s in split)
    assert all(s.controlled for s in split if "controller_gain" in s.label)
    # that a recording is of a controlled mechanism does not tell the effect
    assert sum(s.controlled for s in split) > 2 * sum("controller_gain" in s.label for s in split)
    assert sum(len(label) == 2 for label in labels) == 36
    told = [s.conditions for s in split if s.conditions is not None]
    assert len(told) == 300
    assert Counter(c.sensor.kind for c in told) == {"white": 150, "coloured": 75, "quantised": 75}
    assert sum(c.sensor.lost > 0.0 for c in told) == 60
    nothing = [s.conditions for s in split if s.conditions is not None and s.label == ("none",)]
    off = [(c.tolerance > 1.0, c.discrepancy > 1.0) for c in nothing]
    assert min(off.count((True, False)), off.count((False, True)), off.count((False, False))) > 5
    assert (True, True) not in off
    assert all(max(c.tolerance, c.discrepancy) <= 1.3 for c in nothing)
    assert all(c.rate_hz * s.duration_s <= MOST_SAMPLES + 1 for s, c in zip(split, told, strict=True))
    ratios = [r for c in told for r in c.ratios]
    assert min(ratios) < 1.6 < 30.0 < max(ratios)
    assert all(
        1.2 <= r <= max(40.0, 0.4 / s.noise) for s in split if s.conditions for r in s.conditions.ratios
    )
    for s in split:
        if s.conditions is not None and s.conditions.ratios:
            # nature's own laws are a small part of the gap, and none where the effect is such a law
            assert s.conditions.discrepancy - 1.0 < 0.2 * max(s.conditions.ratios)
            assert s.conditions.discrepancy == 1.0 or s.label[0] not in OUTSIDE_WIDE
    assert 100 < sum(c.discrepancy > 1.0 for c in told if c.ratios) < 160
    assert all(s.forced for s in split if set(s.label) & set(NEEDS_INPUT))


def test_what_is_held_back_is_in_no_calibration() -> None:
    split = strata(b"k" * 16, "sealed", 100, "held_back")
    assert {s.system for s in split} == set(HELD_BACK)
    assert all(fits(s.system, s.label) for s in split)
    assert all(s.conditions is not None for s in split)
    assert not {s.system for s in split} & {s.system for s in strata(b"k" * 16, "cal", 300, "calibration")}
    assert {label for s in split for label in s.label} >= set(MACHINE)


def setting_on(m: Mechanism) -> Setting:
    """Scales of a motion as large as the mechanism."""
    inertia = np.diag(m.inertia_at_rest())
    w = np.sqrt(np.diag(m.stiffness_at_rest()) / inertia)
    u = np.abs(np.linalg.solve(m.b, np.diag(m.stiffness_at_rest()) * 0.1 * m.size))
    x, v = 0.5 * m.size, 0.5 * m.size * w
    scales = (w / (2.0 * np.pi), x, v, m.size, 2.0 * v, u, 2.0 * u, np.full(m.d, 0.02))
    more = {"wide": True, "inertia": inertia, "gain": m.b / inertia[:, None], "payload_kg": payload_kg(m)}
    return Setting(*scales, 20.0, 0.02, True, m.system, base_reach=base_reach(m), **more)


@pytest.mark.parametrize("system", ["two_link", "mujoco_two_link"])
@pytest.mark.parametrize("name", [*MACHINE, *sorted(set(OUTSIDE_WIDE) - set(OUTSIDE))])
def test_later_effects_vanish_with_their_magnitude(name: str, system: str) -> None:
    m = draw_any(system, np.random.default_rng(2))
    m = under_control(m, np.random.default_rng(3)) if name == "controller_gain" else m
    s = setting_on(m)
    make = maker(name, s, 0, 0, np.random.default_rng(5))
    drive = np.sin(0.13 * np.arange(300)[:, None] + np.arange(2)) * s.u_top
    plan = Plan(0.02, [0.0], [np.concatenate([0.5 * m.size, [0.0, 0.0]])], [0], [drive])
    still = seen(world_of(m).move(plan), [], m.d, 0.02)[0]

    def off(magnitude: float) -> float:
        effects = [make(magnitude)]
        return float(
            np.abs((seen(world_of(m, effects).move(plan), effects, m.d, 0.02)[0] - still) / m.size).max()
        )

    assert off(0.0005) < 0.05
    assert off(0.2) > max(0.01, 2.0 * off(0.0005))


def test_other_groups_have_no_conditions() -> None:
    assert all(s.conditions is None and source_of(s.system) == "own" for s in strata(b"k", "dev", 60, "all"))


def test_quantised_samples_lie_on_multiples_of_the_step() -> None:
    recording = draw(wide(Sensor(QUANTISED), "coulomb_friction"), np.random.default_rng(3))
    gap = recording.truth["gap"]
    assert 4.0 < gap["before"] / gap["floor"] < 9.0
    step = quantisation_step(0.01 * np.array(recording.truth["rms"]))[0]
    # an encoder counts alike in every recording
    for columns in recording.files.values():
        counts = columns["q0"] / step
        assert np.abs(counts - np.rint(counts)).max() < 1e-6
    assert recording.truth["rate_hz"] == pytest.approx(90.0)


def test_nature_differs_by_more_than_the_effect() -> None:
    s = wide(Sensor(), "coulomb_friction")
    assert s.conditions is not None
    s = replace(s, noise=0.001, conditions=replace(s.conditions, tolerance=1.0, discrepancy=3.0))
    truth = draw(s, np.random.default_rng(8)).truth
    assert [effect.name for effect in truth["found"]] == ["coulomb_friction"]
    (further,) = truth["further"]
    assert further["kind"] in DISCREPANCIES
    gap = truth["gap"]
    # the effect in the sim leaves what further differs
    assert gap["after"] / gap["floor"] < 1.5
    assert 2.0 < gap["after_sim_plus_effect"] / gap["floor"] < 4.5


@pytest.mark.parametrize("seed", [1, 2])
def test_a_push_lies_where_it_is_felt(seed: int) -> None:
    s = replace(wide(Sensor(), "external_push"), forced=False, duration_s=12.0)
    gap = draw(s, np.random.default_rng(seed)).truth["gap"]
    assert 4.0 < gap["before"] / gap["floor"] < 9.0


def test_lost_rows_are_missing_in_the_files() -> None:
    whole = wide(Sensor(), "none", sine=True)
    lossy = wide(Sensor(lost=0.05, longest=8), "none", sine=True)
    a, b = (draw(s, np.random.default_rng(4)).files["real_0.csv"] for s in (whole, lossy))
    assert len(b["t"]) == len(a["t"]) - round(0.05 * len(a["t"]))
    assert set(b["t"]) < set(a["t"])
    assert b["t"][0] == a["t"][0]
    assert b["t"][-1] == a["t"][-1]
    # the inputs are of one frequency: their spectrum has one peak
    power = np.abs(np.fft.rfft(a["u0"] * np.hanning(len(a["u0"])))) ** 2
    assert np.sort(power)[-5:].sum() > 0.95 * power.sum()


def test_rows_are_lost_singly_or_in_bursts() -> None:
    rng = np.random.default_rng(0)
    for longest in (1, 20):
        keep = kept_rows(4000, Sensor(lost=0.04, longest=longest), rng)
        assert 4000 - keep.sum() == 160
        runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[1], keep.astype(int), [1]]))))[::2]
        assert (runs.max() > 5) == (longest > 1)
    assert kept_rows(50, Sensor(), rng).all()


def test_coloured_noise_has_its_deviation_and_memory() -> None:
    sensor = Sensor(COLOURED, correlation=5.0)
    (y,) = measured([np.zeros((40_000, 2))], np.array([0.1, 1.0]), sensor, np.random.default_rng(1))
    assert np.allclose(y.std(0), [0.1, 1.0], rtol=0.05)
    assert np.mean(y[5:, 1] * y[:-5, 1]) == pytest.approx(np.exp(-1.0), abs=0.06)


def test_the_lowest_rate_resolves_the_fastest_mode() -> None:
    slow = replace(wide(Sensor(), "none", rate=1.0), duration_s=8.0)
    recording = draw(slow, np.random.default_rng(5))
    assert recording.truth["rate_hz"] == pytest.approx(12.0 * recording.truth["natural_hz"][-1])


def test_the_answers_tell_source_and_conditions(tmp_path: Path) -> None:
    said = ["--split", "t", "--key", "public", "--n", "3", "--systems", "calibration"]
    for folder in ("one", "two"):
        main([*said, "--out", str(tmp_path / folder)])
    one, two = ((tmp_path / x / "answers.jsonl").read_text() for x in ("one", "two"))
    assert one == two
    answers = [json.loads(line) for line in one.splitlines()]
    assert {a["source"] for a in answers} == {"own", "mujoco", "textbook"}
    for a in answers:
        conditions = {"rate_hz", "sensor", "ratios", "tolerance", "sine", "controlled", "discrepancy"}
        assert conditions == set(a["conditions"])
        for path in (tmp_path / "one" / "data" / a["id"]).iterdir():
            assert path.read_bytes() == (tmp_path / "two" / "data" / a["id"] / path.name).read_bytes()
    with pytest.raises(SystemExit):
        main([*said, "--tier", "T1", "--out", str(tmp_path / "films")])
