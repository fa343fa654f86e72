"""MATLAB files with plain arrays are read as tables; what is no vector is refused with what was found."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from lagsplat.io.read import read_trajectory
from lagsplat.io.sources import find_sources

TIME_S = np.arange(5) * 0.1
Q = np.arange(10.0).reshape(5, 2)


@pytest.mark.parametrize("turned", [False, True])
def test_vectors_and_blocks_of_either_direction(tmp_path: Path, turned: bool) -> None:
    path = tmp_path / "log.mat"
    block = Q.T if turned else Q
    savemat(path, {"t": TIME_S, "q": block, "torque": Q[:, :1], "dt": 0.1, "note": "by hand"})
    found = read_trajectory(path, columns={"u0": "torque"})
    np.testing.assert_array_equal(found.time_s, TIME_S)
    np.testing.assert_array_equal(found.q, Q)
    np.testing.assert_array_equal(found.u, Q[:, :1])
    assert find_sources(str(path))[0].kind == "trajectory"


def test_programs_beside_a_file_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    savemat("log.mat", {"t": TIME_S, "q": Q})
    Path("scipy.py").write_text("open('ran', 'w')\nraise SystemExit(3)\n", encoding="utf-8")
    np.testing.assert_array_equal(read_trajectory(Path("log.mat")).q, Q)
    assert not Path("ran").exists()


def test_other_names_are_mapped(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"time": TIME_S[:, None], "angle": Q[:, 0]})
    found = read_trajectory(path, columns={"t": "time", "q0": "angle"})
    np.testing.assert_array_equal(found.q[:, 0], Q[:, 0])


def test_cells_and_structs_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    cells = np.empty(2, dtype=object)
    cells[:] = [TIME_S, Q]
    savemat(path, {"Y": cells, "run": {"t": TIME_S}})
    with pytest.raises(ValueError, match=r"no numeric vector among \['Y', 'run'\].*not in cells or structs"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"MATLAB 7.3 MAT-file" + b" " * 97 + b"\0" * 8 + b"\0\2IM", "7.3 is not read"),
        (b"t,q0\n0,1\n", "-v7"),
    ],
)
def test_other_files_are_refused_with_what_to_do(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "log.mat"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=said):
        read_trajectory(path)
