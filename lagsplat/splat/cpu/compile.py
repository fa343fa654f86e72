"""Compile the kernels, and decide when a compiled kernel on disk is still valid."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit

OPTIONS = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    # No flag that assumes finite numbers: NaN and infinity occur, and comparisons handle them.
    "fastmath": {"contract", "nsz", "arcp"},
}


def compiled(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with Numba on the first call and cache the result on disk.

    Numba's disk cache checks only the function's own file, so a kernel would keep using an old version of a
    helper from another file. Here any change to a kernel source invalidates the cache.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(parallel=parallel, **OPTIONS)(function)  # type: ignore[call-overload]
        dispatcher._cache._cache_file._source_stamp = digest(Path(__file__).parent)
        return dispatcher

    return decorate


def digest(folder: Path) -> str:
    """SHA-256 of the kernel sources: the files in ``folder`` and the image model they implement."""
    sources = [*folder.glob("*.py"), folder.parent / "image_model.py"]
    return sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
