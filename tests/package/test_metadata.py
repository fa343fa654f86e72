"""What pyproject.toml, the lock, the citation and the change log say of the package is true and agrees."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from lagsplat import __version__

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def requirements(*lists: list[str]) -> list[Requirement]:
    """Requirements of these lists, with those of the extras that they name."""
    found = []
    for text in (text for each in lists for text in each):
        requirement = Requirement(text)
        inner = [EXTRAS[extra] for extra in requirement.extras] if requirement.name == "lagsplat" else []
        found += requirements(*inner) if inner else [requirement]
    return found


def test_the_version_is_the_same_everywhere() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    releases = re.findall(
        r"^## (\d\S*)(?: \((\S+)\))?$", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE
    )
    newest, day = releases[0]
    assert PROJECT["dynamic"] == ["version"], "it is written in lagsplat/__init__.py alone"
    assert citation["version"] == newest == __version__
    assert str(citation["date-released"]) == day


def test_the_library_has_ranges_and_the_set_up_exact_versions() -> None:
    lock = dict(
        line.split("==") for line in (ROOT / "requirements/lock.txt").read_text().split("\n") if "==" in line
    )
    assert all(not re.search("==|<", str(each.specifier)) for each in requirements(PROJECT["dependencies"]))
    for requirement in requirements(PROJECT["dependencies"], EXTRAS["test"]):
        name = canonical(requirement.name)
        assert name in lock, f"{name} is not in the lock: make lock"
        assert lock[name] in requirement.specifier, f"{name}=={lock[name]} is outside {requirement}"


def imported(path: Path) -> set[str]:
    """Top-level names of what a file imports, wherever it does."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize("folder", ["lagsplat", "workflow"])
def test_what_is_imported_is_required(folder: str) -> None:
    homes = packages_distributions()
    required = {canonical(each.name) for each in requirements(PROJECT["dependencies"], *EXTRAS.values())}
    foreign = {name for path in (ROOT / folder).rglob("*.py") for name in imported(path)}
    foreign -= {*sys.stdlib_module_names, "lagsplat", "benchmarks"}
    missing = {
        name for name in foreign if name in homes and not required & {canonical(home) for home in homes[name]}
    }
    assert missing == set()
