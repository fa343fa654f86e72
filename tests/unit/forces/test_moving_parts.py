"""Moving parts of an image: motion, points to push, and the outline."""

import numpy as np
import pytest

from lagsplat.forces.moving_parts import (
    MovingParts,
    choose_background_points,
    choose_hanging_points,
    choose_lever_points,
    choose_moving_points,
    has_levers,
)
from tests.unit.forces.rocking import CLAMP, CONTACT, hanging, rocking


def test_each_pixel_shows_how_its_matter_moves():
    operating_point = rocking()
    scene = operating_point.find_moving_parts()
    x, y = 20, 9
    expected = 0.1 * np.array([-(y + 0.5 - CONTACT[1]), x + 0.5 - CONTACT[0]])
    assert scene.jacobian[y, x, :, 0] == pytest.approx(expected, rel=0.01)
    assert scene.object[12, 16]
    assert scene.motion[2, 2] == 0.0
    assert not scene.object[2, 2]


def test_levers_grow_away_from_the_centre_of_rotation_and_change_sign():
    operating_point = rocking()
    scene = operating_point.find_moving_parts()
    arms = [x - CONTACT[0] for x, _ in choose_lever_points(scene, margin=1.0)]
    assert arms[0] > arms[1] > arms[2]
    assert arms[0] < 0 < arms[3]


def test_what_turns_has_levers_and_a_bob_on_a_thread_has_none():
    scene = rocking().find_moving_parts()
    assert has_levers(scene)
    moved = scene.jacobian.copy()
    moved[scene.object, 0, 0] += 10.0  # the same turn, and a long way to the side
    assert not has_levers(MovingParts(moved, scene.object))
    assert not has_levers(MovingParts(moved, np.zeros_like(scene.object)))


def test_moving_points_move_more_and_more():
    scene = rocking().find_moving_parts()
    points = choose_moving_points(scene, margin=1.0)
    moves = [scene.motion[int(y), int(x)] for x, y in points]
    assert moves[0] < moves[1] < moves[2]
    assert all(scene.inner[int(y), int(x)] for x, y in points)
    still = MovingParts(np.zeros((8, 8, 2, 1)), np.zeros((8, 8), bool))
    with pytest.raises(ValueError, match="nothing moves"):
        choose_moving_points(still, margin=1.0)


def test_background_points_lie_apart_and_off_the_object():
    operating_point = rocking()
    scene = operating_point.find_moving_parts()
    points = np.array(choose_background_points(scene.object, 3, margin=1.0))
    assert len(points) == 3
    assert all(np.hypot(x - 16.0, y - 12.0) > 8.0 for x, y in points)
    assert min(np.linalg.norm(a - b) for i, a in enumerate(points) for b in points[:i]) > 8.0


def test_an_arm_has_a_middle_a_tip_and_a_direction():
    operating_point = hanging()
    scene = operating_point.find_moving_parts()
    middle, tip, along = choose_hanging_points(scene)
    assert middle[0] == pytest.approx(CLAMP[0], abs=0.5)
    assert CLAMP[1] < middle[1] < tip[1] < 22
    assert along == pytest.approx([0.0, 1.0], abs=0.05)


def test_an_image_in_which_nothing_moves_is_refused():
    still = MovingParts(np.zeros((8, 8, 2, 1)), np.zeros((8, 8), bool))
    with pytest.raises(ValueError, match="no lever arms"):
        choose_lever_points(still, margin=1.0)
    with pytest.raises(ValueError, match="nothing moves"):
        choose_hanging_points(still)


def test_the_inside_of_an_object_has_no_rim_unless_it_is_all_rim():
    disc, strip = (make().find_moving_parts() for make in (rocking, hanging))
    assert disc.object[6, 16]
    assert not disc.inner[6, 16]
    assert disc.inner[12, 16]
    assert strip.inner.any()
    line = np.zeros((8, 8), bool)
    line[3] = True
    assert (MovingParts(np.zeros((8, 8, 2, 1)), line).inner == line).all()
