"""Krauss archives: what is read, and every way one can be wrong."""

import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagsplat.io import krauss
from lagsplat.io.krauss import read_krauss_npz

DT_S = 1001 / 60000
N = 30


@pytest.fixture
def images() -> np.ndarray:
    """(T, 3, H, W), higher than wide, every grey level present."""
    images = np.random.default_rng(0).integers(1, 256, (N, 3, 7, 5), dtype=np.uint8)
    images[0, 0, 0, :3] = (0, 255, 1)
    return images


@pytest.fixture
def arrays(images: np.ndarray) -> dict[str, np.ndarray]:
    return {"images": images, "p1": np.linspace(0, 1, N), "p2": np.linspace(1, 0, N, dtype=np.float32)}


def write(folder: Path, arrays: dict[str, Any], **changes: Any) -> Path:
    path = folder / "arm.npz"
    np.savez_compressed(
        path, **{key: value for key, value in {**arrays, **changes}.items() if value is not None}
    )
    return path


def read(path: Path, n_inputs: int = 2) -> Any:
    return read_krauss_npz(path, dt_s=DT_S, expected_inputs=n_inputs)


def test_channels_move_last_and_clock_is_given(tmp_path: Path, arrays: dict) -> None:
    recording = read(write(tmp_path, arrays))
    np.testing.assert_array_equal(recording.frames, arrays["images"].transpose(0, 2, 3, 1))
    np.testing.assert_allclose(recording.time_s, DT_S * np.arange(N), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(recording.inputs, np.stack([arrays["p1"], arrays["p2"]], axis=1))
    assert recording.input_names == ("p1", "p2")
    assert recording.input_units == ("atm", "atm")
    assert recording.segments == ((0, N),)
    assert recording.meta["origin"] == "filmed"
    assert len(recording.meta["sha256"]) == 64


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_multiples_of_one_255th_lose_nothing(
    tmp_path: Path, arrays: dict, dtype: Any, order: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(krauss, "CHUNK_BYTES", 1000)  # several pieces, the last one shorter
    scaled = np.asarray((arrays["images"] / 255.0).astype(dtype), order=order)  # type: ignore[call-overload]
    recording = read(write(tmp_path, arrays, images=scaled))
    np.testing.assert_array_equal(recording.frames, arrays["images"].transpose(0, 2, 3, 1))


def test_rounding_is_warned_of(tmp_path: Path, arrays: dict) -> None:
    images = np.full((N, 3, 2, 2), 100.4 / 255, np.float32)
    with pytest.warns(UserWarning, match=r"not multiples of 1/255.* up to 0\.40 of a grey level"):
        recording = read(write(tmp_path, arrays, images=images))
    assert (recording.frames == 100).all()


def test_black_frames_are_warned_of(tmp_path: Path, arrays: dict, images: np.ndarray) -> None:
    images[3:5] = 0
    with pytest.warns(UserWarning, match=r"arm\.npz: 2 of 30 frames are entirely black"):
        read(write(tmp_path, arrays))


def with_value(array: np.ndarray, index: tuple, value: float) -> np.ndarray:
    changed = array.astype(np.float64)
    changed[index] = value
    return changed


GREY = np.full((N, 3, 7, 5), 0.2)
FLAT = np.full(N, 0.5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": None}, r"no key 'images', only \['p1', 'p2'\]"),
        ({"images": np.ones((N, 7, 5, 3), np.uint8)}, r"shape \(30, 7, 5, 3\).*channels come second"),
        ({"images": np.ones((N, 7, 5), np.uint8)}, r"shape \(30, 7, 5\), not \(T, 3, H, W\)"),
        ({"images": np.ones((0, 3, 7, 5), np.uint8)}, "not"),
        ({"images": np.ones((N, 3, 7, 5), np.int64)}, "dtype int64; store uint8"),
        ({"images": 255 * GREY}, r"holds 51\.0 at frame 0.*lie in \[0, 1\]\. Divide by 255"),
        (
            {"images": with_value(GREY, (21, 2, 6, 4), np.nan)},
            "holds nan at frame 21, channel 2, row 6, column 4",
        ),
        ({"images": with_value(GREY, (2, 1, 0, 3), -0.01)}, r"holds -0\.01 at frame 2"),
        ({"p1": None}, r"channels \['p2'\], but the system has 2, from 'p1' on"),
        ({"p2": None}, r"channels \['p1'\], but the system has 2"),
        ({"p4": FLAT}, r"channels \['p1', 'p2', 'p4'\], but the system has 2"),
        ({"p3": FLAT}, r"channels \['p1', 'p2', 'p3'\], but the system has 2"),
        ({"p1": FLAT[:-1]}, r"'p1' has shape \(29,\).*there are 30 images"),
        ({"p1": FLAT[:, None]}, r"'p1' has shape \(30, 1\)"),
        ({"p1": np.array(["0.5"] * N)}, "'p1' has shape .* dtype <U3"),
        ({"p2": with_value(FLAT, (17,), np.nan)}, r"'p2' is nan at frame 17 \(1 such"),
        ({"p2": with_value(FLAT, (0,), np.inf)}, "'p2' is inf at frame 0"),
        ({"p1": np.array([0.5] * N, dtype=object)}, "'p1' holds Python objects"),
        ({"images": np.array([[[[None]]] * 3] * N)}, "'images' holds Python objects"),
    ],
)
def test_bad_content_is_named(tmp_path: Path, arrays: dict, changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=rf"arm\.npz.*{message}"):
        read(write(tmp_path, arrays, **changes))


def test_loading_runs_no_code(tmp_path: Path, arrays: dict) -> None:
    class Trap:
        def __reduce__(self) -> tuple:
            return (Path(tmp_path / "sprung").touch, ())

    path = write(tmp_path, arrays, p1=np.array([Trap()] * N, dtype=object))
    with pytest.raises(ValueError, match="could execute code"):
        read(path)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_truncated_archive(tmp_path: Path, arrays: dict, share: float) -> None:
    path = write(tmp_path, arrays)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"arm\.npz: truncated or not an NPZ archive .*fetch it again"):
        read(path)


