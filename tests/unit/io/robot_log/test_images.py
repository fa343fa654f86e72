"""Pictures of every encoding, against what they were made from."""

import base64
from typing import Any

import cv2
import numpy as np
import pytest

from lagsplat.io.robot_log.images import COMPRESSED, LAYOUTS, RAW, VIDEO, decode_image, image_kind

RNG = np.random.default_rng(0)
RGB = RNG.integers(0, 256, (4, 6, 3), np.uint8)
GREY = RGB[..., :1]
ALPHA = np.full((4, 6, 1), 9, np.uint8)


def raw(encoding: str, pixels: np.ndarray, *, pad: int = 0, **changes: Any) -> dict[str, Any]:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    data = np.pad(rows, ((0, 0), (0, pad)), constant_values=77).tobytes()
    message = {"encoding": encoding, "height": 4, "width": 6, "step": rows.shape[1] + pad, "data": data}
    return {**message, "data": base64.b64encode(data).decode(), **changes}


@pytest.mark.parametrize("pad", [0, 3])
@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", RGB, RGB),
        ("bgr8", RGB[..., ::-1], RGB),
        ("8UC3", RGB[..., ::-1], RGB),
        ("rgba8", np.concatenate([RGB, ALPHA], 2), RGB),
        ("bgra8", np.concatenate([RGB[..., ::-1], ALPHA], 2), RGB),
        ("mono8", GREY, GREY.repeat(3, 2)),
        ("mono16", GREY.astype("<u2") * 257, GREY.repeat(3, 2)),
        ("16UC1", GREY.astype("<u2") * 257 - (GREY > 0) * np.uint16(100), GREY.repeat(3, 2)),
        ("rgb16", RGB.astype("<u2") * 257, RGB),
    ],
)
def test_raw_pictures(encoding: str, pixels: np.ndarray, expected: np.ndarray, pad: int) -> None:
    found = decode_image(raw(encoding, pixels, pad=pad), RAW)[..., ::-1]
    np.testing.assert_array_equal(found, expected)


def test_big_endian_numbers() -> None:
    found = decode_image(raw("mono16", GREY.astype(">u2") * 257, is_bigendian=1), RAW)
    np.testing.assert_array_equal(found, GREY.repeat(3, 2))


@pytest.mark.parametrize(
    ("encoding", "luma_first"), [("yuv422", 0), ("uyvy", 0), ("yuv422_yuy2", 1), ("yuyv", 1)]
)
def test_grey_in_yuv(encoding: str, luma_first: int) -> None:
    luma = RNG.integers(16, 236, (4, 6), np.uint8)
    planes = [np.full((4, 6), 128, np.uint8), luma]
    found = decode_image(raw(encoding, np.stack(planes[::-1] if luma_first else planes, 2)), RAW)
    np.testing.assert_allclose(found[..., 0], (luma - 16.0) * 255 / 219, atol=1.5)
    assert np.ptp(found.astype(int), axis=2).max() <= 1


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_one_colour_through_a_bayer_filter(pattern: str) -> None:
    colour = {"r": 200, "g": 100, "b": 30}
    cell = np.array([colour[letter] for letter in pattern], np.uint8).reshape(2, 2)
    found = decode_image(raw(f"bayer_{pattern}8", np.tile(cell, (2, 3))[..., None]), RAW)
    np.testing.assert_array_equal(found[1:3, 1:5], np.broadcast_to([30, 100, 200], (2, 4, 3)))


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".webp", ".jpg"])
def test_compressed_pictures(suffix: str) -> None:
    smooth = cv2.resize(RGB[:2, :2], (48, 32), interpolation=cv2.INTER_CUBIC)
    settings = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    data = cv2.imencode(suffix, smooth, settings)[1].tobytes()
    found = decode_image({"format": suffix[1:], "data": base64.b64encode(data).decode()}, COMPRESSED)
    np.testing.assert_allclose(found.astype(int), smooth, atol=0 if suffix in (".png", ".bmp") else 12)


@pytest.mark.parametrize(
    ("message", "kind", "reason"),
    [
        (raw("32FC1", RGB), RAW, r"'32FC1' is unknown; those read are bgr8, .*mono16"),
        (raw("rgb8", RGB, height=5), RAW, "do not make 6 x 5 pixels"),
        (raw("rgb8", RGB, step=7), RAW, "with a step of 7"),
        (raw("rgb8", RGB, width=0), RAW, "do not make 0 x 4"),
        (raw("rgb8", RGB, data=""), RAW, "0 bytes"),
        (raw("rgb8", RGB, data="§"), RAW, "ASCII"),
        ({"encoding": "rgb8", "height": 4, "width": 6}, RAW, "no bytes in a field 'data'"),
        ({"format": "jpeg", "data": "AAAA"}, COMPRESSED, "3 bytes of format 'jpeg' are no image"),
        ({"format": "jpeg", "data": ""}, COMPRESSED, "0 bytes of format 'jpeg' are no image"),
    ],
)
def test_what_is_no_picture(message: dict, kind: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        decode_image(message, kind)


def test_kinds_by_schema() -> None:
    assert image_kind("sensor_msgs/msg/CompressedImage") == COMPRESSED
    assert image_kind("foxglove.RawImage") == image_kind("sensor_msgs/msg/Image") == RAW
    assert image_kind("foxglove.CompressedVideo") == image_kind("foxglove_msgs/msg/CompressedVideo") == VIDEO
    assert image_kind("sensor_msgs/msg/JointState") is image_kind("") is None
    assert {name.lower() for name in LAYOUTS} == set(LAYOUTS)
