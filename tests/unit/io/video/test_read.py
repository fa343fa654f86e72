"""Films: their own clock, cutting, colour, and every way a file can be wrong."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lagsplat.io.video import read as video
from lagsplat.io.video.read import read_video
from lagsplat.video_quality.frames import FrameSettings

N, RATE = 20, 25.0
TAGS = {".mkv": "FFV1", ".avi": "FFV1", ".mp4": "mp4v"}


def picture(i: int) -> np.ndarray:
    """RGB, 48 high, 64 wide: colour tells the frame, the right half is bluer."""
    image = np.full((48, 64, 3), (10 * i + 5, 250 - 10 * i, 40), np.uint8)
    image[:, 32:, 2] = 200
    return image


def film(folder: Path, suffix: str) -> Path:
    path = folder / f"film{suffix}"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*TAGS[suffix]), RATE, (64, 48))
    for i in range(N):
        writer.write(picture(i)[..., ::-1])
    writer.release()
    return path


def retime(path: Path, *, frame: int, to_ms: int) -> Path:
    """Move one frame of a Matroska film, by the 16-bit time in its block header (track 1, no flags)."""
    old, new = (b"\x81" + ms.to_bytes(2, "big") + b"\x00" for ms in (round(1000 * frame / RATE), to_ms))
    content = path.read_bytes()
    assert content.count(old) == 1
    path.write_bytes(content.replace(old, new))
    return path


def read(path: Path, **changes: Any) -> Any:
    return read_video(path, FrameSettings(**changes))


def test_pictures_are_rgb_and_nothing_is_added(tmp_path: Path) -> None:
    recording = read(film(tmp_path, ".mkv"))
    np.testing.assert_array_equal(recording.frames, np.stack([picture(i) for i in range(N)]))
    assert recording.inputs.shape == (N, 0)
    assert recording.input_names == recording.input_units == ()
    assert recording.segments == ((0, N),)
    assert recording.meta["origin"] == "filmed"
    assert recording.meta["source"] == "film.mkv"


@pytest.mark.parametrize("suffix", TAGS)
def test_times_are_the_containers(tmp_path: Path, suffix: str) -> None:
    np.testing.assert_allclose(read(film(tmp_path, suffix)).time_s, np.arange(N) / RATE, atol=1e-9)


def test_uneven_times_are_kept(tmp_path: Path) -> None:
    time_s = read(retime(film(tmp_path, ".mkv"), frame=10, to_ms=415)).time_s
    np.testing.assert_allclose(time_s[9:12], [0.36, 0.415, 0.44], atol=1e-9)


@pytest.mark.parametrize("to_ms", [280, 360])
def test_time_that_stands_or_goes_back_is_named(tmp_path: Path, to_ms: int) -> None:
    path = retime(film(tmp_path, ".mkv"), frame=10, to_ms=to_ms)
    with pytest.raises(
        ValueError, match=rf"film\.mkv: frame 10 is at 0\.{to_ms}000 s, not after frame 9 at 0\.360"
    ):
        read(path)
    assert read(path, end_s=0.3).n_frames == 8  # as the message advises


def test_cut_is_half_open(tmp_path: Path) -> None:
    recording = read(film(tmp_path, ".mkv"), skip_s=0.2, end_s=0.4)
    np.testing.assert_allclose(recording.time_s, [0.2, 0.24, 0.28, 0.32, 0.36], atol=1e-9)
    np.testing.assert_array_equal(recording.frames[0], picture(5))


def test_crop_and_area_average(tmp_path: Path) -> None:
    path = film(tmp_path, ".mkv")
    cropped = read(path, crop=(30, 8, 4, 12)).frames
    np.testing.assert_array_equal(cropped[3], picture(3)[8:20, 30:34])
    small = read(path, crop=(28, 8, 8, 12), size=(3, 1)).frames
    assert small.shape == (N, 3, 1, 3)
    assert (small[..., 2] == 120).all()  # half 40, half 200


@pytest.mark.parametrize("crop", [(0, 0, 65, 48), (0, 1, 64, 48), (60, 0, 5, 5), (-1, 0, 5, 5), (0, 0, 0, 5)])
def test_crop_outside_the_picture(tmp_path: Path, crop: tuple) -> None:
    with pytest.raises(ValueError, match="outside the picture, which is 64 wide and 48 high"):
        read(film(tmp_path, ".mkv"), crop=crop)


@pytest.mark.parametrize("cut", [{"skip_s": 9.0}, {"end_s": 0.1, "skip_s": 0.09}])
def test_cut_that_leaves_nothing(tmp_path: Path, cut: dict) -> None:
    with pytest.raises(ValueError, match=r"no frame to keep; \d+ were read, from 0\.000 s to"):
        read(film(tmp_path, ".mkv"), **cut)


@pytest.mark.parametrize("suffix", [".avi", ".mkv"])
def test_film_cut_short_gives_what_is_whole(tmp_path: Path, suffix: str) -> None:
    path = film(tmp_path, suffix)
    content = path.read_bytes()
    path.write_bytes(content[: 7 * len(content) // 10])
    with pytest.warns(UserWarning, match=r"only \d+ frames are whole, up to 0\.\d+ s; ") as warned:
        recording = read(path)
    assert 0 < recording.n_frames < N
    assert f"only {recording.n_frames} frames" in str(warned[0].message)
    np.testing.assert_array_equal(recording.frames[-1], picture(recording.n_frames - 1))


def test_films_that_cannot_be_opened(tmp_path: Path) -> None:
    path = film(tmp_path, ".mp4")  # keeps its index at the end
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"moov")])
    with pytest.raises(
        ValueError, match=r"film\.mp4: OpenCV cannot open it; it is truncated or not a film, or its codec"
    ):
        read(path)
    path.write_bytes(b"")
    with pytest.raises(ValueError, match="cannot open it"):
        read(path)
    with pytest.raises(
        FileNotFoundError, match=r"absent\.mp4: no such file or folder; check recording\.path"
    ):
        read(tmp_path / "absent.mp4")


def test_film_without_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Empty:
        """An open film that has no frame."""

        def __init__(self, name: str) -> None:
            self.isOpened, self.grab, self.release = lambda: True, lambda: False, lambda: None

    monkeypatch.setattr(video.cv2, "VideoCapture", Empty)
    (tmp_path / "empty.mkv").write_bytes(b"")
    with pytest.raises(ValueError, match=r"empty\.mkv: no frame to keep; 0 were read"):
        read(tmp_path / "empty.mkv")


def test_real_film_whose_header_lies(shared_data: Path) -> None:
    path = shared_data / "video" / "pendulum_pair" / "video1.mp4"
    recording = read(path, size=(18, 32), end_s=3.0)  # the header says 31.47 frames per second
    np.testing.assert_allclose(recording.time_s, 0.040 * np.arange(75), atol=1e-9)


def test_real_pendulum_without_its_repetition(shared_data: Path) -> None:
    path = shared_data / "video" / "pendulum_pair" / "video2.mp4"
    (found,) = read(path, crop=(0, 0, 250, 360), skip_s=1.5, end_s=12.27, size=(92, 64)).meta["footage"]
    assert found["warnings"] == []
    assert found["sampling"]["period_s"] == pytest.approx(1.603, rel=0.02)
    with pytest.warns(UserWarning, match=r"a hand perhaps, is in the picture until 0\.[56]"):
        read(path, crop=(0, 0, 250, 360), end_s=12.27, size=(92, 64))


def test_real_building_with_few_frames_a_period(shared_data: Path) -> None:
    path = shared_data / "video" / "building_sway" / "building_sway_650x1022.mp4"
    with pytest.warns(UserWarning, match=r"only 3\.\d frames a period of 0\.13") as warned:
        (found,) = read(path, size=(102, 65)).meta["footage"]
    assert len(warned) == 1  # the base moves by 2 of 1300 pixels, and pushes are no cuts
    assert 1.0 / found["sampling"]["period_s"] == pytest.approx(7.2, rel=0.03)
    assert found["camera"]["max_px"] < 1.0


def test_real_pendulum(shared_data: Path) -> None:
    path = shared_data / "video" / "pendulum_pair" / "video2.mp4"
    with pytest.warns(UserWarning, match="the film") as warned:
        recording = read(path, crop=(0, 0, 250, 360), skip_s=1.5, size=(92, 64))
    said = [str(warning.message) for warning in warned]
    assert len(said) == 2  # the film jumps and begins again; the hand has gone, and the camera stands still
    assert "the film jumps at 12.279 s" in said[0]
    assert "the film repeats itself: from 12.2" in said[1]
    assert recording.frames.shape == (536, 92, 64, 3)
    assert recording.dt_s == pytest.approx(1001 / 30000, rel=1e-6)
    assert recording.time_s[0] == pytest.approx(1.5015, abs=1e-4)
    # The ball is the dark spot below the lamp; it swings with a period of 1.603 s, tracked by hand elsewhere.
    dark = np.clip(110.0 - recording.frames[:, 40:90].mean(axis=-1), 0, None)
    x = (dark.sum(axis=1) * np.arange(64)).sum(axis=1) / dark.sum(axis=(1, 2))
    upwards = np.flatnonzero(np.diff(np.sign(x - x.mean())) > 0)
    period_s = np.diff(recording.time_s[upwards]).mean()
    assert period_s == pytest.approx(1.603, rel=0.01)
