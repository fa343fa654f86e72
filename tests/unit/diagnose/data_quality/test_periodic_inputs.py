"""Periods of inputs that repeat themselves, and shifts that are the same but for whole periods."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Candidate, Diagnosis, Parameter
from lagsplat.diagnose.data_quality.input_checks import check_time_offset
from lagsplat.diagnose.data_quality.periodic_inputs import (
    check_periodic_inputs,
    estimate_common_period_s,
    estimate_input_period_s,
    wrap_shift,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.diagnosis import wrap_time_shifts
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing

TIME_S = np.arange(900) / 60.0
SINE = np.sin(2.0 * np.pi * TIME_S / 1.37)
SQUARE = np.sign(np.sin(2.0 * np.pi * TIME_S / 1.37 + 0.1))


def driven(*columns: np.ndarray) -> Trajectory:
    motion = swing(drive=columns[0])
    return replace(motion, u=np.stack(columns, axis=1), u_names=())


@pytest.mark.parametrize("drive", [SINE, SQUARE, SINE + 0.5 * np.sin(4.0 * np.pi * TIME_S / 1.37 + 1.0)])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_the_period_of_an_input_is_found(drive: np.ndarray, noise: float) -> None:
    noisy = drive + noise * np.random.default_rng(0).normal(size=900)
    assert estimate_input_period_s([driven(noisy)], 0) == pytest.approx(1.37, abs=1.0 / 60.0)
    (found,) = check_periodic_inputs([driven(noisy)])
    assert found.columns == ("u0",)


@pytest.mark.parametrize(
    "drive",
    [
        multisine(900),
        np.exp(-TIME_S / 5.0) * SINE,
        np.sin(2.0 * np.pi * (0.2 + 0.05 * TIME_S) * TIME_S),
        np.ones(900),
        np.random.default_rng(0).normal(size=900),
        np.diff(np.random.default_rng(0).normal(size=903), 3),  # a controller that chatters
        (TIME_S > 5.0).astype(float),
    ],
)
def test_what_does_not_repeat_has_no_period(drive: np.ndarray) -> None:
    assert estimate_input_period_s([driven(drive)], 0) is None
    assert check_periodic_inputs([driven(drive)]) == []


def test_inputs_together_repeat_after_the_longest_if_the_others_fit_into_it() -> None:
    half, other = np.sin(4.0 * np.pi * TIME_S / 1.37), np.sin(2.0 * np.pi * TIME_S / 0.91)
    assert estimate_common_period_s([driven(SINE, half)]) == pytest.approx(1.37, abs=1.0 / 60.0)
    assert estimate_common_period_s([driven(SINE, other)]) is None
    assert estimate_common_period_s([driven(SINE, multisine(900))]) is None


def test_a_sine_far_from_resonance_is_no_gross_offset_of_clocks() -> None:
    fast = np.sin(2.0 * np.pi * TIME_S / (0.4 * PERIOD_S))
    assert check_time_offset([replace(driven(fast), u=np.roll(fast, 30)[:, None])], period_s=PERIOD_S) == []


def test_a_delay_of_a_periodic_input_is_given_within_half_a_period() -> None:
    assert wrap_shift(1.2, 1.37) == pytest.approx(-0.17)
    delay, offset = Parameter(1.2, 1.1, 1.3, "s"), Parameter(-0.9, None, None, "s")
    candidates = (
        Candidate("input_delay", 0.6, input="u0", parameters={"delay": delay}),
        Candidate("time_offset", 0.3, parameters={"offset": offset}),
        Candidate("input_gain", 0.1, input="u0", parameters={"gain": delay}),
    )
    found = Diagnosis(
        "effect", candidates, (), None, None, (), (), (), (), (), {}, q_names=("q0",), u_names=("u0",)
    )
    first, second, third = wrap_time_shifts(found, [driven(SINE)]).candidates
    period_s = estimate_input_period_s([driven(SINE)], 0)
    assert period_s is not None
    assert first.parameters["delay"].value == pytest.approx(1.2 - period_s)
    assert first.parameters["delay"].low == pytest.approx(1.1 - period_s)
    assert second.parameters["offset"].value == pytest.approx(period_s - 0.9)
    assert third == candidates[2]
    assert wrap_time_shifts(found, [driven(multisine(900))]) == found
