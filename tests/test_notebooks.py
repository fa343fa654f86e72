"""Notebooks of the documentation: they run, make the pictures of their pages, and find what they say."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jupytext
import mujoco
import pytest

import lagsplat

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = {path.stem: path for path in sorted(FOLDER.glob("*.py"))}
PICTURE = re.compile(r"!\[[^\]]+\]\(([^)\s]+)\)")
LINK = re.compile(r"\]\(((?!https?:)[^)\s]+)\)")
RUN = """
import json, runpy, sys
names = runpy.run_path(sys.argv[1])
print(json.dumps({name: value for name, value in names.items() if type(value) is float}))
"""


def text_of(name: str) -> str:
    """The text of a notebook, without its code."""
    cells = jupytext.read(NOTEBOOKS[name], fmt="py:percent").cells
    return "\n\n".join(cell.source for cell in cells if cell.cell_type == "markdown")


def run(name: str, folder: Path) -> dict[str, float]:
    """Run a notebook in an empty folder, as a user would; return the numbers that it leaves under a name."""
    place = folder / name
    place.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(NOTEBOOKS[name])],
        capture_output=True,
        text=True,
        cwd=place,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr[-4000:]
    made, shown = {path.name for path in place.glob("*.png")}, PICTURE.findall(text_of(name))
    assert made == {Path(picture).name for picture in shown}
    numbers: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return numbers


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_a_short_page_with_light_pictures(name: str) -> None:
    text = text_of(name)
    assert len(text.split()) < 800
    shown = PICTURE.findall(text)
    assert shown
    assert {FOLDER / picture for picture in shown} == set((FOLDER / name).glob("*.png"))
    assert all(path.stat().st_size < 300_000 for path in (FOLDER / name).iterdir())


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_reached_and_its_links_lead_somewhere(name: str) -> None:
    for link in LINK.findall(text_of(name)):
        assert (FOLDER / link.partition("#")[0]).exists(), f"{name} names {link}, which is not there"
    assert f"(notebooks/{name}.py)" in (ROOT / "docs" / "index.md").read_text()
    assert f": notebooks/{name}.md\n" in (ROOT / "mkdocs.yml").read_text()


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_needs_the_public_names_alone(name: str) -> None:
    code = NOTEBOOKS[name].read_text()
    assert not re.search(r"^\s*(from lagsplat|import lagsplat\.)", code, flags=re.MULTILINE)


@pytest.mark.slow
def test_the_film_becomes_a_model_that_can_be_pushed(tmp_path: Path) -> None:
    numbers = run("film-to-pushable-model", tmp_path)
    assert numbers["miss"] < 0.2
    assert numbers["pushed_away"] > 0.3
    page = (tmp_path / "film-to-pushable-model" / "run.html").read_text()
    assert "<canvas" in page


@pytest.mark.slow
def test_two_csv_files_show_dry_friction(tmp_path: Path) -> None:
    run("two-csv-files", tmp_path)
    diagnosis = lagsplat.load_diagnosis(tmp_path / "two-csv-files" / "diagnosis")
    assert diagnosis.verdict == "effect"
    friction = diagnosis.effects[0]
    assert friction.name == diagnosis.candidates[0].name == "coulomb_friction"
    strength = next(iter(friction.parameters.values()))
    assert strength.low <= 0.6 <= strength.high
    assert diagnosis.gap is not None
    assert diagnosis.gap.after < 0.4 * min(diagnosis.gap.before, diagnosis.gap.refit)


@pytest.mark.slow
def test_the_arm_gets_the_friction_that_its_model_lacks(tmp_path: Path) -> None:
    numbers = run("mujoco-arm", tmp_path)
    folder = tmp_path / "mujoco-arm"
    diagnosis = lagsplat.load_diagnosis(folder / "diagnosis")
    assert [(effect.name, effect.coordinate) for effect in diagnosis.effects] == [
        ("coulomb_friction", "elbow")
    ]
    patched = mujoco.MjModel.from_xml_path(str(folder / "diagnosis" / "patched.xml"))
    assert patched.dof_frictionloss == pytest.approx([0.0, 0.05], abs=0.005)
    assert numbers["error_after"] < 0.2 * numbers["error_before"]
