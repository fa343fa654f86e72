"""Where the user's cache keeps what a key determines."""

from pathlib import Path

import pytest

from lagsplat.io.files.user_cache import locate_in_cache


def test_a_key_has_one_place_below_the_cache_and_nothing_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = locate_in_cache("matter", "one")
    assert place.parent == tmp_path / "lagsplat" / "matter"
    assert locate_in_cache("matter", "one") == place != locate_in_cache("matter", "other")
    assert not list(tmp_path.iterdir())
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert locate_in_cache("runs", "one").is_relative_to(Path.home() / ".cache" / "lagsplat")
