"""A rig's JSON: OpenCV's numbers become cameras, films of the same instants views, and slips messages."""

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.novel_views.sharp import obtain_views
from lagsplat.views.novel import NovelViews
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
        (lambda rig: rig | {"pivot_depth": -1}, "pivot is -1.0 ahead of the reference camera"),
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


def film(path: Path, frames: int = 5, *, height: int = 48, width: int = 64, rate: float = 30.0) -> Path:
    """A film whose pictures brighten with time."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (width, height))
    for i in range(frames):
        writer.write(np.full((height, width, 3), 40 + 20 * i, np.uint8))
    writer.release()
    return path


def source(path: Path) -> RecordingConfig:
    return replace(
        compose("system=pendulum", "recording=filmed", f"recording.path={path}").recording,
        height=24,
        width=32,
    )


def views_of(folder: Path, **changes: object) -> NovelViews:
    rig = written(folder, RIG)
    film(folder / "left.mp4", **changes)
    config = compose("system=pendulum", "views=rig", f"views.rig={rig}").views
    front = source(film(folder / "front.mp4"))
    assert config is not None
    return obtain_views(config, read_recording(front), front, released=None, states=None, cache=Path())


def test_films_become_views_of_the_recordings_size(tmp_path: Path) -> None:
    views = views_of(tmp_path)
    assert views.images.shape == (5, 1, 24, 32, 3)
    np.testing.assert_allclose(views.images[:, 0].mean((1, 2, 3)), 40 + 20 * np.arange(5), atol=4)
    assert views.cameras[0].focal == (25.0, 24.0)
    assert (views.space.reference.height, views.space.reference.width) == (24, 32)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": 4}, "has 4 frames and the reference 5"),
        ({"rate": 20.0}, "s off the reference, whose frames are 0.0333 s apart"),
        ({"height": 64}, "camera 'left' is of 48 x 64 pixels and .*left.mp4 of 64 x 64"),
    ],
)
def test_films_that_do_not_fit_their_cameras_are_refused(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        views_of(tmp_path, **changes)


def test_a_rig_wants_whole_films(tmp_path: Path) -> None:
    config = compose("system=pendulum", "views=rig", f"views.rig={written(tmp_path, RIG)}").views
    front = source(film(tmp_path / "front.mp4"))
    recording = read_recording(front)
    assert config is not None
    for wrong, message in (
        (replace(front, kind="simulated"), "not of kind simulated"),
        (replace(front, crop=[0, 0, 32, 24]), "use whole pictures"),
    ):
        with pytest.raises(ValueError, match=message):
            obtain_views(config, recording, wrong, released=None, states=None, cache=Path())
