"""Views by a stand-in for SHARP: filled once, kept by content, gone on with after kill -9, never mixed."""

import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.recording.recording import Recording, save_recording
from lagsplat.novel_views.sharp import make_sharp_views
from lagsplat.novel_views.sharp_tool import focal_px
from lagsplat.views.config import ArrangementConfig, SharpConfig
from lagsplat.views.novel import NovelViews, require_views
from tests.unit.stage1.solid import swinging_ball

FRAMES = 6
ARRANGEMENT = ArrangementConfig(yaw_deg=12.0, pitch_deg=4.0, columns=3, rows=3, held_out=1)
STAND_IN = Path(__file__).with_name("stand_in_sharp.py")


def recording(count: int = FRAMES) -> Recording:
    frames, _ = swinging_ball(24)
    return Recording(
        frames=np.ascontiguousarray(frames[:count]),
        time_s=np.arange(count) / 30,
        inputs=np.zeros((count, 0)),
        input_names=(),
        input_units=(),
        meta={"origin": "filmed"},
    )


@pytest.fixture
def sharp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SharpConfig:
    (tmp_path / "weights.pt").write_bytes(b"weights")
    monkeypatch.setenv("LIFTED", str(tmp_path / "lifted.txt"))
    return SharpConfig(
        command=f"{shlex.quote(sys.executable)} {shlex.quote(str(STAND_IN))}",
        checkpoint=str(tmp_path / "weights.pt"),
        cache=None,
        focal_35mm=40.0,
        upscale=4,
        keep_clouds=False,
        blur_px2=0.3,
    )


def lifted(folder: Path) -> int:
    path = folder / "lifted.txt"
    return len(path.read_text().splitlines()) if path.exists() else 0


def views(
    sharp: SharpConfig, folder: Path, arrangement: ArrangementConfig = ARRANGEMENT, count: int = FRAMES
) -> NovelViews:
    return make_sharp_views(recording(count), sharp, arrangement, folder / "cache")


def test_every_frame_is_seen_from_every_side_at_one_scale(sharp: SharpConfig, tmp_path: Path) -> None:
    found = views(sharp, tmp_path)
    require_views(found, recording().frames)
    assert found.images.shape == (FRAMES, 10, 18, 24, 3)
    assert found.space.reference.focal[0] == pytest.approx(focal_px(40.0, height=18, width=24))
    middle = found.names.index("yaw +0.0 pitch +0.0")
    error = np.square(found.images[:, middle, 1:-1, 1:-1].astype(float) - recording().frames[:, 1:-1, 1:-1])
    assert 10 * np.log10(255**2 / error.mean()) > 22  # the film's own side is the film
    # Depths were guessed up to 10 % apart; from the side the wall still stands in one place.
    aside = found.images[:, found.names.index("yaw +12.0 pitch +0.0"), :4].astype(float)
    assert np.abs(aside - aside[0]).mean() < 4
    assert found.cover is not None
    assert found.cover[:, middle, 4:-4, 4:-4].min() > 200
    assert lifted(tmp_path) == FRAMES
    assert not list((tmp_path / "cache").rglob("*.ply"))


def test_a_full_cache_needs_no_installation_and_other_frames_are_lifted(
    sharp: SharpConfig, tmp_path: Path
) -> None:
    first = views(sharp, tmp_path)
    again = views(replace(sharp, command=None, checkpoint=None), tmp_path)
    np.testing.assert_array_equal(first.images, again.images)
    assert lifted(tmp_path) == FRAMES
    more = views(sharp, tmp_path, count=FRAMES + 2)
    assert lifted(tmp_path) == FRAMES + 2
    np.testing.assert_array_equal(more.images[:FRAMES], first.images)


