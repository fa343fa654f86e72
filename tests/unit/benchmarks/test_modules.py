"""Every benchmark finds what it imports, also those that no test runs."""

from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PATHS = [path.relative_to(ROOT).with_suffix("") for path in sorted((ROOT / "benchmarks").rglob("*.py"))]


@pytest.mark.parametrize("name", [".".join(path.parts) for path in PATHS if path.name != "__init__"])
def test_a_benchmark_finds_what_it_imports(name: str) -> None:
    import_module(name)
