"""The rules of the house, checked on the source itself."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from lagsplat.config.schema import Config

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "lagsplat"
MODULES = sorted(PACKAGE.rglob("*.py"))
CODE = [*MODULES, *sorted((ROOT / "workflow").rglob("*.py"))]
PAGES = [
    path
    for pattern in ("**/*.py", "**/*.smk", "**/*.yaml", "**/*.md", "**/*.rst", "**/*.toml", "Makefile")
    for folder in ("", "lagsplat", "workflow", "conf", "tests", "profiles", "benchmarks")
    for path in ((ROOT / folder).glob(pattern) if folder else ROOT.glob(pattern.removeprefix("**/")))
]
ROOMS = (
    "array_types",
    "integer_lists",
    "normal_equations",
    "monomials",
    "setting_checks",
    "project",
    "provenance",
    "processes",
    "video_quality",
    "io.config",
    "io.files",
    "io.trajectory",
    "io.recording",
    "io.robot_log",
    "io.video",
    "io.lerobot",
    "io.urdf",
    "io.mujoco",
    "io.krauss",
    "io.read",
    "io.sources",
    "views",
    "splat",
    "systems",
    "novel_views",
    "stage1",
    "chart",
    "matter",
    "stage2",
    "baselines",
    "forces",
    "evaluate",
    "diagnose.core",
    "diagnose.mechanics",
    "diagnose.solvers",
    "diagnose.data_quality",
    "diagnose.residual",
    "diagnose.effects",
    "diagnose.estimation",
    "diagnose.identification",
    "diagnose.simulators",
    "diagnose.inference",
    "diagnose.experiment",
    "diagnose.verdict",
    "diagnose.augmented",
    "diagnose.imaging",
    "diagnose.diagnosis",
    "viewer.config",
    "viewer.simulation",
    "viewer.rendering",
    "viewer.server",
    "viewer.static_page",
    "report.common",
    "report.tables",
    "report.figures",
    "report.inspection",
    "report.diagnosis",
    "config",
    "planning",
    "runs",
    "pipelines",
    "cli",
)
"""The rooms, in the order in which data goes through them: each imports from those before it alone."""
DIVIDED = {room.split(".")[0] for room in ROOMS if "." in room}
MOST_MODULES = 20


def room_of(module: str) -> str:
    """The room of a dotted name: its folder, or the folder within where the folder is divided."""
    _, *parts = module.split(".")
    return ".".join(parts[: 2 if parts and parts[0] in DIVIDED else 1])


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def short(path: Path) -> str:
    return str(path.relative_to(ROOT))


def imports_of(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in CODE}


def test_every_module_has_a_room() -> None:
    homeless = [
        short(path) for path in MODULES if path.name != "__init__.py" and room_of(name_of(path)) not in ROOMS
    ]
    assert homeless == []


def test_rooms_are_small() -> None:
    crowded = {
        short(path.parent) for path in MODULES if len(list(path.parent.glob("*.py"))) > MOST_MODULES + 1
    }
    assert not crowded


def test_data_flows_one_way(trees: dict[Path, ast.Module]) -> None:
    place = {room: number for number, room in enumerate(ROOMS)}
    names = {name_of(path) for path in MODULES}
    wrong = []
    for path in MODULES:
        home = room_of(name_of(path))
        for target in imports_of(trees[path]):
            module = target if target in names else target.rpartition(".")[0]
            room = room_of(module)
            if home in place and module in names and room in place and place[room] > place[home]:
                wrong.append(f"{short(path)} imports {target}")
    assert not wrong, "\n".join(wrong)


def body_lines(function: ast.FunctionDef) -> int:
    """Lines from the first statement after the docstring to the last: what has to be read to follow it."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def test_functions_are_short(trees: dict[Path, ast.Module]) -> None:
    long = [
        f"{short(path)}:{node.lineno} {node.name} has {body_lines(node)} lines"
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and body_lines(node) >= 60
    ]
    assert not long, "\n".join(long)


