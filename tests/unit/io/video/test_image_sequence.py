"""The layout that the authors' tool reads, and the numbered pictures it leaves."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from lagsplat.io.video.image_sequence import LISTING, read_predicted, write_dnerf

FRAMES = np.random.default_rng(0).integers(0, 256, size=(12, 6, 8, 3), dtype=np.uint8)


def written(place: Path, n_train: int = 9) -> float:
    return write_dnerf(place, FRAMES, n_train=n_train, field_of_view_rad=0.63, distance=4.0)


def test_one_camera_stands_still_and_times_are_even(tmp_path: Path) -> None:
    divides = written(tmp_path)
    listing = json.loads((tmp_path / LISTING).read_text(encoding="utf-8"))
    times = [frame["time"] for frame in listing["frames"]]
    np.testing.assert_allclose(times, np.arange(12) / 11)
    assert sum(time < divides for time in times) == 9
    cameras = np.array([frame["transform_matrix"] for frame in listing["frames"]])
    np.testing.assert_array_equal(cameras, np.broadcast_to(cameras[0], cameras.shape))
    np.testing.assert_array_equal(cameras[0][:3, 3], [0, 0, 4])
    assert listing["camera_angle_x"] == 0.63
    for frame, truth in zip(listing["frames"], FRAMES, strict=True):
        np.testing.assert_array_equal(
            cv2.imread(str(tmp_path / f"{frame['file_path']}.png"))[..., ::-1], truth
        )


def test_pictures_come_back_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    written(tmp_path)
    (tmp_path / "frames" / "notes.png").write_text("no picture", encoding="utf-8")
    found = read_predicted(tmp_path / "frames", height=6, width=8, at_least=12)
    np.testing.assert_array_equal(found, FRAMES)


@pytest.mark.parametrize("n_train", [0, 12])
def test_a_clip_needs_both_parts(tmp_path: Path, n_train: int) -> None:
    with pytest.raises(ValueError, match="both parts must hold a frame"):
        written(tmp_path, n_train)


def test_what_is_wrong_with_predicted_frames_is_said(tmp_path: Path) -> None:
    written(tmp_path)
    place = tmp_path / "frames"
    with pytest.raises(FileNotFoundError, match="no such folder"):
        read_predicted(tmp_path / "gone", height=6, width=8, at_least=3)
    with pytest.raises(ValueError, match="12 predicted frames, but 33 are held out"):
        read_predicted(place, height=6, width=8, at_least=33)
    with pytest.raises(ValueError, match="6 x 8 pixels, but the recording has 64 x 96"):
        read_predicted(place, height=64, width=96, at_least=3)
    (place / "00004.png").unlink()
    with pytest.raises(ValueError, match=r"00004\.png is missing"):
        read_predicted(place, height=6, width=8, at_least=3)
    (place / "00004.png").write_bytes(b"")
    with pytest.raises(ValueError, match="not a picture"):
        read_predicted(place, height=6, width=8, at_least=3)
