"""The same coordinates on both sides, in the same region, in the same units."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Finding, refuse
from lagsplat.diagnose.data_quality.compatibility import (
    MOSTLY_OUTSIDE_CHECK,
    check_coordinates,
    check_inputs,
    check_region,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import multisine, swing

FREE = swing(start=(1.0, 0.5))
DRIVEN = swing(drive=multisine(900))
AWAY = np.array([0.0, 30.0])


def said(found: list[Finding]) -> list[tuple[str, str]]:
    return [(finding.level, finding.check) for finding in found]


def with_input(motion: Trajectory, *columns: np.ndarray) -> Trajectory:
    return replace(motion, u=np.stack(columns, axis=1), u_names=())


def test_like_and_like_agree() -> None:
    for motion in (FREE, DRIVEN):
        assert check_coordinates([motion, motion], [motion]) == []
        assert check_region([motion], [replace(motion, q=0.4 * motion.q)]) == []
        assert check_inputs([motion], [motion]) == []


def test_other_coordinates_are_refused_by_name() -> None:
    found = check_coordinates([FREE], [swing(source="real.csv")])
    assert said(found) == [("refuse", "coordinates")]
    with pytest.raises(ValueError, match=r"real.csv: coordinates q0, but motion.csv has q0, q1"):
        refuse(found)


def test_inputs_of_one_side() -> None:
    free = swing()
    with pytest.raises(ValueError, match="no input u0"):
        refuse(check_coordinates([DRIVEN], [free]))
    with pytest.raises(ValueError, match=r"other.csv: no input u0.*Other files of real have it"):
        refuse(check_coordinates([], [DRIVEN, replace(free, source="other.csv")]))
    assert said(check_coordinates([free], [DRIVEN])) == [("undetermined", "input of one side")]
    silent = with_input(free, np.full(900, 0.3))
    assert said(check_coordinates([free], [silent])) == [("note", "input of one side")]
    with pytest.raises(ValueError, match="Other files of real have it"):
        refuse(check_coordinates([free], [silent, free]))


def test_inputs_that_never_move_and_those_that_the_sim_never_moved() -> None:
    silent, zero = with_input(DRIVEN, np.full(900, 0.3)), with_input(DRIVEN, np.zeros(900))
    assert said(check_inputs([DRIVEN], [silent])) == [("warn", "constant input")]
    assert said(check_inputs([zero], [DRIVEN])) == [("undetermined", "input of one side")]
    two = with_input(DRIVEN, DRIVEN.u[:, 0], np.zeros(900))
    (finding,) = check_inputs([two], [two])
    assert finding.columns == ("u1",)


@pytest.mark.parametrize(
    ("factor", "units"), [(180.0 / np.pi, "degrees and radians"), (1000.0, "millimetres and metres")]
)
def test_units_are_suspected_in_both_directions(factor: float, units: str) -> None:
    for scale in (factor, 1.0 / factor):
        other = replace(FREE, q=FREE.q * [1.0, scale])
        found = check_region([FREE], [other])
        assert ("undetermined", "units") in said(found)
        assert [units in finding.what for finding in found if finding.check == "units"] == [True]
        assert found[0].columns == ("q1",)


def test_another_region_is_no_overlap_and_somewhat_larger_swings_are_a_warning() -> None:
    assert said(check_region([FREE], [replace(FREE, q=FREE.q + AWAY)])) == [("undetermined", "no overlap")]
    assert said(check_region([FREE], [replace(FREE, q=3.0 * FREE.q)])) == [("warn", "outside the sim")]
    assert said(check_region([FREE], [replace(FREE, q=12.0 * FREE.q)])) == [("warn", MOSTLY_OUTSIDE_CHECK)]
    assert check_region([], [FREE]) == []


def test_a_few_wild_samples_of_the_sim_do_not_widen_its_region() -> None:
    wild = FREE.q.copy()
    wild[::1000] += 1e3
    found = check_region([replace(FREE, q=wild)], [replace(FREE, q=FREE.q + AWAY)])
    assert ("undetermined", "no overlap") in said(found)