def test_no_class_name_stands_twice(trees: dict[Path, ast.Module]) -> None:
    homes: dict[str, list[str]] = {}
    for path in MODULES:
        for node in trees[path].body:
            if isinstance(node, ast.ClassDef):
                homes.setdefault(node.name, []).append(short(path))
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


def test_no_drawers_and_no_relative_imports(trees: dict[Path, ast.Module]) -> None:
    assert [short(path) for path in MODULES if path.stem in ("utils", "helpers", "_helpers", "misc")] == []
    relative = [
        short(path)
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
    ]
    assert not relative, "\n".join(relative)


def test_packages_hold_a_docstring_and_import_nothing(trees: dict[Path, ast.Module]) -> None:
    for path in MODULES:
        if (
            path.name == "__init__.py" and path.parent != PACKAGE
        ):  # the public face names what is in the rooms
            body = trees[path].body
            assert ast.get_docstring(trees[path]), short(path)
            assert not any(isinstance(node, ast.Import | ast.ImportFrom) for node in body), short(path)
    rooms = {path.parent for path in MODULES}
    assert [str(room) for room in rooms if not (room / "__init__.py").is_file()] == []


def is_definition(node: ast.stmt) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom | ast.FunctionDef | ast.ClassDef):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        # To teach the compiler what + means for a type is a definition, whatever its syntax.
        return ast.unparse(node.value.func) == "_overload"
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)  # a docstring
    if isinstance(node, ast.If):
        return ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
    return isinstance(node, ast.Assign | ast.AnnAssign)


def test_importing_defines_and_does_nothing(trees: dict[Path, ast.Module]) -> None:
    active = [
        f"{short(path)}:{node.lineno}"
        for path in MODULES
        if path != PACKAGE / "__init__.py"  # it makes two packages callable
        for node in trees[path].body
        if not is_definition(node)
    ]
    assert not active, "\n".join(active)


def test_no_globals(trees: dict[Path, ast.Module]) -> None:
    found = [
        short(path) for path, tree in trees.items() for node in ast.walk(tree) if isinstance(node, ast.Global)
    ]
    assert found == []


@pytest.mark.parametrize(
    "module", ["lagsplat.config.compose", "lagsplat.planning.plan", "lagsplat.planning.job"]
)
def test_planning_loads_no_heavy_library(module: str) -> None:
    heavy = ("torch", "numba", "cv2", "pandas", "scipy", "matplotlib", "skimage")
    program = f"import sys, {module}; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


NUMERIC_CALLS = (
    "np.linspace",
    "np.geomspace",
    "np.array",
    "np.arange",
    "np.sqrt",
    "np.log",
    "math.sqrt",
    "float",
)
MOST_CONSTANTS = 60
"""Numeric constants of ``diagnose/`` that may stay beside the code; the others are settings in ``core/``."""


