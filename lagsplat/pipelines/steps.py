"""Each step from a video to a diagnosed simulation as one call with plain arguments.

These are the functions of ``import lagsplat``. They read the settings of ``conf/`` and call the steps of the
other rooms, which take typed settings. Overrides are words of Hydra, such as ``"stage1.steps=9000"``.
"""

import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from omegaconf import OmegaConf

from lagsplat.chart.chart import Chart, require_trained_autoencoder
from lagsplat.chart.chart import fit_chart as fit_chart_with
from lagsplat.config.compose import ConfigError, compose, rebuild
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import evaluate as evaluate_models
from lagsplat.forces.operating_point import OperatingPoint, hold_at_load
from lagsplat.io.files.atomic import load_json
from lagsplat.io.lerobot.dataset import is_lerobot
from lagsplat.io.read import read_recording as read_with
from lagsplat.io.recording.recording import Recording, load_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.io.robot_log.storage import is_log
from lagsplat.runs.fit import obtain_recording
from lagsplat.runs.run import FittedRun, locate_artefact, open_run
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.fit import fit_autoencoder as fit_autoencoder_with
from lagsplat.stage1.linear_response import InputHistory
from lagsplat.stage2.decoder_mass import compute_decoder_geometry
from lagsplat.stage2.fit import fit_dynamics as fit_dynamics_with
from lagsplat.stage2.fit import load_dynamics
from lagsplat.stage2.lagrangian import Lagrangian

PathLike = str | os.PathLike[str]


def reading_overrides(path: Path) -> list[str]:
    """How a file is read by default: an archive by its pressures, a log as one, else as a video."""
    source = ["recording=filmed", f"recording.path={str(path)!r}"]
    if path.suffix == ".safetensors":
        return source
    if is_log(path):
        return [*source, "recording.kind=mcap"]
    if is_lerobot(path):
        return [*source, "recording.kind=lerobot"]
    if path.suffix != ".npz":
        return [*source, "recording.kind=video", "recording.n_inputs=0", "recording.dt_s=null"]
    names = zipfile.ZipFile(path).namelist() if zipfile.is_zipfile(path) else []
    pressures = sum(name.removesuffix(".npy")[1:].isdigit() for name in names if name.startswith("p"))
    return [*source, "recording.kind=krauss", f"recording.n_inputs={pressures}"]


def read_recording(path: PathLike, *overrides: str) -> Recording:
    """Read a video, images, an archive, a robot's log, a LeRobot dataset or a ``recording.safetensors``.

    Args:
        path: The file or folder.
        overrides: Settings of ``conf/recording``, such as ``"recording.height=64"`` [px].

    Returns:
        The recording: frames (T, H, W, 3), times [s], inputs (T, n_u), and which frames are held out.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: the file cannot be read, or a setting is unknown.

    Example:
        >>> import lagsplat
        >>> recording = lagsplat.read_recording("run/recording.safetensors")
        >>> recording.frames.shape[3]
        3
    """
    path = Path(path).expanduser()
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder; check the path")
    if path.suffix == ".safetensors":
        return load_recording(path)
    config = compose(*reading_overrides(path), *overrides).recording
    return split_train_held_out(read_with(config), config.split)


def simulate_recording(*overrides: str) -> Recording:
    """Simulate the recording of a mechanism, with its train and held-out parts.

    Args:
        overrides: Settings such as ``"system=rainbow_rocker"``; a driven arm without any.

    Raises:
        ValueError: an unknown setting, or a system that is only filmed.

    Example:
        >>> import lagsplat
        >>> lagsplat.simulate_recording("system=toy", "simulation.n_frames=240").n_frames
        240
    """
    experiment = compose("recording=simulated", *overrides)
    return split_train_held_out(obtain_recording(experiment)[0], experiment.recording.split)


