"""The sum is the published one."""

from pathlib import Path

from lagsplat.io.files.atomic import sha256_of


def test_known_sum(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")  # FIPS 180-4, appendix B.1
    assert sha256_of(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
