"""The published results: each planned file is there, and is the one that its manifest names."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import published
from lagsplat.io.files.atomic import sha256_of

FILES = [(name, key) for name, folder in published.read_plan().items() for key in folder["files"]]


@pytest.mark.parametrize(("name", "key"), FILES)
def test_a_planned_file_is_published_as_its_manifest_says(name: str, key: str) -> None:
    path = published.PUBLISHED / name / key
    assert path.stat().st_size
    if published.MANIFEST.exists():
        made = json.loads(published.MANIFEST.read_text("utf-8"))
        if name in made:
            assert made[name]["files"][key]["sha256"] == sha256_of(path)


def test_a_figure_is_reduced_and_another_file_is_not(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (300, 2000, 3), dtype=np.uint8)).save(tmp_path / "wide.png")
    published.take_file(tmp_path / "wide.png", tmp_path / "out.png")
    with Image.open(tmp_path / "out.png") as figure:
        assert figure.size == (published.WIDEST, 210)
    (tmp_path / "table.csv").write_text("a\n0.1\n")
    published.take_file(tmp_path / "table.csv", tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text() == "a\n0.1\n"


def test_an_unknown_folder_is_refused() -> None:
    with pytest.raises(SystemExit, match="no folder quick_moon; choose from quick_simulated_seven"):
        published.main("quick_moon")
