"""From the folder of a fitted run to a place where it can be pushed: live, or as one page."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from lagsplat.array_types import Vector
from lagsplat.config.compose import compose
from lagsplat.config.schema import Config, options
from lagsplat.diagnose.augmented.model import load_augmented
from lagsplat.diagnose.augmented.simulate import MissingAcceleration
from lagsplat.forces.equilibrium import OperatingPoint, hold_at_load
from lagsplat.pipelines.apply_diagnosis import AUGMENTED_FILE
from lagsplat.provenance import set_threads
from lagsplat.runs.run import FittedRun, open_run
from lagsplat.viewer.simulation.history import RecordedData, read_recorded_data
from lagsplat.viewer.simulation.session import Session, Snapshot

CORES = 2


def view(folder: Path, experiment: Config, own: Mapping[str, str], *, browser: bool) -> None:
    """Serve the run in ``folder`` until interrupted, and open the system's browser there if ``browser``.

    ``own`` may name ``out``, where sessions are saved (the run's folder if not), ``replay``, a session to
    begin with, and ``diagnosis``, the folder of one whose residual can be laid over the picture.

    Raises:
        FileNotFoundError: an artefact of the run, or the session, is not there.
        ValueError: an artefact is unreadable, or the session is of another run.
    """
    from lagsplat.viewer.server.server import ViewerServer
    from lagsplat.viewer.server.session_export import load_history

    set_threads(CORES)
    run = open_run(folder)
    session = pushable(run, experiment)
    if "replay" in own:
        session.replay(load_history(Path(own["replay"])))
    residual = _residual(Path(own["diagnosis"]), session) if "diagnosis" in own else None
    title, out = title_of(folder), Path(own.get("out", str(folder)))
    live = ViewerServer(session, title=title, read_frame=_frames(run), folder=out, residual=residual)
    print(f"{title}: {live.url}   (Ctrl-C ends it)", flush=True)
    if browser:
        live.open_browser()
    live.wait()
    live.stop()


def export_page(folder: Path, experiment: Config, out: Path) -> None:
    """Write the run in ``folder`` as one page that can be pushed without a server.

    Raises:
        FileNotFoundError: an artefact of the run is not there.
        ValueError: the page cannot compute this form of a law, or would be too large.
    """
    from lagsplat.viewer.static_page.build import save_page

    session = pushable(open_run(folder), experiment)
    kinematics = session.operating_point.kinematics
    coordinates = "one learned coordinate" if kinematics.d == 1 else f"{kinematics.d} learned coordinates"
    seen = "one camera" if kinematics.space == 2 else "cameras on several sides"
    subtitle = f"Seen by {seen}, never pushed. {kinematics.center.shape[0]} Gaussians, {coordinates}."
    title = title_of(folder)
    save_page(out, session, title=title[:1].upper() + title[1:], subtitle=subtitle)


def pushable(run: FittedRun, experiment: Config) -> Session:
    """A run at rest, ready to be pushed."""
    operating_point, recorded = held_run(run)
    return Session(operating_point, recorded, experiment.viewer, experiment.forces)


def held_run(run: FittedRun) -> tuple[OperatingPoint, RecordedData]:
    """A run at rest under its mean inputs, and what its recording offers."""
    recorded = read_recorded_data(run.chart, names=run.recording.input_names, units=run.recording.input_units)
    return hold_at_load(run.autoencoder, run.chart, run.lagrangian), recorded


def title_of(folder: Path) -> str:
    """What a run is called: its system, and where its recording comes from, by the folders of the
    workflow."""
    parts = folder.resolve().parts
    for kind in ("simulated", "filmed"):
        if kind in parts[:-1]:
            system = parts[len(parts) - 1 - parts[::-1].index(kind) + 1]
            title = compose(f"system={system}").system.title if system in options("system") else system
            return f"{title} ({kind})"
    return folder.resolve().name


def _frames(run: FittedRun) -> Callable[[int], UInt8[np.ndarray, "H W 3"]]:
    def frame(number: int) -> UInt8[np.ndarray, "H W 3"]:
        return np.asarray(run.recording.frames[number])

    return frame


def _residual(diagnosis: Path, session: Session) -> Callable[[Snapshot], Vector]:
    missing = MissingAcceleration(
        load_augmented(diagnosis / AUGMENTED_FILE if diagnosis.is_dir() else diagnosis)
    )
    try:
        missing.acceleration(session.q, session.v, session.u)
    except ValueError as error:
        raise ValueError(f"{diagnosis}: a diagnosis of another sim than this run ({error})") from error
    return lambda snapshot: missing.acceleration(snapshot.q, snapshot.v, snapshot.u)
