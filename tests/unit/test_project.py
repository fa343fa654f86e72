"""Which pipeline counts: the one that is named, the one of this folder, the one of the package."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lagsplat import __version__, project
from lagsplat.cli.main import main
from lagsplat.io.files.pipeline_copy import copy_pipeline


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A pipeline as `lagsplat init` lays it down."""
    return copy_pipeline(tmp_path / "here" / "copy")


def test_a_checkout_uses_its_own_folders(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(project.VARIABLE, raising=False)
    assert project.find_project() == project.bundled_project() == repository


def test_the_working_folder_counts_only_where_init_made_it(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(project.VARIABLE, raising=False)
    monkeypatch.chdir(copy)
    assert project.find_project() == copy
    (copy / project.MARK).unlink()  # now the conf/ of somebody's own experiments
    assert project.find_project() == project.bundled_project()


def test_the_named_folder_comes_first(copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(project.VARIABLE, str(copy))
    assert project.find_project() == copy
    monkeypatch.setenv(project.VARIABLE, str(tmp_path))
    with pytest.raises(ValueError, match=r"LAGSPLAT_PROJECT=.*: no conf/config\.yaml there; name a folder"):
        project.find_project()


def test_a_workflow_names_its_own_settings(
    copy: Path, repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(project.VARIABLE, str(repository))
    assert project.use_project(copy) == copy
    assert os.environ[project.VARIABLE] == str(copy)
    assert project.use_project(tmp_path) == copy, "a folder without settings changes nothing"


def test_settings_are_read_where_init_laid_them_down(copy: Path) -> None:
    path = copy / "conf" / "stage1" / "default.yaml"
    lines = path.read_text().splitlines()
    changed = ["steps: 7" if line.startswith("steps:") else line for line in lines]
    assert changed != lines
    path.write_text("\n".join(changed))
    program = "import lagsplat; print(lagsplat.compose('profile=full').stage1.steps)"
    environment = {name: value for name, value in os.environ.items() if name != project.VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=copy, env=environment
    )
    assert done.stdout.strip() == "7"
    assert (copy / ".snakemake").is_dir(), "what planning has composed is kept there"


def test_init_lays_down_everything_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "a rocker"
    folder.mkdir()
    assert main(["init", str(folder)]) == 0
    told = capsys.readouterr().out
    assert f"cd '{folder}'" in told
    assert "snakemake -c2 -n" in told
    assert {path.name for path in folder.iterdir()} == {*project.PARTS, project.MARK}
    assert json.loads((folder / project.MARK).read_text()) == {"made_by": f"lagsplat {__version__}"}
    assert not list(folder.rglob("*.pyc"))
    source = project.bundled_project()
    for name in project.PARTS:
        inside = [path for path in (source / name).rglob("*") if path.is_file()]
        files = [path for path in inside if path.parent.name != "__pycache__"]
        for path in files or [source / name]:
            assert (folder / path.relative_to(source)).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("name", ["notes.txt", ".git"])
def test_init_changes_nothing_where_something_stands(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("mine")
    assert main(["init", str(tmp_path)]) == 2
    assert "holds files, which stay as they are; name a folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert main(["init", str(tmp_path / name)]) == 2
    assert "is a file" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("words", [[], ["a", "b"], ["out=a"]])
def test_init_takes_one_folder(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", *words]) == 2
    assert "lagsplat init FOLDER" in capsys.readouterr().err
