"""Every writer on a disk that is full, broken, over its quota or read-only: `failing_writes` says how."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


@pytest.mark.skipif(sys.platform != "linux", reason="the library that fails is for Linux")
def test_no_writer_loses_anything_on_a_failing_disk(tmp_path: Path) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler on this machine; apt-get install gcc")
    library = tmp_path / "shim.so"
    source = HERE / "failing_writes.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    path, memory = os.pathsep.join([str(ROOT), *sys.path]), "/dev/shm"  # every write is forced to the disk
    done = subprocess.run(
        [sys.executable, "-m", "tests.campaign.failing_writes"],
        env={**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": path, "TMPDIR": memory},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert done.stdout.count(" 0 wrong") == 64, "sixteen writers, four errors"
