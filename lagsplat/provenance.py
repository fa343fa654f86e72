"""What made a result: the code, the commit, the libraries, the machine, the seeds.

Planning imports this module, so it uses the standard library alone and reads source files instead of
importing them.
"""

import ast
import hashlib
import os
import platform
import random
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGE = "lagsplat"
BESIDE = ("benchmarks",)
"""Folders of modules beside the package whose code makes results, too."""
ROOT = Path(__file__).resolve().parent
LIBRARIES = ("numpy", "scipy", "torch", "numba", "safetensors", "opencv-python-headless", "gsplat")


def code_digest(*modules: str) -> str:
    """SHA-256 of what the named modules can execute: their code and that of all modules they import from
    `lagsplat` and from the folders `BESIDE` it.

    Comments, docstrings and formatting do not enter; everything else does, the ``__init__`` of sub-packages
    included. Imports inside functions are followed too. The modules are parsed, never imported, and the
    answer is kept for the life of the process. Only absolute imports written as statements can be seen.

    Raises:
        ModuleNotFoundError: a named module is not part of the package.
        ValueError: a module imports relatively, which would hide its dependence.
    """
    pending, digests = [], {}
    for name in modules:
        if _source(name) is None:
            raise ModuleNotFoundError(f"code_digest: no module {name!r} under {ROOT}; check the spelling")
        pending += _with_parents(name)
    while pending:
        name = pending.pop()
        if name not in digests:
            digests[name], imported = _digest_and_imports(name)
            pending += imported
    text = "\n".join(f"{name} {digests[name]}" for name in sorted(digests))
    return hashlib.sha256(text.encode()).hexdigest()


def _source(name: str) -> Path | None:
    # What importlib.util.find_spec would answer, which imports the parent packages to do so.
    head, *rest = name.split(".")
    if head != PACKAGE and head not in BESIDE:
        return None
    base = (ROOT if head == PACKAGE else ROOT.parent / head).joinpath(*rest)
    module, package = base.with_name(base.name + ".py"), base / "__init__.py"
    if package.is_file():
        return package
    return module if rest and module.is_file() else None


def _with_parents(name: str) -> list[str]:
    parts = name.split(".")
    # The root package is left out: it holds the version number, and a release must not make every result
    # stale.
    names = [".".join(parts[: i + 1]) for i in range(1, len(parts))]
    return [name for name in names if _source(name) is not None]


@cache
def _digest_and_imports(name: str) -> tuple[str, tuple[str, ...]]:
    path = _source(name)
    if path is None:
        raise ModuleNotFoundError(f"code_digest: no module {name!r} under {ROOT}")
    tree = ast.parse(path.read_bytes(), filename=str(path))
    imported = tuple(sorted({target for node in ast.walk(tree) for target in _imports(node, path)}))
    _drop_docstrings(tree)
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), imported


def _imports(node: ast.AST, path: Path) -> Iterator[str]:
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield from _with_parents(alias.name)
    elif isinstance(node, ast.ImportFrom):
        if node.level:
            raise ValueError(
                f"{path}, line {node.lineno}: a relative import hides what the code depends on; "
                f"write it as `from {PACKAGE}...`"
            )
        for alias in node.names:
            # Whether `y` of `from x import y` is a module or a name of x, only the folder tells.
            yield from _with_parents(f"{node.module}.{alias.name}")


def _drop_docstrings(tree: ast.AST) -> None:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        # Text that stands alone is documentation wherever it stands: under a class field, too.
        node.body = [statement for statement in node.body if not _is_text(statement)] or [ast.Pass()]


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


def stamp() -> dict[str, Any]:
    """The state of code, libraries and machine at this moment, as plain data.

    ``commit`` and ``tree``, the content of that commit, are None outside a git checkout, and ``dirty`` is
    then None too; ``dirty`` tells whether tracked files differ from the commit. ``threads`` and ``device``
    are those of torch where torch is loaded, else None: asking must not load it. ``time_utc`` is ISO 8601.
    """
    commit, tree, dirty = _commit()
    torch = sys.modules.get("torch")
    loaded = torch is not None and hasattr(torch, "get_num_threads")
    return {
        "package": PACKAGE,
        "commit": commit,
        "tree": tree,
        "dirty": dirty,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": _versions(),
        "threads": torch.get_num_threads() if loaded and torch else None,
        "device": _device(torch) if loaded else None,
        "cpu_count": os.cpu_count(),
        "time_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _commit() -> tuple[str | None, str | None, bool | None]:
    git = ["git", "-C", str(ROOT)]
    try:
        # An installed copy may lie inside somebody else's checkout; its commit would say nothing about this
        # code.
        tracked = subprocess.run(
            [*git, "ls-files", "--error-unmatch", __file__], capture_output=True, timeout=10
        )
        if tracked.returncode:
            return None, None, None
        head = subprocess.run(
            [*git, "rev-parse", "HEAD", "HEAD^{tree}"], capture_output=True, text=True, timeout=10
        )
        status = subprocess.run(
            [*git, "status", "--porcelain", "--untracked-files=no"],
            capture_output=True,
            text=True,
            timeout=10,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None, None, None
    if head.returncode or status.returncode:
        return None, None, None
    commit, tree = head.stdout.split()
    return commit, tree, bool(status.stdout.strip())


@cache
def _versions() -> dict[str, str | None]:
    return {name: _version(name) for name in (PACKAGE, *LIBRARIES)}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _device(torch: Any) -> str:
    # Asking CUDA starts it, which a process that runs on the CPU must not pay for.
    return torch.cuda.get_device_name() if torch.cuda.is_initialized() else "cpu"


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

    Both bring a pool of their own. A thread that spins while it waits keeps the other pool, and every other
    program, from that core: with two cores a step of stage 1 then takes several times as long. A policy that
    the user has set stays.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def set_threads(n: int) -> None:
    """Let Numba use ``n`` threads, and torch one.

    The rasteriser is parallel over frames. What torch is left with are many small operations, which gain a
    quarter from a second thread on an idle machine and lose a factor of two to twenty to its hand-overs as
    soon as another program wants a core. Numba cannot go above the number of threads it was started with; it
    then takes that number.

    Raises:
        ValueError: ``n`` is below one.
    """
    if n < 1:
        raise ValueError(f"threads is {n}; give 1 or more")
    import numba
    import torch

    torch.set_num_threads(1)
    numba.set_num_threads(min(n, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
