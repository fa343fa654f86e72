"""The page's own JavaScript, run without a browser."""

import json
import shutil
import subprocess
from collections.abc import Sequence

import pytest

from lagsplat.viewer.static_page.build import read_asset


def run_script(parts: Sequence[str], driver: str, data: dict) -> object:
    """What ``driver`` prints, which finds ``data`` in its input and the ``parts`` of the page before it."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node on this machine to run the page's JavaScript; a browser test runs it, too")
    script = "\n".join([*(read_asset(name) for name in parts), driver])
    done = subprocess.run(
        [node, "-e", script], input=json.dumps(data), capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
