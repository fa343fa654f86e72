"""HDF5 files written by h5py: plain datasets, demonstrations, and what is refused with its place."""

import json
import pickle
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from lagsplat.io.read import read_trajectory
from lagsplat.io.sources import find_sources
from lagsplat.io.trajectory.hdf5 import survey_hdf5
from lagsplat.report.inspection.dataset import describe_hdf5

TIME_S = np.arange(20) * 0.1
ANGLES = np.stack([np.sin(TIME_S), np.cos(TIME_S)], axis=1)


def written(path: Path, fill: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "w") as file:
        fill(file)
    return path


def fill_plain(file: h5py.File) -> None:
    file["time"] = TIME_S
    file["arm/angle"] = ANGLES
    file["arm/torque"] = ANGLES[:, 0].astype(np.float32)
    file["calibration"] = np.eye(3)


def fill_demos(file: h5py.File, counts: tuple[int, ...] = (12, 9, 11)) -> None:
    """As robomimic lays out its datasets: `data/demo_N/obs`, `actions`, and settings as an attribute."""
    data = file.create_group("data")
    data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": {"control_freq": 20}})
    for number, rows in enumerate(counts):
        demo = data.create_group(f"demo_{number}")
        demo.attrs["num_samples"] = rows
        demo["actions"] = np.full((rows, 2), number, float)
        demo["obs/joint_pos"] = np.arange(3.0 * rows).reshape(rows, 3)
        demo["obs/image"] = np.zeros((rows, 4, 4, 3), np.uint8)
        demo["dones"] = np.zeros(rows, np.int64)


MAPPED = {"t": "time", "q0": "arm/angle[1]", "u0": "arm/torque"}


@pytest.mark.filterwarnings("ignore:a.h5. column")
def test_plain_datasets_by_their_paths(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", fill_plain)
    with pytest.warns(UserWarning, match=r"not of 20 rows as the time, and not used: calibration \(3\)"):
        motion = read_trajectory(path, columns=MAPPED)
    np.testing.assert_array_equal(motion.time_s, TIME_S)
    np.testing.assert_array_equal(motion.q[:, 0], ANGLES[:, 1])
    np.testing.assert_allclose(motion.u[:, 0], ANGLES[:, 0], rtol=1e-6)
    assert find_sources(str(path))[0].kind == "trajectory"


def test_standard_names_need_no_mapping(tmp_path: Path) -> None:
    def fill(file: h5py.File) -> None:
        file["t"], file["q"], file["u"] = TIME_S, ANGLES, ANGLES[:, 0]
        file["segment"] = np.repeat([0, 1], 10)

    motion = read_trajectory(written(tmp_path / "a.hdf5", fill))
    np.testing.assert_array_equal(motion.q, ANGLES)
    assert (motion.u_names, motion.segments) == (("u0",), ((0, 10), (10, 20)))


@pytest.mark.filterwarnings("ignore:a.h5. not of")
def test_a_name_that_is_not_there_is_answered_by_what_is(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", fill_plain)
    with pytest.raises(
        ValueError, match=r"no column t .*'arm/angle\[0\]'.*diagnose.columns=\{t: time, q0: arm"
    ):
        read_trajectory(path)
    with pytest.raises(ValueError, match=r"no column 'arm/angel\[0\]' for q0.*did you mean 'arm/angle"):
        read_trajectory(path, columns={**MAPPED, "q0": "arm/angel[0]"})


@pytest.mark.filterwarnings("ignore:a.h5. column")
def test_demonstrations_are_segments_at_the_rate_of_control(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path / "a.h5", fill_demos)
    Path("h5py.py").write_text("raise SystemExit('a program beside the file was run')", encoding="utf-8")
    columns = {"q0": "obs/joint_pos[2]", "u0": "actions[1]"}
    with pytest.warns(UserWarning, match=r"samples are 0\.05 s apart, by control_freq"):
        motion = read_trajectory(path, columns=columns)
    assert motion.segments == ((0, 12), (12, 21), (21, 32))
    np.testing.assert_allclose(motion.time_s[12:15] - motion.time_s[11], [1.0, 1.05, 1.1])
    np.testing.assert_array_equal(motion.q[12:21, 0], np.arange(9) * 3 + 2)
    np.testing.assert_array_equal(np.unique(motion.u), [0, 1, 2])


@pytest.mark.filterwarnings("ignore:a.h5. column")
def test_demonstrations_in_the_order_of_their_numbers_with_their_own_time(tmp_path: Path) -> None:
    def fill(file: h5py.File) -> None:
        fill_demos(file, (5,) * 11)
        for number in range(11):
            file[f"data/demo_{number}/stamp"] = 7.0 + 0.2 * np.arange(5)

    columns = {"t": "stamp", "q0": "obs/joint_pos[0]", "u0": "actions[0]"}
    motion = read_trajectory(written(tmp_path / "a.h5", fill), columns=columns)
    np.testing.assert_array_equal(motion.u[::5, 0], np.arange(11))
    assert motion.dt_s == pytest.approx(0.2)


def change(path: Path, edit: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "r+") as file:
        edit(file)
    return path


def drop_rows(file: h5py.File) -> None:
    short = file["data/demo_1/obs/joint_pos"][:-2]
    del file["data/demo_1/obs/joint_pos"]
    file["data/demo_1/obs/joint_pos"] = short


def drop_rate(file: h5py.File) -> None:
    file["data"].attrs["env_args"] = json.dumps({"env_kwargs": {}})


def drop_dataset(file: h5py.File) -> None:
    del file["data/demo_2/obs/joint_pos"]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (drop_rows, r"a.h5, data/demo_1/obs/joint_pos: shape \[7, 3\], where \[9, 3\] is due"),
        (drop_rate, r"a.h5, data/demo_0: no time: .* gives no control_freq. .*columns=\{t: NAME\}"),
        (drop_dataset, r"a.h5, data/demo_2/obs/joint_pos: missing, but data/demo_0/obs/joint_pos is there"),
    ],
)
def test_demonstrations_that_contradict_each_other(
    tmp_path: Path, edit: Callable[[h5py.File], object], message: str
) -> None:
    path = change(written(tmp_path / "a.h5", fill_demos), edit)
    with pytest.raises(ValueError, match=message):
        read_trajectory(path, columns={"q0": "obs/joint_pos[0]"})


