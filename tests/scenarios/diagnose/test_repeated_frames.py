"""Frames that repeat an earlier one, and what merely looks like it."""

import numpy as np
import pytest

from lagsplat.diagnose.data_quality.discontinuities import cut_jumps, find_repeated_samples
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import film, oscillator, settings, wave

SIGMA = 0.005
RUNS = ((61, 66), (140, 148), (262, 270), (390, 396))


def swing(*, stuck: bool = True) -> Trajectory:
    """A driven motion; in the runs the camera shows what it saw before them."""
    clean = film(u=wave(5), seconds=12.0)
    q = clean.q.copy()
    for start, stop in RUNS if stuck else ():
        q[start:stop] = q[start - 1]
    q = q + SIGMA * np.std(q) * np.random.default_rng(0).standard_normal(q.shape)
    return Trajectory(time_s=clean.time_s, q=q, u=clean.u, source="film")


def marked(motion: Trajectory) -> np.ndarray:
    return find_repeated_samples(motion.q, np.array(motion.segments), SIGMA * motion.q.std(axis=0))


def test_repeated_frames_are_found() -> None:
    late = np.zeros(len(swing().time_s), dtype=bool)
    for start, stop in RUNS:
        late[start:stop] = True
    found = marked(swing())
    assert found[late].mean() > 0.7
    assert found[~late].mean() < 0.01


def test_a_motion_that_turns_or_sticks_repeats_nothing() -> None:
    assert marked(swing(stuck=False)).mean() < 0.01
    t = np.arange(400) / 50.0
    held = np.where(t < 4.0, 0.3, 0.3 * np.cos(2.0 * np.pi * (t - 4.0)))[:, None]
    noisy = held + 0.001 * np.random.default_rng(1).standard_normal(held.shape)
    assert not find_repeated_samples(noisy, np.array([[0, 400]]), np.array([0.001])).any()


def test_a_picture_that_catches_up_is_no_cut() -> None:
    motion = swing()
    cut, found = cut_jumps(motion, sigma=SIGMA * motion.q.std(axis=0), period_s=1.0)
    assert cut.segments == motion.segments
    assert [one.check for one in found] == ["missing samples"]


def test_long_repeats_are_frame_drops_and_leave_the_rest_as_it_was() -> None:
    found = diagnose(EstimatedSimulator.exact(oscillator()), [swing()], settings()).diagnosis
    assert (found.verdict, found.combination) == ("effect", ("frame_drops",))
    count = found.candidates[0].parameters["count"].value
    assert count == pytest.approx(sum(stop - start for start, stop in RUNS), rel=0.35)
    assert found.checks["misfit_none"] < 3.0


def test_where_repeats_are_many_those_about_a_turn_are_found_too() -> None:
    clean = film(u=wave(5), seconds=30.0)
    rng = np.random.default_rng(3)
    q, late, start = clean.q.copy(), np.zeros(len(clean.q), dtype=bool), 20
    while start < len(q) - 30:
        stop = start + int(rng.integers(4, 14))
        q[start:stop], late[start:stop] = q[start - 1], True
        start = stop + int(rng.integers(8, 30))
    q = q + SIGMA * np.std(q) * rng.standard_normal(q.shape)
    motion = Trajectory(time_s=clean.time_s, q=q, u=clean.u, source="film")
    assert marked(motion)[late].mean() > 0.9
    found = diagnose(EstimatedSimulator.exact(oscillator()), [motion], settings()).diagnosis
    assert (found.verdict, found.combination) == ("effect", ("frame_drops",))
    assert found.candidates[0].parameters["count"].value == pytest.approx(int(late.sum()), rel=0.3)
    assert found.gap is not None
    assert found.gap.after < 0.2 * found.gap.before
