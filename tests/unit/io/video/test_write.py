"""Small films and animations, read back."""

import cv2
import numpy as np
import pytest
from PIL import Image

from lagsplat.io.video.write import save_gif, save_mp4


def pictures(count: int = 12) -> list[np.ndarray]:
    """A bright square that moves right over a dark ground."""
    frames = [np.full((33, 48, 3), 30, np.uint8) for _ in range(count)]
    for i, frame in enumerate(frames):
        frame[10:20, 2 * i : 2 * i + 10] = (220, 120, 40)
    return frames


def test_a_film_holds_every_picture_at_its_rate(tmp_path):
    save_mp4(tmp_path / "a.mp4", pictures(), rate_hz=30.0)
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(30.0)
    read = []
    while (found := film.read())[0]:
        read.append(found[1][:, :, ::-1])
    assert len(read) == 12
    assert read[0].shape == (32, 48, 3)
    np.testing.assert_allclose(read[5][15, 15], (220, 120, 40), atol=25)


def test_an_animation_holds_every_picture_and_repeats(tmp_path):
    save_gif(tmp_path / "a.gif", pictures(), rate_hz=15.0)
    with Image.open(tmp_path / "a.gif") as animation:
        assert animation.n_frames == 12
        assert animation.info["duration"] == 70
        assert animation.info["loop"] == 0


def test_without_a_picture_nothing_is_written(tmp_path):
    for save in (save_mp4, save_gif):
        with pytest.raises(ValueError, match="picture"):
            save(tmp_path / "a.mp4", [], rate_hz=30.0)
    assert list(tmp_path.iterdir()) == []
