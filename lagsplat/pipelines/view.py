"""From the folder of a fitted run to a place where it can be pushed: live, or as one page."""

import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.array_types import Vector
from lagsplat.config.compose import compose
from lagsplat.config.schema import Config, options
from lagsplat.diagnose.augmented.model import load_augmented
from lagsplat.diagnose.augmented.simulate import compute_missing_acceleration
from lagsplat.diagnose.simulators.fitted_run import linearize_law_coordinates
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.io.files.artifact import read_header
from lagsplat.io.recording.recording import ORIGINS
from lagsplat.pipelines.apply_diagnosis import AUGMENTED_FILE
from lagsplat.pipelines.film_runs import FILM_TITLE
from lagsplat.processes import receive_signals
from lagsplat.provenance import set_threads
from lagsplat.report.common.formatting import capitalize_first
from lagsplat.runs.run import FittedRun, open_run
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.viewer.simulation.history import read_recorded_data
from lagsplat.viewer.simulation.session import Session, Snapshot

PathLike = str | os.PathLike[str]
CORES = 2


def view(
    folder: PathLike,
    *overrides: str,
    browser: bool = True,
    diagnosis: PathLike | None = None,
    replay: PathLike | None = None,
    out: PathLike | None = None,
) -> None:
    """Serve a fitted run to the browser, to be pushed there, until interrupted or told to end by SIGTERM.

    Args:
        folder: Of the run.
        overrides: Settings such as ``"viewer.port=8081"``.
        browser: Open the system's browser.
        diagnosis: Folder of a diagnosis whose residual can be laid over the image.
        replay: A saved session to begin with.
        out: Folder in which sessions are saved; the run's own if left out.

    Raises:
        FileNotFoundError: a file of the run, of the diagnosis or of the session is not there.
        ValueError: a file cannot be read, or belongs to another run.

    Example:
        >>> import lagsplat
        >>> lagsplat.view("nowhere")
        Traceback (most recent call last):
        FileNotFoundError: nowhere: no recording.safetensors there ...
    """
    from lagsplat.viewer.server.server import ViewerServer
    from lagsplat.viewer.server.session_export import load_history

    folder, experiment = Path(folder).expanduser(), compose(*overrides)
    set_threads(CORES)
    run = open_run(folder)
    session = pushable(run, experiment)
    if replay is not None:
        session.replay(load_history(Path(replay)))
    title = title_of(folder)
    server = ViewerServer(
        session,
        title=title,
        read_frame=lambda number: np.asarray(run.recording.frames[number]),
        folder=folder if out is None else Path(out),
        residual=None if diagnosis is None else _residual(Path(diagnosis), session, run.lagrangian),
        moving=replay is None,
    )
    with receive_signals() as wait_for_signal:
        print(f"{title}: {server.url}   (Ctrl-C ends it)", flush=True)
        if browser:
            server.open_browser()
        number = wait_for_signal()
    server.stop()
    reason = "Ctrl-C" if number == signal.SIGINT else number.name
    print(f"{title}: ended by {reason}; saved sessions are in {server.folder}", flush=True)


def export_page(folder: PathLike, out: PathLike, *overrides: str) -> Path:
    """Write a fitted run as one web page that can be pushed without a server.

    Args:
        folder: Of the run.
        out: The HTML file that is written.
        overrides: Settings such as ``"forces.brush=0.1"``.

    Returns:
        The file.

    Raises:
        FileNotFoundError: a file of the run is not there.
        ValueError: the page cannot compute this form of the dynamics, or would be too large.

    Example:
        >>> import lagsplat
        >>> lagsplat.export_page("run", "run.html").name
        'run.html'
    """
    from lagsplat.viewer.static_page.build import save_page

    folder, out = Path(folder).expanduser(), Path(out)
    experiment = compose(*overrides)
    session = pushable(open_run(folder), experiment)
    point = session.operating_point
    coordinates = "one learned coordinate" if point.law.d == 1 else f"{point.law.d} learned coordinates"
    seen = "one camera" if point.matter.space == 2 else "cameras on several sides"
    subtitle = f"Seen by {seen}, never pushed. {point.autoencoder.gaussians.n} Gaussians, {coordinates}."
    title = title_of(folder)
    save_page(out, session, title=capitalize_first(title), subtitle=subtitle)
    return out


def pushable(run: FittedRun, experiment: Config) -> Session:
    """A run at rest under its mean inputs, ready to be pushed."""
    operating_point = hold_at_load(run.autoencoder, run.chart, run.lagrangian, run.matter)
    recorded = read_recorded_data(run.chart, names=run.recording.input_names, units=run.recording.input_units)
    return Session(operating_point, recorded, experiment.viewer, experiment.forces, run.draws)


def title_of(folder: Path) -> str:
    """What a run is called: its system and the origin of its recording, or else its folder.

    The job that made the run records both, the folders of the workflow tell them, or its settings do. A film
    for which nobody named a system has none.
    """
    path = folder / "dynamics.safetensors"
    header = read_header(path) if path.is_file() else {}
    known = _name_by_job(header) or _name_by_place(folder) or _name_by_settings(header)
    return known or folder.resolve().name


def _name_by_job(header: Mapping[str, Any]) -> str:
    names = header.get("wildcards", {})
    known = "system" in names and names.get("recording") in ORIGINS
    return _name_system(names["system"], names["recording"]) if known else ""


def _name_by_place(folder: Path) -> str:
    parts = folder.resolve().parts
    for origin in ORIGINS:
        if origin in parts[:-1]:
            return _name_system(parts[len(parts) - parts[::-1].index(origin)], origin)
    return ""


def _name_by_settings(header: Mapping[str, Any]) -> str:
    config = header.get("config", {})
    if not (recording := config.get("recording")):
        return ""
    title = config["system"]["title"]
    if recording["path"] is not None and title in (FILM_TITLE, compose().system.title):
        return ""
    return _join_title(title, "simulated" if recording["kind"] == "simulated" else "filmed")


def _name_system(system: str, origin: str) -> str:
    title = compose(f"system={system}").system.title if system in options("system") else system
    return _join_title(title, origin)


def _join_title(title: str, origin: str) -> str:
    return f"{capitalize_first(title)} ({origin})" if title else ""


def _residual(diagnosis: Path, session: Session, lagrangian: Lagrangian) -> Callable[[Snapshot], Vector]:
    """What the effects of a diagnosis add to the acceleration of latents."""
    file = diagnosis / AUGMENTED_FILE if diagnosis.is_dir() else diagnosis
    augmented = load_augmented(file)

    def missing(q: Vector, v: Vector, u: Vector) -> Vector:
        s, slope = linearize_law_coordinates(lagrangian, q)
        return np.linalg.solve(slope, compute_missing_acceleration(augmented, s, slope @ v, u))

    try:
        missing(session.q, session.v, session.u)
    except ValueError as error:
        raise ValueError(f"{diagnosis}: a diagnosis of another sim than this run ({error})") from error
    return lambda now: missing(now.q, now.v, now.u)
