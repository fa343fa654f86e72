"""Films in the messages of an MCAP log: ``CompressedVideo``, one coded picture a message.

OpenCV decodes files, not packets. So the packets are put one after another into a temporary file of the kind
its codec is streamed in, and that file is decoded.
"""

import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

STREAMS = {"h264": (".h264", b""), "h265": (".h265", b""), "vp9": (".ivf", b"VP90"), "av1": (".ivf", b"AV01")}
"""Suffix of a bare stream of each format, and its four letters where packets are wrapped in an IVF file."""
IVF_HEAD = struct.Struct("<4sHH4sHHIIII")
IVF_PACKET = struct.Struct("<IQ")
TRANSCODE = "transcode the film, for instance to H.264 without B-frames, or to pictures (CompressedImage)"


class PacketFile:
    """Packets of one film, collected to be decoded at the end, and deleted by `close`.

    Raises:
        ValueError: the format of a packet is unknown, or changes.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.format = ""
        self.count = 0

    def close(self) -> None:
        """Delete the packets."""
        self._folder.cleanup()

    @property
    def path(self) -> Path:
        """Where the packets are."""
        return Path(self._folder.name) / f"film{STREAMS[self.format][0]}"

    def add(self, packet: bytes, *, format: str) -> None:
        """Put one packet behind the others."""
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
        """The pictures, BGR, one a packet.

        Raises:
            ValueError: OpenCV cannot decode the film, or it yields more or fewer pictures than packets.
        """
        found = 0
        with _opened(self.path) as capture:
            while True:
                whole, picture = capture.read()
                if not whole:
                    break
                found += 1
                if found <= self.count:
                    yield picture
        if found != self.count:
            raise ValueError(
                f"{self.count} packets of {self.format!r} video give {found} pictures, so times cannot be "
                f"told; {TRANSCODE}"
                if found
                else f"OpenCV cannot decode the {self.format!r} video on this machine; {TRANSCODE}"
            )


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    capture = cv2.VideoCapture(str(path))
    try:
        yield capture
    finally:
        capture.release()
