"""What every test may use: fixed seeds, the recordings beside the checkout, and the device."""

import os
from pathlib import Path

# Workers share the cores, and kernels whose threads outnumber these wait for one another ten times as long.
# Numba reads this when it is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
import pytest
import torch

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files that take minutes come first, the longest foremost, so that no core waits at the end."""
    longest = ("test_toy.py", "test_plan.py")
    items.sort(key=lambda item: longest.index(item.path.name) if item.path.name in longest else len(longest))


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recordings beside the checkout, or the one named by ``LAGSPLAT_SHARED_DATA``."""
    folder = Path(os.environ.get("LAGSPLAT_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no shared recordings at {folder} (set LAGSPLAT_SHARED_DATA)")
    return folder


@pytest.fixture(autouse=True)
def fixed_seeds() -> None:
    """Every test starts from the same random state."""
    np.random.seed(0)  # noqa: NPY002  third-party code may draw from the legacy generator
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def device_or_skip(request: pytest.FixtureRequest) -> None:
    """Skip tests marked ``gpu`` where no CUDA device is present."""
    if request.node.get_closest_marker("gpu") and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
