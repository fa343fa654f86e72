"""Bytes a film lacks by its own account."""

from pathlib import Path

import pytest

from lagsplat.io.video.decode import count_missing_bytes


def box(kind: bytes, content: bytes, *, size: int | None = None) -> bytes:
    return (size if size is not None else 8 + len(content)).to_bytes(4, "big") + kind + content


START = box(b"ftyp", b"isom")
LONG = (1).to_bytes(4, "big") + b"mdat" + (16 + 30).to_bytes(8, "big") + b"m" * 30


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        (START + box(b"mdat", b"m" * 30), 0),
        ((START + box(b"mdat", b"m" * 30))[:-7], 7),
        (START + LONG + box(b"moov", b""), 0),
        ((START + LONG)[:-9], 9),
        (START + box(b"mdat", b"m" * 30, size=0), 0),  # open-ended
        (START + box(b"mdat", b"", size=3) + box(b"free", b""), 0),  # damaged, but must end
        (START + b"\0\0", 6),
        (b"RIFF" + (40).to_bytes(4, "little") + b"A" * 40, 0),
        (b"RIFF" + (41).to_bytes(4, "little") + b"A" * 42, 0),  # padded to an even length
        (b"RIFF" + (40).to_bytes(4, "little") + b"A" * 25, 15),
        (b"\x1aE\xdf\xa3" + b"M" * 30, None),
        (b"", None),
    ],
)
def test_account(tmp_path: Path, content: bytes, missing: int | None) -> None:
    (tmp_path / "film").write_bytes(content)
    assert count_missing_bytes(tmp_path / "film") == missing


def test_hidden_frames_are_not_missing_bytes(shared_data: Path) -> None:
    assert count_missing_bytes(shared_data / "video" / "pendulum_pair" / "video2.mp4") == 0
