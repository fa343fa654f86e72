"""What made a result: the code, the commit, the libraries, the machine, the seeds.

Planning imports this module, so it uses the standard library alone and reads source files instead of
importing them.
"""

import ast
import hashlib
import json
import os
import random
import sqlite3
import sys
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from lagsplat import __version__
from lagsplat.project import INSTALLED, find_project

PACKAGE = "lagsplat"
BESIDE = ("benchmarks",)  # folders of modules in the pipeline whose code makes results, too
ROOT = Path(__file__).resolve().parent
TEMPLATES = "templates"  # folder of page templates beside a package's `__init__.py`
MOST_ANSWERS = 20_000
"""More of them are deleted: answers about files that have changed since are never asked for again."""
LIBRARIES = ("numpy", "scipy", "torch", "numba", "safetensors", "opencv-python-headless", "gsplat")


def code_digest(*modules: str) -> str:
    """SHA-256 of the code of the named modules and of all that they import of `lagsplat` and `BESIDE`.

    Comments, docstrings and formatting do not enter; everything else does, the ``__init__`` of sub-packages
    and the files in their folders `TEMPLATES` included. Imports inside functions are followed too. The
    modules are parsed, never imported. Only absolute imports written as statements can be seen.

    Raises:
        ModuleNotFoundError: a named module is not part of the package.
        ValueError: a module imports relatively, which would hide its dependence.
    """
    pending, digests = [], {}
    for name in modules:
        if _find_source(ROOT, name) is None:
            raise ModuleNotFoundError(f"code_digest: no module {name!r} under {ROOT}; check the spelling")
        pending += _with_parents(name)
    while pending:
        name = pending.pop()
        if name not in digests:
            digests[name], imported = _digest_and_imports(name)
            pending += imported
    text = "\n".join(f"{name} {digests[name]}" for name in sorted(digests))
    return sha256_hex(text.encode())


