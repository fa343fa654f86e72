"""Recordings from MCAP: the same from every writer, and every way a log can be wrong."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagsplat.io.mcap_read import read_mcap
from lagsplat.io.recording import Recording
from tests.unit.io.mcap_files import WRITERS, Take, by_rosbags, take


def read(path: Path, config: Any, **changes: Any) -> Recording:
    return read_mcap(path, config, **{"crop": None, "skip_s": 0.0, "size": None, **changes})


def interpolated(film: Take) -> np.ndarray:
    return np.stack([np.interp(film.frame_ns, film.joint_ns, column) for column in film.angles.T], axis=1)


@pytest.mark.parametrize("writer", WRITERS)
def test_every_writer_gives_the_recording(tmp_path: Path, writer: str) -> None:
    film = take()
    config = WRITERS[writer](tmp_path / "log.mcap", film)
    recording = read(tmp_path / "log.mcap", config)
    np.testing.assert_array_equal(recording.frames, film.frames)
    np.testing.assert_array_equal(recording.time_s, (film.frame_ns - film.frame_ns[0]) / 1e9)
    np.testing.assert_allclose(recording.inputs, interpolated(film), atol=1e-12)
    assert recording.input_names == ("shoulder", "elbow")
    assert recording.input_units == ("rad", "rad")
    assert recording.segments == ((0, len(film.frames)),)
    assert recording.meta["origin"] == "filmed"


def test_raw_pictures_with_padded_rows(tmp_path: Path) -> None:
    film = take()
    config = by_rosbags(tmp_path / "log.mcap", film, raw=True)
    np.testing.assert_array_equal(read(tmp_path / "log.mcap", config).frames, film.frames)