def is_numeric(node: ast.expr) -> bool:
    """Whether an expression is a number, a tuple of numbers, or made of numbers alone."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return is_numeric(node.operand)
    if isinstance(node, ast.BinOp):
        return is_numeric(node.left) and is_numeric(node.right)
    if isinstance(node, ast.Tuple | ast.List):
        return bool(node.elts) and all(is_numeric(item) for item in node.elts)
    if isinstance(node, ast.Call):
        return ast.unparse(node.func) in NUMERIC_CALLS and all(is_numeric(item) for item in node.args)
    return isinstance(node, ast.Attribute) and ast.unparse(node) in ("np.pi", "math.pi")


def numeric_constants(tree: ast.Module) -> Iterator[tuple[str, ast.stmt, ast.stmt | None]]:
    """Name, assignment and following statement of every numeric constant of a module."""
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and is_numeric(node.value):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                yield from ((ast.unparse(name), node, after) for name in names)


def test_numbers_of_a_diagnosis_are_settings(trees: dict[Path, ast.Module]) -> None:
    found, bare = [], []
    for path in (PACKAGE / "diagnose").rglob("*.py"):
        if path == PACKAGE / "diagnose/core/config.py":
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        for name, node, after in numeric_constants(trees[path]):
            found.append(f"{short(path)} {name}")
            explained = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if not explained and "#" not in lines[(node.end_lineno or node.lineno) - 1]:
                bare.append(f"{short(path)}:{node.lineno} {name} has no comment or docstring")
    assert len(found) < MOST_CONSTANTS, "\n".join(found)
    assert not bare, "\n".join(bare)


def is_public(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")


def test_everything_public_is_explained(trees: dict[Path, ast.Module]) -> None:
    bare = [short(path) for path, tree in trees.items() if not ast.get_docstring(tree)]
    for path in MODULES:
        owners = [
            trees[path],
            *(node for node in trees[path].body if isinstance(node, ast.ClassDef) and is_public(node)),
        ]
        bare += [
            f"{short(path)}:{node.lineno} {node.name}"
            for owner in owners
            for node in owner.body
            if isinstance(node, ast.FunctionDef | ast.ClassDef)
            and is_public(node)
            and not ast.get_docstring(node)
            and not any("overload" in ast.unparse(decorator) for decorator in node.decorator_list)
        ]
    assert not bare, "\n".join(bare)


def config_fields(schema: type) -> Iterator[tuple[str, str]]:
    for field in fields(schema):
        kinds = [field.type, *getattr(field.type, "__args__", ())]
        below = [kind for kind in kinds if is_dataclass(kind)]
        for kind in below:
            assert isinstance(kind, type)
            yield from config_fields(kind)
        if not below:
            yield schema.__name__, field.name


def test_every_setting_is_read(trees: dict[Path, ast.Module]) -> None:
    read = set()
    for path, tree in trees.items():
        if path.name == "config.py":
            continue  # a check of its domain does not use a setting
        read |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    others = [*(ROOT / "workflow/rules").glob("*.smk"), *(ROOT / "conf").rglob("*.yaml")]
    rules = "".join(path.read_text(encoding="utf-8") for path in others)
    unread = [
        f"{schema}.{name}"
        for schema, name in config_fields(Config)
        if name not in read and f".{name}" not in rules
    ]
    assert not unread, "\n".join(unread)


def test_every_module_is_tested(trees: dict[Path, ast.Module]) -> None:
    """A test or an example imports it, or imports a module of the same top-level folder that does."""
    programs = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "examples").glob("*.py"), PACKAGE / "__init__.py"]
    names = {name_of(path): path for path in MODULES if path.name != "__init__.py"}
    pending = [
        target
        for path in programs
        if path != Path(__file__)
        for target in imports_of(ast.parse(path.read_text(encoding="utf-8")))
    ]
    # the verbs of the command line are named as text, so that its help loads none of them
    pending += re.findall(r'"(lagsplat\.[\w.]+):', (PACKAGE / "cli" / "main.py").read_text(encoding="utf-8"))
    reached: set[str] = set()
    while pending:
        target = pending.pop()
        name = target if target in names else target.rpartition(".")[0]
        if name in names and name not in reached:
            reached.add(name)
            folder = ".".join(name.split(".")[:2]) + "."
            pending += [target for target in imports_of(trees[names[name]]) if target.startswith(folder)]
    if "lagsplat.diagnose.effects.registry" in reached:  # it finds its entries by looking into their folder
        reached |= {name for name in names if name.startswith("lagsplat.diagnose.effects.")}
    untested = sorted(set(names) - reached - {"lagsplat.array_types"})
    assert not untested, "\n".join(untested)


def test_tests_mirror_the_rooms() -> None:
    folders = {
        path.parent.relative_to(ROOT / "tests/unit") for path in (ROOT / "tests/unit").rglob("test_*.py")
    }
    strange = [str(folder) for folder in folders if not (PACKAGE / folder).is_dir()]
    assert set(strange) <= {"benchmarks"}, strange


@pytest.mark.parametrize("path", PAGES, ids=short)
def test_nothing_unfinished_and_nothing_of_one_machine(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    if path == Path(__file__):
        return
    found = re.findall(
        r"\b(?:TODO|FIXME|XXX|HACK)\b|NotImplementedError\(|(?<![\w.])/(?:work|root|home)/\S*", text
    )
    assert found == []
