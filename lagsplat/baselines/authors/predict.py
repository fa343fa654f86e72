"""From a clip to the frames that the authors' tool predicts of it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from lagsplat.baselines.authors.config import AuthorsConfig
from lagsplat.baselines.authors.tool import (
    check_checkout,
    check_cuda,
    forecast_command,
    launch,
    model_folder,
    predicted_folder,
    train_command,
)
from lagsplat.io.dnerf import write_dnerf
from lagsplat.io.predicted_frames import read_predicted
from lagsplat.shapes import Frames


def predicted_frames(
    frames: Frames, config: AuthorsConfig, *, n_train: int, place: Path, say: Callable[[object], None]
) -> UInt8[np.ndarray, "N H W 3"]:
    """Predicted frames from the first held-out one on: at least as many as are held out, uint8 (N,H,W,3).

    With ``config.frames`` they are read from that folder. Else the clip ``frames`` is written below
    ``place`` in the layout that the tool reads, the tool is trained and asked for a free run, which begins
    with the held-out frames. What it is doing is told to ``say``.

    Raises:
        FileNotFoundError, ValueError: no checkout or folder, submodules not fetched, or predicted frames of
            another size or count.
        RuntimeError: no CUDA, or the tool failed.
    """
    _, height, width, _ = frames.shape
    held = len(frames) - n_train
    if config.frames is not None:
        folder = Path(config.frames).expanduser()
        return read_predicted(folder, height=height, width=width, at_least=held)
    checkout = check_checkout(str(config.checkout))
    say(f"the authors' tool in {checkout}, torch, CUDA and a device: {check_cuda(str(config.python))}")
    data, model = place.resolve() / "data", model_folder(place.resolve())
    max_time = write_dnerf(
        data,
        frames,
        n_train=n_train,
        field_of_view_rad=config.field_of_view_rad,
        distance=config.distance,
    )
    for command in (
        train_command(config, data=data, model=model, max_time=max_time),
        forecast_command(config, model=model, max_time=max_time, free=False),
        forecast_command(config, model=model, max_time=max_time, free=True),
    ):
        say(" ".join(command))
        launch(command, checkout=checkout)
    tested = predicted_folder(config, model, free=False)
    read_predicted(tested, height=height, width=width, at_least=held)
    return read_predicted(
        predicted_folder(config, model, free=True), height=height, width=width, at_least=held
    )
