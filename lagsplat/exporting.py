"""What ``lagsplat export`` writes: a function a format, each importing what its format needs."""

from collections.abc import Callable
from pathlib import Path

from lagsplat.config import ConfigError, compose


def _mcap(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.export import export_mcap
    from lagsplat.pipeline import open_run, protocol

    export_mcap(open_run(folder), protocol(folder, changes), out)


def _page(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.viewing import export_page

    export_page(folder, compose(*changes), out)


def _ply(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.export_ply import export_ply
    from lagsplat.pipeline import open_run, state_of

    if changes:
        raise ConfigError(f"export --ply takes out, frame and q, not {changes[0]!r}")
    run = open_run(folder)
    export_ply(run.autoencoder, run.chart, state_of(run, own.get("frame"), own.get("q")), out)


EXPORTS: dict[str, Callable[[Path, dict[str, str], list[str], Path], None]] = {
    "mcap": _mcap,
    "html": _page,
    "ply": _ply,
}
"""By format: the folder of the run, its own words, changes of the configuration, the file to be written."""
