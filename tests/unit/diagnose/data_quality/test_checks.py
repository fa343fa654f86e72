"""Both sides checked at once: what is found, and what never depends on zeros, units and order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.checks import DataCheck, check_data
from lagsplat.diagnose.data_quality.sampling import count_blocks
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, glued, multisine, swing


def said(checked: DataCheck) -> set[tuple[str, str, str, tuple[str, ...]]]:
    return {(found.level, found.check, found.source, found.columns) for found in checked.findings}


def test_a_good_pair_passes_without_a_word() -> None:
    for sim, real in (
        ([swing(noise=0.0, seconds=18.0)], [swing(seconds=18.0, seed=1)]),
        (
            [swing(drive=multisine(1080), seconds=18.0)],
            [swing(drive=multisine(1080, seed=2), seconds=18.0, seed=1)],
        ),
        ([], [swing(start=(1.0, -0.4), seconds=18.0)]),
    ):
        checked = check_data(sim, real)
        assert said(checked) == set()
        assert checked.undetermined == checked.warnings == ()
        assert checked.real.period_s == pytest.approx(PERIOD_S, rel=0.02)
        assert count_blocks(checked.real.motions, period_s=checked.real.period_s) >= 10
        assert (checked.sim is None) == (not sim)


def test_nothing_real_and_nothing_common_are_refused() -> None:
    with pytest.raises(ValueError, match="no motion at all"):
        check_data([swing()], [])
    with pytest.raises(ValueError, match="coordinates q0, q1"):
        check_data([swing()], [swing(start=(1.0, 1.0))])


def test_what_forbids_a_verdict_is_told_first() -> None:
    real = glued(swing(seconds=1.0), swing(seconds=1.0, start=(-0.8,)))
    checked = check_data([swing()], [real])
    assert len(checked.undetermined) == 1
    assert "natural periods" in checked.undetermined[0]
    assert checked.warnings[0] == checked.undetermined[0]


def test_the_real_side_is_returned_cut() -> None:
    real = glued(swing(seconds=9.0), swing(seconds=9.0, start=(-0.8,), seed=1))
    checked = check_data([swing(noise=0.0)], [real])
    assert checked.real.motions[0].segments == ((0, 540), (540, 1080))
    assert [found.check for found in checked.findings] == ["undeclared cut"]


def test_a_driven_motion_on_another_clock_is_undetermined() -> None:
    drive = multisine(1200)
    real = swing(drive=drive, seconds=20.0, seed=1)
    late = np.interp(real.time_s + 2.0, real.time_s, drive)[:, None]
    checked = check_data([swing(drive=multisine(1200, seed=3), seconds=20.0)], [replace(real, u=late)])
    assert [found.check for found in checked.findings if found.level == "undetermined"] == ["time offset"]


def faulty() -> tuple[Trajectory, Trajectory]:
    """A pair with a fault of several kinds in different coordinates."""
    sim = swing(start=(1.0, 0.5), noise=0.0, seconds=18.0)
    real = glued(swing(start=(1.0, 0.5), seconds=5.0), swing(start=(-0.7, 2.4), seconds=4.0, seed=1))
    q = real.q.copy()
    q[:, 1] = np.rint(q[:, 1] / 0.25) * 0.25
    return sim, replace(real, q=q)


@settings(max_examples=6, deadline=None)
@given(
    scale=st.sampled_from([2.0**-20, 0.01, 3.7, 2.0**20]),
    shift=st.floats(-10.0, 10.0),
    later=st.sampled_from([0.0, -7.5, 1e4]),
    swap=st.booleans(),
)
def test_zeros_units_and_the_order_of_coordinates_change_nothing(
    scale: float, shift: float, later: float, swap: bool
) -> None:
    sim, real = faulty()
    expected = said(check_data([sim], [real]))
    assert expected

    def other(motion: Trajectory) -> Trajectory:
        q = scale * (shift + motion.q)
        return replace(motion, time_s=motion.time_s + later, q=q[:, ::-1] if swap else q)

    renamed = {"q0": "q1", "q1": "q0"} if swap else {"q0": "q0", "q1": "q1"}
    found = {
        (level, name, source, tuple(sorted(renamed[column] for column in columns)))
        for level, name, source, columns in said(check_data([other(sim)], [other(real)]))
    }
    assert found == {(*rest, tuple(sorted(columns))) for *rest, columns in expected}


def test_levels_are_known_and_texts_are_sentences() -> None:
    with pytest.raises(ValueError, match="level 'fatal'"):
        Finding("fatal", "a", "b", "c", "d", "e")
    text = Finding("warn", "a", "real.csv", "it stops", "nothing follows", "go on").text
    assert text == "real.csv: it stops. Nothing follows; go on"
