"""From a picture to a frame."""

import cv2
import numpy as np
import pytest

from lagsplat.io.video.decode import overlap_decoding
from lagsplat.video_quality.frames import FrameSettings, average_areas, crop_and_resize, rotate_image


def noise(rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (rows, columns, 3), dtype=np.uint8)


@pytest.mark.parametrize("shape", [(540, 960), (541, 960), (250, 360)])
def test_areas_are_averaged(shape: tuple[int, int]) -> None:
    picture = cv2.GaussianBlur(noise(*shape), (0, 0), 1.0)
    exact = cv2.resize(picture.astype(np.float64), (50, 30), interpolation=cv2.INTER_AREA)
    error = np.abs(average_areas(picture, (30, 50)) - exact)
    assert error.max() < 6.0  # of noise; a nearest pixel is off by 100
    assert error.mean() < 1.0


def test_grey_is_three_equal_channels_of_the_same_luma() -> None:
    picture = noise(20, 30)
    frame = crop_and_resize(picture, FrameSettings(crop=(2, 3, 10, 8), grey=True), source="x")
    assert (frame == frame[..., :1]).all()
    luma = picture[3:11, 2:12] @ np.array([0.114, 0.587, 0.299])  # BGR
    assert np.abs(frame[..., 0] - luma).max() <= 1.0


@pytest.mark.parametrize(("degrees", "turns"), [(0, 0), (90, -1), (180, 2), (270, 1)])
def test_turns_are_clockwise(degrees: int, turns: int) -> None:
    picture = noise(4, 6)
    np.testing.assert_array_equal(rotate_image(picture, degrees), np.rot90(picture, turns))


def test_overlapped_work_keeps_its_order_and_its_errors() -> None:
    assert list(overlap_decoding(range(20), lambda x: x * x)) == [x * x for x in range(20)]
    with pytest.raises(ZeroDivisionError):
        list(overlap_decoding([1, 0, 1], lambda x: 1 // x))
