"""A fitted run: the recording and the three models that were fitted to it, opened and simulated.

A run is a folder with one file a stage. In the workflow's results several runs share the files of the earlier
stages, which then lie up to two folders higher.
"""

import json
import logging
import os
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart, load_chart
from lagsplat.config.compose import compose
from lagsplat.io.files.atomic import sha256_of
from lagsplat.io.files.user_cache import locate_in_cache
from lagsplat.io.recording.recording import Recording, load_recording
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import MatterField, MatterReport, load_matter, save_matter
from lagsplat.matter.fit import fit_matter
from lagsplat.matter.scene import make_scene
from lagsplat.provenance import code_digest
from lagsplat.stage1.autoencoder import Autoencoder, load_autoencoder
from lagsplat.stage2.fit import load_dynamics, load_parameter_draws
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import rollout as integrate
from lagsplat.views.novel import NovelViews, load_views

log = logging.getLogger(__name__)

ARTEFACTS = ("recording", "autoencoder", "chart", "dynamics")
"""Names of the files of a run, without their suffix."""


@dataclass(frozen=True)
class FittedRun:
    """One trained simulation: its recording, image model, chart and dynamics.

    Example:
        >>> import lagsplat
        >>> run = lagsplat.open_run("run")
        >>> run.recording.n_frames == len(run.chart.latents)
        True
    """

    recording: Recording
    autoencoder: Autoencoder
    chart: Chart
    lagrangian: Lagrangian
    folder: Path | None = None
    """Where it was opened from or written to."""

    @cached_property
    def draws(self) -> Float64[np.ndarray, "m p"] | None:
        """Parameters of laws that the recording allows as well; None without a folder or a likelihood."""
        if self.folder is None:
            return None
        return load_parameter_draws(locate_artefact(self.folder, "dynamics"))

    @cached_property
    def matter(self) -> MatterField:
        """How the matter of its film moves; found now, in about a minute, if it was not when it was fitted.

        What is found of a run in a folder is kept in the user's cache; no folder of a run is written to.

        Raises:
            ValueError: nothing moves near the mean state, or the film is too short.
        """
        if self.folder is None:
            return find_matter(self.recording, self.autoencoder, self.chart, compose().matter)[0]
        try:
            return load_matter(locate_artefact(self.folder, "matter"))[0]
        except FileNotFoundError:
            return _find_matter_once(self, self.folder)


def _find_matter_once(run: FittedRun, folder: Path) -> MatterField:
    """The matter of a run without it, found now or, of the same files, settings and code, before."""
    config, in_space = compose().matter, run.autoencoder.gaussians.space == 3
    names = ("recording", "autoencoder", "chart", *(("views",) if in_space else ()))
    files = {name: locate_artefact(folder, name) for name in names}
    header = {"config": {"matter": asdict(config)}, "code": code_digest(__name__)}
    key = json.dumps([header, [sha256_of(file) for file in files.values()]], sort_keys=True)
    kept = locate_in_cache("matter", key).with_suffix(".safetensors")
    if kept.is_file():
        return load_matter(kept)[0]
    log.warning("%s: no matter.safetensors: looking for bodies in the film", folder)
    views = load_views(files["views"]) if in_space else None
    matter, report = find_matter(run.recording, run.autoencoder, run.chart, config, views=views)
    try:
        save_matter(kept, matter, header, report)
    except OSError as error:
        log.warning("the matter is not kept, and will be looked for again: %s", error)
    return matter


def find_matter(
    recording: Recording,
    autoencoder: Autoencoder,
    chart: Chart,
    config: MatterConfig,
    *,
    views: NovelViews | None = None,
    seed: int = 0,
) -> tuple[MatterField, MatterReport]:
    """Find the bodies of a recording's training part and how they move with its states.

    Args:
        recording: the film.
        autoencoder, chart: of a run.
        config: settings.
        views: of the recording's instants from other cameras, for a run in space.
        seed: of the choice of frames.

    Raises:
        ValueError: nothing moves near the mean state, or the film is too short.
    """
    frames, scene = recording.split()[0].frames, make_scene(autoencoder, chart, views)
    matter, report = fit_matter(frames, chart.train.latents, config, seed=seed, scene=scene)
    for warning in report.warnings:
        log.warning("%s", warning)
    return matter, report


