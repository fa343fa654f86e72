"""Run a program of the GaussianPrediction checkout on a scene of one fixed camera.

The tool takes the scene's extent from the distances between cameras. With one camera it is zero: step sizes
of places would vanish and all points would count as too large. Run by the tool's own interpreter from the
checkout, as ``python static_camera.py EXTENT PROGRAM ARGUMENTS``, this gives it an extent.
"""

import importlib
import runpy
import sys
from typing import Any

READERS = "scene.dataset_readers"
MEASURE = "getNerfppNorm"


def with_extent(extent: float, program: str, *arguments: str) -> None:
    """Run ``program`` with ``arguments``, with a scene extent of at least ``extent``."""
    sys.path.insert(0, "")
    readers = importlib.import_module(READERS)
    measured = getattr(readers, MEASURE, None)
    if measured is None:
        raise SystemExit(
            f"{READERS} has no {MEASURE}: this checkout is another version of the tool than is known here"
        )

    def at_least(cameras: Any) -> Any:
        norm = dict(measured(cameras))
        return norm | {"radius": max(float(norm["radius"]), extent)}

    setattr(readers, MEASURE, at_least)
    sys.argv = [program, *arguments]
    runpy.run_path(program, run_name="__main__")


if __name__ == "__main__":
    with_extent(float(sys.argv[1]), *sys.argv[2:])
