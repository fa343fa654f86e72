"""The digest follows code and nothing else; the stamp tells the truth; planning stays light."""

import os
import random
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numba
import numpy as np
import pytest
import torch

from lagsplat import provenance
from lagsplat.provenance import (
    code_digest,
    let_waiting_threads_sleep,
    seed_everything,
    set_threads,
    stamp,
)

FILES = {
    "__init__.py": '"""The package."""\n\n__version__ = "1"\n',
    "top.py": (
        "from lagsplat.room import chair\nfrom lagsplat.tools.saw import cut\n\n\n"
        "def sit():\n    return cut(chair)\n"
    ),
    "late.py": "def sit():\n    import lagsplat.tools.saw\n\n    return lagsplat.tools.saw.cut(1)\n",
    "alone.py": "import os\nimport numpy as np\n\nX = 1\n",
    "room/__init__.py": '"""A room."""\n',
    "room/chair.py": "LEGS = 4\n",
    "tools/__init__.py": '"""Tools."""\n',
    "tools/saw.py": (
        '"""A saw."""\n\nimport lagsplat.tools.blade as blade\n\n\ndef cut(x):\n    return blade.EDGE * x\n'
    ),
    "tools/blade.py": "# sharp\nEDGE = 2  # mm\n",
    "room/templates/page.html.j2": "<p>{{ text }}</p>\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A small package in place of the real one."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    provenance._digest_and_imports.cache_clear()
    yield tmp_path
    provenance._digest_and_imports.cache_clear()


@pytest.fixture
def changes(package: Path) -> Callable[..., bool]:
    """Whether the digest of a module differs after the text of a file was replaced."""

    def changes(module: str, *, file: str, old: str, new: str) -> bool:
        before = code_digest(module)
        text = (package / file).read_text()
        assert old in text
        (package / file).write_text(text.replace(old, new))
        assert code_digest(module) == before  # kept for the life of the process
        provenance._digest_and_imports.cache_clear()
        return code_digest(module) != before

    return changes


@pytest.mark.parametrize(
    ("module", "file", "old", "new"),
    [
        ("lagsplat.tools.blade", "tools/blade.py", "= 2", "= 3"),
        ("lagsplat.top", "room/chair.py", "4", "3"),  # `from package import module`
        ("lagsplat.top", "tools/saw.py", "* x", "/ x"),  # `from module import name`
        ("lagsplat.top", "tools/blade.py", "2", "3"),  # through another module, `import a.b.c as d`
        ("lagsplat.late", "tools/blade.py", "2", "3"),  # an import inside a function
        (
            "lagsplat.top",
            "tools/__init__.py",
            '"""Tools."""',
            "import os",
        ),  # runs on import
        ("lagsplat.room", "room/__init__.py", '"""A room."""', "X = 1"),
        ("lagsplat.top", "top.py", "import cut\n", "import cut as cut\n"),
        ("lagsplat.room.chair", "room/templates/page.html.j2", "<p>", "<div>"),
    ],
)
def test_code_counts(changes: Callable[..., bool], module: str, file: str, old: str, new: str) -> None:
    assert changes(module, file=file, old=old, new=new)


@pytest.mark.parametrize(
    ("module", "file", "old", "new"),
    [
        ("lagsplat.top", "tools/blade.py", "# sharp", "# blunt"),
        ("lagsplat.top", "tools/blade.py", "  # mm", ""),
        ("lagsplat.top", "tools/saw.py", '"""A saw."""', '"""Cuts wood."""'),
        ("lagsplat.top", "tools/saw.py", "(x):\n", '(x):\n    """Cut."""\n'),
        ("lagsplat.top", "tools/blade.py", "EDGE = 2", 'EDGE = 2\n"""Width of the edge."""'),
        ("lagsplat.top", "top.py", "cut(chair)", "cut(\n        chair,\n    )"),
        ("lagsplat.top", "__init__.py", '"1"', '"2"'),  # a release
        ("lagsplat.top", "alone.py", "1", "2"),  # not imported
        ("lagsplat.alone", "tools/blade.py", "2", "3"),
    ],
)
def test_the_rest_does_not_count(
    changes: Callable[..., bool], module: str, file: str, old: str, new: str
) -> None:
    assert not changes(module, file=file, old=old, new=new)


@pytest.mark.usefixtures("package")
def test_several_modules_make_one_digest() -> None:
    both = code_digest("lagsplat.top", "lagsplat.alone")
    assert both == code_digest("lagsplat.alone", "lagsplat.top")
    assert both not in {code_digest("lagsplat.top"), code_digest("lagsplat.alone")}
    assert len(both) == 64


def test_what_cannot_be_followed(package: Path) -> None:
    for name in ("lagsplat.nowhere", "numpy", "lagsplat.top.sit"):
        with pytest.raises(ModuleNotFoundError, match=f"no module '{name}'"):
            code_digest(name)
    (package / "bad.py").write_text("\n\nfrom .room import chair\n")
    with pytest.raises(ValueError, match=r"bad\.py, line 3: a relative import"):
        code_digest("lagsplat.bad")


def test_circles_end(package: Path) -> None:
    (package / "room" / "chair.py").write_text("import lagsplat.top\n")
    assert code_digest("lagsplat.top") == code_digest("lagsplat.room.chair")


def test_planning_stays_light(repository: Path) -> None:
    code = (
        "import sys; from lagsplat.provenance import code_digest, stamp; stamp();"
        "code_digest('lagsplat.io.recording.recording'); import lagsplat.io.config;"
        "heavy = {'torch', 'numba', 'numpy', 'cv2', 'lagsplat.io.recording.recording'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=repository)


def test_stamp_tells_commit_versions_and_threads(repository: Path) -> None:
    found = stamp()
    git = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=repository)
    if git.returncode == 0:
        assert found["commit"] == git.stdout.strip()
        assert isinstance(found["dirty"], bool)
    assert found["versions"]["torch"] == torch.__version__
    assert found["versions"]["numpy"] == np.__version__
    assert found["threads"] == torch.get_num_threads()
    assert found["time_utc"].endswith("+00:00")


def test_stamp_outside_git(repository: Path, tmp_path: Path) -> None:
    (tmp_path / "lagsplat").mkdir()
    for name in ("__init__.py", "project.py", "provenance.py"):
        shutil.copy(repository / "lagsplat" / name, tmp_path / "lagsplat")
    # A checkout that does not track the copy says nothing about it either.
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    code = (
        "from lagsplat.provenance import stamp; s = stamp();"
        "assert (s['commit'], s['dirty'], s['threads'], s['device']) == (None,) * 4, s"
    )
    subprocess.run(
        [sys.executable, "-P", "-c", f"import sys; sys.path.insert(0, '.'); {code}"], check=True, cwd=tmp_path
    )


def test_seed_repeats_all_generators() -> None:
    def draw() -> tuple[float, float, float]:
        return random.random(), float(np.random.rand()), float(torch.rand(()))  # noqa: NPY002

    seed_everything(7)
    first = draw()
    assert draw() != first
    seed_everything(7)
    assert draw() == first
    for seed in (-1, 2**32):
        with pytest.raises(ValueError, match=f"seed is {seed}"):
            seed_everything(seed)


def test_threads_reach_torch_and_numba() -> None:
    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        set_threads(1)
        assert (torch.get_num_threads(), numba.get_num_threads()) == (1, 1)
        set_threads(numba.config.NUMBA_NUM_THREADS + 1)  # Numba takes what it has
        assert numba.get_num_threads() == numba.config.NUMBA_NUM_THREADS
        with pytest.raises(ValueError, match="threads is 0"):
            set_threads(0)
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])


def test_waiting_threads_sleep_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    let_waiting_threads_sleep()
    assert os.environ["OMP_WAIT_POLICY"] == "PASSIVE"
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    let_waiting_threads_sleep()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
