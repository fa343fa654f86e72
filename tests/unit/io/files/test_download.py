"""Downloads: resumed, checked, patient, and careful with what is there."""

import hashlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lagsplat.io.files import download as module
from lagsplat.io.files.download import ATTEMPTS, download


class Interruption(Exception):
    """Stands for a killed process: raised where the download would wait."""


@pytest.fixture(autouse=True)
def stop(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(seconds: float) -> None:
        raise Interruption

    monkeypatch.setattr(module, "sleep", interrupt)


@pytest.fixture
def waits(stop: None, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The seconds of each wait, which then lasts none."""
    waits: list[float] = []
    monkeypatch.setattr(module, "sleep", waits.append)
    return waits


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def target(tmp_path: Path) -> Path:
    return tmp_path / "new" / "data.bin"


def part(target: Path) -> Path:
    return target.with_name("data.bin.part")


def test_whole_file(site: Any, target: Path) -> None:
    assert download(site.url, target, sha256=sha256(site.content)) == target
    assert target.read_bytes() == site.content
    assert list(target.parent.iterdir()) == [target]
    assert site.asked == [None]


def test_interrupted_transfer_keeps_its_part_and_goes_on(site: Any, target: Path) -> None:
    site.cut_after = [400_000]
    with pytest.raises(Interruption):
        download(site.url, target, sha256=sha256(site.content))
    kept = part(target).stat().st_size
    assert 300_000 < kept <= 400_000
    assert not target.exists()
    download(site.url, target, sha256=sha256(site.content))
    assert site.asked == [None, f"bytes={kept}-"]
    assert target.read_bytes() == site.content
    assert not part(target).exists()


def test_lost_connections_are_taken_up_again(site: Any, target: Path, waits: list[float]) -> None:
    site.cut_after = [200_000] * 4
    download(site.url, target, sha256=sha256(site.content))
    assert target.read_bytes() == site.content
    assert waits == [1.0] * 4  # each gained content


def test_waits_grow_and_end(site: Any, target: Path, waits: list[float]) -> None:
    site.statuses = [503] * 20
    with pytest.raises(ConnectionError, match=rf"503 .*\({ATTEMPTS} attempts without progress\).*run again"):
        download(site.url, target, sha256=None)
    assert waits == [1.0, 2.0, 4.0, 8.0, 16.0]


def test_nobody_answers(target: Path, waits: list[float]) -> None:
    with pytest.raises(ConnectionError, match=r"http://127\.0\.0\.1:9/x: "):
        download("http://127.0.0.1:9/x", target, sha256=None)
    assert len(waits) == ATTEMPTS - 1


@pytest.mark.parametrize("status", [403, 404])
def test_refusal_is_not_tried_again(site: Any, target: Path, status: int) -> None:
    site.statuses = [status]
    with pytest.raises(ConnectionError, match=rf"{status} .*0 bytes are kept"):
        download(site.url, target, sha256=None)


@pytest.mark.parametrize("announce", [True, False])
def test_server_that_cannot_continue_starts_over(site: Any, target: Path, announce: bool) -> None:
    site.ranges, site.announce = False, announce
    target.parent.mkdir()
    part(target).write_bytes(b"x" * 1_500_000)  # longer than the file, and wrong
    download(site.url, target, sha256=sha256(site.content))
    assert target.read_bytes() == site.content


@pytest.mark.usefixtures("waits")
def test_server_that_always_starts_over_and_breaks_off_is_given_up(site: Any, target: Path) -> None:
    site.ranges, site.cut_after = False, [200_000, 100_000] * 20
    with pytest.raises(ConnectionError, match="without progress"):
        download(site.url, target, sha256=None)


def test_part_that_is_whole_already(site: Any, target: Path) -> None:
    target.parent.mkdir()
    part(target).write_bytes(site.content)
    download(site.url, target, sha256=sha256(site.content))
    assert target.read_bytes() == site.content


@pytest.mark.usefixtures("waits")
def test_part_that_is_too_long_is_dropped(site: Any, target: Path) -> None:
    target.parent.mkdir()
    part(target).write_bytes(site.content + b"more")
    download(site.url, target, sha256=sha256(site.content))
    assert target.read_bytes() == site.content


def test_damaged_content_is_told_with_both_sums_and_removed(site: Any, target: Path) -> None:
    expected = sha256(b"the published file")
    with pytest.raises(ValueError, match=rf"{sha256(site.content)}, expected {expected}.*run again"):
        download(site.url, target, sha256=expected)
    assert list(target.parent.iterdir()) == []


def test_damaged_part_is_found(site: Any, target: Path) -> None:
    target.parent.mkdir()
    part(target).write_bytes(b"x" * 1000)
    with pytest.raises(ValueError, match="damaged and was removed"):
        download(site.url, target, sha256=sha256(site.content))
    download(site.url, target, sha256=sha256(site.content))  # the remedy works
    assert target.read_bytes() == site.content


def test_length_is_checked_without_a_sum(site: Any, target: Path) -> None:
    site.cut_after = [900_000]
    with pytest.raises(Interruption):
        download(site.url, target, sha256=None)
    assert not target.exists()


def test_whole_file_is_not_fetched_again(site: Any, target: Path) -> None:
    target.parent.mkdir()
    target.write_bytes(site.content)
    download(site.url, target, sha256=sha256(site.content))
    download(site.url, target, sha256=None)
    assert site.asked == []


def test_file_of_the_user_is_never_overwritten(site: Any, target: Path) -> None:
    target.parent.mkdir()
    target.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match=rf"{sha256(b'mine')}, expected .* move it away"):
        download(site.url, target, sha256=sha256(site.content))
    assert target.read_bytes() == b"mine"
    assert site.asked == []


def test_room_is_checked_first(site: Any, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.shutil, "disk_usage", lambda folder: SimpleNamespace(free=1000))
    with pytest.raises(OSError, match="needs 1000003 bytes, but the disk has 1000 free"):
        download(site.url, target, sha256=None)
    assert not part(target).exists()
