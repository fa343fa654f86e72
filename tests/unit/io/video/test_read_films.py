"""Several clips, folders of images, rotation, stabilisation, and films that break off."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lagsplat.io.video.read import CLIP_GAP_S, read_video
from lagsplat.video_quality.camera_motion import track_background
from lagsplat.video_quality.frames import FrameSettings
from tests.films import RATE, index_first, swing, tag_rotation, write_film


def read(path: Path, **changes: Any) -> Any:
    return read_video(path, FrameSettings(**changes))


def ramp(n: int, *, rows: int = 48, columns: int = 64, start: int = 0) -> np.ndarray:
    """Frames whose brightness tells which they are."""
    levels = (start + 5 * np.arange(n)).astype(np.uint8)
    return np.broadcast_to(levels[:, None, None, None], (n, rows, columns, 3)).copy()


def write_images(folder: Path, frames: np.ndarray) -> Path:
    folder.mkdir(exist_ok=True)
    for i, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"img{i}.png"), frame[..., ::-1])
    return folder


def test_clips_stay_apart_with_their_own_times(tmp_path: Path) -> None:
    write_film(tmp_path / "take2.mkv", ramp(8), codec="FFV1")
    write_film(tmp_path / "take10.mkv", ramp(6, start=100), codec="FFV1")
    recording = read(tmp_path, skip_s=0.08)
    assert recording.segments == ((0, 6), (6, 10))
    np.testing.assert_array_equal(recording.frames[:, 0, 0, 0], [*range(10, 40, 5), *range(110, 130, 5)])
    within = np.diff(recording.time_s)
    np.testing.assert_allclose(np.delete(within, 5), 1 / RATE, atol=1e-9)
    assert within[5] == pytest.approx(CLIP_GAP_S)
    assert recording.time_s[0] == pytest.approx(0.08)
    assert [clip["source"] for clip in recording.meta["clips"]] == ["take2.mkv", "take10.mkv"]
    before = recording.meta["sha256"]
    write_film(tmp_path / "take10.mkv", ramp(6, start=90), codec="FFV1")
    assert read(tmp_path).meta["sha256"] != before


def test_clips_of_one_shape_get_one_size(tmp_path: Path) -> None:
    write_film(tmp_path / "a.mkv", ramp(5, rows=48, columns=64), codec="FFV1")
    write_film(tmp_path / "b.mkv", ramp(5, rows=96, columns=128), codec="FFV1")
    with pytest.warns(UserWarning, match=r"a\.mkv 64 x 48, b\.mkv 128 x 96 px\); all are resized to 64 x 48"):
        assert read(tmp_path).frames.shape == (10, 48, 64, 3)
    with pytest.warns(UserWarning, match="takes the same pixels from each"):
        assert read(tmp_path, crop=(0, 0, 20, 30)).frames.shape == (10, 30, 20, 3)
    write_film(tmp_path / "c.mkv", ramp(5, rows=64, columns=64), codec="FFV1")
    with pytest.raises(ValueError, match=r"differ in shape \(a\.mkv 64 x 48, .*c\.mkv 64 x 64 px\)"):
        read(tmp_path)


def test_clips_of_different_rates_are_told(tmp_path: Path) -> None:
    write_film(tmp_path / "a.mkv", ramp(5), codec="FFV1", rate=25.0)
    write_film(tmp_path / "b.mkv", ramp(5), codec="FFV1", rate=50.0)
    with pytest.warns(UserWarning, match=r"a\.mkv 25\.000, b\.mkv 50\.000 frames/s"):
        recording = read(tmp_path)
    np.testing.assert_allclose(np.diff(recording.time_s[5:]), 0.02, atol=1e-9)


def test_images_are_read_in_order_with_given_times(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", ramp(12))
    recording = read(folder, dt_s=0.5, skip_s=1.0, end_s=4.0)
    np.testing.assert_array_equal(recording.frames[:, 0, 0, 0], np.arange(10, 40, 5))
    np.testing.assert_allclose(recording.time_s, np.arange(1.0, 4.0, 0.5))
    with pytest.raises(ValueError, match=r"12 images carry no times; give .*recording\.dt_s=SECONDS"):
        read(folder)
    times = np.cumsum(np.linspace(0.1, 0.2, 12))
    (folder / "times.csv").write_text("t\n" + "".join(f"{t}\n" for t in times), encoding="utf-8")
    np.testing.assert_allclose(read(folder).time_s, times)
    with pytest.raises(ValueError, match=r"gives the times, and so does recording\.dt_s = 0\.5"):
        read(folder, dt_s=0.5)


@pytest.mark.parametrize("table", ["t\n0\n1\n", "t\n0\n2\n1\n", "time\n0\n1\n2\n", "t\n0\nx\n2\n"])
def test_a_wrong_table_of_times_is_refused(tmp_path: Path, table: str) -> None:
    folder = write_images(tmp_path / "images", ramp(3))
    (folder / "times.csv").write_text(table, encoding="utf-8")
    with pytest.raises(ValueError, match=r"times\.csv: "):
        read(folder)


def test_images_that_do_not_fit_are_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", ramp(3))
    cv2.imwrite(str(folder / "img1.png"), np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(ValueError, match=r"img1\.png: 9 x 9 px, but the images before it are 64 x 48"):
        read(folder, dt_s=1.0)
    (folder / "img1.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"img1\.png: OpenCV cannot read this image"):
        read(folder, dt_s=1.0)


def test_a_film_has_its_own_times(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mkv", ramp(5), codec="FFV1")
    with pytest.raises(ValueError, match=r"dt_s is 0\.1, but a film's own timestamps are used"):
        read(path, dt_s=0.1)


@pytest.mark.parametrize(("degrees", "turns"), [(90, -1), (180, 2), (270, 1)])
def test_the_rotation_tag_is_obeyed_and_can_be_corrected(tmp_path: Path, degrees: int, turns: int) -> None:
    frames = ramp(5)
    frames[:, :24, :32] = 250  # one corner
    path = write_film(tmp_path / "a.mp4", frames, codec="mp4v")
    plain = read(path).frames
    tag_rotation(path, degrees)
    np.testing.assert_array_equal(read(path).frames, np.rot90(plain, turns, axes=(1, 2)))
    np.testing.assert_array_equal(read(path, rotate=360 - degrees).frames, plain)


def test_duplicates_at_the_start_are_dropped(tmp_path: Path) -> None:
    frames = ramp(12)
    frames[:2] = frames[2]
    path = write_film(tmp_path / "a.mkv", frames, codec="FFV1")
    with pytest.warns(UserWarning, match="the first 2 frames only repeat the next one; dropped"):
        recording = read(path)
    np.testing.assert_array_equal(recording.frames, frames[2:])
    assert recording.time_s[0] == pytest.approx(2 / RATE)
    still = write_film(tmp_path / "still.mkv", frames[:1].repeat(9, axis=0), codec="FFV1")
    assert read(still).n_frames == 9


def test_a_film_that_breaks_off_keeps_its_whole_frames(tmp_path: Path) -> None:
    frames, _ = swing(seconds=1.0)
    path = write_film(tmp_path / "a.mp4", frames[:20], codec="mp4v")
    content = index_first(path.read_bytes())
    path.write_bytes(content)
    whole = read(path).frames
    assert len(whole) == 20
    path.write_bytes(content[: 6 * len(content) // 10])
    with pytest.warns(UserWarning, match=r"only \d+ frames are whole, .* \d+ bytes are missing") as warned:
        recording = read(path)
    assert 3 < recording.n_frames < 19
    assert f"only {recording.n_frames} frames" in str(warned[0].message)
    np.testing.assert_array_equal(recording.frames, whole[: recording.n_frames])


def test_a_shake_is_removed(tmp_path: Path) -> None:
    def camera(t: float) -> tuple[float, float]:
        return 3.0 * np.sin(2 * np.pi * 2.1 * t), 0.7 * t + 1.5 * np.sin(2 * np.pi * 3.7 * t)

    frames, time_s = swing(seconds=2.0, shape=(240, 320), camera=camera)
    path = write_film(tmp_path / "a.mkv", frames, codec="FFV1")
    with pytest.warns(UserWarning, match="camera moves by"):
        shaken = read(path).frames
    steady = read(path, stabilise=True).frames
    true = np.array([camera(t) for t in time_s])

    def rms(pictures: np.ndarray, undone: np.ndarray) -> float:
        moved = track_background(np.ascontiguousarray(picture[..., 0]) for picture in pictures)
        assert moved is not None
        return float(np.sqrt(((moved.mean(axis=1) - (undone - undone[0])) ** 2).sum(axis=1).mean()))

    assert rms(shaken, true) < 0.1
    assert rms(steady, 0.0 * true) < 0.1
    # Against a film whose camera never moved: no worse than noise and interpolation, within the border.
    still = swing(seconds=2.0, shape=(240, 320))[0]
    inside = (slice(None), slice(12, -12), slice(12, -12))
    error = np.abs(steady[inside].astype(float) - still[inside]).mean()
    assert error < 3.0 < np.abs(shaken[inside].astype(float) - still[inside]).mean()


def test_without_a_background_nothing_is_stabilised(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mkv", ramp(10), codec="FFV1")
    with pytest.raises(ValueError, match=r"stabilise needs a background that can be followed"):
        read(path, stabilise=True)
