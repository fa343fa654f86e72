"""What is laid over the picture: arrows on what moves, in the picture and in space."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.viewer.rendering.overlays import AccelerationField, select_moving, trace_outlines
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FRONT, turning


@pytest.mark.parametrize(("operating_point", "space"), [(rocking, 2), (turning, 3)], ids=["picture", "space"])
def test_arrows_stand_on_what_moves_and_point_where_it_goes(operating_point, space: int) -> None:
    field = AccelerationField(operating_point())
    arrows = field.arrows(np.zeros(1), np.ones(1), largest=1.0)
    assert arrows.shape[1:] == (2, space)
    assert len(arrows) > 3
    ways = arrows[:, 1] - arrows[:, 0]
    np.testing.assert_allclose(ways / (2.0 * field.cell), field.along(np.ones(1)), atol=1e-9)


def test_the_wall_gets_no_arrow() -> None:
    operating_point = turning()
    assert (operating_point.kinematics.center[select_moving(operating_point.kinematics), 2] == FRONT).all()
    np.testing.assert_allclose(AccelerationField(operating_point).places(np.zeros(1))[:, 2], FRONT)


def test_a_stray_that_moves_alone_is_no_object() -> None:
    operating_point = turning()
    before = select_moving(operating_point.kinematics)
    center = operating_point.kinematics.center.clone()
    stray = int(np.flatnonzero(before)[0])
    center[stray] += 40.0
    after = select_moving(replace(operating_point.kinematics, center=center))
    assert before[stray]
    assert not after[stray]
    assert after.sum() == before.sum() - 1


def test_an_outline_runs_half_way_between_in_and_out() -> None:
    share = np.zeros((20, 30))
    share[5:15, 8:24] = 1.0
    (line,) = trace_outlines(share, smooth_px=0.5)
    np.testing.assert_allclose(line.min(0), (8.0, 5.0), atol=0.1)
    np.testing.assert_allclose(line.max(0), (24.0, 15.0), atol=0.1)
