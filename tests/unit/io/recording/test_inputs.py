"""Inputs of a video come from the table beside it."""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.recording.inputs import add_inputs
from lagsplat.io.recording.recording import Recording


def film(**fields: object) -> Recording:
    given = {
        "frames": np.zeros((10, 2, 2, 3), np.uint8),
        "time_s": np.arange(10) / 10.0,
        "inputs": np.zeros((10, 0)),
        "input_names": (),
        "input_units": (),
        "meta": {"origin": "filmed", "source": "bag.mp4"},
    }
    return Recording(**(given | fields))  # type: ignore[arg-type]


def write(path: Path, rows: str) -> Path:
    path.write_text(f"t,u0,u1\n{rows}\n")
    return path


def test_inputs_are_interpolated_at_the_frames(tmp_path: Path) -> None:
    table = write(tmp_path / "bag.csv", "-1,0,1\n0.6,1.6,1\n2,3,1")
    driven = add_inputs(film(segments=((0, 4), (4, 10))), table)
    assert (driven.input_names, driven.segments) == (("u0", "u1"), ((0, 4), (4, 10)))
    np.testing.assert_allclose(driven.inputs, np.stack([1.0 + driven.time_s, np.ones(10)], axis=1))


def test_frames_without_inputs_are_left_out(tmp_path: Path) -> None:
    table = write(tmp_path / "bag.csv", "0.3,1,0\n0.7,2,0")
    with pytest.warns(UserWarning, match="bag.mp4: 5 frames without inputs"):
        driven = add_inputs(film(), table)
    np.testing.assert_allclose(driven.time_s, [0.3, 0.4, 0.5, 0.6, 0.7])
    with pytest.raises(ValueError, match="give both on one clock"):
        add_inputs(film(), write(tmp_path / "late.csv", "9.3,1,0\n9.7,2,0"))
    known = film(inputs=np.ones((10, 1)), input_names=("p1",), input_units=("atm",))
    with pytest.raises(ValueError, match="in the video and in a table"):
        add_inputs(known, table)


def test_a_file_that_is_no_table_is_named_as_what_it_was_read_as(tmp_path: Path) -> None:
    (tmp_path / "bag.csv").write_text("")
    with pytest.raises(ValueError, match=r"bag\.csv: .*read as the inputs of bag\.mp4, whose stem it has"):
        add_inputs(film(), tmp_path / "bag.csv")
