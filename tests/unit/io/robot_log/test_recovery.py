"""A log cut anywhere gives a leading part of its messages, and says so."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from lagsplat.io.robot_log.recovery import read_whole_messages

N = 300


def write(path: Path, **settings: Any) -> list[bytes]:
    """Messages of noise, so that no codec shrinks them."""
    rng = np.random.default_rng(0)
    contents = [rng.bytes(1000) for _ in range(N)]
    with path.open("wb") as file:
        writer = Writer(file, **settings)
        writer.start()
        channel = writer.register_channel("/noise", "raw", 0)
        for i, content in enumerate(contents):
            writer.add_message(channel, i, content, i)
        writer.finish()
    return contents


def read(path: Path) -> tuple[list[bytes], list[str]]:
    losses: list[str] = []
    return [message.data for _, _, message in read_whole_messages(path, losses)], losses


@pytest.mark.parametrize(
    "settings",
    [
        {"use_chunking": False},
        {"compression": CompressionType.NONE, "chunk_size": 50_000},
        {"compression": CompressionType.NONE, "chunk_size": 10**7},
        {"compression": CompressionType.LZ4, "chunk_size": 10**7},
        {"compression": CompressionType.ZSTD, "chunk_size": 10**7},
    ],
    ids=str,
)
def test_every_cut_gives_a_leading_part(tmp_path: Path, settings: dict[str, Any]) -> None:
    path = tmp_path / "log.mcap"
    contents = write(path, **settings)
    assert read(path) == (contents, [])
    whole = path.read_bytes()
    # Codecs work in blocks, and what is in the last one is lost with it.
    block = 2**17 if settings.get("compression") in (CompressionType.LZ4, CompressionType.ZSTD) else 0
    for length in [*range(9, len(whole) - 9, 9973), len(whole) - 9]:  # the last 8 bytes tell nothing
        path.write_bytes(whole[:length])
        found, losses = read(path)
        assert found == contents[: len(found)]
        assert len(found) >= (length - block) // 1100 - 1
        assert "ends without its footer" in losses[0]


def test_a_file_filled_up_with_zeros(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    contents = write(path, use_chunking=False)
    path.write_bytes(path.read_bytes()[:100_000] + bytes(50_000))
    found, losses = read(path)
    assert len(found) > 80
    assert found[:-1] == contents[: len(found) - 1]  # nothing tells where zeros follow half a message
    assert "ends without its footer" in losses[0]


def test_a_damaged_chunk_loses_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    contents = write(path, chunk_size=50_000, compression=CompressionType.NONE)
    for place in (600, 150_000):  # the first chunk holds the channel, which the summary repeats
        damaged = bytearray(path.read_bytes())
        damaged[place] ^= 0xFF
        (tmp_path / "damaged.mcap").write_bytes(damaged)
        found, losses = read(tmp_path / "damaged.mcap")
        assert set(found) < set(contents)
        assert 0 < N - len(found) <= 51
        assert "is damaged (crc validation failed" in losses[0]


def test_an_unknown_codec(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path)
    path.write_bytes(path.read_bytes().replace(b"zstd", b"zstx"))
    with pytest.raises(ValueError, match="compressed with 'zstx'; those read are lz4, zstd and none"):
        read(path)
