"""Pictures in the messages of an MCAP log: ``CompressedImage``, ``Image`` and ``RawImage``.

Colours become eight bits a channel, BGR as in OpenCV. Sixteen bits are divided by 257, so that the ends of
the two ranges meet.
"""

import base64
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.mcap_message import field_of

COMPRESSED, RAW, VIDEO = "compressed", "raw", "video"
MESSAGES = {"CompressedImage": COMPRESSED, "Image": RAW, "RawImage": RAW, "CompressedVideo": VIDEO}
LAYOUTS: dict[str, tuple[int, type[np.unsignedinteger], int | None]] = {
    "bgr8": (3, np.uint8, None),
    "8uc3": (3, np.uint8, None),
    "rgb8": (3, np.uint8, cv2.COLOR_RGB2BGR),
    "bgra8": (4, np.uint8, cv2.COLOR_BGRA2BGR),
    "8uc4": (4, np.uint8, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, np.uint8, cv2.COLOR_RGBA2BGR),
    "mono8": (1, np.uint8, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, np.uint8, cv2.COLOR_GRAY2BGR),
    "mono16": (1, np.uint16, cv2.COLOR_GRAY2BGR),
    "16uc1": (1, np.uint16, cv2.COLOR_GRAY2BGR),
    "bgr16": (3, np.uint16, None),
    "rgb16": (3, np.uint16, cv2.COLOR_RGB2BGR),
    "yuv422": (2, np.uint8, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, np.uint8, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, np.uint8, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, np.uint8, cv2.COLOR_YUV2BGR_YUY2),
    "bayer_rggb8": (1, np.uint8, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, np.uint8, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, np.uint8, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, np.uint8, cv2.COLOR_BayerGRBG2BGR),
}
"""Of each encoding: channels, numbers, and OpenCV's conversion to BGR."""


def message_kind(schema_name: str) -> str | None:
    """``compressed``, ``raw`` or ``video`` by the last name of the schema; None where it is no picture."""
    return MESSAGES.get(schema_name.replace("/", ".").rpartition(".")[2])


def bytes_of(message: Any) -> bytes:
    """The field ``data``: bytes, or base64 text where the message is JSON.

    Raises:
        ValueError: there is no such field, or it is not base64.
    """
    data = field_of(message, "data")
    if isinstance(data, str):
        return base64.b64decode(data, validate=True)
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError("it has no bytes in a field 'data'")
    return bytes(data)


def picture_of(message: Any, kind: str) -> UInt8[np.ndarray, "h w 3"]:
    """The picture of a message of kind ``compressed`` or ``raw``, BGR.

    Raises:
        ValueError: the encoding is unknown, or the bytes do not make a picture.
    """
    return _decompressed(message) if kind == COMPRESSED else _raw(message)


def _decompressed(message: Any) -> UInt8[np.ndarray, "h w 3"]:
    data = np.frombuffer(bytes_of(message), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if picture is None:
        raise ValueError(
            f"{data.size} bytes of format {field_of(message, 'format')!r} are no picture that OpenCV decodes "
            "(JPEG, PNG, WebP, TIFF, BMP)"
        )
    return picture


def _raw(message: Any) -> UInt8[np.ndarray, "h w 3"]:
    encoding = str(field_of(message, "encoding"))
    if encoding.lower() not in LAYOUTS:
        raise ValueError(f"its encoding {encoding!r} is unknown; those read are {', '.join(LAYOUTS)}")
    channels, numbers, conversion = LAYOUTS[encoding.lower()]
    dtype = np.dtype(numbers).newbyteorder(">" if field_of(message, "is_bigendian") else "<")
    height, width = int(field_of(message, "height") or 0), int(field_of(message, "width") or 0)
    row = width * channels * dtype.itemsize
    step = int(field_of(message, "step") or 0) or row  # zero stands for rows without padding
    data = bytes_of(message)
    # The padding of the last row may be left out.
    if not row or step < row or len(data) < step * (height - 1) + row or not height:
        raise ValueError(
            f"{len(data)} bytes with a step of {step} do not make {width} x {height} pixels of {encoding!r}"
        )
    padded = np.frombuffer(data[: step * height].ljust(step * height, b"\0"), np.uint8).reshape(height, step)
    pixels = np.ascontiguousarray(padded[:, :row]).view(dtype).reshape(height, width, channels)
    if numbers is np.uint16:
        pixels = np.rint(pixels / 257.0).astype(np.uint8)
    pixels = np.ascontiguousarray(pixels.astype(np.uint8, copy=False))
    return pixels if conversion is None else cv2.cvtColor(pixels, conversion)