def fit_autoencoder(recording: Recording, *overrides: str, seed: int = 0) -> Autoencoder:
    """Fit the image model, an encoder and Gaussians that move with the latent state, to a recording.

    Args:
        recording: Only its training frames are used.
        overrides: Settings such as ``"system.d=2"`` (latent dimension) or ``"stage1.steps=9000"``.
        seed: Of the random numbers of the fit.

    Raises:
        ValueError: an unknown setting, or the fit drew nothing but the background.

    Example:
        >>> import lagsplat
        >>> recording = lagsplat.read_recording("run/recording.safetensors")
        >>> small = ("system=toy", "system.n_gaussians=64", "stage1.steps=2", "stage1.batch=2")
        >>> lagsplat.fit_autoencoder(recording, *small).gaussians.n > 0
        True
    """
    train, _ = recording.split()
    history = InputHistory(train.inputs, train.segments)
    autoencoder, _ = fit_autoencoder_with(
        train.frames, compose(*overrides).stage1, seed=seed, history=history
    )
    return autoencoder


def fit_chart(autoencoder: Autoencoder, recording: Recording, *overrides: str, seed: int = 0) -> Chart:
    """Encode a recording and whiten its latents: the coordinates in which the dynamics are learned.

    Args:
        autoencoder: From `fit_autoencoder`.
        recording: The same recording.
        overrides: Settings such as ``"chart.smoothing_frames=2"`` [frames].
        seed: Of the frames on which visibility and dimension are measured.

    Raises:
        ValueError: an unknown setting, or latents that do not vary: the image model learned nothing.

    Example:
        >>> import lagsplat
        >>> run = lagsplat.open_run("run")
        >>> lagsplat.fit_chart(run.autoencoder, run.recording, "chart.visibility_frames=4").d
        2
    """
    require_trained_autoencoder(autoencoder, recording.split()[0].frames)
    return fit_chart_with(autoencoder, recording, compose(*overrides).chart, seed=seed)


def fit_dynamics(autoencoder: Autoencoder, chart: Chart, *overrides: str, seed: int = 0) -> Lagrangian:
    """Fit mass, damping, potential and input map of a Lagrangian to the training part of a chart.

    Args:
        autoencoder: From `fit_autoencoder`; its Gaussians give the mass its form.
        chart: From `fit_chart`.
        overrides: Settings such as ``"stage2=constant"`` or ``"stage2.steps=200"``.
        seed: Of the networks and batches.

    Raises:
        ValueError: an unknown setting, or a recording too short for the settings.

    Example:
        >>> import lagsplat
        >>> run = lagsplat.open_run("run")
        >>> short = ["system=toy", "stage2.likelihood.iterations=2"]
        >>> lagsplat.fit_dynamics(run.autoencoder, run.chart, *short).d
        2
    """
    lagrangian, _ = fit_dynamics_with(
        chart.train.smoothed(chart.smoothing_frames),
        chart.metric,
        compose(*overrides).stage2,
        seed,
        rest=chart.rest,
        geometry=compute_decoder_geometry(autoencoder, chart),
        measured=chart.train,
    )
    return lagrangian


def read_protocol(folder: Path, changes: Sequence[str] = ()) -> EvaluateConfig:
    """How the run in ``folder`` is scored: by its own settings, with changes such as ``evaluate.starts=20``.

    They stand in the dynamics that `fit` writes, and beside the scores that the workflow makes.

    Raises:
        FileNotFoundError: the folder holds neither.
        ConfigError: a change is of something else than ``evaluate``, or unknown.
    """
    if other := [change for change in changes if not change.startswith("evaluate.")]:
        raise ConfigError(f"{other[0]!r}: a run keeps its settings; only evaluate.KEY=VALUE can be changed")
    _, header = load_dynamics(locate_artefact(folder, "dynamics"))
    record = folder / "evaluate.json"
    if "config" in header:
        own = header["config"]["evaluate"]
    elif record.is_file():
        own = load_json(record)["settings"]["cfg"]
    else:
        raise FileNotFoundError(f"{folder}: no evaluate.json says how this run is scored; evaluate it first")
    changed = OmegaConf.from_dotlist([change.removeprefix("evaluate.") for change in changes])
    return rebuild(EvaluateConfig, OmegaConf.to_container(OmegaConf.merge(own, changed)))  # type: ignore[arg-type]