def fill_strange(file: h5py.File) -> None:
    fill_plain(file)
    folder = Path(file.filename).parent
    with h5py.File(folder / "other.h5", "w") as other:
        other["secret"] = TIME_S
    file["outside"] = h5py.ExternalLink("other.h5", "secret")
    file["soft"] = h5py.SoftLink("/outside")
    file["words"] = np.array(["a", "b"] * 10, dtype=h5py.string_dtype())
    file["bytes"] = np.array([b"a"] * 20)
    file["ragged"] = np.array([np.arange(k % 3) for k in range(20)], dtype=h5py.vlen_dtype(float))
    file["pickled"] = np.void(pickle.dumps({"t": TIME_S}))
    file["records"] = np.zeros(20, [("t", float), ("q0", float)])
    (folder / "raw.bin").write_bytes(TIME_S.tobytes())
    file.create_dataset("raw", (20,), float, external=[("raw.bin", 0, 160)])
    layout = h5py.VirtualLayout((20,), float)
    layout[:] = h5py.VirtualSource(folder / "other.h5", "secret", (20,))
    file.create_virtual_dataset("virtual", layout)
    file["pictures"] = np.zeros((20, 4, 4))
    file["arm/self"] = file["arm"]


@pytest.mark.filterwarnings("ignore:a.h5")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("outside", r"a link to another file \(other.h5\); copy its data"),
        ("soft", r"a link to /outside; name that instead"),
        ("words", "text, references or arrays of any length; write plain numbers"),
        ("bytes", "text; write plain numbers"),
        ("ragged", "arrays of any length; write plain numbers"),
        ("pickled", "records or bytes; write plain numbers"),
        ("records", "records or bytes; write plain numbers"),
        ("raw", "its data are in another file; copy them"),
        ("virtual", "its data are in another file; copy them"),
        ("pictures", r"of shape \[20, 4, 4\]; a column is"),
    ],
)
def test_what_is_no_number_of_this_file_is_refused_where_it_is_named(
    tmp_path: Path, name: str, message: str
) -> None:
    path = written(tmp_path / "a.h5", fill_strange)
    with pytest.raises(ValueError, match=rf"a.h5, {name}: .*{message}"):
        read_trajectory(path, columns={**MAPPED, "q0": name})
    read_trajectory(path, columns=MAPPED)  # where it is not named it does no harm
    assert f"not read   {name}: " in describe_hdf5(survey_hdf5(path))


def test_files_that_links_lead_to_are_not_needed(tmp_path: Path) -> None:
    path = written(tmp_path / "a.h5", fill_strange)
    (tmp_path / "other.h5").unlink()
    (tmp_path / "raw.bin").unlink()
    survey_hdf5(path)
    with pytest.warns(UserWarning, match="not used"):
        read_trajectory(path, columns=MAPPED)


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.h5", fill_plain)
    content = path.read_bytes()
    for broken in (content[: len(content) // 2], b"t,q0\n0,1\n", b""):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=r"a\.h5: damaged or not an HDF5 file"):
            read_trajectory(path)
    written(path, lambda file: file.create_group("empty"))
    with pytest.raises(ValueError, match="no dataset of numbers"):
        read_trajectory(path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ValueError, match=r"pip install 'lagsplat\[hdf5\]'"):
        read_trajectory(path)


@pytest.mark.parametrize("free", [0, 2**62], ids=["the library does not come back", "the library says so"])
@pytest.mark.skipif(sys.platform == "win32", reason="seconds of a processor are bounded elsewhere")
def test_settings_in_a_damaged_heap(tmp_path: Path, free: int) -> None:
    path = written(tmp_path / "a.h5", fill_demos)
    data = bytearray(path.read_bytes())
    text = data.index(b"GCOL") + 16  # the first object of the heap, and after it the free space
    size = int.from_bytes(data[text + 8 : text + 16], "little")
    after = text + 16 + -(-size // 8) * 8
    data[after + 8 : after + 16] = free.to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.h5: damaged .*the attribute env_args of data cannot be read: "):
        read_trajectory(path)


def test_a_survey_lists_groups_and_says_how_to_use_them(tmp_path: Path) -> None:
    told = describe_hdf5(survey_hdf5(written(tmp_path / "a.h5", fill_plain)))
    assert "group      arm" in told
    assert "dataset    arm/angle [20, 2] float64" in told
    assert 'diagnose.columns={t: time, q0: "arm/angle[0]", q1: "arm/angle[1]", u0: arm/torque}' in told
    told = describe_hdf5(survey_hdf5(written(tmp_path / "b.h5", fill_demos)))
    assert "demos      3 of 9 to 12 samples" in told
    assert "columns    actions[0], actions[1], dones, obs/joint_pos[0]" in told
