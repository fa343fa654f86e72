"""The wheel in an empty environment: the command line, the Python names, and a pipeline that plans."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from lagsplat import __version__
from lagsplat.project import INSTALLED, PARTS, VARIABLE

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("lagsplat", *PARTS, "setup.py", "pyproject.toml", "MANIFEST.in", "README.md", "LICENSE")

PYTHONS = ("3.11", "3.12", "3.13")

pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints, in an environment that knows nothing of this checkout."""
    foreign = ("PYTHONPATH", VARIABLE, "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if name not in foreign}
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, cwd=cwd, env=environment)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy: setuptools leaves files beside the sources, and takes up those it finds there."""
    copy = tmp_path_factory.mktemp("source")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, copy / name)
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", "dist", ".", cwd=copy)
    (path,) = (copy / "dist").glob("*.whl")
    return path


@pytest.fixture(
    scope="module",
    params=["beside", *(pytest.param(version, marks=pytest.mark.campaign) for version in PYTHONS)],
    ids=str,
)
def programs(request: pytest.FixtureRequest, wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the programs of a new environment with the wheel.

    ``beside``: what the wheel needs is borrowed from the environment of this test, so that nothing is
    downloaded. A version of Python: pip installs it there, in the versions of the lock, but for torch, which
    neither plans nor diagnoses of logs need.
    """
    place = tmp_path_factory.mktemp("environment")
    python = sys.executable if request.param == "beside" else find_python(request.param)
    run(python, "-m", "venv", "--without-pip", place, cwd=place)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        place / "bin" / "python",
        "install",
        "--quiet",
        "--no-compile",
    ]
    run(*pip, "--no-deps", wheel, cwd=place)
    if request.param == "beside":
        packages = Path(sysconfig.get_path("purelib", vars={"base": str(place)}))
        (packages / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    else:
        needed = [line for line in requires("lagsplat") or [] if "extra ==" not in line]
        rest = [line for line in needed if Requirement(line).name != "torch"]
        assert len(rest) == len(needed) - 1
        run(*pip, "--constraint", ROOT / "requirements" / "lock.txt", *rest, cwd=place)
    return place / "bin"


def find_python(version: str) -> str:
    """The interpreter of a version; the test is skipped where there is none."""
    found = shutil.which(f"python{version}")
    if found is None or subprocess.run([found, "--version"], capture_output=True, check=False).returncode:
        pytest.skip(f"python{version} is not there")
    return found


def test_the_wheel_holds_the_pipeline_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.name.startswith(f"lagsplat-{__version__}-")
    assert {Path(name).parts[0] for name in names} == {"lagsplat", f"lagsplat-{__version__}.dist-info"}
    held = {Path(name).parts[2] for name in names if name.startswith(f"lagsplat/{INSTALLED}/")}
    assert held == set(PARTS)
    for name in PARTS:
        inside = [path for path in (ROOT / name).rglob("*") if path.is_file()]
        files = [path for path in inside if path.parent.name != "__pycache__"]
        for path in files or [ROOT / name]:
            assert f"lagsplat/{INSTALLED}/{path.relative_to(ROOT)}" in names
    assert not [name for name in names if name.endswith(".pyc")]


def test_the_package_says_which_version_it_is(programs: Path, tmp_path: Path) -> None:
    assert run(programs / "lagsplat", "--version", cwd=tmp_path).strip() == f"lagsplat {__version__}"
    program = (
        "import lagsplat; from lagsplat.provenance import stamp; s = stamp(); "
        "print(lagsplat.__file__, lagsplat.compose('profile=toy').seeds, s['version'], s['commit'])"
    )
    file, *told = run(programs / "python", "-c", program, cwd=tmp_path).split()
    assert Path(file).is_relative_to(programs.parent)
    assert told == ["[0]", __version__, "None"]


def test_the_pipeline_plans_in_a_new_folder(programs: Path, tmp_path: Path) -> None:
    run(programs / "lagsplat", "init", "rocker", cwd=tmp_path)
    # the module, not the program: a borrowed one would start the environment that it belongs to
    told = run(programs / "python", "-m", "snakemake", "-c2", "-n", cwd=tmp_path / "rocker")
    assert "stage1" in told
    assert "This was a dry-run" in told
    assert not (tmp_path / "rocker" / "results").exists()


@pytest.mark.campaign
def test_two_logs_are_diagnosed(programs: Path, tmp_path: Path) -> None:
    told = run(programs / "python", ROOT / "examples" / "04_diagnose_two_csv.py", cwd=tmp_path)
    assert "coulomb_friction" in told
    assert (tmp_path / "diagnosis" / "report.html").is_file()