def test_flipped_byte_is_found(tmp_path: Path, arrays: dict) -> None:
    path = tmp_path / "arm.npz"
    np.savez(path, **arrays)
    content = bytearray(path.read_bytes())
    content[1500] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="Bad CRC-32"):
        read(path)


@pytest.mark.parametrize("key", ["images", "p2"])
def test_member_that_ends_early(tmp_path: Path, arrays: dict, key: str) -> None:
    whole = write(tmp_path, arrays)
    short = tmp_path / "short.npz"
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(short, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, content[:-11] if name == f"{key}.npy" else content)
    with pytest.raises(ValueError, match=rf"short\.npz: key '{key}' ends 11 bytes early"):
        read(short)


def test_member_that_is_no_array(tmp_path: Path, arrays: dict) -> None:
    path = write(tmp_path, arrays, p2=None)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("p2.npy", "0.1 0.2 0.3")
    with pytest.raises(ValueError, match="key 'p2' is not a plain NumPy array"):
        read(path)


def test_missing_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"absent\.npz: no such file; check recording\.path"):
        read(tmp_path / "absent.npz")
    np.save(tmp_path / "plain.npy", np.zeros(3))
    with pytest.raises(ValueError, match="truncated or not an NPZ archive"):
        read(tmp_path / "plain.npy")


@pytest.mark.parametrize(("name", "n_inputs"), [("2seg_32x32_59fps_TWIN", 4), ("1seg_32x32_59fps_TWIN", 2)])
def test_recordings_in_the_published_schema(shared_data: Path, name: str, n_inputs: int) -> None:
    path = shared_data / "krauss_twin" / f"scr_dataset_raw_{name}.npz"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = read(path, n_inputs)
    assert recording.frames.shape == (20_000, 32, 32, 3)
    assert recording.inputs.shape == (20_000, n_inputs)
    assert recording.dt_s == pytest.approx(DT_S, rel=1e-9)
    with np.load(path) as archive:
        np.testing.assert_array_equal(recording.frames[::997], archive["images"][::997].transpose(0, 2, 3, 1))
    assert not recording.inputs[19_500:].any()  # the depressurised tail
    with pytest.raises(ValueError, match="Check system="):
        read(path, 6 - n_inputs)
