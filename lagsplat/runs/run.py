"""The road from a recording to its scores in one process, for the command line.

The workflow walks the same functions one job at a time and keeps what it can; this module suits a single run.
A run is a folder with the artefacts of every stage; in the workflow's results they stand up to two folders
higher, where several runs share them.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64
from omegaconf import OmegaConf

from lagsplat.chart.chart import Chart, fit_chart, load_chart, require_trained, save_chart
from lagsplat.config.compose import Config, ConfigError, rebuild
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import evaluate
from lagsplat.io.files.json_files import load_json
from lagsplat.io.read import read_recording
from lagsplat.io.recording.recording import Recording, load_recording, save_recording
from lagsplat.io.recording.segments import divide
from lagsplat.novel_views.sharp import obtain_views
from lagsplat.stage1.autoencoder import Autoencoder, load_autoencoder, save_autoencoder
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage2.decoder_mass import decoder_geometry
from lagsplat.stage2.fit import fit_dynamics, load_dynamics, save_dynamics
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import rollout
from lagsplat.systems.simulate import stand_in
from lagsplat.systems.truth import Truth
from lagsplat.views.novel import save_views

log = logging.getLogger(__name__)
FILES = ("recording", "autoencoder", "chart", "dynamics")


@dataclass(frozen=True)
class Run:
    """The artefacts of one trained simulation."""

    recording: Recording
    autoencoder: Autoencoder
    chart: Chart
    lagrangian: Lagrangian


def obtain(experiment: Config) -> tuple[Recording, Truth | None]:
    """The recording an experiment is about, read from a file or fetched, or simulated with its truth."""
    if experiment.recording.kind != "simulated":
        return read_recording(experiment.recording), None
    return stand_in(experiment.simulation, experiment.release, seed=0)


def fit(experiment: Config, *, out: Path, header: Mapping[str, Any]) -> Run:
    """Fit every stage to the experiment's recording and keep the artefacts in ``out``.

    Seeds are the experiment's first. A stopped fit goes on where stage 1 was.

    Raises:
        ValueError: the recording is unreadable or too short for the split, or stage 1 learned nothing.
    """
    made, truth = obtain(experiment)
    recording = divide(made, experiment.recording.split)
    train, _ = recording.split()
    save_recording(out / "recording.safetensors", recording)
    checkpoint, seed = out / "checkpoint" / "state.pt", experiment.autoencoder_seeds[0]
    identity = f"{header} {recording.meta.get('sha256')} {recording.n_train} {seed}"
    novel = None
    if experiment.views is not None:
        novel = obtain_views(
            experiment.views, recording, experiment.recording, released=experiment.release,
            states=None if truth is None else truth.states, cache=out / "sharp",
        )  # fmt: skip
        save_views(out / "views.safetensors", novel, header)
    autoencoder, _ = fit_autoencoder(
        train.frames, experiment.stage1, seed=seed, checkpoint=checkpoint, identity=identity,
        novel=None if novel is None else novel.first(train.n_frames),
        supervision=None if experiment.views is None else experiment.views.supervision,
    )  # fmt: skip
    save_autoencoder(out / "autoencoder.safetensors", autoencoder, header)
    require_trained(autoencoder, train.frames)
    chart = fit_chart(autoencoder, recording, experiment.chart, seed=seed)
    save_chart(out / "chart.safetensors", chart, header)
    lagrangian, report = fit_dynamics(
        chart.train.smoothed(chart.smoothing_frames),
        chart.metric,
        experiment.stage2,
        experiment.seeds[0],
        rest=chart.rest,
        geometry=decoder_geometry(autoencoder, chart),
        listen=lambda row: log.info("%s", row),
    )
    save_dynamics(out / "dynamics.safetensors", lagrangian, {**header, "report": asdict(report)})
    checkpoint.unlink(missing_ok=True)
    return Run(recording, autoencoder, chart, lagrangian)


def open_run(folder: Path) -> Run:
    """A run that `fit` or the workflow left in ``folder``.

    Raises:
        FileNotFoundError: an artefact is neither there nor in the two folders above.
    """
    found = {name: _locate(folder, f"{name}.safetensors") for name in FILES}
    autoencoder, _ = load_autoencoder(found["autoencoder"])
    chart, _ = load_chart(found["chart"])
    lagrangian, _ = load_dynamics(found["dynamics"])
    return Run(load_recording(found["recording"]), autoencoder, chart, lagrangian)


def _locate(folder: Path, name: str) -> Path:
    places = [folder, *folder.resolve().parents[:2]]
    for place in places:
        if (place / name).is_file():
            return place / name
    raise FileNotFoundError(
        f"{folder}: no {name} there or up to two folders above; give run=FOLDER of a finished fit"
    )


def protocol(folder: Path, changes: Sequence[str] = ()) -> EvaluateConfig:
    """How the run in ``folder`` is scored: by its own settings, with changes such as ``evaluate.starts=20``.

    They stand in the dynamics that `fit` writes, and beside the scores that the workflow makes.

    Raises:
        FileNotFoundError: the folder holds neither.
        ConfigError: a change is of something else than ``evaluate``, or unknown.
    """
    if other := [change for change in changes if not change.startswith("evaluate.")]:
        raise ConfigError(f"{other[0]!r}: a run keeps its settings; only evaluate.KEY=VALUE can be changed")
    _, header = load_dynamics(_locate(folder, FILES[-1] + ".safetensors"))
    record = folder / "evaluate.json"
    if "config" in header:
        own = header["config"]["evaluate"]
    elif record.is_file():
        own = load_json(record)["settings"]["cfg"]
    else:
        raise FileNotFoundError(f"{folder}: no evaluate.json says how this run is scored; evaluate it first")
    changed = OmegaConf.from_dotlist([change.removeprefix("evaluate.") for change in changes])
    return rebuild(EvaluateConfig, OmegaConf.to_container(OmegaConf.merge(own, changed)))  # type: ignore[arg-type]


def score(run: Run, config: EvaluateConfig) -> dict[str, Any]:
    """Every score of a run under a protocol."""
    return evaluate(run.autoencoder, run.chart, run.lagrangian, run.recording, config)


def push(
    run: Run, inputs: Float64[np.ndarray, "N n_u"], *, frame: int | None
) -> tuple[Float64[np.ndarray, "N d"], Float64[np.ndarray, "N d"]]:
    """Whitened states and velocities [1/s] under ``inputs``, one a frame of the recording.

    From rest at the encoded rest image, or with the encoded state and velocity of ``frame``, the latter by
    the true times of frames of its clip. Inputs are the median spacing of the recording apart.

    Raises:
        ValueError: the number of inputs is not the run's, the frame is not in the recording, or its clip has
        less than three frames.
    """
    chart = run.chart
    if inputs.shape[1] != chart.inputs.shape[1]:
        raise ValueError(
            f"{inputs.shape[1]} input columns, but the run was trained with {chart.inputs.shape[1]}"
        )
    if frame is not None and not 0 <= frame < len(chart.latents):
        raise ValueError(f"frame={frame}: the recording has frames 0 to {len(chart.latents) - 1}")
    q0, v0 = chart.rest, np.zeros(chart.d)
    if frame is not None:
        smooth = chart.whole.smoothed(chart.smoothing_frames).latents
        at = np.array([frame])
        q0, v0 = smooth[frame], chart.whole.clock.slope(smooth, at, _stencil(chart, frame))[0]
    start = (torch.as_tensor(x[None]) for x in (q0, v0, inputs))
    q, v = rollout(run.lagrangian, *start, dt_s=chart.dt_s)
    return q[0].double().numpy(), v[0].double().numpy()


def state_of(run: Run, frame: str | None, q: str | None) -> Float64[np.ndarray, " d"]:
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
    if not 0 <= number < len(run.chart.latents):
        raise ValueError(f"frame={frame}: the recording has frames 0 to {len(run.chart.latents) - 1}")
    return run.chart.latents[number]


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
