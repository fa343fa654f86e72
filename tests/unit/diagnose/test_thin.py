"""Means of neighbours: as many as a motion can spare, in step with it, and never across a cut."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.data_quality.sampling import (
    REPEATED_SAMPLES_CHECK,
    average_dense_samples,
    average_samples,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs


def swing(rate_hz: float, *, hertz: float = 1.0, seconds: float = 8.0) -> Trajectory:
    """A swing whose input is its own coordinate."""
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    q = np.sin(2.0 * np.pi * hertz * time_s)[:, None]
    return Trajectory(
        time_s=time_s, q=q, u=q, v=2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * time_s)[:, None]
    )


def test_a_fine_log_keeps_its_motion_and_loses_its_samples() -> None:
    (short,), (note,) = average_dense_samples([swing(1000.0)], hold="linear")
    assert 1.0 / short.dt_s == pytest.approx(1000.0 / 7.0)
    assert note.level == "note"
    for name, size in (("q", 1.0), ("u", 1.0), ("v", 2.0 * np.pi)):
        phase = 2.0 * np.pi * short.time_s
        there = size * (np.cos if name == "v" else np.sin)(phase)
        np.testing.assert_allclose(getattr(short, name)[:, 0], there, atol=2e-4 * size)


@pytest.mark.parametrize(("rate_hz", "hertz"), [(60.0, 0.1), (120.0, 1.0), (500.0, 5.0)])
def test_what_is_no_finer_than_its_motion_needs_is_left_alone(rate_hz: float, hertz: float) -> None:
    one = swing(rate_hz, hertz=hertz)
    assert average_dense_samples([one], hold="linear") == ((one,), ())


def test_an_input_that_is_held_acts_between_the_samples_that_are_left() -> None:
    time_s = np.arange(40) / 1000.0
    step = (time_s >= 0.0195).astype(float)[:, None]
    short = average_samples(Trajectory(time_s=time_s, q=step, u=step), 5, held=True)
    edges = np.append(short.time_s, short.time_s[-1] + 0.005)
    pushed_s = float((short.u[:, 0] * np.diff(edges)).sum())
    assert pushed_s == pytest.approx(edges[-1] - 0.020, abs=1e-9)


def test_a_mean_never_reaches_across_a_cut() -> None:
    one = Trajectory(time_s=np.arange(31) * 0.01, q=np.repeat([0.0, 1.0], [15, 16])[:, None], u=np.zeros((31, 0)),
                 segments=((0, 15), (15, 31)))  # fmt: skip
    short = average_samples(one, 5, held=False)
    assert short.segments == ((0, 3), (3, 6))
    np.testing.assert_array_equal(short.q[:, 0], [0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(("rate_hz", "told"), [(1000.0, {"averaged"}), (100.0, {REPEATED_SAMPLES_CHECK})])
def test_a_sample_that_repeats_is_no_matter_where_many_are_averaged(
    tmp_path: Path, rate_hz: float, told: set[str]
) -> None:
    one = swing(rate_hz, seconds=20.0)
    q = one.q[:, 0].copy()
    q[round(5.0 * rate_hz)] = q[round(5.0 * rate_hz) - 1]
    pd.DataFrame({"t": one.time_s, "q0": q}).to_csv(tmp_path / "log.csv", index=False)
    (tmp_path / "arm.py").write_text("def sim(q, v, u):\n    return -39.5 * q\n", encoding="utf-8")
    pair = open_diagnosis_inputs(f"{tmp_path}/arm.py:sim", f"{tmp_path}/log.csv", compose().diagnose)
    assert {one.check for one in pair.checked.findings} & {"averaged", REPEATED_SAMPLES_CHECK} == told