def open_run(folder: str | os.PathLike[str]) -> FittedRun:
    """Open the run that `fit_run` or the workflow left in ``folder``.

    Raises:
        FileNotFoundError: an artefact is neither there nor in the two folders above.

    Example:
        >>> import lagsplat
        >>> lagsplat.open_run("run").chart.d
        2
    """
    folder = Path(folder).expanduser()
    paths = {name: locate_artefact(folder, name) for name in ARTEFACTS}
    autoencoder, _ = load_autoencoder(paths["autoencoder"])
    chart, _ = load_chart(paths["chart"])
    lagrangian, _ = load_dynamics(paths["dynamics"])
    return FittedRun(load_recording(paths["recording"]), autoencoder, chart, lagrangian, folder=folder)


def locate_artefact(folder: Path, name: str) -> Path:
    """The file of an artefact (`ARTEFACTS`, ``matter``, ``views``): in ``folder`` or up to two folders above.

    Raises:
        FileNotFoundError: it is in none of them.
    """
    file = f"{name}.safetensors"
    for place in (folder, *folder.resolve().parents[:2]):
        if (place / file).is_file():
            return place / file
    raise FileNotFoundError(f"{folder}: no {file} there or up to two folders above; name a finished fit")


def rollout(
    run: FittedRun, inputs: Float64[np.ndarray, "N n_u"], *, frame: int | None = None
) -> tuple[Float64[np.ndarray, "N d"], Float64[np.ndarray, "N d"]]:
    """Whitened states and velocities [1/s] under ``inputs``, one a frame of the recording.

    From rest at the encoded rest image, or with the encoded state and velocity of ``frame``, the latter by
    the true times of frames of its clip. Inputs are the median spacing of the recording apart.

    Raises:
        ValueError: the number of inputs is not the run's, the frame is not in the recording, or its clip has
        less than three frames.

    Example:
        >>> import lagsplat, numpy
        >>> run = lagsplat.open_run("run")
        >>> states, velocities = lagsplat.rollout(run, numpy.zeros((9, 2)))
        >>> states.shape
        (9, 2)
    """
    chart = run.chart
    if inputs.shape[1] != chart.inputs.shape[1]:
        raise ValueError(f"{inputs.shape[1]} inputs, but the run was trained with {chart.inputs.shape[1]}")
    q0, v0 = chart.rest, np.zeros(chart.d)
    if frame is not None:
        _check_frame(chart, frame)
        smooth = chart.whole.smoothed(chart.smoothing_frames).latents
        at = np.array([frame])
        q0, v0 = smooth[frame], chart.whole.clock.slope(smooth, at, _stencil(chart, frame))[0]
    start = (torch.as_tensor(x[None]) for x in (q0, v0, inputs))
    q, v = integrate(run.lagrangian, *start, dt_s=chart.dt_s)
    return q[0].double().numpy(), v[0].double().numpy()


def choose_state(run: FittedRun, frame: str | None, q: str | None) -> Float64[np.ndarray, " d"]:
    """The whitened state that a command names: that of a frame as it was encoded, given numbers, or rest.

    Raises:
        ValueError: both are given, what is given is no number, or the recording has no such frame.
    """
    if frame is not None and q is not None:
        raise ValueError(f"frame={frame} and q={q} exclude each other: a frame has its own state")
    try:
        if q is not None:
            return np.array([float(number) for number in q.split(",")])
        if frame is None:
            return run.chart.rest
        number = int(frame)
    except ValueError as error:
        raise ValueError(f"frame={frame} q={q}: give a frame's number, or q=q0,q1,... ({error})") from error
    _check_frame(run.chart, number)
    return run.chart.latents[number]


def _check_frame(chart: Chart, frame: int) -> None:
    if not 0 <= frame < len(chart.latents):
        raise ValueError(f"frame={frame}: the recording has frames 0 to {len(chart.latents) - 1}")


def _stencil(chart: Chart, frame: int) -> tuple[int, int]:
    """Two neighbours within the frame's clip that give its velocity to second order, later ones first."""
    start, stop = next((a, b) for a, b in chart.segments if a <= frame < b)
    for pair in ((1, 2), (-1, 1), (-2, -1)):
        if start <= frame + pair[0] and frame + pair[1] < stop:
            return pair
    raise ValueError(
        f"frame={frame} lies in a clip of {stop - start} frame(s) and a velocity needs three; choose a frame "
        "of a longer clip"
    )
