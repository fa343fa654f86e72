"""Lay down the pipeline in a new folder, where its settings and rules can be changed."""

import os
import shutil
from pathlib import Path

from lagsplat import __version__
from lagsplat.io.files.atomic import save_json
from lagsplat.project import MARK, PARTS, bundled_project

NOT_COPIED = ("__pycache__", "*.py[cod]", ".*")


def copy_pipeline(folder: str | os.PathLike[str]) -> Path:
    """Copy the pipeline that came with this package to ``folder``, which is new or empty.

    Args:
        folder: Made with its parents where it is missing.

    Returns:
        The folder.

    Raises:
        FileExistsError: something stands there already; nothing was changed.
        OSError: the folder cannot be written.
    """
    folder, source = Path(folder).expanduser(), bundled_project()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        what = "holds files" if folder.is_dir() else "is a file"
        raise FileExistsError(f"{folder} {what}, which stay as they are; name a folder that is new or empty")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in PARTS:
            if (source / name).is_dir():
                shutil.copytree(source / name, folder / name, ignore=shutil.ignore_patterns(*NOT_COPIED))
            else:
                shutil.copyfile(source / name, folder / name)
        # Last, so that a copy that was cut short is not taken for a pipeline.
        save_json(folder / MARK, {"made_by": f"lagsplat {__version__}"})
    except OSError as error:
        # `copytree` goes on after an error and tells of all of them.
        reason = error.args[0][0][2] if isinstance(error, shutil.Error) else error
        raise OSError(
            f"{folder} does not hold the whole pipeline: {reason}. Delete it, make room or choose a folder "
            "that can be written, and run again"
        ) from error
    return folder
