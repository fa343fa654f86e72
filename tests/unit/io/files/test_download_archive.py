"""Members of a public archive: fetched once, checked, never fetched again when whole."""

import hashlib
import io
import threading
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lagsplat.io.config import ArchiveConfig
from lagsplat.io.files import download as module
from lagsplat.io.files.download import fetch_member

CONTENT = {
    "processed/one.npz": np.random.default_rng(1).bytes(300_000),
    "processed/two.npz": np.random.default_rng(2).bytes(1000),
}


def sums() -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in CONTENT.items()}


@pytest.fixture
def config(site: Any, tmp_path: Path) -> ArchiveConfig:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in CONTENT.items():
            archive.writestr(name, content)
    site.content = packed.getvalue()
    return ArchiveConfig(
        url=f"{site.url}?download=1",
        folder=str(tmp_path / "data"),
        licence="CC0",
        archive_sha256=None,
        member_sha256=sums(),
    )


def visible(folder: str) -> set[str]:
    return {path.name for path in Path(folder).iterdir() if not path.name.startswith(".")}


def test_member_is_fetched_once(config: ArchiveConfig, site: Any) -> None:
    path = fetch_member(config, "processed/one.npz")
    assert path.read_bytes() == CONTENT["processed/one.npz"]
    assert visible(config.folder) == {"one.npz", "data.bin"}
    fetch_member(config, "processed/two.npz")
    assert len(site.asked) == 1  # the archive was there
    (Path(config.folder) / "data.bin").unlink()
    assert fetch_member(config, "processed/one.npz") == path
    assert len(site.asked) == 1  # the member was there


def test_two_jobs_share_one_download(config: ArchiveConfig, site: Any) -> None:
    jobs = [threading.Thread(target=fetch_member, args=(config, name)) for name in CONTENT]
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    assert visible(config.folder) == {"one.npz", "two.npz", "data.bin"}
    assert len(site.asked) == 1


def test_interrupted_archive_goes_on(
    config: ArchiveConfig, site: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path(config.folder).mkdir()
    (Path(config.folder) / "data.bin.part").write_bytes(site.content[:200_000])
    fetch_member(config, "processed/one.npz")
    assert site.asked == ["bytes=200000-"]


def test_changed_member_is_told_with_both_sums(config: ArchiveConfig) -> None:
    found = config.member_sha256["processed/one.npz"]
    config.member_sha256["processed/one.npz"] = "0" * 64
    with pytest.raises(ValueError, match=rf"'processed/one\.npz' is {found}, expected {'0' * 64}"):
        fetch_member(config, "processed/one.npz")
    assert visible(config.folder) == {"data.bin"}


def test_damaged_archive(config: ArchiveConfig, site: Any) -> None:
    content = bytearray(site.content)
    content[5000] ^= 1
    site.content = bytes(content)
    with pytest.raises(ValueError, match=r"data\.bin: damaged \(Bad CRC-32.*delete it and run again"):
        fetch_member(config, "processed/one.npz")
    assert visible(config.folder) == {"data.bin"}


def test_something_else_than_an_archive(config: ArchiveConfig, site: Any) -> None:
    site.content = b"<html>Sorry</html>"
    with pytest.raises(ValueError, match="damaged"):
        fetch_member(config, "processed/one.npz")


def test_unknown_and_absent_members(config: ArchiveConfig) -> None:
    with pytest.raises(ValueError, match=r"recording\.member is 'three\.npz'"):
        fetch_member(config, "three.npz")
    config.member_sha256["three.npz"] = "0" * 64
    with pytest.raises(ValueError, match=r"no member 'three\.npz', only \['processed/one\.npz'"):
        fetch_member(config, "three.npz")


def test_changed_file_in_the_folder_is_left(config: ArchiveConfig, site: Any) -> None:
    path = fetch_member(config, "processed/two.npz")
    path.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match=r"two\.npz: SHA-256 is .*delete it and run again"):
        fetch_member(config, "processed/two.npz")
    assert path.read_bytes() == b"mine"


def test_room_is_checked(config: ArchiveConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    fetch_member(config, "processed/two.npz")
    monkeypatch.setattr(module.shutil, "disk_usage", lambda folder: SimpleNamespace(free=1000))
    with pytest.raises(OSError, match=r"one\.npz: needs 300000 bytes, but the disk has 1000 free"):
        fetch_member(config, "processed/one.npz")
