"""Where the pipeline stands: the folder of ``Snakefile``, ``conf/``, ``workflow/`` and what belongs to them.

A checkout holds them beside the package. A wheel holds a copy inside the package, put there by ``setup.py``,
and ``lagsplat init`` lays down one that can be changed. Planning imports this module, so it uses the standard
library alone.
"""

import os
from pathlib import Path

PACKAGE_FOLDER = Path(__file__).resolve().parent
PARTS = ("Snakefile", "conf", "workflow", "profiles", "benchmarks")
"""What makes a pipeline, all of it in one folder."""
INSTALLED = "_project"  # folder of the copy in a wheel
MARK = ".lagsplat.json"  # `lagsplat init` writes it into the folders that it makes
VARIABLE = "LAGSPLAT_PROJECT"  # names a folder to be used instead of any other


def bundled_project() -> Path:
    """The pipeline that came with this package: inside it, or beside it in a checkout."""
    inside = PACKAGE_FOLDER / INSTALLED
    return inside if inside.is_dir() else PACKAGE_FOLDER.parent


def find_project() -> Path:
    """The pipeline whose ``conf/`` counts in this process.

    It is the folder that ``LAGSPLAT_PROJECT`` names, else the working folder where ``lagsplat init`` made it,
    else the one that came with the package.

    Raises:
        ValueError: ``LAGSPLAT_PROJECT`` names a folder without ``conf/config.yaml``.
    """
    if named := os.environ.get(VARIABLE):
        folder = Path(named).expanduser().resolve()
        if not _holds_settings(folder):
            raise ValueError(
                f"{VARIABLE}={named}: no conf/config.yaml there; "
                "name a folder that `lagsplat init` made, or unset the variable"
            )
        return folder
    here = Path.cwd()
    return here if (here / MARK).is_file() and _holds_settings(here) else bundled_project()


def use_project(folder: str | os.PathLike[str]) -> Path:
    """Let this process and those that it starts read the ``conf/`` in ``folder``, if there is one.

    A workflow that loads this one as a module has no such folder: then `find_project` decides.

    Returns:
        The folder that counts from now on.
    """
    if _holds_settings(Path(folder)):
        os.environ[VARIABLE] = str(Path(folder).resolve())
    return find_project()


def _holds_settings(folder: Path) -> bool:
    return (folder / "conf" / "config.yaml").is_file()
