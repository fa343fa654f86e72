"""Films in messages: VP9 as OpenCV writes it, H.264 as the standard spells a picture without compression."""

import struct
from collections.abc import Iterator
from pathlib import Path

import cv2
import foxglove
import numpy as np
import pytest
from foxglove.channels import CompressedVideoChannel
from foxglove.messages import CompressedVideo, Timestamp

from lagsplat.io.robot_log.images import VideoPackets
from lagsplat.io.robot_log.recording import read_log
from lagsplat.video_quality.frames import FrameSettings
from tests.unit.io.robot_log.mcap_files import topics

N = 12


@pytest.fixture
def packets() -> Iterator[VideoPackets]:
    file = VideoPackets()
    yield file
    file.close()


@pytest.fixture(scope="module")
def vp9(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    path: Path = tmp_path_factory.mktemp("film") / "film.ivf"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"VP90"), 25.0, (64, 48))
    for i in range(N):
        writer.write(np.full((48, 64, 3), 20 * i, np.uint8))
    writer.release()
    content, found, place = path.read_bytes(), [], 32
    while place < len(content):
        (length,) = struct.unpack_from("<I", content, place)
        found.append(content[place + 12 : place + 12 + length])
        place += 12 + length
    return found


def test_vp9(vp9: list[bytes], packets: VideoPackets) -> None:
    assert len(vp9) == N
    for packet in vp9:
        packets.add(packet, format="vp9")
    brightness = [picture.mean() for picture in packets.pictures()]
    np.testing.assert_allclose(brightness, 20.0 * np.arange(N), atol=6)


def test_a_film_in_a_log_is_cut_by_the_stamps_of_its_packets(tmp_path: Path, vp9: list[bytes]) -> None:
    path, context = tmp_path / "log.mcap", foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        camera = CompressedVideoChannel("/camera", context=context)
        for i, packet in enumerate(vp9):
            stamped = Timestamp(sec=100, nsec=40_000_000 * i)
            camera.log(CompressedVideo(timestamp=stamped, data=packet, format="vp9"), log_time=i)
    recording = read_log(path, topics(inputs=[]), FrameSettings(skip_s=0.1, end_s=0.3, size=(6, 8)))
    np.testing.assert_allclose(recording.time_s, 0.04 * np.arange(3, 8), atol=1e-9)
    np.testing.assert_allclose(recording.frames.mean(axis=(1, 2, 3)), 20.0 * np.arange(3, 8), atol=6)


class Bits:
    """Bits of an H.264 unit: fixed-length numbers and Exp-Golomb codes (ITU-T H.264, 9.1)."""

    def __init__(self) -> None:
        self.text = ""

    def u(self, value: int, length: int) -> None:
        self.text += f"{value:0{length}b}"

    def ue(self, *values: int) -> None:
        for value in values:
            code = f"{value + 1:b}"
            self.text += "0" * (len(code) - 1) + code

    def align(self, bit: str) -> None:
        self.text += bit * (-len(self.text) % 8)

    def unit(self, kind: int) -> bytes:
        """With start code; three bytes that look like one get an escape (7.4.1)."""
        self.text += "1"
        self.align("0")
        out = bytearray()
        for byte in int(self.text, 2).to_bytes(len(self.text) // 8, "big"):
            if out[-2:] == b"\0\0" and byte <= 3:
                out.append(3)
            out.append(byte)
        return b"\0\0\0\1" + bytes([kind]) + bytes(out)


def plain_h264(luma: np.ndarray) -> bytes:
    """One grey picture (16 a, 16 b) as an IDR access unit of I_PCM macroblocks (7.3.5)."""
    rows, columns = luma.shape[0] // 16, luma.shape[1] // 16
    sps, pps, piece = Bits(), Bits(), Bits()
    sps.u(66, 8)  # baseline
    sps.u(0, 8)
    sps.u(30, 8)
    sps.ue(0, 0, 2, 1)
    sps.u(0, 1)
    sps.ue(columns - 1, rows - 1)
    sps.u(0b1100, 4)  # frames only, direct 8x8, no crop, no VUI
    pps.ue(0, 0)
    pps.u(0, 2)
    pps.ue(0, 0, 0)
    pps.u(0, 3)
    pps.ue(0, 0, 0)
    pps.u(0b100, 3)  # deblocking may be switched off
    piece.ue(0, 7, 0)
    piece.u(0, 4)
    piece.ue(0)
    piece.u(0, 2)
    piece.ue(0, 1)  # no change of the quantiser; no deblocking
    for row in range(rows):
        for column in range(columns):
            piece.ue(25)  # I_PCM
            piece.align("0")
            block = luma[16 * row : 16 * row + 16, 16 * column : 16 * column + 16]
            for value in [*block.reshape(-1), *[128] * 128]:
                piece.u(int(value), 8)
    return sps.unit(0x67) + pps.unit(0x68) + piece.unit(0x65)


def test_h264(packets: VideoPackets) -> None:
    lumas = np.random.default_rng(0).integers(16, 236, (5, 32, 48), np.uint8)
    for luma in lumas:
        packets.add(plain_h264(luma), format="h264")
    found = list(packets.pictures())
    assert len(found) == 5
    for picture, luma in zip(found, lumas, strict=True):
        np.testing.assert_allclose(picture[..., 1], (luma - 16.0) * 255 / 219, atol=1.5)


def test_what_cannot_be_decoded(vp9: list[bytes], packets: VideoPackets) -> None:
    with pytest.raises(ValueError, match="format 'mpeg' is unknown; those read are h264, h265, vp9, av1"):
        packets.add(b"a", format="mpeg")
    packets.add(b"no film" * 50, format="h264")
    with pytest.raises(ValueError, match="changes from 'h264' to 'vp9'; transcode"):
        packets.add(vp9[0], format="vp9")
    with pytest.raises(ValueError, match="OpenCV cannot decode the 'h264' video on this machine; transcode"):
        list(packets.pictures())


def test_a_film_that_begins_between_key_frames_is_refused(vp9: list[bytes], packets: VideoPackets) -> None:
    for packet in [*vp9[:4], b"", *vp9[4:]]:
        packets.add(packet, format="vp9")
    with pytest.raises(
        ValueError, match="13 packets of 'vp9' video give 12 pictures, so times cannot be told"
    ):
        list(packets.pictures())
