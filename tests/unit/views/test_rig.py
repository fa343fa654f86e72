"""A rig's JSON: OpenCV's numbers become cameras, films of the same instants views, and slips messages."""

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lagsplat.io.recording import Recording
from lagsplat.views.filmed import filmed_views
from lagsplat.views.rig import read_rig

LENS = [[50.0, 0.0, 31.5], [0.0, 48.0, 23.5], [0.0, 0.0, 1.0]]
TURN = cv2.Rodrigues(np.array([0.1, -0.3, 0.05]))[0]
SHIFT = [0.2, -0.1, 0.3]
SIZE = {"width": 64, "height": 48}
RIG = {
    "format": "lagsplat rig",
    "version": 1,
    "reference": "front",
    "pivot_depth": 1.5,
    "cameras": [
        {"name": "front", **SIZE, "K": LENS, "R": np.eye(3).tolist(), "t": [0, 0, 0]},
        {"name": "left", "video": "left.mp4", **SIZE, "K": LENS, "R": TURN.tolist(), "t": SHIFT},
    ],
}


def written(folder: Path, rig: object) -> Path:
    (folder / "left.mp4").touch()
    path = folder / "rig.json"
    path.write_text(rig if isinstance(rig, str) else json.dumps(rig))
    return path


def test_cameras_project_as_opencv_does_but_for_the_half_pixel(tmp_path: Path) -> None:
    rig = read_rig(written(tmp_path, RIG))
    points = np.array([[0.1, 0.2, 1.4], [-0.3, 0.1, 2.0]])
    expected = cv2.projectPoints(points, TURN, np.array(SHIFT), np.array(LENS), None)[0][:, 0]
    np.testing.assert_allclose(rig.others[0].camera.project(points), expected + 0.5, atol=1e-9)
    assert rig.space.reference.middle == (32.0, 24.0)
    assert rig.space.unit == pytest.approx(1.5 / 50)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rig: "{", "not JSON"),
        (lambda rig: rig | {"version": 2}, "not a rig of version 1"),
        (lambda rig: rig | {"reference": "back"}, r"'back' is none of the cameras \['front', 'left'\]"),
        (lambda rig: rig | {"pivot_depth": -1}, "pivot's depth is -1"),
        (lambda rig: rig | {"cameras": rig["cameras"][:1]}, "is the only camera"),
        (lambda rig: rig | {"cameras": 2 * rig["cameras"]}, "give each a name of its own"),
        ({"K": [[1, 2], [3, 4]]}, "needs K and R of 3 x 3"),
        ({"K": [[50, 9, 0], [0, 50, 0], [0, 0, 1]]}, r"is not \[\[fx, 0, cx\]"),
        ({"R": (2 * TURN).tolist()}, "'left': a camera's rotation is not one"),
        ({"R": "none"}, "R of camera 'left' is not made of numbers"),
        ({"distortion": [0.1, 0, 0, 0]}, "undistort its video"),
        ({"video": None}, r"no video of \['left'\]"),
        ({"width": None}, "int"),
    ],
)
def test_slips_are_named(tmp_path: Path, change, message: str) -> None:
    rig = deepcopy(RIG)
    if callable(change):
        rig = change(rig)
    else:
        rig["cameras"][1] |= change
    with pytest.raises((ValueError, TypeError), match=message):
        read_rig(written(tmp_path, rig))


def test_a_missing_key_and_a_missing_video_are_named(tmp_path: Path) -> None:
    rig = deepcopy(RIG)
    del rig["cameras"][1]["t"]
    with pytest.raises(ValueError, match="'t' is missing in 'left'"):
        read_rig(written(tmp_path, rig))
    rig["cameras"][1] |= {"t": SHIFT, "video": "right.mp4"}
    with pytest.raises(FileNotFoundError, match=r"camera 'left': no video .*right\.mp4"):
        read_rig(written(tmp_path, rig))


def film(frames: int = 5, height: int = 24, width: int = 32, late_s: float = 0.0) -> Recording:
    time_s = np.arange(frames) / 30
    time_s[2:] += late_s
    pictures = np.random.default_rng(frames).integers(0, 255, (frames, height, width, 3), dtype=np.uint8)
    return Recording(
        frames=pictures,
        time_s=time_s,
        inputs=np.zeros((frames, 0)),
        input_names=(),
        input_units=(),
        meta={"origin": "filmed"},
    )


def test_films_become_views_of_the_recordings_size(tmp_path: Path) -> None:
    rig = read_rig(written(tmp_path, RIG))
    aside = film()
    views = filmed_views(rig, film(), lambda path: aside)
    assert views.images.shape == (5, 1, 24, 32, 3)
    np.testing.assert_array_equal(views.images[:, 0], aside.frames)
    assert views.cameras[0].focal == (25.0, 24.0)
    assert (views.space.reference.height, views.space.reference.width) == (24, 32)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (film(frames=4), "filmed 4 frames and the reference 5"),
        (film(late_s=0.03), "up to 0.0300 s off the reference"),
        (film(height=32), "calibrated on 64 x 48 pixels and its film is of 32 x 32"),
    ],
)
def test_films_that_do_not_fit_their_cameras_are_refused(
    tmp_path: Path, other: Recording, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        filmed_views(read_rig(written(tmp_path, RIG)), film(), lambda path: other)


def test_a_recording_of_another_shape_than_the_reference_camera_is_refused(tmp_path: Path) -> None:
    square = replace(film(), frames=np.zeros((5, 32, 32, 3), np.uint8))
    with pytest.raises(ValueError, match="the reference was calibrated on 64 x 48 pixels"):
        filmed_views(read_rig(written(tmp_path, RIG)), square, lambda path: film())