def sha256_hex(data: bytes) -> str:
    """SHA-256 of ``data``, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def recall(key: str, make: Callable[[], Any]) -> Any:
    """What ``make`` returned for ``key`` before, or now: plain JSON data that depends on ``key`` alone.

    Answers are kept between processes in ``.snakemake/`` of the pipeline, since planning a workflow asks for
    the same ones every time. Where that lies in an installed package, or cannot be written, nothing is kept.
    """
    store, digest = _answers(), sha256_hex(key.encode())
    if store is None:
        return make()
    try:
        row = store.execute("SELECT answer FROM answers WHERE key = ?", (digest,)).fetchone()
        if row is not None:
            return json.loads(row[0])
        answer = make()
        store.execute("INSERT OR REPLACE INTO answers VALUES (?, ?)", (digest, json.dumps(answer)))
    except sqlite3.Error:  # another process holds the file, or it is damaged: only time is lost
        return make()
    return answer


@cache
def _answers() -> sqlite3.Connection | None:
    project = find_project()
    if project.name == INSTALLED or not (project / "Snakefile").is_file():
        return None
    folder = project / ".snakemake"
    try:
        folder.mkdir(exist_ok=True)
        store = sqlite3.connect(folder / "lagsplat-planning.sqlite", timeout=1.0, isolation_level=None)
        store.execute("PRAGMA synchronous = OFF")  # a lost answer is made again
        store.execute("CREATE TABLE IF NOT EXISTS answers (key TEXT PRIMARY KEY, answer TEXT)")
        if store.execute("SELECT COUNT(*) FROM answers").fetchone()[0] > MOST_ANSWERS:
            store.execute("DELETE FROM answers")
    except (sqlite3.Error, OSError):
        return None
    return store


@cache
def _find_source(root: Path, name: str) -> Path | None:
    # What importlib.util.find_spec would answer, which imports the parent packages to do so.
    head, *rest = name.split(".")
    if head != PACKAGE and head not in BESIDE:
        return None
    base = (root if head == PACKAGE else find_project() / head).joinpath(*rest)
    module, package = base.with_name(base.name + ".py"), base / "__init__.py"
    if package.is_file():
        return package
    return module if rest and module.is_file() else None


def _with_parents(name: str) -> list[str]:
    parts = name.split(".")
    # The root package is left out: it holds the version number, and a release must not make every result
    # stale.
    names = [".".join(parts[: i + 1]) for i in range(1, len(parts))]
    return [name for name in names if _find_source(ROOT, name) is not None]


@cache
def _digest_and_imports(name: str) -> tuple[str, tuple[str, ...]]:
    path = _find_source(ROOT, name)
    assert path is not None, "`modules_in` names modules that are there"
    digest, imports = parse_source(path)
    if path.name == "__init__.py":  # templates beside a package make its pages as its code does
        for template in sorted((path.parent / TEMPLATES).glob("*")):
            digest = sha256_hex(f"{digest} {template.name} ".encode() + template.read_bytes())
    return digest, modules_in(imports)


def modules_in(imports: Iterable[str]) -> tuple[str, ...]:
    """Modules of this repository, packages included, that imports such as ``module.name`` load."""
    # Whether `y` of `from x import y` is a module or a name of x, only the folder tells.
    return tuple(sorted({module for target in imports for module in _with_parents(target)}))


def parse_source(path: Path) -> tuple[str, list[str]]:
    """SHA-256 of a file's code without comments and docstrings, and what it imports of this repository.

    An import is given as ``module.name``, whether the name is a module or not.

    Raises:
        ValueError: a relative import.
        SyntaxError: the file is no Python.
    """
    source = path.read_bytes()

    def parse() -> tuple[str, list[str]]:
        tree = ast.parse(source, filename=str(path))
        imports = sorted({target for node in ast.walk(tree) for target in _imports(node, path)})
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                # Text that stands alone is documentation wherever it stands: under a class field, too.
                node.body = [statement for statement in node.body if not _is_text(statement)] or [ast.Pass()]
        return sha256_hex(ast.dump(tree).encode()), imports

    # `ast.dump` differs between versions of Python.
    own_digest = sha256_hex(Path(__file__).read_bytes())
    digest, imports = recall(f"source {sys.version_info[:2]} {own_digest} {sha256_hex(source)}", parse)
    return digest, imports


def _imports(node: ast.AST, path: Path) -> Iterator[str]:
    targets: list[str] = []
    if isinstance(node, ast.Import):
        targets = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        if node.level:
            where = f"{path}, line {node.lineno}"
            raise ValueError(f"{where}: a relative import hides a dependence; write `from {PACKAGE}...`")
        targets = [f"{node.module}.{alias.name}" for alias in node.names]
    yield from (target for target in targets if target.partition(".")[0] in (PACKAGE, *BESIDE))


def _is_text(statement: ast.stmt) -> bool:
    if not isinstance(statement, ast.Expr) or not isinstance(statement.value, ast.Constant):
        return False
    return isinstance(statement.value.value, str)


def stamp() -> dict[str, Any]:
    """The state of code, libraries and machine at this moment, as plain data.

    ``commit`` and ``tree``, the content of that commit, are None outside a git checkout, where ``version``
    alone names the code, and ``dirty`` is then None too; ``dirty`` tells whether tracked files differ from
    the commit. ``threads`` and ``device`` are those of torch where torch is loaded, else None: asking must
    not load it. ``time_utc`` is ISO 8601.
    """
    import platform

    commit, tree, dirty = _commit()
    torch: Any = sys.modules.get("torch")
    loaded = hasattr(torch, "get_num_threads")
    # Asking CUDA starts it, which a process that runs on the CPU must not pay for.
    device = torch.cuda.get_device_name() if loaded and torch.cuda.is_initialized() else "cpu"
    return {
        "package": PACKAGE,
        "version": __version__,
        "commit": commit,
        "tree": tree,
        "dirty": dirty,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": _versions(),
        "threads": torch.get_num_threads() if loaded else None,
        "device": device if loaded else None,
        "cpu_count": os.cpu_count(),
        "time_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _commit() -> tuple[str | None, str | None, bool | None]:
    # An installed copy may lie inside somebody else's checkout, whose commit would say nothing about it.
    tracked = _git("ls-files", "--error-unmatch", __file__)
    head = _git("rev-parse", "HEAD", "HEAD^{tree}")
    status = _git("status", "--porcelain", "--untracked-files=no")
    if tracked is None or head is None or status is None:
        return None, None, None
    commit, tree = head.split()
    return commit, tree, bool(status)


def _git(*words: str) -> str | None:
    """What git prints about the checkout around this file; None if it fails."""
    import subprocess

    command = ["git", "-C", str(ROOT), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return None if done.returncode else done.stdout.strip()


@cache
def _versions() -> dict[str, str | None]:
    from importlib.metadata import PackageNotFoundError, version

    versions: dict[str, str | None] = {}
    for name in (PACKAGE, *LIBRARIES):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return versions


def seed_everything(seed: int) -> None:
    """Seed Python, NumPy and torch (all devices) with ``seed``, which lies in [0, 2**32).

    For libraries that draw from global generators. Code of this package passes generators by hand.

    Raises:
        ValueError: ``seed`` is outside the range.
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed is {seed}; NumPy takes 0 to 2**32 - 1")
    import numpy as np
    import torch

    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - for libraries that draw from the global generator
    torch.manual_seed(seed)


def let_waiting_threads_sleep() -> None:
    """Tell OpenMP, before torch and Numba start their pools, that an idle thread gives its core away.

    A thread that spins while it waits keeps the other pool, and every other program, from that core: with two
    cores a step of stage 1 then takes several times as long. A policy that the user has set stays.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def set_threads(n: int) -> None:
    """Let Numba use ``n`` threads, and torch one.

    The rasteriser is parallel over frames. Torch is left with many small operations, which gain a quarter
    from a second thread on an idle machine and lose a factor of two to twenty as soon as another program
    wants a core. Numba takes at most the number of threads it was started with.

    Raises:
        ValueError: ``n`` is below one.
    """
    if n < 1:
        raise ValueError(f"threads is {n}; give 1 or more")
    import numba
    import torch

    torch.set_num_threads(1)
    numba.set_num_threads(min(n, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
