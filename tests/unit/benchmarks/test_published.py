"""The published results: each planned file is there, and is the one that its manifest names."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from benchmarks import published
from lagsplat.io.files.atomic import sha256_of

FILES = [(name, key) for name, folder in published.read_plan().items() for key in folder["files"]]
MOST_BYTES = 3_000_000


@pytest.mark.parametrize(("name", "key"), FILES)
def test_a_planned_file_is_published_as_its_manifest_says(name: str, key: str) -> None:
    path = published.place_of(name, published.read_plan()[name]) / key
    assert path.stat().st_size
    if published.MANIFEST.exists():
        made = json.loads(published.MANIFEST.read_text("utf-8"))
        if name in made:
            assert made[name]["files"][key]["sha256"] == sha256_of(path)


def test_nothing_stands_there_that_no_plan_makes_and_all_of_it_is_small() -> None:
    planned = {published.place_of(name, published.read_plan()[name]) / key for name, key in FILES}
    campaigns = yaml.safe_load(published.PLAN.read_text("utf-8"))["campaigns"]
    assert all((published.PUBLISHED / name).is_dir() for name in campaigns)
    files = [path for path in published.PUBLISHED.rglob("*") if path.is_file()]
    others = {path for path in files if path.relative_to(published.PUBLISHED).parts[0] not in campaigns}
    assert others - planned - {published.MANIFEST} == {published.PUBLISHED / "README.md"}
    assert sum(path.stat().st_size for path in files) < MOST_BYTES


def test_recordings_that_are_not_there_leave_a_folder_as_it_is(monkeypatch, capsys) -> None:
    monkeypatch.delenv("FILMS", raising=False)
    monkeypatch.setattr(published, "write_pages", lambda: 0)
    published.main("quick_filmed_four")
    assert "left as it is, for FILMS names no folder" in capsys.readouterr().out
    command = published.write_command(published.read_plan()["quick_filmed_four"], ["a.csv"])
    films = "systems=[pendulum_pair,pendulum_pair_both,pendulum_timer,building_sway]"
    assert command[2:5] == ["a.csv", "--config", f"hydra={films} recording=filmed seeds=[0,1,2]"]
    assert "hydra_pendulum_pair=recording.path={data}/pendulum_pair/video2.mp4" in command


def test_a_figure_is_reduced_and_another_file_is_not(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (300, 2000, 3), dtype=np.uint8)).save(tmp_path / "wide.png")
    published.take_file(tmp_path / "wide.png", tmp_path / "out.webp")
    with Image.open(tmp_path / "out.webp") as figure:
        assert figure.size == (published.WIDEST, 210)
        assert figure.format == "WEBP"
    (tmp_path / "table.csv").write_text("a\n0.1\n")
    published.take_file(tmp_path / "table.csv", tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text() == "a\n0.1\n"


def test_an_unknown_folder_is_refused() -> None:
    with pytest.raises(SystemExit, match="no folder quick_moon; choose from speed, quick_simulated_seven"):
        published.main("quick_moon")


def test_minutes_of_several_calls_are_added_and_a_failure_is_raised(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(published, "WORK", tmp_path)
    clock = tmp_path / "some.minutes"
    for _ in range(2):
        published.run_timed([sys.executable, "-c", "import time; time.sleep(0.6)"], clock)
    assert 0.02 < float(clock.read_text()) < 0.5
    with pytest.raises(subprocess.CalledProcessError):
        published.run_timed([sys.executable, "-c", "raise SystemExit(3)"], clock)


def test_settings_are_told_apart_and_recordings_need_not_be_there() -> None:
    plan = published.read_plan()
    told = {name: published.describe_settings(folder) for name, folder in plan.items()}
    assert told["quick_baselines"]["settings_sha256"] != told["quick_simulated_seven"]["settings_sha256"]
    assert told["quick_filmed_four"]["seeds"]["runs"] == [0, 1, 2]
    assert told["full_krauss_2seg"]["seeds"]["runs"] == [0, 1, 2, 3, 4]


def test_the_entry_of_a_file_made_by_a_command_names_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(published, "WORK", tmp_path / "work")
    monkeypatch.setattr(published, "PUBLISHED", tmp_path / "published")
    monkeypatch.setattr(published, "name_commit", lambda: "abc")
    write = 'python -c \'import sys; open(sys.argv[1], "w").write("a")\' {out}'
    entry = published.make_folder("some", {"files": {"a.txt": {"command": write}}})
    assert (tmp_path / "published/some/a.txt").read_text() == "a"
    assert (entry["commit"], entry["command"], entry["files"]["a.txt"]["made_by"]) == ("abc", "", write)
