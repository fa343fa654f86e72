"""Damaged inputs: those that were once answered badly, and a few new ones of every format."""

import os
import warnings
from pathlib import Path

import pytest

from tests.campaign.inputs import FORMATS, in_child, mutated

FOUND = [
    ("mat", 1, 2),  # SciPy: IndexError
    ("mat", 1, 17),  # SciPy: the process crashed
    ("hdf5", 1, 0),  # HDF5: RuntimeError
    ("hdf5", 1, 16),  # HDF5: KeyError
    ("session", 1, 19),  # Zstandard: ZstdError
    ("session", 1, 46),  # MemoryError
    ("session", 2, 18),
    ("npz", 3, 127),  # zipfile: NotImplementedError
    ("npz", 4, 170),
    ("krauss", 3, 22),  # NumPy: TokenError
    ("safetensors", 1, 43),  # TypeError, and other entries of a header
    ("safetensors", 1, 47),
    ("safetensors", 1, 52),
    ("robomimic", 3, 82),  # HDF5: never came back from a damaged heap
    ("safetensors", 21, 49),
    ("parquet", 31, 45),  # what pandas notes beside the columns: KeyError
    ("parquet", 31, 4218),  # the same: TypeError
    ("db3", 31, 2535),  # SQLite: MemoryError
    ("mjcf", 12, 239),  # MuJoCo: a warning in a file in the working directory
]
NEW = [(kind, 0, number) for kind in FORMATS if kind != "mat" for number in range(4)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="every input has a process of its own")
@pytest.mark.parametrize(("kind", "seed", "number"), [*FOUND, *NEW])
def test_a_damaged_input_is_taken_or_refused(
    tmp_path: Path, kind: str, seed: int, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write, readers = FORMATS[kind]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = write(tmp_path)
    path.write_bytes(mutated(kind, path.read_bytes(), seed, number))
    before = sorted(tmp_path.rglob("*"))
    for reader in readers:
        assert in_child(path, reader) is None
    assert sorted(tmp_path.rglob("*")) == before
