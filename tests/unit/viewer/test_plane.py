"""The picture's sheet in the scene: places and lines of sight."""

import numpy as np
import pytest

from lagsplat.viewer.rendering.scene_frame import ImagePlane

PLANE = ImagePlane(120, 80)


def test_a_place_in_the_picture_is_found_again_from_any_side_of_its_front():
    places = np.array([[0.0, 0.0], [120.0, 80.0], [33.0, 71.0]])
    for eye in ((0.0, 0.0, 5.0), (3.0, -2.0, 4.0)):
        for place in places:
            # any point on the line of sight means the same place
            on = PLANE.to_scene(place)
            between = tuple(0.5 * (on + np.array(eye)))
            np.testing.assert_allclose(PLANE.to_pixels(between, eye=eye), place, atol=1e-9)


def test_the_first_row_is_on_top():
    top, bottom = PLANE.to_scene(np.array([[60.0, 0.0], [60.0, 80.0]]))
    assert top[1] > 0.0 > bottom[1]
    assert PLANE.size == (4.0, pytest.approx(8 / 3))


@pytest.mark.parametrize(
    ("point", "eye"),
    [
        ((0.0, 0.0, 6.0), (0.0, 0.0, 5.0)),
        ((1.0, 0.0, 5.0), (0.0, 0.0, 5.0)),
        ((np.nan, 0.0, 0.0), (0.0, 0.0, 5.0)),
        ((1e308, -1e308, 0.0), (0.0, 0.0, 5.0)),
        ((1e308, 0.0, 0.0), (-1e308, 0.0, 5.0)),
        ((1.0, 0.0, 5.0 - 1e-300), (0.0, 0.0, 5.0)),
    ],
    ids=["behind", "parallel", "nan", "huge", "huge between", "all but parallel"],
)
def test_a_line_of_sight_past_the_sheet_is_refused(point, eye):
    with pytest.raises(ValueError, match=r"nothing was pushed|turn the view"):
        PLANE.to_pixels(point, eye=eye)
