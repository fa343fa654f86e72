"""Settings lead to the right reader with the right values."""

import hashlib
import io
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lagsplat.io.config import ArchiveConfig, RecordingConfig, SplitConfig
from lagsplat.io.read import read_recording


@pytest.fixture
def krauss(tmp_path: Path) -> RecordingConfig:
    images = np.full((10, 3, 4, 4), 9, np.uint8)
    np.savez(tmp_path / "arm.npz", images=images, p1=np.arange(10.0), p2=np.zeros(10))
    return RecordingConfig(
        kind="krauss",
        path=str(tmp_path / "arm.npz"),
        archive=None,
        member=None,
        dt_s=0.5,
        n_inputs=2,
        rotate=0,
        stabilise=False,
        grey=False,
        crop=None,
        skip_s=0.0,
        end_s=None,
        spans_s=None,
        height=None,
        width=None,
        split=SplitConfig(train_fraction=0.8, held_out_frames=None, held_out_clips=None),
        mcap=None,
    )


@pytest.fixture
def video(krauss: RecordingConfig, tmp_path: Path) -> RecordingConfig:
    path = tmp_path / "film.mkv"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 25.0, (64, 48))
    for i in range(20):
        writer.write(np.full((48, 64, 3), i, np.uint8))
    writer.release()
    return replace(
        krauss,
        kind="video",
        path=str(path),
        dt_s=None,
        n_inputs=0,
        crop=[0, 0, 32, 48],
        skip_s=0.2,
        end_s=0.6,
        height=12,
        width=8,
    )


def test_krauss_file(krauss: RecordingConfig) -> None:
    recording = read_recording(krauss)
    assert recording.dt_s == 0.5
    assert recording.inputs.shape == (10, 2)
    assert recording.meta["licence"] == "unknown"


def test_video_file(video: RecordingConfig) -> None:
    recording = read_recording(video)
    assert recording.frames.shape == (10, 12, 8, 3)
    assert recording.frames[0, 0, 0, 0] == 5
    assert recording.time_s[0] == pytest.approx(0.2)


def test_home_folder_is_understood(
    krauss: RecordingConfig, video: RecordingConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(Path(krauss.path).parent))  # type: ignore[arg-type]
    assert read_recording(replace(krauss, path="~/arm.npz")).n_frames == 10
    assert read_recording(replace(video, path="~/film.mkv")).n_frames == 10


def test_krauss_archive_brings_its_licence(krauss: RecordingConfig, site: Any, tmp_path: Path) -> None:
    content = Path(krauss.path).read_bytes()  # type: ignore[arg-type]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("processed/arm.npz", content)
    site.content = packed.getvalue()
    public = ArchiveConfig(
        url=site.url,
        folder=str(tmp_path / "data"),
        licence="CC BY-ND 4.0",
        archive_sha256=None,
        member_sha256={"processed/arm.npz": hashlib.sha256(content).hexdigest()},
    )
    fetched = read_recording(replace(krauss, path=None, archive=public, member="processed/arm.npz"))
    assert fetched.meta["licence"] == "CC BY-ND 4.0"
    assert fetched.meta["source"] == site.url
    by_hand = read_recording(replace(krauss, archive=public))
    assert by_hand.meta["licence"] == "CC BY-ND 4.0"  # known by its sum
    public.member_sha256["processed/arm.npz"] = "0" * 64
    assert read_recording(replace(krauss, archive=public)).meta["licence"] == "unknown"


def test_what_cannot_be_read(krauss: RecordingConfig, video: RecordingConfig) -> None:
    with pytest.raises(ValueError, match=r"kind is 'simulated'; only .* are read from a file"):
        read_recording(replace(krauss, kind="simulated"))
    with pytest.raises(ValueError, match=r"no archive with a member is given; give recording.path"):
        read_recording(replace(krauss, path=None))
    with pytest.raises(ValueError, match=r"recording.path is null; name the film or the log"):
        read_recording(replace(video, path=None))
    with pytest.raises(ValueError, match="n_inputs is 2, but a film carries no inputs"):
        read_recording(replace(video, n_inputs=2))
    with pytest.raises(FileNotFoundError, match="absent"):
        read_recording(replace(krauss, path="absent.npz"))
