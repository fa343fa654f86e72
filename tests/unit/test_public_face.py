"""What ``import lagsplat`` gives: its names, lazily, and two packages that are functions, too."""

import inspect
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import lagsplat
from lagsplat.pipelines.steps import reading_overrides

HEAVY = ("torch", "numpy", "numba", "pandas", "scipy", "matplotlib", "hydra")


def run(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_loads_no_library() -> None:
    program = f"import sys, lagsplat; dir(lagsplat); print([m for m in {HEAVY} if m in sys.modules])"
    assert run(program) == "[]"


def test_importing_takes_a_moment() -> None:
    program = "import time; t = time.process_time(); import lagsplat; print(time.process_time() - t)"
    assert min(float(run(program)) for _ in range(3)) < 0.3


@pytest.mark.parametrize(
    "module", ["lagsplat.pipelines.diagnosis", "lagsplat.pipelines.diagnose_data", "lagsplat.io.read"]
)
def test_a_diagnosis_of_trajectories_loads_no_torch(module: str) -> None:
    assert run(f"import sys, {module}; print('torch' in sys.modules)") == "False"


def test_a_page_is_shown_without_torch(tmp_path: Path) -> None:
    page = tmp_path / "run.html"
    page.write_text("<p>")
    program = (
        "import sys; from lagsplat.cli.main import main; "
        f"assert main(['view', {str(page)!r}, '--no-browser']) == 0; print('torch' in sys.modules)"
    )
    assert run(program).splitlines() == [page.as_uri(), "False"]


def test_the_names_are_sorted_and_all_there() -> None:
    assert lagsplat.__all__ == sorted(lagsplat._HOMES)
    assert set(lagsplat.__all__) <= set(dir(lagsplat))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        lagsplat.nonsense  # noqa: B018


@pytest.mark.parametrize("name", lagsplat.__all__)
def test_a_public_name_is_documented(name: str) -> None:
    thing = getattr(lagsplat, name)
    assert callable(thing)
    function = getattr(thing, "__wrapped__", thing) if isinstance(thing, ModuleType) else thing
    text = inspect.getdoc(function) or ""
    assert text.splitlines()[0].endswith("."), name
    assert "Example:" in text, name
    if inspect.isfunction(function) and len(inspect.signature(function).parameters) > 3:
        assert "Args:" in text, name


@pytest.mark.parametrize("name", ["diagnose", "evaluate"])
@pytest.mark.parametrize(
    "imports",
    [
        "import lagsplat; thing = lagsplat.{name}",
        "from lagsplat import {name} as thing",
        "import lagsplat.{name}.config; thing = lagsplat.{name}",
        "import lagsplat; lagsplat.{name}; import lagsplat.{name} as thing",
        "import importlib; thing = importlib.import_module('lagsplat.{name}')",
    ],
)
def test_a_package_is_also_its_function(name: str, imports: str) -> None:
    imports = imports.format(name=name).replace("diagnose.config", "diagnose.core.config")
    program = (
        f"{imports}\nimport types, lagsplat.{name}\n"
        "assert isinstance(thing, types.ModuleType) and callable(thing) and thing.__path__\n"
        f"assert thing is lagsplat.{name}"
    )
    run(program)


@pytest.mark.parametrize(("name", "arguments"), [("diagnose", "sim real out"), ("evaluate", "run overrides")])
def test_a_callable_package_has_the_arguments_of_its_function(name: str, arguments: str) -> None:
    program = f"import inspect, lagsplat; print(*inspect.signature(lagsplat.{name}).parameters)"
    assert run(program).startswith(arguments)


@pytest.mark.parametrize(
    ("name", "kind"), [("a.mp4", "video"), ("frames", "video"), ("log.mcap", "mcap"), ("arm.npz", "krauss")]
)
def test_a_file_is_read_by_its_kind(name: str, kind: str) -> None:
    assert f"recording.kind={kind}" in reading_overrides(Path(name))