def evaluate(run: FittedRun | PathLike, *overrides: str) -> dict[str, Any]:
    """Score a run on the held-out part of its recording, under the protocol it was made with.

    Args:
        run: A fitted run from a folder, or the folder.
        overrides: Changes of the protocol, such as ``"evaluate.starts=20"``.

    Returns:
        Scores by name, and the curves behind them; errors are mean squares of images in [0, 1] or fractions.

    Raises:
        FileNotFoundError: nothing says how the run is scored.
        ValueError: a change of something else than the protocol, or a run that was never in a folder.

    Example:
        >>> import lagsplat
        >>> scores = lagsplat.evaluate("run", "evaluate.starts=2")["scores"]
        >>> 0 < scores["ae_floor"] < 1
        True
    """
    run = run if isinstance(run, FittedRun) else open_run(run)
    if run.folder is None:
        raise ValueError("this run has no folder, which holds how it is scored; open it with open_run")
    protocol = read_protocol(run.folder, overrides)
    return evaluate_models(run.autoencoder, run.chart, run.lagrangian, run.recording, protocol)


def hold(run: FittedRun | PathLike, inputs: Float64[np.ndarray, " n_u"] | None = None) -> OperatingPoint:
    """Let a run come to rest under constant inputs, so that it can be pushed there.

    Args:
        run: A fitted run or its folder.
        inputs: Constant inputs; the mean of the recorded ones if left out.

    Raises:
        ValueError: no equilibrium is reached.

    Example:
        >>> import lagsplat
        >>> lagsplat.hold("run").rest.shape
        torch.Size([2])
    """
    run = run if isinstance(run, FittedRun) else open_run(run)
    return hold_at_load(run.autoencoder, run.chart, run.lagrangian, run.matter, inputs)


def push(
    run: FittedRun | PathLike,
    at: tuple[float, float],
    direction: tuple[float, float],
    *,
    share: float | None = None,
    hold_s: float = 1.0,
    duration_s: float = 3.0,
    brush: float | None = None,
) -> tuple[Float64[np.ndarray, "N d"], Float64[np.ndarray, "N d"]]:
    """Push a run at a point of its image, let go, and follow the motion.

    The force is constant while it is held. It needs no scale in newtons: ``share`` says how far it drives the
    state at rest, as a share of how far the recording went.

    Args:
        run: A fitted run or its folder.
        at: Where to push, x to the right and y down [px of the training image].
        direction: Along which to push (right, down); only its direction counts.
        share: Of the recorded range [1]; by default ``forces.response``.
        hold_s: How long the force is held [s].
        duration_s: How long the motion is followed [s].
        brush: Radius within which matter is grasped, as a share of the image's width [1]; by
            default ``forces.brush``.

    Returns:
        States (N, d), whitened, and velocities (N, d) [1/s], one frame of the recording apart.

    Raises:
        ValueError: nothing is drawn at the point, or the matter there does not move that way.

    Example:
        >>> import lagsplat
        >>> run = lagsplat.open_run("run")
        >>> at, along = lagsplat.find_lever(run)
        >>> states, velocities = lagsplat.push(run, at, along, duration_s=0.5)
        >>> states.shape == velocities.shape
        True
    """
    point, defaults = hold(run), compose().forces
    grasp = point.grasp(at, radius=(defaults.brush if brush is None else brush) * point.width)
    q, v = point.push(
        grasp,
        np.asarray(direction, dtype=np.float64),
        share=defaults.response if share is None else share,
        hold_s=hold_s,
        duration_s=duration_s,
    )
    return q.numpy(), v.numpy()


def find_lever(run: FittedRun | PathLike) -> tuple[tuple[float, float], tuple[float, float]]:
    """A point of the image that moves most when the state changes, and the direction in which it moves.

    Returns:
        The point [px], x to the right and y down, and a unit vector (right, down), towards the middle.

    Example:
        >>> import lagsplat
        >>> at, along = lagsplat.find_lever("run")
        >>> len(at), len(along)
        (2, 2)
    """
    return hold(run).find_lever()
