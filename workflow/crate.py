"""Describe this workflow and its tables and figures as an RO-Crate: ``python workflow/crate.py OUT``.

The crate follows the profile Workflow RO-Crate: the Snakefile is its main entity. It needs ``pip install
rocrate``.
"""

import sys
from importlib.metadata import version
from pathlib import Path

from lagsplat import __version__
from lagsplat.project import PARTS

ROOT = Path(__file__).resolve().parents[1]
MADE = ("results/tables", "results/figures")  # below the folder where Snakemake ran


def write_crate(root: Path, results: Path, out: Path) -> Path:
    """Write the crate of the workflow in ``root`` with what is in ``results`` to the folder ``out``.

    Raises:
        FileExistsError: there is something in ``out``.
    """
    from rocrate.rocrate import ROCrate

    if out.exists() and any(out.iterdir()):
        raise FileExistsError(f"{out} holds files; name a folder that is new or empty")
    crate = ROCrate()
    crate.name, crate.license = "LaGSplat", "https://spdx.org/licenses/BSD-3-Clause"
    crate.description = "From one fixed-camera video to a simulation that can be pushed"
    about = {"name": "LaGSplat", "version": __version__}
    language = {"lang": "snakemake", "lang_version": version("snakemake")}
    crate.add_workflow(str(root / "Snakefile"), "Snakefile", main=True, properties=about, **language)
    for place, names in ((root, PARTS), (results, MADE)):
        for name in names:
            for path in sorted((place / name).rglob("*")):
                if path.is_file() and path.suffix != ".pyc":
                    crate.add_file(str(path), str(path.relative_to(place)))
    crate.write(out)
    return out


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python workflow/crate.py OUT, in the folder where Snakemake ran")
    try:
        print(write_crate(ROOT, Path.cwd(), Path(sys.argv[1])))
    except (OSError, ImportError) as error:
        sys.exit(f"{error}" if isinstance(error, OSError) else f"{error}; pip install rocrate")
