"""The blind check shares nothing with what it judges."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
GENERATOR = sorted((ROOT / "benchmarks" / "gapgen").glob("*.py"))
ALLOWED = {"numpy", "scipy", "numba", "benchmarks"}
# sealing needs a cipher, scoring draws, and one source of motions is MuJoCo
MORE = {
    "seal.py": {"cryptography"},
    "figures.py": {"matplotlib"},
    "mujoco_world.py": {"mujoco"},
    "mujoco_steps.py": {"mujoco"},
}


def roots(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("path", GENERATOR, ids=lambda path: path.name)
def test_the_generator_needs_numbers_only(path: Path) -> None:
    known = ALLOWED | MORE.get(path.name, set()) | set(sys.stdlib_module_names)
    foreign = {name for name in roots(path) if name.split(".")[0] not in known}
    foreign |= {
        n for n in roots(path) if n.startswith("benchmarks") and not n.startswith("benchmarks.gapgen")
    }
    assert foreign == set()


def test_the_library_does_not_know_the_generator() -> None:
    files = sorted((ROOT / "lagsplat").rglob("*.py"))
    assert files
    assert [
        str(path) for path in files if any(name.split(".")[0] == "benchmarks" for name in roots(path))
    ] == []
    assert [str(path) for path in files if "gapgen" in path.read_text(encoding="utf-8")] == []
