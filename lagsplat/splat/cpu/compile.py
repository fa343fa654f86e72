"""How the kernels are compiled, and when a compiled kernel on disk may be used again."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba import njit

OPTIONS = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    # Nothing that assumes the absence of NaN or infinity: both occur, and are sorted out by comparisons.
    "fastmath": {"contract", "nsz", "arcp"},
}


def compiled(*, parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: compile with Numba on the first call, keep the result on disk.

    Numba's disk cache looks only at the file of the function itself, so a kernel would go on using an old
    version of a helper from another file. Here a cached result is void once any source of a kernel changes.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(parallel=parallel, **OPTIONS)(function)  # type: ignore[call-overload]
        dispatcher._cache._cache_file._source_stamp = digest(Path(__file__).parent)
        return dispatcher

    return decorate


def digest(folder: Path) -> str:
    """SHA-256 of the kernels' sources: the files in ``folder`` and the image model they implement."""
    sources = [*folder.glob("*.py"), folder.parent / "image_model.py"]
    return sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
