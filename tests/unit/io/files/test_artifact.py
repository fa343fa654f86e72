"""Artefacts: what is refused, what is lazy, what survives a failure."""

import resource
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from lagsplat.io.files.artifact import load_artifact, read_header, save_artifact

HEADER = {"kind": "chart", "schema": 2}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "chart.safetensors"
    save_artifact(path, {"mean": np.arange(4.0), "frames": np.ones((5, 6), np.uint8)}, HEADER)
    return path


@pytest.fixture
def small_files() -> Iterator[None]:
    """The operating system refuses to write past 4096 bytes of a file."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_mapped_tensors_are_lazy_and_others_may_be_changed(path: Path) -> None:
    tensors, _ = load_artifact(path, mapped=("frames",))
    assert isinstance(tensors["frames"], np.memmap)
    assert not tensors["frames"].flags.writeable
    tensors["mean"][0] = 7.0
    assert load_artifact(path)[0]["mean"][0] == 0.0


def test_stamp_is_added_but_a_given_one_stays(path: Path, tmp_path: Path) -> None:
    assert {"commit", "versions", "time_utc"} <= set(read_header(path)["stamp"])
    save_artifact(tmp_path / "b.safetensors", {}, {**HEADER, "stamp": "mine"})
    assert read_header(tmp_path / "b.safetensors")["stamp"] == "mine"


def test_torch_tensors_and_numpy_header_values(tmp_path: Path) -> None:
    weight = torch.arange(6.0).reshape(2, 3).T.requires_grad_()
    header = {**HEADER, "d": np.int64(4), "scale": np.array([1.5, 2.0]), "file": Path("a/b"), "clip": (0, 3)}
    save_artifact(tmp_path / "a.safetensors", {"w": weight}, header)
    tensors, found = load_artifact(tmp_path / "a.safetensors")
    np.testing.assert_array_equal(tensors["w"], weight.detach().numpy())
    assert [found[key] for key in ("d", "scale", "file", "clip")] == [4, [1.5, 2.0], "a/b", [0, 3]]


@pytest.mark.parametrize("keep", [0, 4, 40, -1])
def test_truncated_file_is_named(path: Path, keep: int) -> None:
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"chart\.safetensors: not a whole safetensors file.*run again"):
        load_artifact(path)


def test_no_flipped_bit_goes_unnoticed(tmp_path: Path) -> None:
    path = tmp_path / "chart.safetensors"
    tensors = {"mean": np.arange(3.0), "frames": np.ones((2, 3), np.uint8), "none": np.zeros((0, 2))}
    save_artifact(path, tensors, {**HEADER, "stamp": "mine", "scale": [1.5, 2.0]})
    content, (_, header) = path.read_bytes(), load_artifact(path)
    reasons = []
    for bit in range(0, 8 * len(content), 7):
        flipped = bytearray(content)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        try:
            found, found_header = load_artifact(path, kind="chart", mapped=("frames",))
        except ValueError as error:
            reasons.append(str(error))
            continue
        assert found_header == header
        assert all(np.array_equal(found[name], tensor) for name, tensor in tensors.items())
    for part in ("tensor 'mean'", "tensor 'frames'", "the header"):
        assert any(f"{part} is not what was written: its checksum differs" in text for text in reasons)
    assert all("chart.safetensors: " in text for text in reasons)


def test_a_file_from_before_there_were_checksums_opens(tmp_path: Path) -> None:
    path = tmp_path / "chart.safetensors"
    save_file({"a": np.arange(2.0)}, path, metadata={"lagsplat": '{"kind": "chart", "schema": 2}'})
    np.testing.assert_array_equal(load_artifact(path, kind="chart", schema=2)[0]["a"], [0.0, 1.0])


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    pickle = tmp_path / "weights.pt"
    torch.save({"a": 1}, pickle)
    with pytest.raises(ValueError, match=r"weights\.pt: not a whole safetensors file"):
        load_artifact(pickle)
    other = tmp_path / "other.safetensors"
    save_file({"a": np.zeros(2)}, other)
    with pytest.raises(ValueError, match="no 'lagsplat' header"):
        load_artifact(other)
    save_file({"a": np.zeros(2)}, other, metadata={"lagsplat": "{'kind"})
    with pytest.raises(ValueError, match="is not JSON"):
        load_artifact(other)
    save_file({"a": np.zeros(2)}, other, metadata={"lagsplat": "[]"})
    with pytest.raises(ValueError, match="names no kind"):
        load_artifact(other)
    with pytest.raises(FileNotFoundError, match="absent"):
        load_artifact(tmp_path / "absent.safetensors")


def test_wrong_kind_schema_and_tensor_are_refused(path: Path) -> None:
    with pytest.raises(ValueError, match="holds a 'chart', but a 'dynamics' is wanted"):
        load_artifact(path, kind="dynamics")
    with pytest.raises(ValueError, match="schema 2, but this version reads schema 3"):
        load_artifact(path, kind="chart", schema=3)
    with pytest.raises(ValueError, match=r"no tensor 'whiten', only \['frames', 'mean'\]"):
        load_artifact(path, mapped=("whiten",))


@pytest.mark.parametrize(
    ("tensors", "header", "message"),
    [
        ({}, {"schema": 1}, "kind = None"),
        ({}, {"kind": "chart", "schema": "1"}, "schema = '1'"),
        ({}, {**HEADER, "model": object()}, "header is not JSON"),
        ({"names": np.array(["p1"])}, HEADER, "'names' has dtype <U2"),
        ({"any": np.array([{}])}, HEADER, "'any' has dtype object"),
    ],
)
def test_what_cannot_be_kept_is_refused_before_writing(
    path: Path, tensors: dict, header: dict, message: str
) -> None:
    before = path.read_bytes()
    with pytest.raises(ValueError, match=message):
        save_artifact(path, tensors, header)
    assert path.read_bytes() == before


@pytest.mark.usefixtures("small_files")
def test_failed_write_leaves_the_earlier_file(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(OSError, match=r"chart\.safetensors was not written: .*largest size allowed"):
        save_artifact(path, {"big": np.zeros(100_000)}, HEADER)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_an_artefact_is_as_readable_as_any_other_file(tmp_path: Path) -> None:
    save_artifact(tmp_path / "a.safetensors", {"x": np.zeros(1)}, {"kind": "test", "schema": 1})
    (tmp_path / "other").touch()
    assert (tmp_path / "a.safetensors").stat().st_mode == (tmp_path / "other").stat().st_mode
