"""Fit every stage to one recording, in one process.

The workflow calls the same functions one job at a time and keeps what it can; this module suits a single run.
"""

import logging
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lagsplat.chart.chart import fit_chart, require_trained_autoencoder, save_chart
from lagsplat.config.schema import Config
from lagsplat.io.files.lease import hold_lease
from lagsplat.io.files.tracking import track
from lagsplat.io.read import read_recording
from lagsplat.io.recording.recording import Recording, save_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.matter.field import save_matter
from lagsplat.novel_views.sharp import obtain_views
from lagsplat.provenance import code_digest, sha256_hex
from lagsplat.runs.run import FittedRun, find_matter
from lagsplat.stage1.autoencoder import save_autoencoder
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage1.linear_response import InputHistory
from lagsplat.stage2.decoder_mass import compute_decoder_geometry
from lagsplat.stage2.finished_fits import FinishedFits
from lagsplat.stage2.fit import fit_dynamics, save_dynamics
from lagsplat.systems.simulate import simulate_system
from lagsplat.systems.truth import Truth
from lagsplat.views.novel import save_views

log = logging.getLogger(__name__)


def obtain_recording(experiment: Config) -> tuple[Recording, Truth | None]:
    """The recording of an experiment: read from a file, downloaded, or simulated together with its truth."""
    if experiment.recording.kind != "simulated":
        return read_recording(experiment.recording), None
    return simulate_system(experiment.simulation, experiment.release, seed=0)


def fit_run(
    experiment: Config,
    *,
    out: str | os.PathLike[str],
    header: Mapping[str, Any] | None = None,
    recording: Recording | None = None,
) -> FittedRun:
    """Fit every stage to the experiment's recording and write the artefacts to the folder ``out``.

    The first seed of the experiment is used. A fit that was stopped continues from its checkpoints, with the
    same result: stage 1 from the last step that was kept, stage 2 after the last of its fits.

    Args:
        experiment: From `lagsplat.compose`.
        out: The folder.
        header: Plain data kept in every artefact; the settings and the digest of the code if left out.
        recording: The experiment's recording, where it has been read already.

    Raises:
        ValueError: the recording is unreadable or too short for the split, or stage 1 learned nothing.
        BlockingIOError: another process is fitting a run in the same folder.

    Example:
        >>> import lagsplat
        >>> experiment = lagsplat.compose("profile=toy", "recording=filmed", "recording.path=gone.npz")
        >>> lagsplat.fit_run(experiment, out="short")
        Traceback (most recent call last):
        FileNotFoundError: gone.npz ...
    """
    out = Path(out).expanduser()
    if header is None:
        header = {"config": asdict(experiment), "code": code_digest(__name__)}
    with hold_lease(out / "run"):
        return _fit_stages(experiment, out, header, recording)


def _fit_stages(
    experiment: Config, out: Path, header: Mapping[str, Any], recording: Recording | None
) -> FittedRun:
    made, truth = obtain_recording(experiment) if recording is None else (recording, None)
    recording = split_train_held_out(made, experiment.recording.split)
    train, _ = recording.split()
    save_recording(out / "recording.safetensors", recording)
    checkpoint, fits = (out / "checkpoint" / name for name in ("state.pt", "fits.pt"))
    seed = experiment.seeds[0]
    identity = f"{header} {recording.meta.get('sha256')} {recording.n_train} {seed}"
    novel = supervision = views = None
    if experiment.views is not None:
        supervision = experiment.views.supervision
        views = obtain_views(
            experiment.views,
            recording,
            experiment.recording,
            released=experiment.release,
            states=None if truth is None else truth.states,
            cache=out / "sharp",
        )
        save_views(out / "views.safetensors", views, header)
        novel = views.first(train.n_frames)
    autoencoder, curve = fit_autoencoder(
        train.frames,
        experiment.stage1,
        seed=seed,
        checkpoint=checkpoint,
        identity=identity,
        novel=novel,
        supervision=supervision,
        history=InputHistory(train.inputs, train.segments),
    )
    save_autoencoder(out / "autoencoder.safetensors", autoencoder, header)
    require_trained_autoencoder(autoencoder, train.frames)
    chart = fit_chart(autoencoder, recording, experiment.chart, seed=seed)
    save_chart(out / "chart.safetensors", chart, header)
    try:
        matter, about = find_matter(recording, autoencoder, chart, experiment.matter, views=views, seed=seed)
        save_matter(out / "matter.safetensors", matter, header, about)
    except ValueError as error:
        log.warning("the run cannot be pushed: %s", error)
    lagrangian, report = fit_dynamics(
        chart.train.smoothed(chart.smoothing_frames),
        chart.metric,
        experiment.stage2,
        experiment.seeds[0],
        rest=chart.rest,
        geometry=compute_decoder_geometry(autoencoder, chart),
        measured=chart.train,
        on_candidate=lambda row: log.info("%s", row),
        recall=FinishedFits(fits, identity=f"{identity} {sha256_hex(chart.train.latents.tobytes())}"),
    )
    for warning in report.warnings:
        log.warning("%s", warning)
    save_dynamics(out / "dynamics.safetensors", lagrangian, header, report)
    curves = {"stage1": [point._asdict() for point in curve], "stage2": [asdict(row) for row in report.curve]}
    for rule, rows in curves.items():
        track(experiment.tracking, rows, run=str(out), rule=rule, settings=asdict(experiment))
    for finished in (checkpoint, fits):
        finished.unlink(missing_ok=True)
    return FittedRun(recording, autoencoder, chart, lagrangian, folder=out)
