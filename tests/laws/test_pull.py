"""A pointer in space: the ray through a pixel comes back to it, and a drag stays under the pointer."""

from functools import cache

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.report.figures.forces import turn_camera
from lagsplat.viewer.server.canvas import ImageDrag, RayDrag
from tests.unit.forces.solid import FRONT, HEIGHT, WIDTH, turning

YAW, PITCH = st.floats(-40.0, 40.0), st.floats(-25.0, 25.0)
ON_THE_PLATE = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
PIXEL = st.tuples(st.floats(-WIDTH, 2.0 * WIDTH), st.floats(-HEIGHT, 2.0 * HEIGHT))


@cache
def operating_point() -> OperatingPoint:
    return turning()


def pressed(yaw: float, pitch: float, offset: tuple[float, float]) -> tuple[RayDrag, np.ndarray]:
    """A press on the plate from some side, and the place that was met."""
    camera = turn_camera(operating_point(), yaw, pitch)
    camera = camera.resized(4 * camera.height, 4 * camera.width)
    press = camera.project(np.array([[*offset, FRONT]]))[0]
    drag = RayDrag(operating_point(), camera, press)
    place = np.array(drag.find_target(operating_point().rest.numpy()))
    assert abs(camera.within(place[None])[0, 2] - drag.depth) < 1e-6
    return drag, place


@given(YAW, PITCH, ON_THE_PLATE)
def test_the_place_that_a_ray_meets_is_seen_in_the_pixel_that_was_pressed(yaw, pitch, offset) -> None:
    drag, place = pressed(yaw, pitch, offset)
    np.testing.assert_allclose(drag.camera.project(place[None])[0], drag.press, atol=1e-6)
    assert abs(place[2] - FRONT) < 5.0, "the plate is met, not the wall behind it"


@given(YAW, PITCH, ON_THE_PLATE, PIXEL)
def test_a_dragged_place_stays_under_the_pointer_in_the_plane_of_the_image(
    yaw, pitch, offset, pointer
) -> None:
    drag, place = pressed(yaw, pitch, offset)
    displacement = drag.displacement(np.array(pointer))
    np.testing.assert_allclose(drag.camera.project((place + displacement)[None])[0], pointer, atol=1e-6)
    assert abs(drag.camera.rotation[2] @ displacement) < 1e-9 * (1.0 + np.linalg.norm(displacement))


@given(PIXEL)
def test_no_way_leads_anywhere_before_something_was_met(pointer) -> None:
    drag = RayDrag(operating_point(), turn_camera(operating_point(), 0.0, 0.0), np.array([1.0, 1.0]))
    assert not drag.displacement(np.array(pointer)).any()


@given(PIXEL, PIXEL)
def test_in_the_picture_a_press_is_its_place_and_a_drag_the_way_between(press, pointer) -> None:
    drag = ImageDrag(np.array(press))
    assert drag.find_target(np.zeros(1)) == press
    np.testing.assert_array_equal(drag.displacement(np.array(pointer)), np.subtract(pointer, press))
