"""Decode the camera's messages: ``CompressedImage``, ``Image``, ``RawImage`` and ``CompressedVideo``.

Images are processed as they arrive, so memory holds only the result. Colours become eight bits per channel,
BGR as in OpenCV. Sixteen bits are divided by 257, which maps the ends of one range to those of the other.
OpenCV decodes files, not packets, so the packets of a video are concatenated in a temporary file of the
codec's stream format, which is then decoded.
"""

import base64
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.robot_log.messages import read_field
from lagsplat.video_quality.frames import FrameSettings, Thumbnails, crop_and_resize, rotate_image


class CameraReader:
    """Frames of one topic, by the number of their message.

    A message that cannot be decoded is skipped and listed in ``damaged``, unless it is the first. ``source``
    is the file's name in errors. Close it: it may make a temporary file.
    """

    def __init__(self, topic: str, settings: FrameSettings, *, source: str) -> None:
        self.topic, self.settings, self.source = topic, settings, source
        self.frames: dict[int, np.ndarray] = {}
        self.damaged: list[str] = []
        self.thumbnails = Thumbnails()
        self.start_ns = 0  # time of the first message
        self._packets = VideoPackets()
        self._wanted: list[bool] = []

    def close(self) -> None:
        """Delete the temporary file."""
        self._packets.close()

    def add(self, message: Any, schema_name: str, now_ns: int) -> None:
        """Take the next message, of the time ``now_ns``; keep its image if it is not cut off.

        Raises:
            ValueError: the topic has no images, the first cannot be decoded, or a video changes format.
        """
        number, end_s = len(self._wanted), self.settings.end_s
        if number == 0:
            self.start_ns = now_ns
        since_ns = now_ns - self.start_ns
        wanted = since_ns >= round(1e9 * self.settings.skip_s)
        wanted = wanted and (end_s is None or since_ns < round(1e9 * end_s))
        self._wanted.append(wanted)
        kind = image_kind(schema_name)
        if kind is None:
            problem = f"{schema_name}, which is no picture; choose one of {', '.join(MESSAGES)}"
            raise ValueError(f"topic {self.topic} holds {problem}")
        try:
            if kind == VIDEO:
                self._packets.add(message_bytes(message), format=str(read_field(message, "format")))
            elif wanted:
                self._keep(number, decode_image(message, kind))
        except ValueError as error:
            if kind == VIDEO or not self.frames:
                raise ValueError(f"topic {self.topic}, message {number}: {error}") from error
            self.damaged.append(f"message {number}: {error}")

    def finish(self) -> None:
        """Decode the video, if the topic is one.

        Raises:
            ValueError: it cannot be decoded, or the numbers of its images and packets differ.
        """
        if self._packets.count:
            for number, picture in enumerate(self._packets.pictures()):
                if self._wanted[number]:
                    self._keep(number, picture)

    def _keep(self, number: int, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        picture = rotate_image(picture, self.settings.rotate)
        self.thumbnails.add(picture)
        self.frames[number] = crop_and_resize(picture, self.settings, source=self.source)


COMPRESSED, RAW, VIDEO = "compressed", "raw", "video"
MESSAGES = {"CompressedImage": COMPRESSED, "Image": RAW, "RawImage": RAW, "CompressedVideo": VIDEO}
ENCODINGS: dict[tuple[int, type[np.unsignedinteger], int | None], tuple[str, ...]] = {
    (3, np.uint8, None): ("bgr8", "8uc3"),
    (3, np.uint8, cv2.COLOR_RGB2BGR): ("rgb8",),
    (4, np.uint8, cv2.COLOR_BGRA2BGR): ("bgra8", "8uc4"),
    (4, np.uint8, cv2.COLOR_RGBA2BGR): ("rgba8",),
    (1, np.uint8, cv2.COLOR_GRAY2BGR): ("mono8", "8uc1"),
    (1, np.uint16, cv2.COLOR_GRAY2BGR): ("mono16", "16uc1"),
    (3, np.uint16, None): ("bgr16",),
    (3, np.uint16, cv2.COLOR_RGB2BGR): ("rgb16",),
    (2, np.uint8, cv2.COLOR_YUV2BGR_UYVY): ("yuv422", "uyvy"),
    (2, np.uint8, cv2.COLOR_YUV2BGR_YUY2): ("yuv422_yuy2", "yuyv"),
    (1, np.uint8, cv2.COLOR_BayerRGGB2BGR): ("bayer_rggb8",),
    (1, np.uint8, cv2.COLOR_BayerBGGR2BGR): ("bayer_bggr8",),
    (1, np.uint8, cv2.COLOR_BayerGBRG2BGR): ("bayer_gbrg8",),
    (1, np.uint8, cv2.COLOR_BayerGRBG2BGR): ("bayer_grbg8",),
}
"""Names of every layout: channels, number type, and OpenCV's conversion to BGR."""
LAYOUTS = {name: layout for layout, names in ENCODINGS.items() for name in names}


def image_kind(schema_name: str) -> str | None:
    """``compressed``, ``raw`` or ``video`` by the last name of the schema; None if it is no image."""
    return MESSAGES.get(schema_name.replace("/", ".").rpartition(".")[2])


def message_bytes(message: Any) -> bytes:
    """The field ``data``: bytes, or base64 text in a JSON message.

    Raises:
        ValueError: there is no such field, or it is not base64.
    """
    data = read_field(message, "data")
    if isinstance(data, str):
        return base64.b64decode(data, validate=True)
    if not isinstance(data, bytes | bytearray | memoryview):
        raise ValueError("it has no bytes in a field 'data'")
    return bytes(data)


def decode_image(message: Any, kind: str) -> UInt8[np.ndarray, "h w 3"]:
    """Decode a message of kind ``compressed`` or ``raw`` to a BGR image.

    Raises:
        ValueError: the encoding is unknown, or the bytes are no valid image.
    """
    if kind == RAW:
        return _decode_raw(message)
    data = np.frombuffer(message_bytes(message), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if picture is None:
        content = f"{data.size} bytes of format {read_field(message, 'format')!r}"
        raise ValueError(f"{content} are no image that OpenCV decodes (JPEG, PNG, WebP, TIFF, BMP)")
    return picture


def _decode_raw(message: Any) -> UInt8[np.ndarray, "h w 3"]:
    encoding = str(read_field(message, "encoding"))
    if encoding.lower() not in LAYOUTS:
        raise ValueError(f"its encoding {encoding!r} is unknown; those read are {', '.join(LAYOUTS)}")
    channels, numbers, conversion = LAYOUTS[encoding.lower()]
    dtype = np.dtype(numbers).newbyteorder(">" if read_field(message, "is_bigendian") else "<")
    height, width = int(read_field(message, "height") or 0), int(read_field(message, "width") or 0)
    row = width * channels * dtype.itemsize
    step = int(read_field(message, "step") or 0) or row  # zero means rows without padding
    data = message_bytes(message)
    # The last row may lack its padding.
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


STREAMS = {"h264": (".h264", b""), "h265": (".h265", b""), "vp9": (".ivf", b"VP90"), "av1": (".ivf", b"AV01")}
"""Suffix of each format's bare stream, and its FourCC if packets are wrapped in an IVF file."""
IVF_HEAD = struct.Struct("<4sHH4sHHIIII")
IVF_PACKET = struct.Struct("<IQ")
TRANSCODE = "transcode the film, for instance to H.264 without B-frames, or to pictures (CompressedImage)"


class VideoPackets:
    """Packets of one video in a temporary file, decoded at the end and deleted by `close`."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.format = ""
        self.count = 0

    def close(self) -> None:
        """Delete the temporary file."""
        self._folder.cleanup()

    @property
    def path(self) -> Path:
        """Path of the temporary file."""
        return Path(self._folder.name) / f"film{STREAMS[self.format][0]}"

    def add(self, packet: bytes, *, format: str) -> None:
        """Append one packet.

        Raises:
            ValueError: its format is unknown, or another than before.
        """
        if format not in STREAMS:
            raise ValueError(f"the video format {format!r} is unknown; those read are {', '.join(STREAMS)}")
        if self.count and format != self.format:
            raise ValueError(f"the video format changes from {self.format!r} to {format!r}; {TRANSCODE}")
        self.format = format
        letters = STREAMS[format][1]
        with self.path.open("ab") as file:
            if letters and not self.count:
                file.write(IVF_HEAD.pack(b"DKIF", 0, IVF_HEAD.size, letters, 0, 0, 1000, 1, 0, 0))
            if letters:
                file.write(IVF_PACKET.pack(len(packet), self.count))
            file.write(packet)
        self.count += 1

    def pictures(self) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """Yield the images, BGR, one per packet.

        Raises:
            ValueError: OpenCV cannot decode the video, or the numbers of images and packets differ.
        """
        found, capture = 0, cv2.VideoCapture(str(self.path))
        try:
            while (read := capture.read())[0]:
                found += 1
                if found <= self.count:
                    yield read[1]
        finally:
            capture.release()
        if found == 0:
            raise ValueError(f"OpenCV cannot decode the {self.format!r} video on this machine; {TRANSCODE}")
        if found != self.count:
            counts = f"{self.count} packets of {self.format!r} video give {found} pictures"
            raise ValueError(f"{counts}, so times cannot be told; {TRANSCODE}")
