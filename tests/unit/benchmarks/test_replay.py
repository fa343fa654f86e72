"""The true mechanism of a recording, played again, and the tables of what is measured with it."""

import numpy as np
import pytest

from benchmarks import next_experiment, repeats
from benchmarks.gapgen.replay import TrueMechanism
from lagsplat.diagnose.core.result import Suggestion

NOISE = 0.02


@pytest.fixture(scope="module")
def world() -> TrueMechanism:
    return next_experiment.draw_case("input_lag", 0)[0]


def test_a_repeat_has_the_inputs_of_the_first_recording_and_noise_of_its_own(world: TrueMechanism) -> None:
    first = world.recording.files["real_0.csv"]
    again, other = (world.repeat(np.random.default_rng(seed), off=0.0) for seed in (0, 1))
    assert np.allclose(again["u0"], first["u0"])
    rms = first["q0"].std()
    late = slice(len(first["t"]) // 2, None)  # what the start was off by has decayed
    assert np.std(again["q0"][late] - first["q0"][late]) < 0.2 * rms
    difference = np.std(again["q0"] - other["q0"]) / np.sqrt(2.0)
    assert difference == pytest.approx(world.noise * world.recording.truth["rms"][0], rel=0.15)


def test_a_start_that_is_off_shows(world: TrueMechanism) -> None:
    near, far = (world.repeat(np.random.default_rng(0), off=off)["q0"] for off in (0.0, 0.5))
    assert abs(far[0] - near[0]) > 0.05 * near.std()


def test_both_second_recordings_are_equally_long_and_within_the_recorded_input(world: TrueMechanism) -> None:
    t = np.arange(300) / 60.0
    most = float(np.abs(world.recording.files["real_0.csv"]["u0"]).max())
    table = {"t": t, "u0": 0.5 * most * np.sin(6.0 * t)}
    planned = Suggestion("chirp", "", 5.0, 6.0, 5.0, 7.0, 1, "q0", 1.0, (0.0, 1.0), {"q0": 0.0}, table)
    rng = np.random.default_rng(0)
    suggested, random = (next_experiment.play_arm(arm, world, planned, rng) for arm in next_experiment.ARMS)
    assert np.allclose(suggested["u0"], table["u0"])
    assert len(random["t"]) == len(t)
    assert np.abs(random["u0"]).max() == pytest.approx(most)


def test_the_table_counts_undecided_cases_with_a_suggestion() -> None:
    def case(separated: bool, **more: object) -> dict[str, object]:
        said = {"decided": separated, "separated": separated, "pair_lead": 8.0, "first": "input_lag"}
        row = {"effect": "input_lag", "before": {"decided": False}, "between": ["input_lag", "input_delay"]}
        return {
            **row,
            "suggestion": "chirp",
            "suggested": said,
            "random": {**said, "separated": False},
            **more,
        }

    rows = [case(True), case(False), case(True, between=["none", "creep"])]
    rows += [case(True, suggestion=None), case(True, before={"decided": True})]
    table = next_experiment.format_table(rows)
    assert "5 cases, 4 undecided at first, 3 of these with a suggestion" in table
    assert "one of the two leaders in 2" in table
    assert "| suggested | 1/2, 0.50 [" in table
    assert "| random | 0/2, 0.00 [" in table


def test_repeats_agree_in_pairs_and_as_a_whole() -> None:
    row = {"effect": "coulomb_friction", "together": "coulomb_friction", "files": [[0.2, 0.1, -3.0, ""]] * 3}
    rows = [
        {**row, "names": ["coulomb_friction"] * 3},
        {**row, "names": ["coulomb_friction", "stribeck_friction", "creep"]},
    ]
    table = repeats.format_table(rows)
    assert "| two repeats, same name | 3/6 |" in table
    assert "| all repeats, same name | 1/2 |" in table
    assert "| right, one repeat | 5/6 |" in table
    assert "| files wrongly said to disagree | 0/6 |" in table
