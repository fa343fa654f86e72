"""Run the authors' GaussianPrediction on a clip: check the checkout, build its commands, read its frames.

The repository carries no licence, so nothing of it is part of this project; only its documented commands are
used, through `static_camera`.

Source: facts of github.com/BoMingZhao/GaussianPrediction, commit 301f3d5.
"""

import logging
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from lagsplat.array_types import Frames
from lagsplat.baselines import static_camera
from lagsplat.baselines.config import AuthorsConfig
from lagsplat.io.video.image_sequence import read_predicted, write_dnerf
from lagsplat.processes import ends_with_this_process


def predict_frames(
    frames: Frames, config: AuthorsConfig, *, n_train: int, place: Path, say: Callable[[object], None]
) -> UInt8[np.ndarray, "N H W 3"]:
    """Predicted frames from the first held-out one on: at least as many as are held out.

    With ``config.frames`` they are read from that folder. Otherwise the tool is trained on the first
    ``n_train`` frames and predicts freely, beginning with the held-out ones. ``place`` is a folder for its
    files, ``say`` reports progress.

    Raises:
        FileNotFoundError, ValueError: no checkout or folder, submodules not fetched, or predicted frames of
            another size or count.
        RuntimeError: no CUDA, or the tool failed.
    """
    _, height, width, _ = frames.shape
    wanted = {"height": height, "width": width, "at_least": len(frames) - n_train}
    if config.frames is not None:
        return read_predicted(Path(config.frames).expanduser(), **wanted)
    checkout = check_checkout(str(config.checkout))
    say(f"the authors' tool in {checkout}, torch, CUDA and a device: {check_cuda(str(config.python))}")
    data = place.resolve() / "data"
    model = place.resolve() / "d-nerf" / "model"  # the tool reads D-NeRF data only where the path says so
    camera = {"field_of_view_rad": config.field_of_view_rad, "distance": config.distance}
    max_time = write_dnerf(data, frames, n_train=n_train, **camera)
    commands = [make_train_command(config, data=data, model=model, max_time=max_time)]
    for free in (False, True):
        commands.append(make_forecast_command(config, model=model, max_time=max_time, free=free))
    for command in commands:
        say(" ".join(command))
        run_tool(command, checkout=checkout)
    written = f"ours_{config.iterations}/renders"
    read_predicted(model / EXPERIMENT / "[metrics]Predicted_by_GCN_on_test_views" / written, **wanted)
    return read_predicted(model / EXPERIMENT / "Predicted_more_by_GCN" / written / "view0", **wanted)


log = logging.getLogger(__name__)
PROGRAMS = ("train.py", "train_GCN.py", "scene/dataset_readers.py")
SUBMODULES = ("submodules/simple-knn", "submodules/diff-gaussian-rasterization-w-depth", "submodules/FRNN")
KEY_POINTS = "--max_points 100 --adaptive_points_num 100"
SHARED = "--time_freq 6 --nearest_num 6 --feature_amplify 0.5 --norm_rotation"
EXPERIMENT = "lagsplat"
ASK_CUDA = "import torch; print(torch.__version__, torch.version.cuda, torch.cuda.is_available())"


def check_checkout(checkout: str) -> Path:
    """The folder of a checkout that has everything the tool needs."""
    place = Path(checkout).expanduser()
    missing = [name for name in PROGRAMS if not (place / name).is_file()]
    if missing:
        reason = f"no {missing[0]} in it" if place.is_dir() else "no such folder"
        raise FileNotFoundError(
            f"authors.checkout={checkout}: {reason}; give a clone of github.com/BoMingZhao/GaussianPrediction"
        )
    empty = [name for name in SUBMODULES if not (place / name).is_dir() or not any((place / name).iterdir())]
    if empty:
        raise ValueError(
            f"authors.checkout={checkout}: nothing in {', '.join(empty)}; run "
            "`git submodule update --init --recursive` there and build what its README lists"
        )
    return place


def check_cuda(python: str) -> str:
    """Versions of torch and CUDA in the tool's interpreter."""
    try:
        done = subprocess.run([python, "-c", ASK_CUDA], capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise FileNotFoundError(
            f"authors.python={python}: no such interpreter; give the tool's own"
        ) from error
    if done.returncode:
        raise RuntimeError(
            f"authors.python={python}: has no torch {done.stderr.strip().splitlines()[-1:]}; give the "
            "interpreter of the environment that the tool's README makes"
        )
    versions = done.stdout.strip()
    if not versions.endswith("True"):
        raise RuntimeError(
            f"authors.python={python}: torch {versions.split()[0]} finds no CUDA device, and the tool runs "
            "on nothing else; run it on another machine and give its frames with authors.frames=FOLDER"
        )
    return versions


def make_train_command(config: AuthorsConfig, *, data: Path, model: Path, max_time: float) -> list[str]:
    """The command that trains Gaussians, motion and key points; ``max_time`` ends the training part."""
    steps = config.iterations
    options = (
        f"--eval --seed 1 {KEY_POINTS} --iterations {steps} --test_iterations {steps} "
        f"--jointly_iteration 1000 --save_iterations 29999 {steps} --checkpoint_iterations 29999 {steps} "
        "--densify_from_iter 3000 --densify_until_iter 20000 --position_lr_max_steps 40000 "
        f"--adaptive_from_iter 3000 --adaptive_interval 500 --max_time {max_time!r} {SHARED}"
    )
    return [*_program(config, "train.py"), "-s", str(data), "-m", f"{model}/", *options.split()]


def make_forecast_command(config: AuthorsConfig, *, model: Path, max_time: float, free: bool) -> list[str]:
    """The command that trains the graph network and predicts the held-out frames, or freely from these on.

    The settings of the training are repeated: the tool would use its defaults, not what it was trained with.
    """
    mode = f"--evaluate --predict_more --frames {config.free_frames} --cam_id 0" if free else "--metrics"
    options = (
        f"--ckpt_iteration {config.iterations} --max_time {max_time!r} {KEY_POINTS} --num_stage 6 "
        f"--noise_step 100 --noise_init 0 --input_size 10 --epoch {config.epochs} --exp_name {EXPERIMENT} "
        f"{SHARED} {mode}"
    )
    return [*_program(config, "train_GCN.py"), "-m", f"{model}/", *options.split()]


def run_tool(command: Sequence[str], *, checkout: Path) -> None:
    """Run a command from the checkout; a failure is quoted with the last lines of the log."""
    log.info("in %s: %s", checkout, " ".join(command))
    done = subprocess.run(
        command, cwd=checkout, capture_output=True, text=True, check=False, **ends_with_this_process()
    )
    log.info("%s%s", done.stdout, done.stderr)
    if done.returncode:
        reason = (done.stderr.strip() or done.stdout.strip() or "no reason given")[-600:]
        raise RuntimeError(f"{command[3]} of {checkout} failed: {reason}")


def _program(config: AuthorsConfig, name: str) -> list[str]:
    wrapper = str(Path(static_camera.__file__).resolve())
    return [str(config.python), wrapper, repr(config.extent), name]