def test_other_cameras_settings_and_weights_are_refused(sharp: SharpConfig, tmp_path: Path) -> None:
    views(sharp, tmp_path)
    with pytest.raises(
        ValueError, match=r"was made with other cameras .*arrangement .*views\.sharp\.cache=FOLDER"
    ):
        views(sharp, tmp_path, replace(ARRANGEMENT, yaw_deg=10.0))
    with pytest.raises(
        ValueError, match=r"made with other cameras .*focal_35mm \(40\.0 there, 50\.0 asked\)"
    ):
        views(replace(sharp, focal_35mm=50.0), tmp_path)
    (tmp_path / "weights.pt").write_bytes(b"other")
    views(sharp, tmp_path)  # nothing is lifted, so nothing is mixed
    with pytest.raises(ValueError, match="lifted with other weights"):
        views(sharp, tmp_path, count=FRAMES + 1)


def test_a_half_written_file_is_made_again(sharp: SharpConfig, tmp_path: Path) -> None:
    first = views(sharp, tmp_path)
    files = sorted((tmp_path / "cache").glob("*.safetensors"))
    files[0].write_bytes(files[0].read_bytes()[:-100])
    files[1].write_bytes(b"")
    np.testing.assert_array_equal(views(sharp, tmp_path).images, first.images)
    assert lifted(tmp_path) == FRAMES + 2


def test_a_killed_run_goes_on_where_it_was(sharp: SharpConfig, tmp_path: Path) -> None:
    save_recording(tmp_path / "film.safetensors", recording())
    program = (
        "from pathlib import Path; from lagsplat.io.recording.recording import load_recording\n"
        "from lagsplat.novel_views.sharp import make_sharp_views\n"
        f"from lagsplat.views.config import ArrangementConfig, SharpConfig\n"
        f"make_sharp_views(load_recording({str(tmp_path / 'film.safetensors')!r}), {sharp!r}, "
        f"{ARRANGEMENT!r}, Path({str(tmp_path / 'cache')!r}))\n"
    )
    whole, half = "[!.]*.safetensors", ".killed.safetensors"
    environment = {
        **os.environ,
        "SLOW": "0.4",
        "LIFTED": str(tmp_path / "killed.txt"),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    process = subprocess.Popen([sys.executable, "-c", program], env=environment, stderr=subprocess.DEVNULL)
    began = time.monotonic()
    while len(list((tmp_path / "cache").glob(whole))) < 3 and time.monotonic() - began < 120:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").glob(whole)}
    assert 3 <= len(kept) < FRAMES
    (tmp_path / "cache" / half).write_bytes(b"half a file")
    found = views(sharp, tmp_path)
    assert lifted(tmp_path) == FRAMES - len(kept)
    assert not list((tmp_path / "cache").glob("lifting-*"))
    assert not list((tmp_path / "cache").glob(".*.safetensors"))
    assert all(path.stat().st_mtime_ns == at for path, at in kept.items())
    fresh = views(sharp, tmp_path / "fresh")
    np.testing.assert_array_equal(found.images, fresh.images)


def test_an_installation_that_is_missing_or_fails_is_told(
    sharp: SharpConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for change, message in (
        ({"command": None}, r"no installation is named\. SHARP .*research only"),
        ({"command": "no-such-sharp"}, "no such program"),
        ({"checkpoint": str(tmp_path / "none.pt")}, "no such file"),
    ):
        with pytest.raises(ValueError, match=message):
            views(replace(sharp, **change), tmp_path)
    monkeypatch.setenv("FAILS", "1")
    with pytest.raises(
        RuntimeError, match="exit code 1 and left 1 of 1 frames out; its last words: out of memory"
    ):
        views(sharp, tmp_path)


def test_two_runs_do_not_fill_one_cache(sharp: SharpConfig, tmp_path: Path) -> None:
    from lagsplat.novel_views.sharp_tool import SharpCache

    with (
        SharpCache(tmp_path / "cache").lock(),
        pytest.raises(BlockingIOError, match="another run fills the cache"),
    ):
        views(sharp, tmp_path)


def test_clouds_are_kept_on_request(sharp: SharpConfig, tmp_path: Path) -> None:
    views(replace(sharp, keep_clouds=True), tmp_path)
    assert len(list((tmp_path / "cache").glob("*.ply"))) == FRAMES
